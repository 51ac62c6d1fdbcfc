"""Leaks that monitors found, by size."""

from __future__ import annotations

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cassini_bayes.report.plots.style import STYLE


def leak_figure(table: pd.DataFrame) -> Figure:
    """Share of leaks found and median delay by size, a line per monitor.

    ``table`` has the columns monitor, leak_n (intervals, N), found and delay_s.
    """
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(10.0, 4.0), layout="constrained")
        left, right = figure.subplots(1, 2)
        for label, own in table.groupby("monitor", observed=True):
            middle = [1e3 * np.sqrt(max(each.left, 1e-5) * each.right) for each in own["leak_n"]]
            style = "-" if str(label).startswith("sequential") else "--"
            left.plot(middle, own["found"], style, marker="o", ms=3, label=str(label))
            right.plot(middle, own["delay_s"], style, marker="o", ms=3)
        for axes, what in ((left, "share found"), (right, "median delay of those found, s")):
            axes.set_xscale("log")
            axes.set_xlabel("leak, mN")
            axes.set_ylabel(what)
        left.set_ylim(0.0, 1.02)
        figure.legend(loc="outside lower center", ncols=4)
    return figure
