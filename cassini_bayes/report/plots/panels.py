"""Panels of one thruster each, side by side, with events along x."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report.plots.quantities import shortened
from cassini_bayes.report.plots.style import event_axis, new_figure, symbols

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PANELS_ACROSS: Final = 4  # a page
NARROWEST_IN: Final = 9.2  # title and legend need it
THRUST_LABEL: Final = "thrust [N]"
LONGEST_TITLE: Final = 28  # letters of an event in a panel of a third of a page


def limits_of(*values: Array, room: float = 0.10) -> tuple[float, float]:
    """Axis limits that hold all of ``values`` with room around them."""
    finite = np.concatenate([v[np.isfinite(v)] for v in values])
    if finite.size == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    margin = room * (high - low) or 0.01
    return low - margin, high + margin


def some_panels(figure: Figure, count: int, across: int, **shared: Any) -> list[Axes]:
    """Panels in rows of so many; the last row may be shorter."""
    made = figure.subplots(-(-count // across), across, squeeze=False, **shared).ravel()
    for spare in made[count:]:
        spare.remove()
    return list(made[:count])


def axis_panels(
    figure: Figure, events: Sequence[str], across: str, up: str, **shared: Any
) -> NDArray[np.object_]:
    """A panel of every event about every body axis (E, 3), the outer ones with labels."""
    panels: NDArray[np.object_] = figure.subplots(len(events), 3, squeeze=False, **shared)
    for row, event in zip(panels, events, strict=True):
        row[0].set_ylabel(up)
        for panel, axis in zip(row, "XYZ", strict=True):
            panel.set_title(f"{shortened(event, LONGEST_TITLE)}, {axis}", loc="left")
    for panel in panels[-1]:
        panel.set_xlabel(across)
    return panels


def thruster_panels(thrusters: Sequence[str], slots: int) -> tuple[Figure, list[Axes]]:
    """A figure with one panel per thruster, all on the same axes."""
    across = min(PANELS_ACROSS, len(thrusters))
    down = -(-len(thrusters) // across)
    width = float(np.clip(0.27 * slots + 0.45, 2.2, 5.0)) * across + 0.6
    figure = new_figure(max(width, NARROWEST_IN), 2.6 * down + 1.9)
    return figure, some_panels(figure, len(thrusters), across, sharex=True, sharey=True)


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
