"""Figures of a diagnosis: channels laid over, spectra, a size with what it trades with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.figure import Figure

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.correlations import WINDOW_ROWS, running_mean
from cassini_bayes.diagnosis.nuisances import Trade
from cassini_bayes.diagnosis.overlay import Channel, Overlay
from cassini_bayes.diagnosis.spectrum import RARE, Spectrum
from cassini_bayes.report.plots.criticism import EXTENDED
from cassini_bayes.report.plots.panels import axis_panels
from cassini_bayes.report.plots.powers import label_powers
from cassini_bayes.report.plots.style import (
    INK,
    POSTERIOR,
    PRIOR,
    PRIOR_LINE,
    label_axes,
    legend_below,
    styled_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MEASURED: Final = "#9a9a9a"
CAUSE: Final = "#f3c9a4"
MEASURED_DOTS: Final[dict[str, Any]] = {"ms": 1.6, "color": MEASURED, "rasterized": True}
BASELINE_LINE: Final[dict[str, Any]] = {"lw": 2.2, "color": POSTERIOR, "alpha": 0.75}
EXTENDED_LINE: Final[dict[str, Any]] = {"lw": 0.9, "color": EXTENDED}
CONTOURS: Final = (0.5, 0.9)  # probability inside
_POINTS: Final = 2_500  # of a curve: more than a page has pixels
_ROOM: Final = 4.0  # widths of a posterior that a prior may take on either side of it
_MARGIN: Final = 0.2  # and that are left free at least
_BINS: Final = 40  # each way: a bin holds some draws of a few thousand


def overlay_figure(overlay: Overlay) -> Figure:
    """Rates and wheel speeds of one event as measured and modelled, and what is left of each.

    Upper panels: measured grey, baseline blue, extended orange; the area between the extended model
    and the same without its cause is shaded. Lower panels: measured less modelled, running means
    over 61 rows.
    """
    rates = [channel for channel in overlay.channels if channel.unit == "mrad/s"]
    wheels = [channel for channel in overlay.channels if channel.unit != "mrad/s"]
    columns = max(len(rates), len(wheels))
    with styled_figure(10.0, 8.6) as figure:
        panels = figure.subplots(
            4, columns, squeeze=False, sharex=True, gridspec_kw={"height_ratios": (3, 2, 3, 2)}
        )
        for first, group in ((0, rates), (2, wheels)):
            for c, channel in enumerate(group):
                _laid_over(panels[first, c], overlay.time_s, channel)
                _left(panels[first + 1, c], overlay.time_s, channel)
            panels[first, 0].set_ylabel(f"{group[0].name.split()[0]} ({group[0].unit})")
            panels[first + 1, 0].set_ylabel(f"left ({group[0].unit})")
            for spare in panels[first : first + 2, len(group) :].ravel():
                spare.set_visible(False)
        for panel in panels[-1]:
            panel.set_xlabel("time since first row (s)")
        entries = len(panels[0, 0].get_legend_handles_labels()[0])
        legend_below(figure, panels[0, 0], ncols=entries, markerscale=4.0)
    return figure


def _laid_over(panel: Axes, time_s: Array, channel: Channel) -> None:
    step = max(1, len(time_s) // _POINTS)
    at = slice(None, None, step)
    smoother = np.std(np.diff(channel.measured)) < np.std(np.diff(channel.baseline))
    depth = 3.0 if smoother else 1.5  # what scatters more lies behind; lines are at 2
    panel.plot(
        time_s[at], channel.measured[at], ".", label="measured", zorder=depth, **MEASURED_DOTS
    )
    if channel.extended is not None and channel.cause is not None:
        without, extended = (channel.extended - channel.cause)[at], channel.extended[at]
        look: dict[str, Any] = {"color": CAUSE, "lw": 0, "label": "the cause's part"}
        panel.fill_between(time_s[at], without, extended, **look)
    panel.plot(time_s[at], channel.baseline[at], label="baseline", **BASELINE_LINE)
    if channel.extended is not None:
        panel.plot(time_s[at], channel.extended[at], label="with the cause", **EXTENDED_LINE)
    fit = " → ".join(percent(value, 2) for value in channel.fit if value is not None)
    panel.set_title(f"{channel.name}, fit {fit} %", loc="left")


def percent(fit: float, digits: int) -> str:
    """A fit of so many per cent; below 0 it says no more than that the channel hardly moves."""
    return f"{fit:.{digits}f}" if fit >= 0.0 else "below 0"


def _left(panel: Axes, time_s: Array, channel: Channel) -> None:
    for modelled, look in ((channel.baseline, BASELINE_LINE), (channel.extended, EXTENDED_LINE)):
        if modelled is not None:
            left = running_mean(channel.measured - modelled, WINDOW_ROWS)
            panel.plot(time_s, left, **look)
    panel.axhline(0.0, lw=0.6, color=INK)


def spectrum_figure(spectra: Sequence[Spectrum]) -> Figure | None:
    """Power of the whitened innovations against frequency, per event and body axis.

    White innovations have mean power one; the dashed line is passed by the largest of them with a
    chance of one in a hundred. The peak is named where it is above.
    """
    events = list(dict.fromkeys(spectrum.event for spectrum in spectra))
    if not events:
        return None
    with styled_figure(10.0, 1.9 * len(events) + 0.6) as figure:
        labels = ("frequency (Hz)", "power (1)")
        panels = axis_panels(figure, events, *labels, sharex=True, sharey="row")
        for row, event in zip(panels, events, strict=True):
            of_event = [spectrum for spectrum in spectra if spectrum.event == event]
            for panel, spectrum in zip(row, of_event, strict=True):
                power = np.maximum(spectrum.power, 1e-3)
                panel.loglog(spectrum.frequency_hz, power, lw=0.7, color=POSTERIOR)
                panel.axhline(1.0, lw=0.6, color=INK)
                level = -np.log(-np.expm1(np.log1p(-RARE) / len(power)))
                panel.axhline(level, lw=0.8, ls="--", color=PRIOR_LINE)
                if spectrum.chance < RARE:
                    at = float(spectrum.frequency_hz[spectrum.peak])
                    beside = {"xytext": (4, 2), "textcoords": "offset points"}
                    place, look = (at, power[spectrum.peak]), {"fontsize": 8, "color": PRIOR_LINE}
                    panel.annotate(f"{at:.3g} Hz", place, **beside, **look)
                for axis in (panel.xaxis, panel.yaxis):
                    label_powers(axis)
                    axis.minorticks_off()  # hundreds of them, in panels of five centimetres
    return figure


def trade_figure(trade: Trade) -> Figure:
    """Corner of a cause's size and the free quantity it trades with most, priors drawn in."""
    with styled_figure(6.2, 5.6) as figure:
        panels = figure.subplots(2, 2)
        panels[0, 1].set_visible(False)
        ends = [_ends(trade, which) for which in range(2)]
        for which, panel in ((0, panels[0, 0]), (1, panels[1, 1])):
            edges = np.linspace(*ends[which], _BINS)
            for values, colour, label in (
                (trade.prior[:, which], PRIOR, "prior"),
                (trade.posterior[:, which], POSTERIOR, "posterior"),
            ):
                # a density over all values: there may be none within the axis
                each = np.full(len(values), 1.0 / (len(values) * (edges[1] - edges[0])))
                panel.hist(
                    values, edges, weights=each, histtype="stepfilled", color=colour, alpha=0.6,
                    label=label,
                )  # fmt: skip
            panel.set_yticks([])
            panel.set_xlim(*ends[which])
        for panel in (panels[0, 0], panels[1, 0], panels[1, 1]):
            panel.locator_params(axis="x", nbins=5)
            panel.ticklabel_format(axis="x", scilimits=(-3, 4), useOffset=False)
        across = panels[1, 0]
        for values, colour in ((trade.prior, PRIOR), (trade.posterior, POSTERIOR)):
            across.plot(*values.T, ".", ms=2.0, color=colour, alpha=0.5, rasterized=True)
        for share in CONTOURS:
            across.plot(*_ellipse(trade.posterior, share), lw=1.1, color=POSTERIOR)
        across.set_xlim(*ends[0])
        across.set_ylim(*ends[1])
        name = f"{trade.quantity} ({trade.unit})" if trade.unit else trade.quantity
        label_axes(across, f"{trade.cause}: {trade.size}", name)
        panels[1, 1].set_xlabel(name)
        correlation = f"{trade.correlation:+.2f}".replace("-", "−")
        panels[0, 0].set_title(f"correlation {correlation}", loc="left")
        panels[0, 0].legend(loc="upper right")
    return figure


def _ends(trade: Trade, which: int) -> tuple[float, float]:
    """Of an axis: the posterior with as much of the prior as leaves it to be seen.

    None of a prior that lies beyond that: the space up to it would be empty.
    """
    own, prior = trade.posterior[:, which], trade.prior[:, which]
    low, high = np.quantile(own, (0.001, 0.999))
    margin, room = _MARGIN * (high - low), _ROOM * (high - low)
    least, most = np.quantile(prior, (0.005, 0.995))
    if most < low - room or least > high + room:
        least, most = low, high
    left = max(min(least, low - margin), low - room)
    return float(left), float(min(max(most, high + margin), high + room))


def _ellipse(values: Array, share: float) -> Array:
    """Curve (2, n) that holds a share of a normal with the values' mean and covariance."""
    factor = np.linalg.cholesky(np.cov(values.T))
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    radius = np.sqrt(-2.0 * np.log1p(-share))
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(values.mean(0)[:, None] + radius * factor @ circle)
