"""The page of mistakes: mistake × data set, rates by input, honest draws by stratum."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Flags
from cassini_bayes.studies.conditions import strata_of
from cassini_bayes.studies.mistakes.campaign import (
    CASES,
    MODULE,
    NO_EFFECT,
    NO_EVENT,
    ROW_CASES,
    VERDICTS,
    Honest,
    WithMistakes,
)
from cassini_bayes.studies.mistakes.flights import EFFECTS
from cassini_bayes.studies.mistakes.kinds import TELEMETRY, TOTALS
from cassini_bayes.studies.mistakes.oracle import MATTERS, TELLS
from cassini_bayes.studies.study import Arrays, Study

NAMED: Final = "named"
KNOWN_NOT: Final = "cannot be known"
HARMLESS: Final = "harmless"
NOTHING: Final = "–"
RIGHT: Final = (NAMED, KNOWN_NOT)
WORSE: Final = ("wrong name", "missed", "flagged", KNOWN_NOT, NAMED, HARMLESS, NOTHING)
"""Outcomes, the one that matters most first."""
GOAL_NAMED: Final = 0.95  # of mistakes that matter and can be known: the goals of
GOAL_HONEST: Final = 0.01  # docs/results/index.md; of honest draws, disturbed


@dataclass(frozen=True)
class Outcome:
    """What became of a mistake in one set, in a word and in a cell."""

    word: str
    said: str


def outcome(verdict: str, names: Sequence[str], moved: float, nats: float) -> Outcome:
    """Judge a verdict; ``moved`` and ``nats`` are the oracle's where nothing was said."""
    if verdict in names:
        return Outcome(NAMED, NAMED)
    if verdict == "flagged":
        return Outcome("flagged", "flagged")
    if verdict != "passed":
        return Outcome("wrong name", f"**{verdict}**")
    if np.isnan(moved):
        return Outcome(NOTHING, NOTHING)
    if moved <= MATTERS:
        return Outcome(HARMLESS, f"harmless ({moved:.1f} σ)")
    said = f"({moved:.3g} σ, {nats:.2g} nats)"
    if nats < TELLS:
        return Outcome(KNOWN_NOT, f"not knowable {said}")
    return Outcome("missed", f"**missed {said}**")


def run_mistakes(study: Study, scenario: Path, priors: Path, numbers: Mapping[str, int]) -> bool:
    """Fly, judge and write the page; ``numbers`` are sets by part. Whether both goals are met."""
    honest = study.repeat(
        "honest", "honest draws", Honest(scenario, priors, seed=study.seed), numbers["honest"]
    )
    mistaken = study.repeat(
        "mistaken",
        "sets with mistakes",
        WithMistakes(scenario, priors, seed=study.seed),
        numbers["mistaken"],
    )
    outcomes = list(_outcomes(mistaken))
    counted = Counter(each.word for _, _, row in outcomes for each in row)
    disturbed = _disturbed(honest)
    body = [
        *_opening(outcomes, counted, disturbed),
        *_by_input(outcomes),
        *_by_stratum(honest, disturbed),
        *_by_mistake(outcomes),
    ]
    study.publish("Mistakes in data", "\n".join(body), MODULE, {}, {})
    return bool(_share(counted) >= GOAL_NAMED and disturbed.mean() <= GOAL_HONEST)


Row = tuple[str, str, list[Outcome]]
"""A mistake, where it stands, and its outcome in each set."""


def _outcomes(mistaken: Arrays) -> Iterator[Row]:
    keys = [("telemetry", *case) for case in CASES] + [("totals", *case) for case in ROW_CASES]
    by_case: dict[tuple[str, str, str], list[Outcome]] = {}
    for place, (source, name, where) in enumerate(keys):
        names = TELEMETRY[name].names if source == "telemetry" else TOTALS[name].names
        by_case[source, name, where] = [
            outcome(VERDICTS[int(verdict)], names, float(moved), float(nats))
            for verdict, moved, nats in zip(
                *(mistaken[key][:, place] for key in ("verdict", "moved", "nats")), strict=True
            )
        ]
    for (source, name, where), row in by_case.items():
        yield name, where if source == "telemetry" else f"totals, {where}", row
        if source == "telemetry" and where == "slew" and (source, name, "bias") in by_case:
            bias = by_case[source, name, "bias"]
            yield name, "both", [_of_both(a, b) for a, b in zip(bias, row, strict=True)]


def _of_both(bias: Outcome, slew: Outcome) -> Outcome:
    """A bias and a slew with the same mistake: what is said of the first is said."""
    for each in (bias, slew):
        if each.word in (NAMED, "wrong name"):
            return each
    return min(bias, slew, key=lambda each: WORSE.index(each.word))


