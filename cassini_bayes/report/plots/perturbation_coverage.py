"""Figure of the comparison of error bars: coverage against length."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cassini_bayes.report.plots.style import INK, legend_below, line, styled_figure

_COLOURS: Final = ("#CC6677", "#882255", "#999933", "#BB8800", "#4477AA", "#332288")
_MARKERS: Final = ("s", "D", "^", "v", "o", "P")
_CLAIMS: Final = (0.68, 0.9)  # coverages that bars are read as: one standard deviation, 90 %


def coverage_length_figure(table: pd.DataFrame, certain: str) -> Figure:
    """Coverage against mean length of every kind of interval, per reading and estimand.

    Open symbols claim 68 %, filled ones 90 % (dashed and full lines); the method ``certain`` claims
    certainty where sizes are largest errors. Bars: one standard error of the coverage.
    """
    readings, estimands, methods = (
        list(dict.fromkeys(table[name])) for name in ("reading", "estimand", "method")
    )
    with styled_figure(10.2, 3.0 * len(readings) + 0.9) as figure:
        panels = figure.subplots(len(readings), len(estimands), squeeze=False, sharey=True)
        for row, reading in enumerate(readings):
            for column, estimand in enumerate(estimands):
                axes = panels[row, column]
                rows = table[(table["reading"] == reading) & (table["estimand"] == estimand)]
                _panel(axes, rows, methods, certain)
                axes.set_title(f"{estimand}\nsizes drawn as {reading}", loc="left")
                if column == 0:
                    axes.set_ylabel("coverage [%]")
                if row == len(readings) - 1:
                    axes.set_xlabel("mean length of the interval [mN]")
        looks = zip(_MARKERS, _COLOURS, methods, strict=False)
        handles = [line(ls="", marker=m, color=c, label=method) for m, c, method in looks]
        legend_below(figure, handles, ncols=3)
    return figure


def _panel(axes: Axes, own: pd.DataFrame, methods: Sequence[str], certain: str) -> None:
    axes.axhline(90.0, color=INK, lw=0.9)
    axes.axhline(68.0, color=INK, lw=0.9, ls="--")
    for i, method in enumerate(methods):
        for _, row in own[own["method"] == method].iterrows():
            filled = method == certain or row["claim"] == _CLAIMS[-1]
            axes.errorbar(
                1e3 * row["mean_length_n"], 100.0 * row["coverage"],
                yerr=100.0 * row["coverage_error"], color=_COLOURS[i], marker=_MARKERS[i], ms=6.0,
                mfc=_COLOURS[i] if filled else "white", lw=0.9, zorder=4,
            )  # fmt: skip
    axes.set_ylim(-4.0, 103.0)  # a symbol at nil is shown whole
    axes.set_xlim(0.0, 1.1e3 * float(np.nanmax(own["mean_length_n"])))
    axes.grid(axis="y")
