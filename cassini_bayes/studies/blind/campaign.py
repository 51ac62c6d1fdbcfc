"""The blind campaign: its trials, and the tables, figures and page of results.

``cassini-bayes calibrate blind`` writes ``docs/results/blind``, with ``--conditions``
``docs/results/blind-conditions``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from cassini_bayes.errors import InputError
from cassini_bayes.files.checkpoint import RecordStore
from cassini_bayes.files.json_file import read_json
from cassini_bayes.files.pieces import run_pieces
from cassini_bayes.files.storage import write_bytes, write_text
from cassini_bayes.files.tables import frame_csv
from cassini_bayes.report.plots import encode
from cassini_bayes.report.plots.blind import blind_figure, conditions_figure, confusion_figure
from cassini_bayes.report.study_page import table_of
from cassini_bayes.studies.blind.by_condition import LEVEL, POOLED, by_condition, condition_lines
from cassini_bayes.studies.blind.flights import Blind
from cassini_bayes.studies.blind.rates import (
    COVERAGE,
    FAINT,
    ORACLE,
    Record,
    answered,
    confusion,
    expected_by_oracle,
    failed,
    rates,
    reliability,
    timing_table,
    trial_table,
)
from cassini_bayes.studies.blind.strata import (
    OVER_CONDITIONS,
    STRATA,
    Stratum,
    planned,
    stratum_of,
)
from cassini_bayes.studies.blind.trials import run_trial, trial_code, trial_name
from cassini_bayes.studies.study import Study

ENOUGH_TRIALS: Final = 40
FULL: Final[Mapping[str, int]] = {"trials": planned(STRATA)}
QUICK: Final[Mapping[str, int]] = {"trials": 47}
FULL_OVER_CONDITIONS: Final[Mapping[str, int]] = {"trials": planned(OVER_CONDITIONS)}
QUICK_OVER_CONDITIONS: Final[Mapping[str, int]] = {"trials": 16}
ASKED: Final = "Does the diagnosis find what is hidden from it? An effect is hidden in simulated"
ONE_CONDITION: Final = f"""\
{ASKED} telemetry: one
wheel bias and a slew set at 1 Hz, everything drawn from the priors, wheel rates anew in every
trial."""
OVER_CONDITIONS_DRAWN: Final = f"""\
{ASKED} telemetry.
Every trial draws craft, events, cadence, steps of counters and wheels, noise of rates, controller,
whether noise is known, and the torque that drives wheels; parameters are drawn from the priors,
wheel rates anew. What is hidden acts in all events of a trial."""


def run_campaign(study: Study, campaign: Blind, trials: int, parts: Sequence[str] = ()) -> None:
    """Run the trials that this code has not left in the study's folder.

    Of the first ``trials`` those of the ``parts`` named, or all: a trial has the same number, and
    hides the same, whichever are run.

    Raises
    ------
    InputError
        The campaign has no part of such a name.
    """
    names = [stratum.name for stratum in campaign.strata]
    if strange := sorted(set(parts) - set(names)):
        wanted = f"some of {', '.join(names)}"
        raise InputError("--parts", wanted, ", ".join(strange), "separate names by commas")
    made_by = {"seed": campaign.seed, "code": trial_code(), "events": list(campaign.events)}
    store = RecordStore(study.work, made_by)
    pieces = {
        trial_name(index): (index,)
        for index in range(trials)
        if not parts or stratum_of(campaign.strata, index).name in parts
    }
    for done, total in run_pieces(run_trial, campaign, pieces, store, study.workers):
        study.progress("blind trials", done, total)


def read_trials(folder: Path, seed: int) -> list[Record]:
    """The finished trials of a seed, all made by one state of the code.

    That of the running code if it left any, else the one that left most.
    """
    trials = [read_json(path, "a trial") for path in sorted(folder.glob("trial_*.json"))]
    records = [record for record in trials if record["seed"] == seed]
    codes = Counter(record["code"] for record in records)
    if not codes:
        return []
    code = trial_code()
    chosen = code if code in codes else codes.most_common(1)[0][0]
    return [record for record in records if record["code"] == chosen]


def write_results(study: Study, strata: Sequence[Stratum] = STRATA) -> dict[str, Any]:
    """Write tables, figures and the page of the trials in the study's folder; rates by name.

    ``strata`` are the parts that were planned. Trials over conditions are counted by level, too.

    Raises
    ------
    InputError
        No trial of the study's seed has a verdict.
    """
    records = read_trials(study.work, study.seed)
    if not any(map(answered, records)):
        raise InputError(
            str(study.work),
            f"finished trials of seed {study.seed} with a verdict",
            f"none among {len(records)}",
            "run more trials, or give the --seed and --work of those that there are",
        )
    table, headline = trial_table(records), rates(records)
    stated, matrix = reliability(records), confusion(records)
    frames = [
        ("trials", table, False),
        ("rates", headline, False),
        ("reliability", stated, False),
        ("timing", timing_table(records), False),
        ("confusion", matrix, True),
    ]
    figures = [
        ("blind", blind_figure(table, stated, headline)),
        ("confusion", confusion_figure(matrix)),
    ]
    title, told, levels = "Blind trials of the diagnosis", ONE_CONDITION, ""
    if any("condition" in record for record in records):
        counted = by_condition(records)
        title = "Blind trials over conditions"
        told, levels = OVER_CONDITIONS_DRAWN, _levels(counted)
        frames.append(("conditions", counted, False))
        figures.append(("conditions", conditions_figure(counted)))
    for name, frame, index in frames:
        write_text(study.page.with_name(f"{name}.csv"), frame_csv(frame, index))
    for name, figure in figures:
        write_bytes(study.page.with_name(f"{name}.png"), encode(figure, "png"))
    body = _body(records, table, headline, stated, _planned(records, strata), told, levels)
    study.publish(title, body, "studies.blind.trials", {}, {})
    counted = headline[headline["trials"] > 0]  # of parts that were not run there is no rate
    return dict(zip(counted["rate"], counted["value"], strict=True))


def _against_goal(row: Mapping[str, Any]) -> str:
    """The goal and whether the figure reaches it; null trials shall stay below theirs.

    Coverage has a value for its goal, and the interval holds it or not.

    Few trials show nothing either way: then no goal is called reached or missed.
    """
    if not row["reached"] or not row["trials"]:
        return ""
    goal = f"{row['goal']:.2f}"
    if row["rate"] == COVERAGE:
        result = "in the interval" if row["reached"] == "True" else "not in the interval"
    else:
        goal = f"{'≤' if str(row['rate']).startswith('null') else '≥'} {goal}"
        result = "reached" if row["reached"] == "True" else "missed"
    return f"{goal}: {'too few trials' if row['trials'] < ENOUGH_TRIALS else result}"


def _failures(table: pd.DataFrame) -> str:
    wrong = table[~table["named"].astype(bool) & (table["stratum"] != "uncatalogued")]
    odd = table[(table["stratum"] == "uncatalogued") & (table["first"] != "unknown")]
    return table_of(
        pd.concat([wrong, odd]),
        "trial | part | hidden | size (σ) | named first | its probability | cannot be told from",
        "{index} | {stratum} | {hidden} | {sigma} | {first} | {probability:.3f}"
        " | {confounded_with}",
    )


def _faint_sentence(records: Sequence[Record], headline: pd.DataFrame) -> str:
    value = headline.set_index("rate")["value"]
    if np.isnan(value[ORACLE]):
        return ""
    return (
        f"Faint causes: {value[FAINT]:.3f} are among the three best. The oracle has "
        f"{value[ORACLE]:.3f} on the same data (difference {value[FAINT] - value[ORACLE]:+.3f}); "
        f"{expected_by_oracle(records):.3f} is expected from draws. Here only the name itself "
        "counts, as at such sizes nearly all causes are within 3 nats of each other."
    )


def _errors(records: Sequence[Record]) -> str:
    lines = [f"- trial {r['index']} ({r['stratum']}): {r['error']}" for r in records if failed(r)]
    return "\n".join(["Trials that an exception ended, counted as misses:", "", *lines, ""])


def _planned(records: Sequence[Record], strata: Sequence[Stratum]) -> str:
    counts = Counter(r["stratum"] for r in records)
    return ", ".join(f"{s.name} {counts.get(s.name, 0)} of {s.trials}" for s in strata)


def _levels(counted: pd.DataFrame) -> str:
    """The section of trials over conditions, by level."""
    tested = counted[counted["condition"] != POOLED]
    wrong = [
        f"{row.condition.replace('_', ' ')} {row.level} ({row.rate})"
        for row in tested[tested["rejected"]].itertuples()
    ]
    return f"""\

