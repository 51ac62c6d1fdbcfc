"""Figures of any scalars of a fit, from its draws alone: corner with the prior drawn in, trace."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
import xarray as xr

from cassini_bayes.report.plots.corners import corner_figure
from cassini_bayes.report.plots.quantities import display_scale, short_name
from cassini_bayes.report.plots.style import PRIOR_LINE, headline, new_figure
from cassini_bayes.report.plots.tables import Column
from cassini_bayes.results.record import Fit
from cassini_bayes.sweep.models import scalar_names, units_of, values_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEADLINES: Final = (
    *("thrust_common_n", "tau_fall_s"),
    *(f"inertia_{axis}{axis}_kg_m2" for axis in "xyz"),
    "cm_x_m",
)
"""Scalars that say most of a fit at a glance: shown where none are named, if a fit has them."""
MOST_TRACED: Final = 1_000  # steps of a walker drawn: about as many as a panel has pixels
ROW_IN: Final = 1.25  # inches: an axis with three tick labels


def columns_of(fit: Fit, names: Sequence[str]) -> list[Column]:
    """Posterior and prior draws of named scalars, in units that a reader can take in."""
    result = []
    after, before = values_of(fit.posterior, names), values_of(fit.prior, names)
    for j, (name, unit) in enumerate(zip(names, units_of(fit.posterior, names), strict=True)):
        values, prior = after[:, j], before[:, j]
        scale = display_scale(unit, float(np.abs(values).mean()), float(np.abs(prior).mean()))
        label = short_name(name, unit)
        result.append(Column(label, scale.unit, values * scale.factor, prior * scale.factor))
    return result


def scalar_corner(fit: Fit, names: Sequence[str]) -> Figure | None:
    """Corner plot of named scalars; None with fewer than two that vary."""
    return corner_figure(columns_of(fit, names), "Posterior and prior")


def trace_figure(fit: Fit, names: Sequence[str]) -> Figure:
    """Draws of named scalars in their order, one colour an ensemble, with the prior's mean."""
    figure = new_figure(8.6, ROW_IN * len(names) + 0.8)
    panels = figure.subplots(len(names), 1, squeeze=False)[:, 0]
    for panel, name, column in zip(panels, names, columns_of(fit, names), strict=True):
        chains = column.posterior.reshape(fit.posterior.sizes["chain"], -1)
        every = max(1, chains.shape[1] // MOST_TRACED)
        places = np.arange(0, chains.shape[1], every)
        for chain in chains:
            panel.plot(places, chain[::every], lw=0.5, alpha=0.8)
        panel.axhline(float(column.prior.mean()), color=PRIOR_LINE, lw=1.0)
        panel.set_ylabel(column.unit)
        panel.set_title(name, loc="left")
    panels[-1].set_xlabel("draw (one colour an ensemble; line: prior mean)")
    headline(figure, "Draws in order")
    return figure


def headlines(posterior: xr.Dataset) -> tuple[str, ...]:
    """The scalars that say most of a fit at a glance, those that it has."""
    known = scalar_names(posterior)
    return tuple(name for name in HEADLINES if name in known)
