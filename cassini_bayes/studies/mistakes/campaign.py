"""Sets of honest events and of mistaken ones: what the checks of the package say of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.cached import cached_property
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import MISTAKES, MistakeError, TelemetryCheck
from cassini_bayes.events.telemetry import Chunk, TelemetryEvent
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.nominal import check_rows, nominal_values
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.studies.conditions import CRAFTS, draw_condition
from cassini_bayes.studies.mistakes.flights import EFFECTS, fly, with_events
from cassini_bayes.studies.mistakes.kinds import TELEMETRY, TOTALS
from cassini_bayes.studies.mistakes.oracle import (
    MATTERS,
    Answer,
    Physics,
    Recorded,
    answer_of,
    physics_of,
)
from cassini_bayes.studies.repeated import Repeated

MODULE: Final = "studies.mistakes.campaign"
FULL: Final[Mapping[str, int]] = {"honest": 500, "mistaken": 5}
QUICK: Final[Mapping[str, int]] = {"honest": 40, "mistaken": 1}
VERDICTS: Final = ("passed", "flagged", "refused", *MISTAKES)
"""``refused`` is under no name that can be accepted."""
NO_EFFECT: Final = -1
NO_EVENT: Final = -1
MOST_EVENTS: Final = 5
"""Of a draw: three biases or a bias and slews, and the table of its biases."""
FORMS: Final = ("every row", "one row of six", "a row alone")
TOTALS_PRIORS: Final[Mapping[str, str]] = {
    "A branch": "cassini_a_branch_2005.toml",
    "B branch": "cassini_b_branch_2010.toml",
}
CASES: Final = tuple((name, kind) for name, each in TELEMETRY.items() for kind in each.kinds)
"""Every mistake in telemetry with every kind of event that it is for."""
ROW_CASES: Final = tuple((name, form) for name in TOTALS for form in FORMS)


def judge(event: TelemetryEvent, chunk: Chunk, priors: Priors, sought: Sequence[str] = ()) -> str:
    """One of :data:`VERDICTS` on telemetry.

    A message names all mistakes that explain the data as well as the best does; the one that is
    ``sought`` counts if it is among them.
    """
    check = TelemetryCheck(event, priors.spacecraft, nominal_values(priors))

    def ask() -> Sequence[str]:
        check.take(chunk)
        return check.verdict().findings

    return _verdict(ask, sought)


def judge_rows(rows: Sequence[TotalsEvent], priors: Priors, sought: Sequence[str] = ()) -> str:
    """One of :data:`VERDICTS` on totals; as :func:`judge`."""
    return _verdict(lambda: check_rows(rows, priors, "totals.csv"), sought)


def _verdict(ask: Callable[[], Sequence[str]], sought: Sequence[str]) -> str:
    try:
        return "flagged" if ask() else "passed"
    except MistakeError as error:
        return next((name for name in error.mistakes if name in sought), error.mistakes[0])
    except InputError:
        return "refused"


@dataclass(frozen=True)
class Sets(Repeated):
    """Sets of events over conditions: scenario whose events are flown, and folder of priors."""

    scenario: Path
    priors: Path

    def inputs(self) -> list[Path]:
        """The scenario, and the priors files of telemetry and totals of all crafts."""
        files = (*(file for file, *_ in CRAFTS.values()), *TOTALS_PRIORS.values())
        return [self.scenario, *(self.priors / file for file in files)]


class Honest(Sets):
    """Draws over the conditions, every second one with a clear effect of the catalogue."""

    per_file = 10

    def repetition(self, index: int) -> Mapping[str, NDArray[Any] | float]:
        """Levels of the conditions, place of the effect in :data:`EFFECTS`, verdict by event."""
        rng = self.stream(0, index)
        condition = draw_condition(rng)
        if condition.events == "six biases":  # as good as three here, at half the time
            condition = with_events(condition, "three biases")
        effect = int(rng.integers(len(EFFECTS))) if index % 2 else NO_EFFECT
        hidden = None if effect == NO_EFFECT else list(EFFECTS)[effect]
        flight = fly(condition, self.scenario, self.priors, rng, hidden)
        verdicts = [judge(event, chunk, flight.priors) for event, chunk in flight.events]
        if flight.rows:
            totals = read_priors(self.priors / TOTALS_PRIORS[condition.craft])
            verdicts.append(judge_rows(flight.rows, totals))
        numbers = np.full(MOST_EVENTS, NO_EVENT)
        numbers[: len(verdicts)] = [VERDICTS.index(verdict) for verdict in verdicts]
        return {"levels": condition.places, "effect": effect, "verdict": numbers}


class WithMistakes(Sets):
    """Sets without effects: every mistake in turn in a bias, in slews, and in six totals rows."""

    per_file = 1

    def repetition(self, index: int) -> Mapping[str, NDArray[Any]]:
        """Verdict, largest shift of a scalar and nats, of :data:`CASES` and :data:`ROW_CASES`."""
        rng = self.stream(1, index)
        while True:
            condition = draw_condition(rng)
            flight = fly(with_events(condition, "bias and slews"), self.scenario, self.priors, rng)
            # few rows lie between the firings of some: commands refuse such events for that alone
            if all(answer_of([event], flight.priors) for event in flight.events):
                break
        table = fly(with_events(condition, "six biases"), self.scenario, self.priors, rng)
        believed = read_priors(self.priors / TOTALS_PRIORS[condition.craft])
        found = [*_of_telemetry(flight.events, flight.priors), *_of_rows(table.rows, believed)]
        verdicts, moved, nats = zip(*found, strict=True)
        return {
            "verdict": np.array([VERDICTS.index(verdict) for verdict in verdicts]),
            "moved": np.array(moved),
            "nats": np.array(nats),
        }


Found = tuple[str, float, float]
"""Verdict, shift and nats; the last two are only asked where nothing was said."""


def _of_telemetry(
    events: Sequence[tuple[TelemetryEvent, Chunk]], priors: Priors
) -> Iterator[Found]:
    honest: dict[str, tuple[TelemetryEvent, Chunk]] = {each[0].kind: each for each in events}
    oracles = {kind: Oracle((recorded,), priors) for kind, recorded in honest.items()}
    for name, kind in CASES:
        event, chunk = honest[kind]
        each = TELEMETRY[name]
        wrong = each.change(chunk)
        verdict = judge(event, wrong, priors, each.names)
        yield oracles[kind].found(verdict, ((event, wrong),), each.spread(kind))


def _of_rows(rows: Sequence[TotalsEvent], priors: Priors) -> Iterator[Found]:
    table, alone = Oracle(tuple(rows), priors), Oracle((rows[2],), priors)
    for name, form in ROW_CASES:
        each = TOTALS[name]
        oracle, wrong, changed = table, tuple(each.change(row) for row in rows), len(rows)
        if form == "one row of six":
            wrong, changed = (*rows[:2], wrong[2], *rows[3:]), 1
        elif form == "a row alone":
            oracle, wrong, changed = alone, (wrong[2],), 1
        verdict = judge_rows(wrong, priors, each.names)
        yield oracle.found(verdict, wrong, each.spread * changed)


@dataclass(frozen=True, eq=False)
class Oracle:
    """Answers and physics of one set of honest data, made when first asked for."""

    honest: tuple[Recorded, ...]
    priors: Priors

    @cached_property
    def _right(self) -> Answer | None:
        return answer_of(self.honest, self.priors)

    @cached_property
    def _true(self) -> Physics | None:
        return physics_of(self.honest, self.priors)

    def found(self, verdict: str, wrong: tuple[Recorded, ...], spread: float) -> Found:
        """The verdict on wrong data, and what :meth:`ask` says where nothing was said of them."""
        return verdict, *(self.ask(wrong, spread) if verdict == "passed" else _UNASKED)

    def ask(self, wrong: tuple[Recorded, ...], spread: float) -> tuple[float, float]:
        """How far a mistake moves a scalar, in σ, and the nats by which data speak for it.

        ``spread``: logarithm of the volume that a row of telemetry, or all of totals, gains by it.

        NaN where the package declines the honest data; infinite where it declines the wrong ones.
        """
        right, found = self._right, answer_of(wrong, self.priors)
        if right is None:
            return _UNASKED
        if found is None:
            return np.inf, np.inf
        moved = right.moved(found)
        if moved <= MATTERS:
            return moved, np.nan
        true, physics = self._true, physics_of(wrong, self.priors)
        if true is None or physics is None:
            return moved, np.inf
        return moved, true.best - spread * true.rows - physics.best


_UNASKED: Final = (np.nan, np.nan)