## By condition

Shares with 95 % intervals. *null*, *clear*: trials of these parts, in brackets those that the
package declined: it refused the events before any search, in one line. Where nothing is hidden they
are left out; of clear trials they are misses, but left out in the last column. Goals: false alarms
at most 0.05, `unknown` at most 0.03, p-values below 0.05 in 0.05 of the trials, a clear cause, or
one that the oracle cannot tell from it, first in 0.95. Every level is tested (binomial), with
Holm's correction over all levels and rates; what is rejected at {LEVEL:.0%} is bold. Few trials
reject little.

**Rejected: {len(wrong)} of {len(tested)}{"" if not wrong else ": " + "; ".join(wrong)}.**

{condition_lines(counted)}

Dots: rates with 95 % intervals; filled ones are rejected, lines are the goals.

![Rates by condition]({"conditions.png"})

"""


def _body(
    records: Sequence[Record],
    table: pd.DataFrame,
    headline: pd.DataFrame,
    stated: pd.DataFrame,
    strata: str,
    told: str,
    levels: str,
) -> str:
    run = headline[headline["trials"] > 0]  # parts that were not run have no rates
    rows = table_of(
        run.assign(goal=[_against_goal(row) for row in run.to_dict(orient="records")]),
        "rate | count | value | 95 % interval (binomial) | goal",
        "{rate} | {hits} of {trials} | {value:.3f} | {low_95:.3f} … {high_95:.3f} | {goal}",
    )
    bins = table_of(
        stated.assign(inside=np.where(stated["inside"], "yes", "no")),
        "stated | trials | mean stated | right | 95 % interval (binomial) | holds what was stated",
        "{stated_from:.2f} … {stated_to:.2f} | {trials} | {mean_stated:.3f} | {right:.3f}"
        " | {low_95:.3f} … {high_95:.3f} | {inside}",
    )
    times = timing_table(records)
    broken = _errors(records) if any(map(failed, records)) else ""
    digests = ", ".join(sorted({r["code"] for r in records}))
    return f"""\
{told} The diagnosis gets no hint and says what is wrong. {len(records)} trials, by part, of those
planned: {strata}. [The method](../../topics/criticism.md) says what the parts are,
[what campaigns found](../diagnosis-campaigns.md) why trials failed.

{rows}

{_faint_sentence(records, headline)}
{levels}
![Power, reliability, p-values, coverage and rates]({"blind.png"})

Stated probability of the first cause against how often it is the hidden one (stratum `prior`):

{bins}

![Confusion]({"confusion.png"})

Trials in which the first cause is wrong, with confounded groups counted as right. `prior` and
`faint` also hold effects that are too small to be told from none.

{_failures(table)}

{broken}
One diagnosis took {times["cpu_diagnose_s"].median():.1f} s of one core in the median, and
{times["cpu_diagnose_s"].max():.1f} s at most. A whole trial with its flights took
{times["wall_s"].median():.1f} s of wall time. Tables: [trials](trials.csv), [rates](rates.csv),
[reliability](reliability.csv), [confusion](confusion.csv), [timing](timing.csv). Digest of the
diagnosing code: {digests}."""
