"""Thrust of every thruster in every bias, with its prior and the method it replaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report.plots.panels import bars, finish, limits_of, outer_labels, thruster_panels
from cassini_bayes.report.plots.quantities import INTERVAL, INTERVAL_SHORT, short_events
from cassini_bayes.report.plots.style import (
    BASELINE,
    INK,
    PRIOR,
    headline,
    legend_below,
    line,
    patch,
    symbol,
    symbols,
    thruster_styles,
)
from cassini_bayes.report.plots.tables import (
    events_of,
    flat_draws,
    level_row,
    thrust_grid,
    thrusters_of,
)
from cassini_bayes.results.baselines import MEAN, PER_EVENT, POOLED
from cassini_bayes.results.review import Review
from cassini_bayes.results.tables import hdi

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cassini_bayes.report.plots.style import Handle


ALL_EVENTS: Final = "all events"


@dataclass(frozen=True)
class BaselineStyle:
    """How the estimates of one baseline method are drawn."""

    per_event: str
    pooled: str | None
    label: str
    marker: str
    offset: float


# The two methods of the papers; a pooled estimate stands in the column of all events.
BASELINES: Final = (
    BaselineStyle(PER_EVENT, POOLED, "pseudo-inverse", "D", 0.05),
    BaselineStyle(MEAN, None, "mean of all thrusters", "s", 0.34),
)


def thrust_figure(review: Review) -> Figure:
    """Credible interval of every thruster in every event, one panel per thruster.

    Grey band: prior. Thick bar and marker: posterior. Black symbols: the least-squares methods of
    the papers with their perturbation bars, hollow where the papers call the estimate not valid.
    Dashed: the thrust printed with the event. Estimates outside the axes are carets at the edge
    with their value. The last column is the thruster's level over all events.
    """
    events, thrusters = events_of(review), thrusters_of(review)
    styles = thruster_styles(thrusters)
    labels = [*short_events(events), ALL_EVENTS]
    mean = _with_level(review, "mean")
    low, high = _with_level(review, "hdi_90_low"), _with_level(review, "hdi_90_high")
    band = _prior_bounds(review)
    printed = _printed(review)
    limits = limits_of(low, high, *band, printed, room=0.10 if review.baseline.empty else 0.22)
    figure, panels = thruster_panels(thrusters, len(labels))
    for k, (name, axes) in enumerate(zip(thrusters, panels, strict=True)):
        style = styles[name]
        _prior_band(axes, band[0][:, k], band[1][:, k])
        _printed_line(axes, printed)
        for look in BASELINES:
            _baseline(axes, review, look, name, limits)
        of_thruster = (mean[:, k], low[:, k], high[:, k])
        bars(axes, *of_thruster, style.colour, style.marker, offset=-0.27, width=5)
        axes.axvline(len(events) - 0.5, color="#777777", lw=0.8, zorder=1)
        finish(axes, name, labels, limits)
    outer_labels(panels)
    headline(figure, f"Thrust of every thruster in every bias – posterior mean and {INTERVAL}")
    legend_below(figure, _thrust_legend(review, printed))
    return figure


def _with_level(review: Review, column: str) -> Array:
    """Rows: events, then the level over all events; columns: thrusters. (E + 1, K)"""
    return np.vstack([thrust_grid(review, column), level_row(review, column)])


def _printed(review: Review) -> Array:
    """Thrust printed with each event, NaN where none, (E,)."""
    constants = review.fit.groups["constant_data"]
    if "thrust_predicted_n" not in constants:
        return np.full(len(events_of(review)), np.nan)
    printed = constants["thrust_predicted_n"].sel(event=events_of(review))
    return np.asarray(printed.values, dtype=float)


def _prior_bounds(review: Review) -> tuple[Array, Array]:
    """Prior interval of each thruster in each event, then of its level, (E + 1, K) each.

    Events are alike before the data: their draws are put together for a smooth bound.
    """
    prior = review.fit.prior.sel(event=events_of(review))
    thrust = flat_draws(prior, "thrust_n")
    low, high = hdi(thrust.reshape(-1, thrust.shape[-1]))
    level_low, level_high = hdi(flat_draws(review.fit.prior, "thrust_level_n"))
    repeat = (thrust.shape[1], 1)
    return (
        np.vstack([np.tile(low, repeat), level_low]),
        np.vstack([np.tile(high, repeat), level_high]),
    )


def _prior_band(axes: Axes, low: Array, high: Array) -> None:
    centre = np.arange(len(low))
    axes.bar(centre, high - low, bottom=low, width=1.0, color="#e9e9e9", zorder=0.5)
    edges = np.arange(len(low) + 1) - 0.5
    for bound in (low, high):
        axes.stairs(bound, edges, baseline=None, color=PRIOR, lw=0.8, zorder=0.6)


def _printed_line(axes: Axes, printed: Array) -> None:
    for i, value in enumerate(printed):
        if np.isfinite(value):
            axes.hlines(value, i - 0.5, i + 0.5, color=INK, lw=1.1, ls=(0, (3, 1.5)), zorder=2)


def _baseline(
    axes: Axes, review: Review, look: BaselineStyle, thruster: str, limits: tuple[float, float]
) -> None:
    """One method's estimates of one thruster, bars clipped by the axes, far values as carets."""
    for place, row in _baseline_rows(review, look, thruster):
        x = place + look.offset
        estimate, bar = float(row["estimate_n"]), float(row["bar_rss_n"])
        if not np.isfinite(estimate):
            continue
        margin = 0.015 * (limits[1] - limits[0])
        if not limits[0] + margin <= estimate <= limits[1] - margin:
            _caret(axes, x, estimate, limits, valid=bool(row["valid"]))
            continue
        if np.isfinite(bar):
            axes.vlines(x, estimate - bar, estimate + bar, color=BASELINE, lw=0.9, zorder=3)
        _estimate(axes, x, estimate, look.marker, 3.8, valid=bool(row["valid"]))


