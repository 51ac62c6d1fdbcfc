"""Figure of diagnosed on-times: how causes compare, and held-out predictions against flight."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cassini_bayes.report.plots.powers import label_powers
from cassini_bayes.report.plots.style import INK, POSTERIOR, VERDICT_COLOURS, styled_figure

MOST_CAUSES = 7  # bars that fit one column
GREY = "#777777"
LINEAR_NATS = 10.0  # up to which the axis of log Bayes factors is linear


def on_time_figure(
    probability: pd.DataFrame, log_bayes_factor: Mapping[str, float], points: pd.DataFrame
) -> Figure:
    """Log Bayes factors of the most probable causes; held-out predictions of every on-time.

    ``probability`` is indexed by cause, most probable first; ``points`` has flight_s, none_s,
    none_half_s, first_s, first_half_s.
    """
    names = [str(name) for name in probability.index[:MOST_CAUSES]][::-1]
    first = str(probability.index[0])
    with styled_figure(9.6, 4.4) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
        colours = [GREY if name in ("none", "unknown") else POSTERIOR for name in names]
        left.barh(range(len(names)), [log_bayes_factor[name] for name in names], color=colours)
        left.set_yticks(range(len(names)), names)
        left.set_xscale("symlog", linthresh=LINEAR_NATS)
        label_powers(left.xaxis)
        left.set_xlabel("log Bayes factor against none (nats)")
        top = float(points[["flight_s", "none_s", "first_s"]].to_numpy().max()) * 1.05
        right.plot([0.0, top], [0.0, top], color=INK, lw=0.7, label="as flown")
        for prefix, name, colour, marker in (
            ("none", "none (ideal)", VERDICT_COLOURS["conflict"], "x"),
            ("first", first, POSTERIOR, "o"),
        ):
            right.errorbar(
                points["flight_s"],
                points[f"{prefix}_s"],
                yerr=np.asarray(points[f"{prefix}_half_s"]),
                fmt=marker,
                ms=4.0,
                lw=0.0,
                elinewidth=0.9,
                color=colour,
                label=f"{name}, central 90 % prediction interval",
            )
        right.set_xlabel("flight on-time of a thruster (s)")
        right.set_ylabel("predicted from the other events (s)")
        figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
