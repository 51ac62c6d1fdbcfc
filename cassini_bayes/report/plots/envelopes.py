"""Rank distributions of calibration campaigns in their simultaneous envelopes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from cassini_bayes.report.plots.style import POSTERIOR, STYLE, VERDICT_COLOURS
from cassini_bayes.results.ranks import Ranks, envelope_band, envelope_p_values

_COLUMNS: Final = 3  # panels across a page


def envelope_figure(ranks: Mapping[str, Ranks], probability: float) -> Figure:
    """ECDF of the ranks minus the uniform one, one panel per campaign (label → ranks).

    Every parameter is a line; the band holds the whole line of one parameter with the probability
    stated. Lines that leave it after Bonferroni's correction are red and the worst two are named.
    """
    with matplotlib.rc_context(dict(STYLE)):
        rows = -(-len(ranks) // _COLUMNS)
        figure = Figure(figsize=(11.0, 2.9 * rows), layout="constrained")
        axes = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True)
        for axis in axes.flat[len(ranks) :]:
            axis.set_visible(False)
        for axis, (label, campaign) in zip(axes.flat, ranks.items(), strict=False):
            n, parameters = campaign.ranks.shape
            grid, low, high = envelope_band(n, probability)
            axis.fill_between(grid, low - grid, high - grid, color="#bcd0e6")
            p_values = envelope_p_values(campaign.ranks)
            bad = p_values * parameters <= 1.0 - probability
            for column, outside in zip(campaign.ranks.T, bad, strict=True):
                result = np.searchsorted(np.sort(column), grid, side="right") / n - grid
                colour = VERDICT_COLOURS["conflict"] if outside else POSTERIOR
                axis.plot(grid, result, lw=0.5, color=colour, alpha=0.8 if outside else 0.35)
            worst = [campaign.names[i] for i in np.argsort(p_values)[:2] if bad[i]]
            title = f"{label}\n{n} repetitions, {parameters} parameters"
            axis.set_title(title + (f"\nout: {', '.join(worst)}" if worst else ""), loc="left")
            axis.axhline(0.0, color="black", lw=0.5)
        for axis in axes[:, 0]:
            axis.set_ylabel("ECDF of ranks − uniform\n(fraction)")
        lowest = [axes[(len(ranks) - 1 - column) // _COLUMNS, column] for column in range(_COLUMNS)]
        for axis in lowest[: len(ranks)]:  # of a last row that is not full, the one above
            axis.set_xlabel("normalised rank of the truth")
            axis.tick_params(labelbottom=True)
    return figure
