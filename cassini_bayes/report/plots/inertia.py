"""Inertia beside the methods it replaces, and what the events could tell before sampling."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from cassini_bayes.balance.inertia import ELEMENTS, WITH_WHEELS
from cassini_bayes.report.plots.quantities import INTERVAL_SHORT, observed_name
from cassini_bayes.report.plots.style import (
    BASELINE,
    INK,
    POSTERIOR,
    PRIOR,
    headline,
    legend_below,
    line,
    new_figure,
    patch,
    symbol,
    symbols,
)
from cassini_bayes.report.plots.tables import both_draws
from cassini_bayes.results.review import Review
from cassini_bayes.results.tables import hdi

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cassini_bayes.report.plots.style import Handle

VERDICT_FILLS: Final = {
    "seen well": "#22558c",
    "seen": "#6699CC",
    "hardly seen": "#c9d8e8",
    "not seen": "#dddddd",
}
WIDEST_SD: Final = 6.0  # prior standard deviations that the axis shows on either side


def inertia_figure(review: Review) -> Figure | None:
    """Every element: prior, posterior, and the papers' least squares with their bars.

    None where no element was walked.
    """
    walked = [e for e in ELEMENTS if WITH_WHEELS.format(e) in review.fit.posterior]
    if not walked:
        return None
    methods = review.inertia_methods
    labels = [] if methods.empty else list(dict.fromkeys(methods["label"]))
    figure = new_figure(11.6, 2 * (0.17 * len(labels) + 1.5) + 0.9)
    panels = figure.subplots(2, 3, sharey=True, squeeze=False).ravel()
    for element, axes in zip(walked, panels, strict=False):
        _element(axes, review, element, labels)
    for axes in panels[len(walked) :]:
        axes.remove()
    headline(figure, "Inertia about the centre of mass, wheels included as if not spinning")
    legend_below(figure, _inertia_legend(bool(labels)), ncols=3)
    return figure


def _element(axes: Axes, review: Review, element: str, labels: list[str]) -> None:
    name = WITH_WHEELS.format(element)
    posterior, prior = both_draws(review, name)
    low, high = hdi(posterior)
    before = np.quantile(prior, [0.05, 0.95])
    axes.axvspan(before[0], before[1], color="#ececec", zorder=0)
    axes.hlines(0, low, high, color=POSTERIOR, lw=5, zorder=3)
    symbols(axes, [posterior.mean()], [0], "o", 5, POSTERIOR, hollow=True, zorder=4)
    ends = [float(before[0]), float(before[1]), float(low), float(high)]
    if labels:
        table = review.inertia_methods
        rows = table[table["element"] == element].set_index("label")
        for place, label in enumerate(labels, start=1):
            if label in rows.index and np.isfinite(float(rows.loc[label, "estimate_kg_m2"])):
                _method(axes, place, rows.loc[label])
                ends.append(float(rows.loc[label, "estimate_kg_m2"]))
    centre, reach = float(prior.mean()), WIDEST_SD * float(prior.std())
    axes.set_xlim(
        max(min(ends) - 0.05 * reach, centre - reach), min(max(ends) + 0.05 * reach, centre + reach)
    )
    axes.set_yticks(range(len(labels) + 1), ["posterior", *labels])
    axes.set_ylim(len(labels) + 0.6, -0.6)
    axes.set_xlabel(f"I {element} [kg m²]")
    axes.grid(axis="x")
    axes.locator_params(axis="x", nbins=5)


def _method(axes: Axes, place: int, row: pd.Series) -> None:
    estimate, bar = float(row["estimate_kg_m2"]), float(row["bar_rss_kg_m2"])
    axes.hlines(place, estimate - bar, estimate + bar, color=BASELINE, lw=1.0, zorder=3)
    axes.plot([estimate], [place], "D", color=BASELINE, ms=4.2, zorder=4)


def _inertia_legend(methods: bool) -> list[Handle]:
    posterior = f"posterior mean and {INTERVAL_SHORT}"
    handles: list[Handle] = [
        line(color=POSTERIOR, marker="o", lw=5, mfc="white", label=posterior),
        patch(facecolor="#ececec", edgecolor=PRIOR, label="prior, 90 % equal-tailed interval"),
    ]
    if methods:
        label = "least squares ± perturbations (rss)"
        handles.append(line(color=BASELINE, marker="D", ms=4.2, lw=1.0, label=label))
    return handles


def observability_figure(review: Review) -> Figure:
    """Expected posterior over prior width, and the width that came out."""
    table = review.observability.table
    rows = table[~table["quantity"].str.contains("thrust[", regex=False)]
    levels = table[table["quantity"].str.startswith("thrust[all events")]
    shown = pd.concat([levels, rows], ignore_index=True)
    figure = new_figure(9.6, 0.21 * len(shown) + 1.5)
    axes = figure.subplots()
    came_out = _came_out(review)
    for place, (_, row) in enumerate(shown.iterrows()):
        fill = VERDICT_FILLS[str(row["verdict"])]
        axes.barh(place, row["ratio"], height=0.7, color=fill, zorder=2)
        label = observed_name(str(row["quantity"]))
        if label in came_out:
            symbols(axes, [came_out[label]], [place], "o", 4.6, INK, hollow=True, zorder=3)
    axes.set_yticks(range(len(shown)), [observed_name(str(q)) for q in shown["quantity"]])
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_xlim(0.0, 1.15)
    axes.axvline(1.0, color="#999999", lw=0.8)
    axes.grid(axis="x")
    axes.set_xlabel("posterior over prior standard deviation (1: the prior is returned)")
    headline(figure, "What these events can see: expected before sampling, and what came out")
    expected = [
        patch(facecolor=fill, label=f"expected: {verdict}")
        for verdict, fill in VERDICT_FILLS.items()
    ]
    came = symbol("o", 5, INK, "came out (sd ratio)", hollow=True)
    legend_below(figure, [*expected, came], ncols=5)
    return figure


def _came_out(review: Review) -> dict[str, float]:
    """Posterior over prior standard deviation of the same quantities."""
    result = {
        str(row["name"]): float(row["sd"]) / float(row["prior_sd"])
        for _, row in review.nuisances.iterrows()
    }
    levels = review.summary[review.summary["quantity"] == "thrust_level_n"]
    for _, row in levels.iterrows():
        if float(row["prior_sd"]) > 0:
            result[f"{row['item']} level"] = float(row["sd"]) / float(row["prior_sd"])
    return result
