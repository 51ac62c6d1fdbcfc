"""Figure of diagnosed on-times: how causes compare, and held-out predictions against flight."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cassini_bayes.report.plots.criticism import evidence_axis
from cassini_bayes.report.plots.style import (
    INK,
    POSTERIOR,
    VERDICT_COLOURS,
    label_axes,
    legend_below,
    styled_figure,
)

MOST_CAUSES = 7  # bars that fit one column
GREY = "#777777"


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
        evidence_axis(left, far=True)
        top = float(points[["flight_s", "none_s", "first_s"]].to_numpy().max()) * 1.05
        right.plot([0.0, top], [0.0, top], color=INK, lw=0.7, label="as flown")
        for prefix, name, colour, marker in (
            ("none", "none (ideal)", VERDICT_COLOURS["conflict"], "x"),
            ("first", first, POSTERIOR, "o"),
        ):
            look = {"ms": 4.0, "lw": 0.0, "elinewidth": 0.9, "color": colour}
            x, y, half = (points[key] for key in ("flight_s", f"{prefix}_s", f"{prefix}_half_s"))
            label = f"{name}, central 90 % prediction interval"
            right.errorbar(x, y, yerr=np.asarray(half), fmt=marker, label=label, **look)
        across, up = "flight on-time of a thruster (s)", "predicted from the other events (s)"
        label_axes(right, across, up)
        legend_below(figure, right, ncols=3)
    return figure
