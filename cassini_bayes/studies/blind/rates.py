"""What the trials of a blind campaign add up to: rates with intervals, calibration, confusion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import beta

Record = dict[str, Any]
NAMED: Final = 0.5
BEST: Final = 3
LEAST_SIGMA: Final = 5.0
FAINT: Final = "faint: among the three best real causes"
ORACLE: Final = "faint: the oracle, on the same data"
COVERAGE: Final = "prior: 90 % intervals of the size hold it"
ORACLE_MARGIN: Final = 0.10
CLEAR: Final = "clear: named first (confounded group counts)"
CLEAR_BY_ORACLE: Final = "clear: named first (the oracle's group counts)"
UNKNOWN: Final = "uncatalogued: unknown first"
UNKNOWN_BY_ORACLE: Final = "uncatalogued: unknown first (where the oracle tells it apart)"
FALSE_ALARM: Final = "null: causes[0] is not none"
FAILED: Final = "all: trial failed"
DECLINED: Final = "all: declined before any search"
WITHOUT_DECLINED: Final = ", declined left out"
GOALS: Final[Mapping[str, float]] = {
    CLEAR: 0.95,
    CLEAR_BY_ORACLE: 0.95,
    FALSE_ALARM: 0.05,
    UNKNOWN_BY_ORACLE: 0.90,
    "two: both named (confounded groups count)": 0.80,
    "two: both named, names alone": 0.80,
    COVERAGE: 0.90,
}
EDGES: Final = (0.0, 0.5, 0.7, 0.85, 0.95, 1.0 + 1e-9)
STATED: Final = (
    "stated_from",
    "stated_to",
    "trials",
    "mean_stated",
    "right",
    "low_95",
    "high_95",
    "inside",
)


def interval(hits: int, n: int) -> tuple[float, float]:
    """Clopper-Pearson 95 % interval of a rate."""
    if n == 0:
        return 0.0, 1.0
    low = 0.0 if hits == 0 else float(beta.ppf(0.025, hits, n - hits + 1))
    high = 1.0 if hits == n else float(beta.ppf(0.975, hits + 1, n - hits))
    return low, high


def failed(record: Record) -> bool:
    """Whether an exception ended the trial."""
    return "error" in record


def declined(record: Record) -> bool:
    """Whether the package refused the events before any search, in one line."""
    return "declined" in record


def answered(record: Record) -> bool:
    """Whether there is a verdict."""
    return not failed(record) and not declined(record)


def first(record: Record) -> str:
    """Name of the most probable cause."""
    return str(record["causes"][0]["name"])


def named(record: Record) -> bool:
    """Whether the first cause is (one of) the hidden, or is confounded with it, or rightly none."""
    if not answered(record):
        return False
    hidden = [h["name"] for h in record["hidden"]]
    if not hidden:
        return first(record) == "none"
    group = {first(record), *record["confounded_with"]}
    return first(record) != "none" and any(name in group for name in hidden)


def named_by_oracle(record: Record) -> bool:
    """Whether the first cause is the hidden one, or of the group that the oracle makes of it."""
    return answered(record) and first(record) in record["oracle_group"]


def alone(record: Record) -> bool:
    """Whether the first cause is the hidden one itself, or rightly none."""
    if not answered(record):
        return False
    return first(record) in ([h["name"] for h in record["hidden"]] or ["none"])


def _among_best(record: Record) -> bool:
    if not answered(record):
        return False
    rank = record["rank_of_truth"][0]
    return rank is not None and rank < BEST


def _is_unknown(record: Record) -> bool:
    return answered(record) and first(record) == "unknown"


def _both(record: Record) -> bool:
    if not answered(record) or record["pair"] is None:
        return False
    return {h["name"] for h in record["hidden"]} == set(str(record["pair"]).split("+"))


def _both_alike(record: Record) -> bool:
    """Whether two hidden causes are the pair that is named, each or one confounded with it."""
    if not answered(record) or record["pair"] is None:
        return False
    one, other = str(record["pair"]).split("+")
    groups = {one, *record["pair_first_like"]}, {other, *record["pair_second_like"]}
    a, b = (h["name"] for h in record["hidden"])
    return any(x in groups[0] and y in groups[1] for x, y in ((a, b), (b, a)))


def _counts(records: Sequence[Record]) -> dict[str, list[bool]]:
    """Hits of every rate, over all trials and, where some were declined, without these."""
    counts = _hits(records)
    asked = [record for record in records if not declined(record)]
    if len(asked) == len(records):
        return counts
    result = {}
    for (name, hits), without in zip(counts.items(), _hits(asked).values(), strict=True):
        result[name] = hits
        if len(without) < len(hits) and name != FAILED:
            result[f"{name}{WITHOUT_DECLINED}"] = without
    return {**result, DECLINED: [declined(r) for r in records]}


def _hits(records: Sequence[Record]) -> dict[str, list[bool]]:
    """Hits of every rate. A trial that failed is a miss, and a false alarm where none is hidden.

    One that was declined is a miss, and no trial at all where none is hidden.
    """

    def of(stratum: str) -> list[Record]:
        return [r for r in records if r["stratum"] == stratum]

    null, clear, faint, two, prior = map(of, ("null", "clear", "faint", "two", "prior"))
    null = [r for r in null if not declined(r)]
    other = [
        r for r in of("uncatalogued") if not answered(r) or r["hidden"][0]["sigma"] >= LEAST_SIGMA
    ]
    told = [r for r in other if not answered(r) or r.get("alias_left", 0.0) >= LEAST_SIGMA]
    by_oracle = any("alias_left" in r for r in other)
    sizes = [s for r in prior if answered(r) for s in r["sizes"]]
    judged = [r for r in faint if answered(r)]
    grouped = any("oracle_group" in r for r in clear)
    return {
        CLEAR: [named(r) for r in clear],
        **({CLEAR_BY_ORACLE: [named_by_oracle(r) for r in clear]} if grouped else {}),
        "clear: named first, name alone": [alone(r) for r in clear],
        FAINT: [_among_best(r) for r in faint],
        ORACLE: [r["oracle_rank"] < BEST for r in judged],
        FALSE_ALARM: [not named(r) for r in null],
        "null: P(none) < 0.5": [failed(r) or r["probability_of_none"] < NAMED for r in null],
        UNKNOWN: [_is_unknown(r) for r in other],
        **({UNKNOWN_BY_ORACLE: [_is_unknown(r) for r in told]} if by_oracle else {}),
        "two: both named (confounded groups count)": [_both_alike(r) for r in two],
        "two: both named, names alone": [_both(r) for r in two],
        "two: one of them first (group counts)": [named(r) for r in two],
        "prior: truth first (none included, group counts)": [named(r) for r in prior],
        COVERAGE: [bool(s["covers"]) for s in sizes],
        FAILED: [failed(r) for r in records],
    }


def rates(records: Sequence[Record]) -> pd.DataFrame:
    """Every headline rate with its count, binomial 95 % interval, goal, and whether it is reached.

    A goal is reached where the figure itself is at or beyond it; coverage, whose goal is a value
    and no bound, where its interval holds it. The goal of faint trials is the oracle's rate less
    ten points.
    """
    counts = _counts(records)
    values = {name: float(np.mean(hits)) if hits else float("nan") for name, hits in counts.items()}
    goals = {**GOALS, FAINT: values[ORACLE] - ORACLE_MARGIN}
    rows = []
    for name, hits in counts.items():
        low, high = interval(sum(hits), len(hits))
        goal = goals.get(name, float("nan"))
        rows.append(
            {
                "rate": name,
                "hits": sum(hits),
                "trials": len(hits),
                "value": values[name],
                "low_95": low,
                "high_95": high,
                "goal": goal,
                "reached": ""
                if np.isnan(goal)
                else str(_reached(name, values[name], (low, high), goal)),
            }
        )
    return pd.DataFrame(rows)


def _reached(name: str, value: float, interval_95: tuple[float, float], goal: float) -> bool:
    if name == COVERAGE:
        return interval_95[0] <= goal <= interval_95[1]
    return value <= goal if name.startswith("null") else value >= goal


def expected_by_oracle(records: Sequence[Record]) -> float:
    """Mean over faint trials of how often the oracle expects the cause among the three best."""
    expected = [r["oracle_expected"] for r in records if r["stratum"] == "faint" and answered(r)]
    return float(np.mean(expected)) if expected else float("nan")


def reliability(records: Sequence[Record]) -> pd.DataFrame:
    """Stated probability of the first cause against how often it was right, prior stratum.

    ``inside``: the mean stated one is in the binomial 95 % interval. The last row holds all trials.
    """
    chosen = [r for r in records if r["stratum"] == "prior" and answered(r)]
    stated = np.array([r["causes"][0]["probability"] for r in chosen])
    right = np.array([alone(r) for r in chosen], dtype=bool)
    bins = [*pairwise(EDGES), (EDGES[0], EDGES[-1])]
    rows = []
    for low, high in bins:
        inside = (stated >= low) & (stated < high)
        if not inside.any():
            continue
        band = interval(int(right[inside].sum()), int(inside.sum()))
        mean = float(stated[inside].mean())
        numbers = (int(inside.sum()), mean, float(right[inside].mean()), *band)
        rows.append((low, min(high, 1.0), *numbers, bool(band[0] <= mean <= band[1])))
    return pd.DataFrame(rows, columns=list(STATED))


def confusion(records: Sequence[Record]) -> pd.DataFrame:
    """Hidden kind (rows) against first named kind (columns), one hidden effect or none."""
    single = [r for r in records if answered(r) and len(r["hidden"]) <= 1]
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
    """One row per trial with a verdict; nothing that changes from run to run."""
    return pd.DataFrame(
        [
            {
                "index": r["index"],
                "stratum": r["stratum"],
                **r.get("condition", {}),
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
                "rank_of_truth": "+".join(str(rank) for rank in r["rank_of_truth"]),
                "oracle_rank": "" if r["oracle_rank"] is None else str(r["oracle_rank"]),
                "oracle_expected": r["oracle_expected"],
                "pair": r["pair"] or "",
                "alias": r.get("alias", ""),
                "alias_left": f"{r['alias_left']:.2f}" if "alias_left" in r else "",
                "p_value": r["p_value"],
                "size_covered": " ".join(str(int(s["covers"])) for s in r["sizes"]),
                "code": r["code"],
            }
            for r in records
            if answered(r)
        ]
    )


def timing_table(records: Sequence[Record]) -> pd.DataFrame:
    """Seconds of every trial: of one core, and by the clock."""
    return pd.DataFrame(
        [
            {key: round(r[key], 1) if key != "index" else r[key] for key in keys}
            for r in records
            if answered(r)
            for keys in [("index", "cpu_prepare_s", "cpu_diagnose_s", "wall_s")]
        ]
    )
