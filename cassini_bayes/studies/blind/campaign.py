"""The blind campaign: its trials, and the tables, figures and page of results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from cassini_bayes.files.checkpoint import RecordStore
from cassini_bayes.files.json_file import read_json
from cassini_bayes.files.pieces import run_pieces
from cassini_bayes.files.storage import write_bytes, write_text
from cassini_bayes.files.tables import frame_csv
from cassini_bayes.report.plots import encode
from cassini_bayes.report.plots.blind import blind_figure, confusion_figure
from cassini_bayes.studies.blind.flights import Blind
from cassini_bayes.studies.blind.rates import (
    COVERAGE,
    FAINT,
    ORACLE,
    Record,
    confusion,
    expected_by_oracle,
    failed,
    rates,
    reliability,
    timing_table,
    trial_table,
)
from cassini_bayes.studies.blind.strata import STRATA, planned
from cassini_bayes.studies.blind.trials import run_trial, trial_code, trial_name
from cassini_bayes.studies.study import Study

ENOUGH_TRIALS: Final = 40
FULL: Final[Mapping[str, int]] = {"trials": planned(STRATA)}
QUICK: Final[Mapping[str, int]] = {"trials": 47}


def run_campaign(study: Study, campaign: Blind, trials: int) -> None:
    """Run the trials that this code has not left in the study's folder."""
    made_by = {"seed": campaign.seed, "code": trial_code(), "events": list(campaign.events)}
    store = RecordStore(study.work, made_by)
    pieces = {trial_name(index): (index,) for index in range(trials)}
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


def write_results(study: Study) -> dict[str, Any]:
    """Write tables, figures and the page of the trials in the study's folder; the rates."""
    records = read_trials(study.work, study.seed)
    table, headline = trial_table(records), rates(records)
    stated, matrix = reliability(records), confusion(records)
    for name, frame, index in (
        ("trials", table, False),
        ("rates", headline, False),
        ("reliability", stated, False),
        ("timing", timing_table(records), False),
        ("confusion", matrix, True),
    ):
        write_text(study.page.with_name(f"{name}.csv"), frame_csv(frame, index))
    for name, figure in (
        ("blind", blind_figure(table, stated, headline)),
        ("confusion", confusion_figure(matrix)),
    ):
        write_bytes(study.page.with_name(f"{name}.png"), encode(figure, "png"))
    body = _body(records, table, headline, stated)
    study.publish("Blind trials of the diagnosis", body, "studies.blind.trials", {}, {})
    return {row["rate"]: row["value"] for row in headline.to_dict(orient="records")}


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
    return "\n".join(
        f"| {r['index']} | {r['stratum']} | {r['hidden']} | "
        f"{r['sigma']} | {r['first']} | {r['probability']:.3f} | "
        f"{r['confounded_with']} |"
        for r in pd.concat([wrong, odd]).to_dict(orient="records")
    )


def _faint_sentence(records: Sequence[Record], headline: pd.DataFrame) -> str:
    value = headline.set_index("rate")["value"]
    return (
        f"Faint causes: {value[FAINT]:.3f} are among the three best. The oracle has "
        f"{value[ORACLE]:.3f} on the same data (difference {value[FAINT] - value[ORACLE]:+.3f}); "
        f"{expected_by_oracle(records):.3f} is expected from draws. Here only the name itself "
        "counts, as at such sizes nearly all causes are within 3 nats of each other."
    )


def _errors(records: Sequence[Record]) -> str:
    lines = [f"- trial {r['index']} ({r['stratum']}): {r['error']}" for r in records if failed(r)]
    return "\n".join(["Trials that an exception ended, counted as misses:", "", *lines, ""])


def _body(
    records: Sequence[Record],
    table: pd.DataFrame,
    headline: pd.DataFrame,
    stated: pd.DataFrame,
) -> str:
    rows = "\n".join(
        f"| {r['rate']} | {r['hits']} of {r['trials']} | {r['value']:.3f} | "
        f"{r['low_95']:.3f} … {r['high_95']:.3f} | "
        f"{_against_goal(r)} |"
        for r in headline.to_dict(orient="records")
    )
    bins = "\n".join(
        f"| {r['stated_from']:.2f} … {r['stated_to']:.2f} | {r['trials']} | "
        f"{r['mean_stated']:.3f} | {r['right']:.3f} | {r['low_95']:.3f} … {r['high_95']:.3f} | "
        f"{'yes' if r['inside'] else 'no'} |"
        for r in stated.to_dict(orient="records")
    )
    counts = Counter(r["stratum"] for r in records)
    times = timing_table(records)
    broken = _errors(records) if any(map(failed, records)) else ""
    strata = ", ".join(f"{s.name} {counts.get(s.name, 0)} of {s.trials}" for s in STRATA)
    digests = ", ".join(sorted({r["code"] for r in records}))
    return f"""\
Does the diagnosis find what is hidden from it? An effect is hidden in simulated telemetry: one
wheel bias and a slew set at 1 Hz, everything drawn from the priors, wheel rates anew in every
trial. The diagnosis gets no hint and says what is wrong. {len(records)} trials, by part, of those
planned: {strata}. [The method](../../topics/criticism.md) says what the parts are,
[what campaigns found](../diagnosis-campaigns.md) why trials failed.

| rate | count | value | 95 % interval (binomial) | goal |
| --- | --- | --- | --- | --- |
{rows}

{_faint_sentence(records, headline)}

![Power, reliability, p-values, coverage and rates]({"blind.png"})

Stated probability of the first cause against how often it is the hidden one (stratum `prior`):

| stated | trials | mean stated | right | 95 % interval (binomial) | holds what was stated |
| --- | --- | --- | --- | --- | --- |
{bins}

![Confusion]({"confusion.png"})

Trials in which the first cause is wrong, with confounded groups counted as right. `prior` and
`faint` also hold effects that are too small to be told from none.

| trial | part | hidden | size (σ) | named first | its probability | cannot be told from |
| --- | --- | --- | --- | --- | --- | --- |
{_failures(table)}

{broken}
One diagnosis took {times["cpu_diagnose_s"].median():.1f} s of one core in the median, and
{times["cpu_diagnose_s"].max():.1f} s at most. A whole trial with its flights took
{times["wall_s"].median():.1f} s of wall time. Tables: [trials](trials.csv), [rates](rates.csv),
[reliability](reliability.csv), [confusion](confusion.csv), [timing](timing.csv). Digest of the
diagnosing code: {digests}."""
