"""Calibration figures: interval coverage per parameter, and rank distributions in a band."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import binom

from cassini_bayes.report.plots.style import (
    POSTERIOR,
    VERDICT_COLOURS,
    label_axes,
    legend_below,
    styled_figure,
)
from cassini_bayes.results.ranks import Ranks


def coverage_figure(ranks: Mapping[str, Ranks], tolerances: Mapping[str, float]) -> Figure:
    """Coverage of central 90 % intervals per parameter, and rank ECDF differences.

    One row per campaign (label → ranks, label → tolerance). Left: share of repetitions whose
    interval holds the truth, every parameter, sorted, with the tolerance asked for and the 99 %
    binomial band of a single parameter; red where outside the tolerance. Right: empirical
    distribution of the ranks minus the uniform one, every parameter, with the 99 % band of a single
    parameter at each rank.
    """
    with styled_figure(10.0, 3.1 * len(ranks) + 0.4) as figure:
        axes = figure.subplots(len(ranks), 2, squeeze=False)
        for (left, right), (label, every) in zip(axes, ranks.items(), strict=True):
            campaign = every.of_fitted()
            n, p = campaign.ranks.shape
            coverage = np.sort(campaign.coverage())
            low, high = binom.ppf([0.005, 0.995], n, 0.9) / n
            tolerance = tolerances[label]
            left.axhspan(0.9 - tolerance, 0.9 + tolerance, color="#dcdcdc", label="tolerance")
            left.axhspan(low, high, color="#bcd0e6", label="99 % band of one parameter (and rank)")
            outside = np.abs(coverage - 0.9) > tolerance
            colours = np.where(outside, VERDICT_COLOURS["conflict"], POSTERIOR)
            left.scatter(np.arange(p), coverage, s=8, c=colours, zorder=3)
            up = "coverage of 90 % intervals\n(central, fraction)"
            title = f"{label}: {n} repetitions, {p} parameters"
            label_axes(left, "parameter, sorted by coverage", up, title)
            left.set_ylim(min(0.8, coverage.min() - 0.02), 1.0)
            grid = np.linspace(0.0, 1.0, 101)
            band = 2.576 * np.sqrt(grid * (1.0 - grid) / n)
            right.fill_between(grid, -band, band, color="#bcd0e6")
            for column in campaign.ranks.T:
                difference = np.searchsorted(np.sort(column), grid, side="right") / n - grid
                right.plot(grid, difference, lw=0.5, color=POSTERIOR, alpha=0.35)
            across = "normalised rank of the truth among its posterior draws"
            label_axes(right, across, "ECDF of ranks − uniform\n(fraction)")
        legend_below(figure, axes[0, 0], ncols=2)
    return figure