def _share(counted: Mapping[str, int]) -> float:
    judged = sum(counted[word] for word in WORSE if word not in (HARMLESS, NOTHING))
    return sum(counted[word] for word in RIGHT) / max(judged, 1)


def _disturbed(honest: Arrays) -> Flags:
    """Draws of which anything was refused or flagged."""
    quiet = (honest["verdict"] == VERDICTS.index("passed")) | (honest["verdict"] == NO_EVENT)
    return np.asarray(~quiet.all(axis=1))


def _opening(
    outcomes: Sequence[Row],
    counted: Mapping[str, int],
    disturbed: Flags,
) -> list[str]:
    kinds, sets = len({name for name, _, _ in outcomes}), len(outcomes[0][2])
    judged = sum(counted[word] for word in WORSE if word not in (HARMLESS, NOTHING))
    right = sum(counted[word] for word in RIGHT)
    return [
        f"What the checks ([Mistakes in data](../topics/plausibility.md)) say of {kinds} kinds of",
        f"mistakes in {sets} data sets each, and of {len(disturbed)} honest draws, every second",
        "one with a clear effect of the catalogue. Conditions (controller, cadence, noise, craft,",
        "steps of counters and wheels) are those of the [calibration over",
        "conditions](conditions.md).",
        "",
        f"* **{right} of {judged} mistakes that matter are named, or cannot be known"
        f" ({100 * _share(counted):.1f} %; goal {100 * GOAL_NAMED:.0f} %)**:"
        f" {counted[NAMED]} named, {counted[KNOWN_NOT]} cannot be known;"
        f" {counted['wrong name']} refused under another name, {counted['flagged']} flagged without"
        f" one, {counted['missed']} missed.",
        f"* **{int(disturbed.sum())} of {len(disturbed)} honest draws are refused or flagged"
        f" ({100 * disturbed.mean():.1f} %; goal at most {100 * GOAL_HONEST:.0f} %).**",
        "",
        "Where nothing is said, the model is fitted (Laplace) to the data as they should be and as",
        f"they are. A mistake matters if it moves any inferred scalar by more than {MATTERS:.0f} σ;"
        f" harmless ones ({counted[HARMLESS]})",
        "are not counted, nor are events that no fit takes"
        f" ({counted[NOTHING]}). It cannot be known if the data",
        f"speak for it by less than {TELLS:.0f} nats against priors five times as wide and any one",
        "effect of the catalogue ([how](../topics/plausibility.md#what-cannot-be-known)).",
        "",
    ]


def _by_input(outcomes: Sequence[Row]) -> list[str]:
    columns = (NAMED, KNOWN_NOT, "wrong name", "flagged", "missed", HARMLESS)
    lines = ["## By input", "", f"| input | {' | '.join(columns)} |", "| --- " * 7 + "|"]
    for where in dict.fromkeys(where for _, where, _ in outcomes):
        counted = Counter(each.word for _, own, row in outcomes if own == where for each in row)
        lines.append(f"| {where} | {' | '.join(str(counted[word]) for word in columns)} |")
    return [*lines, ""]


def _by_stratum(honest: Arrays, disturbed: Flags) -> list[str]:
    lines = ["## Honest draws", "", "| condition | level | draws | disturbed |", "| --- " * 4 + "|"]
    hides = honest["effect"] != NO_EFFECT
    of_effects = (("effect", "none", ~hides), ("effect", "a clear one", hides))
    for name, level, chosen in (*of_effects, *strata_of(honest["levels"])):
        if chosen.any():
            lines.append(f"| {name} | {level} | {chosen.sum()} | {disturbed[chosen].sum()} |")
    names = list(EFFECTS)
    for row in np.flatnonzero(disturbed):
        effect = names[int(honest["effect"][row])] if hides[row] else "no effect"
        said = [VERDICTS[int(v)] for v in honest["verdict"][row] if v > 0]
        lines += ["", f"Not passed: draw {row}, {effect}: {', '.join(said)}."]
    return [*lines, ""]


def _by_mistake(outcomes: Sequence[Row]) -> list[str]:
    sets = len(outcomes[0][2])
    heads = " | ".join(f"set {i + 1}" for i in range(sets))
    lines = [
        "## By mistake and data set",
        "",
        f"| mistake | in | {heads} |",
        "| --- " * (sets + 2) + "|",
    ]
    for name, where, row in outcomes:
        lines.append(f"| {name} | {where} | {' | '.join(each.said for each in row)} |")
    return lines
