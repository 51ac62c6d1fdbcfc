"""The blind campaign: run its trials resumably, count what was found, write tables and figures."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import beta
from threadpoolctl import threadpool_limits

from cassini_bayes import __version__
from cassini_bayes.criticism.blind import STRATA, code_digest, is_done, run_trial
from cassini_bayes.criticism.blind_flights import Blind
from cassini_bayes.plots import encode
from cassini_bayes.plots.blind import blind_figure, confusion_figure
from cassini_bayes.storage import write_bytes, write_text

Record = dict[str, Any]
NAMED: Final = 0.5
GOALS: Final[Mapping[str, float]] = {
    "clear: named first (confounded group counts)": 0.95,
    "null: causes[0] is not none": 0.05,
    "uncatalogued, detected: unknown first": 0.90,
    "two: both named": 0.80,
    "prior: 90 % intervals of the size hold it": 0.90,
}
ENOUGH_TRIALS: Final = 40
DETECTED_NATS: Final = 12.5
"""Half of 5²: an uncatalogued effect is clear where the best explanation gains this much."""


def run_campaign(
    campaign: Blind, trials: int, folder: Path, jobs: int
) -> Iterator[tuple[int, int]]:
    """Run the trials that this code has not left in ``folder``; yields (done, total)."""
    code = code_digest()
    missing = [i for i in range(trials) if not is_done(campaign, i, folder, code)]
    done = trials - len(missing)
    yield done, trials
    with ProcessPoolExecutor(max_workers=jobs) as pool:
        pending = [pool.submit(_one, campaign, i, folder) for i in missing]
        for future in as_completed(pending):
            future.result()
            done += 1
            yield done, trials


def _one(campaign: Blind, index: int, folder: Path) -> None:
    with threadpool_limits(1):  # the work is spread over processes; more threads would compete
        run_trial(campaign, index, folder)


def read_trials(folder: Path, seed: int) -> list[Record]:
    """The finished trials of a seed."""
    records = [json.loads(path.read_text()) for path in sorted(folder.glob("trial_*.json"))]
    return [record for record in records if record["seed"] == seed]


def interval(hits: int, n: int) -> tuple[float, float]:
    """Clopper-Pearson 95 % interval of a rate."""
    if n == 0:
        return 0.0, 1.0
    low = 0.0 if hits == 0 else float(beta.ppf(0.025, hits, n - hits + 1))
    high = 1.0 if hits == n else float(beta.ppf(0.975, hits + 1, n - hits))
    return low, high


def first(record: Record) -> str:
    """Name of the most probable cause."""
    return str(record["causes"][0]["name"])


def named(record: Record) -> bool:
    """Whether the first cause is (one of) the hidden, or is confounded with it, or rightly none."""
    hidden = [h["name"] for h in record["hidden"]]
    if not hidden:
        return first(record) == "none"
    group = {first(record), *record["confounded_with"]}
    return first(record) != "none" and any(name in group for name in hidden)


def _best_gain(record: Record) -> float:
    return max(float(c["log_bayes_factor"]) for c in record["causes"])


def _both(record: Record) -> bool:
    if record["pair"] is None:
        return False
    return {h["name"] for h in record["hidden"]} == set(str(record["pair"]).split("+"))


def rates(records: Sequence[Record]) -> pd.DataFrame:
    """Every headline rate with its count, 95 % interval and goal."""
    by = {s: [r for r in records if r["stratum"] == s] for s in {r["stratum"] for r in records}}
    null, clear, faint = (by.get(s, []) for s in ("null", "clear", "faint"))
    other = [r for r in by.get("uncatalogued", []) if _best_gain(r) > DETECTED_NATS]
    sizes = [s for r in by.get("prior", []) if r["hidden"] for s in r["sizes"]]
    counts = {
        "clear: named first (confounded group counts)": [named(r) for r in clear],
        "clear: named first, name alone": [first(r) == r["hidden"][0]["name"] for r in clear],
        "faint: among the three best real causes": [
            r["rank_of_truth"][0] is not None and r["rank_of_truth"][0] < 3 for r in faint
        ],
        "null: causes[0] is not none": [first(r) != "none" for r in null],
        "null: P(none) < 0.5": [r["probability_of_none"] < NAMED for r in null],
        "uncatalogued, detected: unknown first": [first(r) == "unknown" for r in other],
        "two: both named": [_both(r) for r in by.get("two", [])],
        "two: one of them first (group counts)": [named(r) for r in by.get("two", [])],
        "prior: truth first (none included, group counts)": [named(r) for r in by.get("prior", [])],
        "prior: 90 % intervals of the size hold it": [bool(s["covers"]) for s in sizes],
    }
    rows = []
    for name, hits in counts.items():
        low, high = interval(sum(hits), len(hits))
        rows.append(
            {
                "rate": name,
                "hits": sum(hits),
                "trials": len(hits),
                "value": sum(hits) / len(hits) if hits else float("nan"),
                "low_95": low,
                "high_95": high,
                "goal": GOALS.get(name, float("nan")),
            }
        )
    return pd.DataFrame(rows)


def reliability(records: Sequence[Record], bins: int = 5) -> pd.DataFrame:
    """Stated probability of the first cause against how often it was right, prior stratum."""
    chosen = [r for r in records if r["stratum"] == "prior"]
    stated = np.array([r["causes"][0]["probability"] for r in chosen])
    right = np.array([_exactly(r) for r in chosen], dtype=bool)
    edges = np.array([0.0, 0.5, 0.7, 0.85, 0.95, 1.0 + 1e-9])[: bins + 1]
    rows = []
    for low, high in pairwise(edges):
        inside = (stated >= low) & (stated < high)
        if inside.any():
            band = interval(int(right[inside].sum()), int(inside.sum()))
            rows.append(
                {
                    "stated_from": low,
                    "stated_to": min(high, 1.0),
                    "trials": int(inside.sum()),
                    "mean_stated": float(stated[inside].mean()),
                    "right": float(right[inside].mean()),
                    "low_95": band[0],
                    "high_95": band[1],
                }
            )
    return pd.DataFrame(
        rows,
        columns=["stated_from", "stated_to", "trials", "mean_stated", "right", "low_95", "high_95"],
    )


def _exactly(record: Record) -> bool:
    hidden = [h["name"] for h in record["hidden"]] or ["none"]
    return first(record) in hidden


def confusion(records: Sequence[Record]) -> pd.DataFrame:
    """Hidden kind (rows) against first named kind (columns), one hidden effect or none."""
    single = [r for r in records if len(r["hidden"]) <= 1]
    pairs = [
        (
            r["hidden"][0]["name"].partition(":")[0] if r["hidden"] else "none",
            first(r).partition(":")[0],
        )
        for r in single
    ]
    return pd.crosstab(
        pd.Series([a for a, _ in pairs], name="hidden"),
        pd.Series([b for _, b in pairs], name="named"),
    )


def trial_table(records: Sequence[Record]) -> pd.DataFrame:
    """One row per trial."""
    return pd.DataFrame(
        [
            {
                "index": r["index"],
                "stratum": r["stratum"],
                "hidden": "+".join(h["name"] for h in r["hidden"]) or "none",
                "sigma": "+".join(f"{h['sigma']:.2f}" for h in r["hidden"]),
                "first": first(r),
                "probability": round(r["causes"][0]["probability"], 5),
                "log_bayes_factor": round(r["causes"][0]["log_bayes_factor"], 2),
                "probability_of_truth": "+".join(f"{p:.5f}" for p in r["probability_of_truth"]),
                "probability_of_none": round(r["probability_of_none"], 5),
                "probability_of_unknown": round(r["probability_of_unknown"], 5),
                "confounded_with": " ".join(r["confounded_with"]),
                "named": named(r),
                "pair": r["pair"] or "",
                "p_value": r["p_value"],
                "size_covered": " ".join(str(int(s["covers"])) for s in r["sizes"]),
                "cpu_s": round(r["cpu_prepare_s"] + r["cpu_diagnose_s"], 1),
                "cpu_diagnose_s": round(r["cpu_diagnose_s"], 1),
                "code": r["code"],
            }
            for r in records
        ]
    )


def write_results(folder: Path, page: Path, seed: int, command: Sequence[str]) -> dict[str, Any]:
    """Write CSV tables, figures and the page of the trials in ``folder``; returns the rates."""
    records = read_trials(folder, seed)
    table, headline = trial_table(records), rates(records)
    stated, matrix = reliability(records), confusion(records)
    for name, frame, index in (
        ("trials", table, False),
        ("rates", headline, False),
        ("reliability", stated, False),
        ("confusion", matrix, True),
    ):
        write_text(page / f"{name}.csv", frame.to_csv(index=index))
    write_bytes(page / "blind.png", encode(blind_figure(table, stated), "png"))
    write_bytes(page / "confusion.png", encode(confusion_figure(matrix), "png"))
    write_text(page / "index.md", _page(table, headline, stated, seed, command))
    return {row["rate"]: row["value"] for row in headline.to_dict(orient="records")}


def _against_goal(row: Mapping[str, Any]) -> str:
    """The goal and whether the 95 % interval reaches it; null trials shall stay below theirs.

    With too few trials every interval reaches its goal: then it is only called not excluded.
    """
    goal = row["goal"]
    if np.isnan(goal) or not row["trials"]:
        return ""
    below = str(row["rate"]).startswith("null")
    held = row["low_95"] <= goal if below else row["high_95"] >= goal
    enough = row["trials"] >= ENOUGH_TRIALS
    word = ("reached" if enough else "not excluded (few trials)") if held else "missed"
    return f"{'≤' if below else '≥'} {goal:.2f}: {word}"


def _failures(table: pd.DataFrame) -> str:
    wrong = table[~table["named"].astype(bool) & (table["stratum"] != "uncatalogued")]
    odd = table[(table["stratum"] == "uncatalogued") & (table["first"] != "unknown")]
    return "\n".join(
        f"| {r['index']} | {r['stratum']} | {r['hidden']} | "
        f"{str(r['sigma']).replace('nan', '–')} | {r['first']} | {r['probability']:.3f} | "
        f"{r['confounded_with']} |"
        for r in pd.concat([wrong, odd]).to_dict(orient="records")
    )


def _page(
    table: pd.DataFrame,
    headline: pd.DataFrame,
    stated: pd.DataFrame,
    seed: int,
    command: Sequence[str],
) -> str:
    rows = "\n".join(
        f"| {r['rate']} | {r['hits']} of {r['trials']} | {r['value']:.3f} | "
        f"{r['low_95']:.3f} … {r['high_95']:.3f} | "
        f"{_against_goal(r)} |"
        for r in headline.to_dict(orient="records")
    )
    bins = "\n".join(
        f"| {r['stated_from']:.2f} … {r['stated_to']:.2f} | {r['trials']} | "
        f"{r['mean_stated']:.3f} | {r['right']:.3f} | {r['low_95']:.3f} … {r['high_95']:.3f} |"
        for r in stated.to_dict(orient="records")
    )
    counts = table["stratum"].value_counts()
    strata = ", ".join(f"{name} {counts.get(name, 0)} of {planned}" for name, planned in STRATA)
    digests = ", ".join(sorted(set(table["code"])))
    return f"""# Blind trials of the diagnosis

