"""Where the variance of the thrusts comes from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report.plots.style import BLOCK_FILLS, INK, headline, new_figure, patch, symbols
from cassini_bayes.report.plots.tables import (
    NOISE_ONLY,
    NONLINEAR,
    SHARE,
    budget_blocks,
    grid,
    thrusters_of,
)
from cassini_bayes.results.review import Review

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


CONSIDER: Final = "consider (nuisances at their priors, not estimated)"
LEAST_SHOWN: Final = 0.003  # a share too thin to be seen is not in the legend


def block_label(block: str) -> str:
    """What a share of the budget stands for."""
    return {
        NOISE_ONLY: "left with all nuisances known (noise of the data, thrust priors)",
        NONLINEAR: "joint, not attributable to one block",
        "noise": "levels of noise, which are not known for sure",
    }.get(block, block)


def budget_figure(review: Review) -> Figure:
    """Shares of each thrust's variance by block, and the three standard deviations, in mN."""
    thrusters, budget = thrusters_of(review), review.budget
    events = int(budget["event"].nunique())
    figure = new_figure(11.4, 0.40 * len(thrusters) + 2.6)
    shares, sigmas = figure.subplots(1, 2, sharey=True, width_ratios=(1.45, 1.0))
    _share_bars(shares, review)
    _sigma_dots(sigmas, review)
    places = np.arange(len(thrusters))
    shares.set_yticks(places, thrusters)
    shares.set_ylim(len(thrusters) - 0.45, -0.55)
    shares.set_ylabel("thruster")
    sigmas.set_ylabel("thruster")
    sigmas.yaxis.label.set_visible(False)
    over = f", mean over {events} events" if events > 1 else ""
    headline(figure, f"Error budget of the thrusts{over}")
    handles = [
        patch(facecolor=fill, hatch=hatch, edgecolor="white", label=block_label(block))
        for block, (fill, hatch) in _fills(budget_blocks(budget)).items()
        if (budget[block + SHARE].abs() >= LEAST_SHOWN).any()
    ]
    figure.legend(handles=handles, loc="outside lower left", ncols=3)
    return figure


def _fills(blocks: Sequence[str]) -> dict[str, tuple[str, str]]:
    special = {NOISE_ONLY: ("#cccccc", ""), NONLINEAR: ("#666666", "..")}
    ordinary = [b for b in blocks if b not in special]
    fills = {b: BLOCK_FILLS[i % len(BLOCK_FILLS)] for i, b in enumerate(ordinary)}
    return {b: special.get(b) or fills[b] for b in blocks}


def _share_bars(axes: Axes, review: Review) -> None:
    """Positive shares to the right of zero, negative ones (anticorrelated blocks) to the left."""
    thrusters, budget = thrusters_of(review), review.budget
    right, left = np.zeros(len(thrusters)), np.zeros(len(thrusters))
    for block, (fill, hatch) in _fills(budget_blocks(budget)).items():
        percent = 100.0 * _mean_over_events(budget, block + SHARE, thrusters)
        start = np.where(percent >= 0.0, right, left)
        look: dict[str, Any] = {"color": fill, "hatch": hatch, "edgecolor": "white", "lw": 0.5}
        axes.barh(np.arange(len(thrusters)), percent, left=start, height=0.72, **look)
        right += np.clip(percent, 0.0, None)
        left += np.clip(percent, None, 0.0)
    axes.axvline(0.0, color=INK, lw=0.8)
    axes.axvline(100.0, color=INK, lw=0.8, ls=":")
    axes.grid(axis="x")
    axes.set_xlabel("share of the posterior variance of the thrust [%]")


def _mean_over_events(budget: pd.DataFrame, column: str, thrusters: Sequence[str]) -> Array:
    means = budget.groupby("thruster")[column].mean().reindex(list(thrusters))
    return np.asarray(np.nan_to_num(np.asarray(means, dtype=float)))


def _sigma_dots(axes: Axes, review: Review) -> None:
    """Mean over events as a marker, the range over events as a line."""
    looks = (
        ("noise_only_sd_n", "noise only (nuisances known)", "#777777", "s", -0.22),
        ("full_sd_n", "full posterior", "#22558c", "o", 0.0),
        ("consider_sd_n", CONSIDER, "#b2182b", "D", 0.22),
    )
    for column, label, colour, marker, offset in looks:
        values = 1e3 * grid(review.budget, column, review)  # mN
        places = np.arange(values.shape[1]) + offset
        centre = np.array([_finite_mean(v) for v in values.T])
        with np.errstate(invalid="ignore"):
            low = np.nan_to_num(np.nanmin(values, axis=0, initial=np.inf), posinf=np.nan)
            high = np.nan_to_num(np.nanmax(values, axis=0, initial=-np.inf), neginf=np.nan)
            axes.hlines(places, low, high, color=colour, lw=1.4)
        symbols(axes, centre, places, marker, 5.5, colour, hollow=True, mew=1.3, label=label)
    axes.set_xlim(left=0.0)
    axes.grid(axis="x")
    axes.set_xlabel("standard deviation of the thrust [mN]\nmarker: mean, line: range over events")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=7.8)


def _finite_mean(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")
