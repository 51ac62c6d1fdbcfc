"""Figures of the blind campaign: power, reliability, p-values, false alarms, coverage, rates."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from cassini_bayes.report.plots.style import INK, POSTERIOR, label_axes, styled_figure

EDGES = (0.0, 1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 20.0, 50.0, np.inf)
"""Of sizes in σ: finer where detection turns from chance to sure."""
SIZE = "size (σ of the data)"
TICKS = (0, 1, 2, 3, 5, 10, 30, 100)  # of the same axis
ACROSS: Final = 3  # panels
HALO: Final = withStroke(linewidth=2.0, foreground="white")  # of numbers over lines


def blind_figure(trials: pd.DataFrame, reliability: pd.DataFrame, rates: pd.DataFrame) -> Figure:
    """Power and coverage against size, reliability, p-values and false alarms on null, rates.

    Panels of which there are no trials are left out.
    """
    single = trials[(trials["sigma"] != "") & ~trials["sigma"].str.contains(r"\+|nan")]
    known = single[single["stratum"] != "uncatalogued"]
    null = trials[trials["hidden"] == "none"]
    panels: list[Callable[[Axes], None]] = []
    if len(known):
        panels += [partial(_power, known=known), partial(_coverage, known=known)]
    if len(reliability) > 1:
        panels.append(partial(_reliability, reliability=reliability))
    if len(null):
        panels += [partial(_p_values, null=null), partial(_false_alarms, null=null)]
    panels.append(partial(_rates, rates=rates))
    lines = -(-len(panels) // ACROSS)
    with styled_figure(10.0, 3.3 * lines) as figure:
        grid = figure.subplots(lines, min(len(panels), ACROSS), squeeze=False).ravel()
        for axes, draw in zip(grid, panels, strict=False):
            draw(axes)
        for spare in grid[len(panels) :]:
            spare.set_visible(False)
    return figure


def _power(axes: Axes, known: pd.DataFrame) -> None:
    _by_size(axes, known["sigma"].astype(float).to_numpy(), known["named"].to_numpy(dtype=bool))
    label_axes(axes, SIZE, "named first, group counts (fraction)", "power (number of trials)")


def _coverage(axes: Axes, known: pd.DataFrame) -> None:
    covered = known["size_covered"].str.split().to_list()
    each = np.repeat(known["sigma"].astype(float).to_numpy(), [len(flags) for flags in covered])
    hit = np.array([flag == "1" for flags in covered for flag in flags], dtype=bool)
    _by_size(axes, each, hit)
    axes.axhline(0.9, lw=0.8, color=INK)
    words = ("90 % interval holds the truth (fraction)", "coverage (number of parameters)")
    label_axes(axes, SIZE, *words)


def _by_size(axes: Axes, sigma: NDArray[np.float64], hit: NDArray[np.bool_]) -> None:
    """Share of hits in bins of size, at the bin's median size, with the number in each bin."""
    places, shares, counts = [], [], []
    for low, high in pairwise(EDGES):
        inside = (sigma >= low) & (sigma < high)
        if inside.any():
            places.append(float(np.median(sigma[inside])))
            shares.append(float(hit[inside].mean()))
            counts.append(int(inside.sum()))
    axes.plot(places, shares, "o-", color=POSTERIOR)
    for x, y, n in zip(places, shares, counts, strict=True):
        look: dict[str, Any] = {"textcoords": "offset points", "xytext": (0, 6), "ha": "center"}
        axes.annotate(str(n), (x, y), fontsize=7, path_effects=[HALO], **look)
    axes.set_xscale("symlog", linthresh=1.0)
    axes.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    axes.set_xlim(0.0, max(12.0, 1.3 * max(places, default=0.0)))
    axes.set_ylim(-0.03, 1.12)


def _reliability(axes: Axes, reliability: pd.DataFrame) -> None:
    axes.plot([0, 1], [0, 1], lw=0.8, color=INK)
    bins = reliability.iloc[:-1]  # the last row holds all trials
    if len(bins):
        value, error = bins["right"], _reach(bins, "right")
        axes.errorbar(bins["mean_stated"], value, yerr=error, fmt="o", color=POSTERIOR, capsize=3)
    across, up = "probability stated (1)", "how often it was right (fraction)"
    label_axes(axes, across, up, "reliability, 95 % binomial bars")


def _reach(rows: pd.DataFrame, value: str = "value") -> NDArray[np.float64]:
    """Length of the 95 % bars to either side."""
    sides = np.stack([rows[value] - rows["low_95"], rows["high_95"] - rows[value]])
    return np.asarray(np.abs(sides))


