"""Figures of a diagnosis: innovations over time, causes by probability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cassini_bayes.criticism.innovations import EventRows
from cassini_bayes.criticism.symptoms import WINDOW_ROWS, running_mean
from cassini_bayes.plots.style import INK, POSTERIOR, STYLE, VERDICT_COLOURS

MOST_CAUSES: Final = 12
_POINTS: Final = 2_500


def innovation_figure(
    baseline: Sequence[EventRows], extended: Sequence[EventRows] = ()
) -> Figure | None:
    """Innovations per event and body axis, N m s, with running means before and after.

    Grey: the baseline's innovations; blue: their running mean over 61 rows; orange: that of the
    extended model.
    """
    if not baseline:
        return None
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(10.0, 1.9 * len(baseline) + 0.6), layout="constrained")
        axes = figure.subplots(len(baseline), 3, squeeze=False, sharex="row")
        for row, own in enumerate(baseline):
            step = max(1, len(own.time_s) // _POINTS)
            for c, axis in enumerate("XYZ"):
                panel = axes[row, c]
                residual = own.residual_n_m_s[:, c]
                panel.plot(own.time_s[::step], residual[::step], ".", ms=1.2, color="#c4c4c4")
                mean = running_mean(residual, WINDOW_ROWS)
                panel.plot(own.time_s, mean, lw=1.4, color=POSTERIOR, label="baseline")
                if len(extended):
                    after = running_mean(extended[row].residual_n_m_s[:, c], WINDOW_ROWS)
                    panel.plot(
                        extended[row].time_s, after, lw=1.2, color="#d95f02", label="extended"
                    )
                panel.axhline(0.0, lw=0.6, color=INK)
                limit = 1.15 * float(np.quantile(np.abs(residual), 0.997))
                panel.set_ylim(-limit, limit)
                panel.set_title(f"{own.event}, {axis}", loc="left")
                if row == len(baseline) - 1:
                    panel.set_xlabel("time since first row (s)")
                if c == 0:
                    panel.set_ylabel("innovation (N m s)")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        labels = [f"{label}: mean of {WINDOW_ROWS} rows" for label in labels]
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def cause_figure(causes: Sequence[Mapping[str, Any]]) -> Figure:
    """Posterior probability and log Bayes factor against ``none`` of the most probable causes."""
    shown = list(causes[:MOST_CAUSES])[::-1]
    names = [str(cause["name"]) for cause in shown]
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(8.6, 0.27 * len(shown) + 1.3), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        colours = ["#777777" if name in ("none", "unknown") else POSTERIOR for name in names]
        places = np.arange(len(shown))
        left.barh(places, [cause["probability"] for cause in shown], color=colours)
        left.set_yticks(places, names)
        left.set_xlim(0.0, 1.0)
        left.set_xlabel("posterior probability (1)")
        right.barh(places, [cause["log_bayes_factor"] for cause in shown], color=colours)
        right.axvline(0.0, lw=0.8, color=VERDICT_COLOURS["conflict"])
        right.set_xscale("symlog", linthresh=10.0)
        right.set_xlabel("log Bayes factor against none (nats)")
    return figure


def width_figure(probability: pd.DataFrame, most: int = 7) -> Figure:
    """Probability of causes (rows, most probable first) at prior widths (columns)."""
    shown = probability.head(most).iloc[::-1]
    colours = ("#a6c4e0", POSTERIOR, "#d95f02")
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(7.4, 0.45 * len(shown) + 1.2), layout="constrained")
        axes = figure.subplots()
        places = np.arange(len(shown))
        for i, width in enumerate(shown.columns):
            axes.barh(
                places + 0.25 * (1 - i),
                shown[width],
                height=0.24,
                color=colours[i % len(colours)],
                label=f"width × {width:g}",
            )
        axes.set_yticks(places, [str(name) for name in shown.index])
        axes.set_xlim(0.0, 1.0)
        axes.set_xlabel("posterior probability (1)")
        figure.legend(loc="outside lower center", ncols=3)
    return figure
