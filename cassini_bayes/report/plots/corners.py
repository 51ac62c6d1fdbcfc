"""Corner plots with the prior drawn in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.arviz_import import corner
from cassini_bayes.report.plots.quantities import MISSING, plus_minus, wrapped_name
from cassini_bayes.report.plots.style import INK, POSTERIOR, PRIOR_LINE, headline, line, new_figure
from cassini_bayes.report.plots.tables import Column, common_column, level_columns, nuisance_column
from cassini_bayes.results.review import Review

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_DRAWS: Final = 8_000  # in the panels, evenly thinned: contours are smooth with them
FEW_COLUMNS: Final = 5
"""Of a corner plot that can be read at the width of the page."""
CONTOUR_LEVELS: Final = (0.393, 0.865)  # 1 and 2 standard deviations of a two-dimensional normal
PANEL_IN: Final = 1.32  # inches of a panel
SMALLEST_IN: Final = 6.0  # inches of a figure: its title fits
KEY_IN: Final = 1.0  # inches for the legend above few panels
ROOM_FOR_KEY: Final = 6  # columns
LABEL_OFFSET_IN: Final = 0.46  # inches from axis to label: two lines of ticks
BINS: Final = 26  # across a panel of the posterior
PRIOR_BINS: Final = 40  # across a panel of the prior, smoothed over two
FARTHEST_PRIOR: Final = 10.0  # posterior standard deviations at which a prior is still shown
WIDEST_VIEW: Final = 5.0  # posterior standard deviations shown on either side for a wide prior


def thrust_corner(review: Review) -> Figure | None:
    """Levels of all thrusters with tail-off time: the thrust–tail-off degeneracy."""
    columns = level_columns(review)
    tail = nuisance_column(review, "tau_fall_s")
    title = "Thrust levels of the thrusters"
    if tail is not None:
        columns.append(tail)
        title += " and the tail-off time"
    return corner_figure(columns, title)


def joint_corner(review: Review) -> Figure | None:
    """The few quantities that are most correlated: the common thrust, and what is walked."""
    columns = [c for name in review.nuisances["name"] if (c := nuisance_column(review, str(name)))]
    common = common_column(review)
    chosen = most_correlated([common, *columns] if common else columns, first=common is not None)
    return corner_figure(chosen, "What trades against what")


def most_correlated(
    columns: Sequence[Column], *, first: bool, count: int = FEW_COLUMNS
) -> list[Column]:
    """The columns most tied to one another, in their order; with ``first``, the first in any case.

    Greedy: the strongest pair (of the first, if it is asked for), then whatever correlates most
    with one that is already in.
    """
    usable = [c for c in columns if _varies(c.posterior)]
    if len(usable) <= count:
        return usable
    tied = np.abs(np.corrcoef(np.stack([_thin(c.posterior) for c in usable])))
    np.fill_diagonal(tied, 0.0)
    kept = [0] if first and usable[0] is columns[0] else [int(np.argmax(tied.max(0)))]
    while len(kept) < count:
        left = [j for j in range(len(usable)) if j not in kept]
        kept.append(max(left, key=lambda j: float(tied[kept, j].max())))
    return [usable[j] for j in sorted(kept)]


def nuisance_corner(review: Review, names: Sequence[str], title: str) -> Figure | None:
    """Some of the walked parameters."""
    return corner_figure([c for name in names if (c := nuisance_column(review, name))], title)


def corner_figure(columns: Sequence[Column], title: str) -> Figure | None:
    """Corner plot of at least two varying columns; None with fewer, or fewer draws than columns.

    Two-dimensional contours hold 39 % and 86 % of the draws (1 and 2 standard deviations of a
    two-dimensional normal). Columns that do not vary or are not finite are left out and named.
    """
    usable = [c for c in columns if _varies(c.posterior)]
    if len(usable) < 2 or len(usable[0].posterior) <= len(usable):
        return None
    left_out = [c.label for c in columns if not _varies(c.posterior)]
    library = corner()
    draws = np.column_stack([_thin(c.posterior) for c in usable])
    ranges = [_view(c) for c in usable]
    size = max(PANEL_IN * len(usable) + 0.9, SMALLEST_IN)
    key_in = KEY_IN if len(usable) < ROOM_FOR_KEY else 0.0  # above the panels where few are
    height = size + key_in
    figure = new_figure(size, height, by_hand=True)
    library.corner(
        draws,
        fig=figure,
        bins=BINS,
        range=ranges,
        levels=CONTOUR_LEVELS,
        smooth=1.0,
        plot_datapoints=False,
        plot_density=False,
        fill_contours=True,
        color=POSTERIOR,
        max_n_ticks=3,
        hist_kwargs={"density": True, "lw": 1.3},
    )
    cells = np.array(figure.axes).reshape(len(usable), len(usable))
    for i, row in enumerate(usable):
        for j in range(len(usable)):
            if j > i:
                cells[i, j].remove()
            elif j == i:
                _prior_density(cells[i, i], row, ranges[i])
                _diagonal(cells[i, i], row)
            else:
                _prior_contour(library, cells[i, j], usable[j], row, ranges[j], ranges[i])
                _correlation(cells[i, j], draws[:, j], draws[:, i])
    lines = max(wrapped_name(c.label).count("\n") for c in usable)
    margin_in = 0.85 + 0.16 * lines
    figure.subplots_adjust(
        left=margin_in / size,
        bottom=margin_in / height,
        right=1.0 - 0.12 / size,
        top=1.0 - (0.62 + 0.13 * lines + key_in) / height,
        wspace=0.06,
        hspace=0.06,
    )
    _labels(cells, usable)
    _key(figure, title, left_out)
    return figure


def _varies(values: Array) -> bool:
    return bool(np.isfinite(values).all() and np.ptp(values) > 1e-12 * abs(values).max())


def _thin(values: Array) -> Array:
    step = -(-len(values) // MOST_DRAWS)
    return values[::step]


def _view(column: Column) -> tuple[float, float]:
    """Axis limits: the bulk of the posterior, and of the prior where it is not far wider."""
    low, high = np.quantile(column.posterior, [0.002, 0.998])
    centre, sd = column.posterior.mean(), column.posterior.std()
    if _varies(column.prior):
        prior_low, prior_middle, prior_high = np.quantile(column.prior, [0.02, 0.5, 0.98])
        low = min(low, max(prior_low, centre - WIDEST_VIEW * sd))
        high = max(high, min(prior_high, centre + WIDEST_VIEW * sd))
        if abs(prior_middle - centre) < FARTHEST_PRIOR * sd:  # a conflict is shown whole
            low, high = min(low, prior_middle - sd), max(high, prior_middle + sd)
    room = 0.04 * (high - low)
    return float(low - room), float(high + room)


def _prior_density(axes: Axes, column: Column, view: tuple[float, float]) -> None:
    """Prior density on the diagonal, on the same scale as the posterior's."""
    if not _varies(column.prior):
        return
    edges = np.linspace(*view, PRIOR_BINS + 1)
    counts = np.histogram(column.prior, edges)[0] / (len(column.prior) * (edges[1] - edges[0]))
    density = gaussian_filter1d(counts, 2.0, mode="nearest")
    axes.plot((edges[1:] + edges[:-1]) / 2.0, density, color=PRIOR_LINE, ls="--", lw=1.2)
    axes.set_ylim(0.0, max(axes.get_ylim()[1], 1.1 * float(density.max())))