def _p_values(axes: Axes, null: pd.DataFrame) -> None:
    values = np.sort(null["p_value"].to_numpy(dtype=float))
    if len(values):
        axes.step(values, np.arange(1, len(values) + 1) / len(values), color=POSTERIOR)
    axes.plot([0, 1], [0, 1], lw=0.8, color=INK)
    title = f"p-values, {len(values)} with nothing hidden"
    label_axes(axes, "p-value of the baseline (1)", "share of trials below (fraction)", title)


def _false_alarms(axes: Axes, null: pd.DataFrame) -> None:
    """How often a name would be given that is not none, by the probability asked of it."""
    asked = np.linspace(0.0, 1.0, 101)
    stated = np.where(null["first"] == "none", 0.0, null["probability"].to_numpy(dtype=float))
    alarms = [float((stated > at).mean()) if len(stated) else 0.0 for at in asked]
    axes.step(asked, alarms, where="post", color=POSTERIOR)
    axes.axhline(0.05, lw=0.8, color=INK)
    axes.set_ylim(0.0, max(0.15, 1.15 * max(alarms)))
    title = f"false alarms, {len(stated)} with nothing hidden"
    label_axes(axes, "probability asked of a name (1)", "false alarms (fraction)", title)


def _rates(axes: Axes, rates: pd.DataFrame) -> None:
    """Rates that have a goal, with 95 % binomial bars and the goals as ticks."""
    shown = rates[(rates["goal"].notna()) & (rates["trials"] > 0)].iloc[::-1]
    value, rows = shown["value"], np.arange(len(shown))
    axes.errorbar(value, rows, xerr=_reach(shown), fmt="o", color=POSTERIOR, capsize=3)
    axes.plot(shown["goal"], rows, "|", color=INK, markersize=14)
    names = [str(name).replace(": ", ":\n").replace(" (", "\n(") for name in shown["rate"]]
    axes.set_yticks(rows, names, fontsize=6.5)
    axes.set_ylim(-0.6, len(shown) - 0.4)
    axes.set_xlim(-0.03, 1.03)
    label_axes(axes, "rate (fraction)", "", "rates and goals (ticks), 95 % bars")


def conditions_figure(counted: pd.DataFrame) -> Figure:
    """Rates of which there are trials, by level of every condition, with 95 % binomial bars.

    Rejected ones are filled.

    ``counted`` has a row for every condition, level and rate: hits, trials, value, low_95, high_95,
    goal, rejected.
    """
    names = list(counted.loc[counted["trials"] > 0, "rate"].unique())
    levels = counted[["condition", "level"]]
    levels = levels.drop_duplicates().agg(": ".join, axis=1).replace("all: all", "all")
    places = levels.str.replace("_", " ").to_list()
    with styled_figure(10.0, 1.2 + 0.23 * len(places)) as figure:
        each = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
        for axes, name in zip(each, names, strict=True):
            rows = counted[counted["rate"] == name].reset_index(drop=True)
            shown = rows[rows["trials"] > 0]
            reach = _reach(shown)
            axes.errorbar(shown["value"], shown.index, xerr=reach, fmt="none", ecolor=POSTERIOR)
            for rejected, face in ((True, POSTERIOR), (False, "white")):
                own = shown[shown["rejected"] == rejected]
                axes.plot(own["value"], own.index, "o", mec=POSTERIOR, mfc=face, ms=5)
            goal = float(rows["goal"].iloc[0])
            axes.axvline(goal, lw=0.8, color=INK)
            most = 1.0 if goal > 0.5 else max(0.2, float(shown["high_95"].max()))
            axes.set_xlim(-0.03 * most, 1.03 * most)
            axes.set_xlabel("rate (fraction)")
            axes.set_title(name.replace(": ", ":\n").replace(", ", ",\n"), loc="left", fontsize=9)
        each[0].set_yticks(range(len(places)), places, fontsize=7.5)
        each[0].set_ylim(len(places) - 0.4, -0.6)
    return figure


def confusion_figure(matrix: pd.DataFrame) -> Figure:
    """Hidden kind against the kind named first; numbers are trials."""
    with styled_figure(2.6 + 0.42 * matrix.shape[1], 2.2 + 0.3 * matrix.shape[0]) as figure:
        axes = figure.subplots()
        counts = matrix.to_numpy()
        share = counts / counts.sum(1, keepdims=True)
        axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        for i, j in np.argwhere(counts.astype(int)):
            colour, text = "white" if share[i, j] > 0.6 else INK, f"{counts[i, j]:.0f}"
            axes.text(j, i, text, ha="center", va="center", fontsize=8, color=colour)
        axes.set_xticks(range(matrix.shape[1]), list(matrix.columns), rotation=60, ha="right")
        axes.set_yticks(range(matrix.shape[0]), list(matrix.index))
        label_axes(axes, "named first (kind)", "hidden (kind)")
    return figure
