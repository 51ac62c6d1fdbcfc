"""Thrusts in words and tables: the main result, and the methods it replaces beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.report.cells import MN, Cell, Table, or_missing, percent
from cassini_bayes.report.plots.budget import NOISE_ONLY, NOT_BLOCKS, SHARE, budget_blocks
from cassini_bayes.report.plots.quantities import (
    INTERVAL,
    INTERVAL_SHORT,
    MISSING,
    interval,
    number,
    plus_minus,
)
from cassini_bayes.report.plots.tables import events_of, level_row, thrust_grid, thrusters_of
from cassini_bayes.results.review import Review

PSEUDO_INVERSE: Final = "pseudo-inverse, per event"
POOLED: Final = "pseudo-inverse, pooled"
MEAN_OF_ALL: Final = "mean of all thrusters, per event"


def _common(review: Review) -> pd.Series:
    rows = review.summary[review.summary["quantity"] == "thrust_common_n"]
    return rows.iloc[0]


def summary_sentences(review: Review) -> list[str]:
    """The main result in plain words: level, spread, what limits it, and the printed thrust.

    Nothing without thrusts.
    """
    if not events_of(review):
        return []
    common, thrusters = _common(review), thrusters_of(review)
    level, sd = level_row(review, "mean"), thrust_grid(review, "sd") * MN
    lowest, highest = int(np.nanargmin(level)), int(np.nanargmax(level))
    sentences = [
        f"The thrusters share a common level of {plus_minus(common['mean'], common['sd'])} N "
        f"(mean ± standard deviation; {INTERVAL} "
        f"{interval(common['hdi_90_low'], common['hdi_90_high'])} N), from "
        f"{_count(len(events_of(review)), *_what(review))} and "
        f"{_count(len(thrusters), 'thruster', 'thrusters')}."
    ]
    if len(thrusters) > 1:
        sentences.append(
            f"The thrusters' own levels run from {number(level[lowest], common['sd'])} N "
            f"({thrusters[lowest]}) to {number(level[highest], common['sd'])} N "
            f"({thrusters[highest]})."
        )
    sentences.append(
        "The thrust of one thruster in one bias is known to "
        f"{_span(sd, ' mN')} (standard deviation)."
    )
    return [*sentences, *_limit_sentence(review), *_printed_sentence(review, common)]


def _what(review: Review) -> tuple[str, str]:
    """One event with thrusts, and several: totals rows are biases, telemetry may be a burn."""
    if review.telemetry is None:
        return "wheel bias", "wheel biases"
    return "event with firings", "events with firings"


def _count(n: int, one: str, many: str) -> str:
    return f"{n} {one if n == 1 else many}"


def _span(values: np.ndarray, unit: str) -> str:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    first, last = number(low, low), number(high, high)
    return f"{first}{unit}" if first == last else f"{first} to {last}{unit}"


def _limit_sentence(review: Review) -> list[str]:
    """Which block carries most of the variance."""
    blocks = [b for b in budget_blocks(review.budget) if b not in NOT_BLOCKS]
    shares = {b: float(np.nanmean(review.budget[b + SHARE])) for b in blocks}
    noise = float(np.nanmean(review.budget[NOISE_ONLY + SHARE]))
    if not shares:
        return []
    worst = max(shares, key=lambda b: shares[b])
    return [
        f"Of the nuisances, {worst} limits the accuracy most: {percent(shares[worst])} of the "
        f"variance of a thrust, on average; {percent(noise)} would be left if all nuisances were "
        "known."
    ]


def _printed_sentence(review: Review, common: pd.Series) -> list[str]:
    constants = review.fit.groups["constant_data"]
    if "thrust_predicted_n" not in constants:
        return []
    printed = np.asarray(constants["thrust_predicted_n"].values, dtype=float)
    printed = printed[np.isfinite(printed)]
    if printed.size == 0:
        return []
    shift = (float(common["mean"]) - float(printed.mean())) / float(common["sd"])
    low, high = f"{printed.min():.2f}", f"{printed.max():.2f}"
    span = low if low == high else f"{low} to {high}"
    return [
        f"The thrust printed with the events is {span} N; the "
        f"common level lies {abs(shift):.1f} of its standard deviations "
        f"{'above' if shift > 0 else 'below'} its mean."
    ]


def key_numbers(review: Review) -> list[tuple[str, str]]:
    """The few numbers that everyone asks for, with their names."""
    varying = review.summary[review.summary["sd"] > 0]
    smallest = np.nanmin(varying[["ess_bulk", "ess_tail"]].to_numpy(dtype=float))
    return [
        *_thrust_numbers(review),
        ("largest R-hat", f"{np.nanmax(varying['rhat'].to_numpy(dtype=float)):.4f}"),
        ("smallest effective sample", f"{smallest:.0f}"),
    ]


def _thrust_numbers(review: Review) -> list[tuple[str, str]]:
    if not events_of(review):
        return []
    common = _common(review)
    return [
        ("common thrust level", f"{plus_minus(common['mean'], common['sd'])} N"),
        (f"its {INTERVAL_SHORT}", f"{interval(common['hdi_90_low'], common['hdi_90_high'])} N"),
        ("one thruster, one bias: sd", _span(thrust_grid(review, "sd") * MN, " mN")),
    ]


def thrust_matrix(review: Review) -> Table | None:
    """Events × thrusters, mean ± sd; last row the level over all events; None without thrusts."""
    if not events_of(review):
        return None
    mean, sd = thrust_grid(review, "mean"), thrust_grid(review, "sd")
    rows = [
        (Cell(event), *(Cell(plus_minus(m, s)) for m, s in zip(mean[e], sd[e], strict=True)))
        for e, event in enumerate(events_of(review))
    ]
    level = zip(level_row(review, "mean"), level_row(review, "sd"), strict=True)
    rows.append((Cell("all events"), *(Cell(plus_minus(m, s)) for m, s in level)))
    return Table(("event", *(f"{t} [N]" for t in thrusters_of(review))), tuple(rows))


def thrust_tables(review: Review) -> list[Table]:
    """One table per event, posterior beside baseline; last the level over all events."""
    if not events_of(review):
        return []
    baseline = {
        (row["method"], row["event"], row["thruster"]): row for _, row in review.baseline.iterrows()
    }
    events, thrusters = events_of(review), thrusters_of(review)
    observed = review.fit.groups["observed_data"].sel(event=events)
    on_time, pulses = observed["on_time_s"].values, observed["pulses"].values
    mean, sd, low, high = (
        thrust_grid(review, c) for c in ("mean", "sd", "hdi_90_low", "hdi_90_high")
    )
    tables = []
    for e, event in enumerate(events):
        rows = tuple(
            (
                Cell(name),
                Cell(or_missing(on_time[e, k], ".2f")),
                Cell(or_missing(pulses[e, k], ".0f")),
                Cell(plus_minus(mean[e, k], sd[e, k])),
                Cell(interval(low[e, k], high[e, k])),
                _baseline_cell(baseline.get((PSEUDO_INVERSE, event, name))),
                _baseline_cell(baseline.get((MEAN_OF_ALL, event, name))),
            )
            for k, name in enumerate(thrusters)
        )
        tables.append(
            Table(
                (
                    "thruster",
                    "on-time [s]",
                    "pulses",
                    "posterior mean ± sd [N]",
                    f"{INTERVAL_SHORT} [N]",
                    "pseudo-inverse ± rss (worst case) [N]",
                    "mean of all thrusters ± rss (worst case) [N]",
                ),
                rows,
                title=event,
            )
        )
    return [*tables, _level_table(review, baseline)]


def _level_table(review: Review, baseline: Mapping[tuple[str, str, str], pd.Series]) -> Table:
    mean, sd, low, high = (
        level_row(review, c) for c in ("mean", "sd", "hdi_90_low", "hdi_90_high")
    )
    return Table(
        (
            "thruster",
            "level, mean ± sd [N]",
            f"{INTERVAL_SHORT} [N]",
            "pseudo-inverse of all events ± rss (worst case) [N]",
        ),
        tuple(
            (
                Cell(name),
                Cell(plus_minus(mean[k], sd[k])),
                Cell(interval(low[k], high[k])),
                _baseline_cell(baseline.get((POOLED, "", name))),
            )
            for k, name in enumerate(thrusters_of(review))
        ),
        title="all events",
    )


def _baseline_cell(row: pd.Series | None) -> Cell:
    """Estimate with its perturbation bars; greyed, with a dagger, where not valid."""
    if row is None or not math.isfinite(float(row["estimate_n"])):
        return Cell(MISSING, "muted")
    estimate, bar, worst = (float(row[c]) for c in ("estimate_n", "bar_rss_n", "bar_worst_n"))
    text = plus_minus(estimate, bar)
    if math.isfinite(bar) and math.isfinite(worst):
        text += f" ({number(worst, bar)})"
    return Cell(text) if row["valid"] else Cell(f"{text} †", "muted")