An effect is hidden in simulated telemetry (one wheel bias and a slew set at 1 Hz, everything drawn
from the priors, wheel rates anew in every trial) and the diagnosis, which knows nothing of it, says
what is wrong. {len(table)} trials, by part, of those planned:
{strata}.
[The method](../../criticism.md) says what the parts are and analyses the failures.

| rate | count | value | 95 % interval (binomial) | goal |
| --- | --- | --- | --- | --- |
{rows}

![Power, reliability, p-values]({"blind.png"})

Stated probability of the first cause against how often it is the hidden one (stratum `prior`):

| stated | trials | mean stated | right | 95 % interval (binomial) |
| --- | --- | --- | --- | --- |
{bins}

![Confusion]({"confusion.png"})

Trials in which the first cause is wrong, confounded groups counted as right; `prior` and `faint`
hold effects too small to be told from none:

| trial | part | hidden | size (σ) | named first | its probability | cannot be told from |
| --- | --- | --- | --- | --- | --- | --- |
{_failures(table)}

One diagnosis took {table["cpu_diagnose_s"].median():.1f} s of one core (median; largest
{table["cpu_diagnose_s"].max():.1f} s), a whole trial with its two flights
{table["cpu_s"].median():.1f} s. Tables: [trials](trials.csv), [rates](rates.csv),
[reliability](reliability.csv), [confusion](confusion.csv).

Made by `{" ".join(command)}` (seed {seed}) with cassini_bayes {__version__}; digest of the
diagnosing code {digests}.
"""