def _estimate(axes: Axes, x: float, y: float, marker: str, size: float, *, valid: bool) -> None:
    """A symbol of a replaced method, hollow where the papers call the estimate not valid."""
    symbols(axes, [x], [y], marker, size, BASELINE, hollow=not valid, mew=0.8, zorder=3.5)


def _baseline_rows(
    review: Review, look: BaselineStyle, thruster: str
) -> list[tuple[int, pd.Series]]:
    """(slot on the event axis, row) of one method and thruster."""
    table = review.baseline
    if table.empty:
        return []
    events = events_of(review)
    mine = table[table["thruster"] == thruster]
    result = [
        (events.index(row["event"]), row)
        for _, row in mine[mine["method"] == look.per_event].iterrows()
        if row["event"] in events
    ]
    if look.pooled is not None:
        result += [(len(events), row) for _, row in mine[mine["method"] == look.pooled].iterrows()]
    return result


def _caret(axes: Axes, x: float, value: float, limits: tuple[float, float], *, valid: bool) -> None:
    above = value > limits[1]
    room = 0.035 * (limits[1] - limits[0])
    y = limits[1] - room if above else limits[0] + room
    _estimate(axes, x, y, "^" if above else "v", 3.6, valid=valid)
    shift, side = (-4, "top") if above else (4, "bottom")
    beside: dict[str, Any] = {"xytext": (0, shift), "textcoords": "offset points", "va": side}
    look: dict[str, Any] = {"fontsize": 5.8, "color": BASELINE, "zorder": 3.5}
    text = f"{value:.2f}".replace("-", "−")
    axes.annotate(text, (x, y), ha="center", rotation=90, **beside, **look)


def _thrust_legend(review: Review, printed: Array) -> list[Handle]:
    posterior = {"color": "#332288", "marker": "o", "lw": 5, "ms": 5, "mfc": "white"}
    handles: list[Handle] = [
        line(**posterior, label=f"posterior, {INTERVAL_SHORT}"),
        patch(facecolor="#e9e9e9", edgecolor=PRIOR, label=f"prior, {INTERVAL_SHORT}"),
    ]
    if np.isfinite(printed).any():
        handles.append(line(color=INK, lw=1.1, ls=(0, (3, 1.5)), label="printed with the event"))
    if not review.baseline.empty:
        bars_of = {look.marker: f"{look.label} ± perturbations (rss)" for look in BASELINES}
        handles += [
            line(color=BASELINE, marker=marker, lw=0.9, ms=4.5, label=label)
            for marker, label in bars_of.items()
        ]
        handles += [
            symbol("D", 4.5, BASELINE, "hollow: on-time < 5 s, not valid", hollow=True),
            symbol("^", 4.5, BASELINE, "beyond the axes: value printed"),
        ]
    return handles
