"""Panels of one thruster each, side by side, with events along x."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report.plots.style import event_axis, new_figure, symbols

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PANELS_ACROSS: Final = 4  # a page
NARROWEST_IN: Final = 9.2  # title and legend need it
THRUST_LABEL: Final = "thrust [N]"


def limits_of(*values: Array, room: float = 0.10) -> tuple[float, float]:
    """Axis limits that hold all of ``values`` with room around them."""
    finite = np.concatenate([v[np.isfinite(v)] for v in values])
    if finite.size == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    margin = room * (high - low) or 0.01
    return low - margin, high + margin


def thruster_panels(thrusters: Sequence[str], slots: int) -> tuple[Figure, list[Axes]]:
    """A figure with one panel per thruster, all on the same axes."""
    across = min(PANELS_ACROSS, len(thrusters))
    down = -(-len(thrusters) // across)
    width = float(np.clip(0.27 * slots + 0.45, 2.2, 5.0)) * across + 0.6
    figure = new_figure(max(width, NARROWEST_IN), 2.6 * down + 1.9)
    made = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in made[len(thrusters) :]:
        axes.remove()
    return figure, list(made[: len(thrusters)])


def outer_labels(panels: Sequence[Axes]) -> None:
    """Event names under the lowest panel of each column, the thrust label on the left only."""
    across = min(PANELS_ACROSS, len(panels))
    for i, axes in enumerate(panels):
        lowest = i + across >= len(panels)
        axes.xaxis.label.set_visible(lowest)
        axes.tick_params(axis="x", labelbottom=lowest)
        axes.set_ylabel(THRUST_LABEL)
        axes.yaxis.label.set_visible(i % across == 0)


def finish(axes: Axes, name: str, labels: list[str], limits: tuple[float, float]) -> None:
    """Slots, limits and name of one thruster's panel."""
    event_axis(axes, labels)
    axes.set_ylim(*limits)
    axes.grid(axis="y")
    axes.set_title(name, fontweight="bold", loc="left")


def bars(
    axes: Axes,
    mean: Array,
    low: Array,
    high: Array,
    colour: str,
    marker: str,
    *,
    offset: float,
    width: float,
) -> None:
    """Intervals as thick lines with a white symbol at the mean, beside each slot."""
    x = np.arange(len(mean)) + offset
    axes.vlines(x, low, high, color=colour, lw=width, zorder=4)
    symbols(axes, x, mean, marker, 5.0, colour, hollow=True, mew=1.1, zorder=5)
