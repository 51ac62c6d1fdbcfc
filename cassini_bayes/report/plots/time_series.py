"""The momentum balance of a telemetry event, row by row."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report.plots.quantities import NORMAL_90, NORMAL_INTERVAL
from cassini_bayes.report.plots.style import (
    INK,
    POSTERIOR,
    headline,
    legend_below,
    line,
    new_figure,
    patch,
    symbol,
    symbols,
)
from cassini_bayes.results.time_series import EventSeries

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cassini_bayes.report.plots.style import Handle

BAND: Final = "#dcdcdc"
MEASURED: Final = "#b5651d"


def series_figure(series: EventSeries) -> Figure:
    """Three columns, one per body axis: the momentum above, the residual on its noise below."""
    figure = new_figure(12.4, 5.6)
    panels = figure.subplots(2, 3, sharex=True, height_ratios=(1.0, 1.0))
    for axis, name in enumerate("xyz"):
        above, below = panels[0, axis], panels[1, axis]
        _momentum(above, series, axis)
        _residual(below, series, axis)
        above.set_title(
            f"body axis {name}: {100 * series.inside[axis]:.0f} % of rows inside",
            loc="left",
            fontsize=9.5,
        )
        below.set_xlabel("time [s]")
    panels[0, 0].set_ylabel(f"{series.quantity} [N m s]")
    panels[1, 0].set_ylabel("measured − predicted [N m s]")
    thinned = f", every {_ordinal(series.every)} row" if series.every > 1 else ""
    headline(figure, f"{series.event} ({series.kind}): angular momentum balance{thinned}")
    legend_below(figure, _legend(), ncols=2)
    return figure


def _ordinal(n: int) -> str:
    endings = {1: "st", 2: "nd", 3: "rd"}
    return f"{n}{endings.get(n % 10, 'th') if n % 100 not in (11, 12, 13) else 'th'}"


def _momentum(axes: Axes, series: EventSeries, axis: int) -> None:
    time = series.time_s
    mean = series.predicted[:, axis]
    reach = NORMAL_90 * np.hypot(series.predicted_sd[:, axis], series.noise_sd[:, axis])
    axes.fill_between(time, mean - reach, mean + reach, color=POSTERIOR, alpha=0.2, lw=0)
    _dots(axes, time, series.measured[:, axis], 2.6, MEASURED)
    axes.plot(time, mean, color=POSTERIOR, lw=1.0, zorder=3)
    axes.grid(axis="y")


def _residual(axes: Axes, series: EventSeries, axis: int) -> None:
    time, noise = series.time_s, NORMAL_90 * series.noise_sd[:, axis]
    axes.fill_between(time, -noise, noise, color=BAND, lw=0)
    _dots(axes, time, series.residual[:, axis], 2.2, POSTERIOR)
    axes.axhline(0.0, color=INK, lw=0.8)
    reach = max(2.2 * float(noise.max()), 1.05 * float(np.abs(series.residual[:, axis]).max()))
    axes.set_ylim(-reach, reach)
    axes.grid(axis="y")


def _dots(axes: Axes, time: Array, values: Array, size: float, colour: str) -> None:
    """Rows as dots: a picture within the SVG, which thousands of marks would make heavy."""
    symbols(axes, time, values, ".", size, colour, rasterized=True, zorder=2)


def _legend() -> list[Handle]:
    return [
        symbol(".", 6, MEASURED, "measured"),
        line(color=POSTERIOR, lw=1.4, label="predicted, posterior mean"),
        patch(facecolor=POSTERIOR, alpha=0.2, label=f"prediction with noise: {NORMAL_INTERVAL}"),
        patch(facecolor=BAND, label=f"noise of a row: {NORMAL_INTERVAL}"),
    ]