def _prior_contour(
    corner: Any,
    axes: Axes,
    x: Column,
    y: Column,
    view_x: tuple[float, float],
    view_y: tuple[float, float],
) -> None:
    """Prior contours of the same levels, from the prior's own range; may lie outside the view."""
    if not (_varies(x.prior) and _varies(y.prior)):
        return
    own = [tuple(np.quantile(c.prior, [0.001, 0.999])) for c in (x, y)]
    corner.hist2d(
        x.prior,
        y.prior,
        ax=axes,
        bins=20,
        range=own,
        levels=CONTOUR_LEVELS,
        smooth=1.2,
        plot_datapoints=False,
        plot_density=False,
        no_fill_contours=True,
        contour_kwargs={"colors": PRIOR_LINE, "linestyles": "dashed", "linewidths": 0.8},
        new_fig=False,
    )
    axes.set_xlim(*view_x)
    axes.set_ylim(*view_y)


def _diagonal(axes: Axes, column: Column) -> None:
    text = plus_minus(float(column.posterior.mean()), float(column.posterior.std(ddof=1)))
    axes.set_title(f"{wrapped_name(column.label)}\n{text}", fontsize=8)


def _correlation(axes: Axes, x: Array, y: Array) -> None:
    r = float(np.corrcoef(x, y)[0, 1])
    if abs(r) >= 0.2:
        axes.text(
            0.96, 0.95, f"r = {r:.2f}".replace("-", "−"), transform=axes.transAxes, ha="right",
            va="top", fontsize=6.5, color=INK,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.8},
        )  # fmt: skip


def _labels(cells: NDArray[np.object_], columns: Sequence[Column]) -> None:
    """Names with units along the left and lower edges, ticks small and upright."""
    last = len(columns) - 1
    size_in = cells[0, 0].get_position().size * cells[0, 0].figure.get_size_inches()
    below, beside = -LABEL_OFFSET_IN / size_in[::-1]
    for i, column in enumerate(columns):
        label = f"{wrapped_name(column.label)}\n[{column.unit}]"
        bottom = cells[last, i]
        bottom.set_xlabel(label, fontsize=8.5)
        bottom.xaxis.set_label_coords(0.5, below)
        if i > 0:
            cells[i, 0].set_ylabel(label, fontsize=8.5)
            cells[i, 0].yaxis.set_label_coords(beside, 0.5)
        else:
            inverse = MISSING if column.unit == MISSING else f"1/({column.unit})"
            cells[0, 0].set_ylabel(f"density\n[{inverse}]", fontsize=8.5)
            cells[0, 0].yaxis.set_label_coords(beside, 0.5)
        for j in range(i + 1):
            axes = cells[i, j]
            axes.tick_params(labelsize=6.8, length=2.5, pad=2)
            axes.tick_params(axis="x", labelrotation=45, labelbottom=i == last)
            axes.tick_params(axis="y", labelleft=j == 0)
            for axis in (axes.xaxis, axes.yaxis):
                axis.get_offset_text().set_visible(False)


def _key(figure: Figure, title: str, left_out: Sequence[str]) -> None:
    headline(figure, title, x=0.99, ha="right")
    inside = " and ".join(f"{100 * level:.0f} %" for level in CONTOUR_LEVELS)
    handles = [
        line(color=POSTERIOR, lw=1.5, label=f"posterior; contours hold {inside}"),
        line(color=PRIOR_LINE, ls="--", lw=1.2, label="prior; same contours"),
        line(lw=0, label="above: mean ± standard deviation; r: correlation"),
    ]
    if left_out:
        handles.append(line(lw=0, label=f"fixed, not drawn: {', '.join(left_out)}"))
    figure.legend(
        handles=handles,
        loc="upper right",
        bbox_to_anchor=(0.995, 1 - 0.42 / figure.get_figheight()),
    )
