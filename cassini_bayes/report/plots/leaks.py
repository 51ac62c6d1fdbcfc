"""Leaks that monitors found, by size; and what separates a leak from a torque."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cassini_bayes.report.plots.style import INK, label_axes, styled_figure

LEAST_DETECTED: Final = 5
"""Leaks whose median delay is shown: one of fewer is chance."""
_BY_WINDOW: Final = ("#332288", "#117733", "#CC6677", "#BB8800")
_MARKERS: Final = ("o", "s", "^", "D")


def leak_figure(table: pd.DataFrame) -> Figure:
    """Share of leaks found and median delay by size, a line per monitor.

    ``table`` has the columns monitor, leak_n (intervals, N), leaks, found and delay_s. Monitors
    come in pairs, of one row and of several: thin and thick lines of one colour.
    """
    with styled_figure(10.0, 4.4) as figure:
        left, right = figure.subplots(1, 2)
        for i, (label, rows) in enumerate(table.groupby("monitor", observed=True)):
            middle = [1e3 * np.sqrt(max(each.left, 1e-5) * each.right) for each in rows["leak_n"]]
            colour, marker = (each[i // 2 % len(each)] for each in (_BY_WINDOW, _MARKERS))
            look = {"color": colour, "marker": marker, "ms": 4, "lw": (1.0, 2.0)[i % 2]}
            left.plot(middle, rows["found"], "-", label=str(label), **look)
            enough = rows["found"] * rows["leaks"] > LEAST_DETECTED - 0.5
            right.plot(middle, rows["delay_s"].where(enough), "-", **look)
        for axes, what in (
            (left, "share found"),
            (right, f"median delay where {LEAST_DETECTED} or more are found, s"),
        ):
            _in_millinewtons(axes)
            axes.set_ylabel(what)
        left.set_ylim(-0.02, 1.04)
        right.set_ylim(bottom=0.0)
        figure.legend(loc="outside lower center", ncols=4)
    return figure


def torque_figure(after: pd.DataFrame, least: pd.DataFrame) -> Figure:
    """σ between a leak and a torque against time after a turn; the least leak against the turn.

    ``after`` has the columns turn_deg, after_s and sigma, ``least`` stay_s, turn_deg and leak_n.
    """
    with styled_figure(10.0, 4.0) as figure:
        left, right = figure.subplots(1, 2)
        for turn, rows in after.groupby("turn_deg"):
            left.plot(rows["after_s"], rows["sigma"], color=INK)
            last = (rows["after_s"].iloc[-1], rows["sigma"].iloc[-1])
            left.annotate(f" {turn:.0f}°", last, va="center", fontsize=8)
        left.axhline(5.0, lw=0.8, ls="--", color=INK)
        label_axes(left, "time after the turn, s", "leak and torque apart, σ")
        for stay, rows in least.groupby("stay_s"):
            right.plot(rows["turn_deg"], 1e3 * rows["leak_n"], color=INK)
            first = (rows["turn_deg"].iloc[0], 1e3 * rows["leak_n"].iloc[0])
            right.annotate(f"{stay:.0f} s ", first, ha="right", va="center", fontsize=8)
        right.set_xscale("log")
        right.set_xlim(1.0, 200.0)
        right.set_xticks([2, 5, 10, 30, 90, 180], ["2", "5", "10", "30", "90", "180"])
        right.minorticks_off()
        right.set_yscale("log")
        ticks = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
        low, high = right.get_ylim()
        shown = [tick for tick in ticks if low <= tick <= high]
        right.set_yticks(shown, [f"{tick:g}" for tick in shown])
        right.minorticks_off()
        label_axes(right, "turn, degrees", "least leak told apart at 5 σ, mN")
    return figure


def _in_millinewtons(axes: Axes) -> None:
    """A logarithmic axis of leaks with plain numbers: the style shows no powers."""
    axes.set_xscale("log")
    axes.set_xticks([0.03, 0.1, 0.3, 1.0, 3.0], ["0.03", "0.1", "0.3", "1", "3"])
    axes.minorticks_off()
    axes.set_xlabel("leak, mN")
