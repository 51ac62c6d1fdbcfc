"""Figures of a diagnosis: innovations and what they go with, discrepancy curves, causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, ScalarFormatter

from cassini_bayes.balance.linearised import InnovationRows
from cassini_bayes.diagnosis.correlations import (
    POINTWISE,
    WINDOW_ROWS,
    InnovationTests,
    Tested,
    running_mean,
)
from cassini_bayes.diagnosis.discrepancy import Curve
from cassini_bayes.report.plots.panels import LONGEST_TITLE, axis_panels
from cassini_bayes.report.plots.quantities import shortened
from cassini_bayes.report.plots.style import (
    INK,
    POSTERIOR,
    VERDICT_COLOURS,
    legend_below,
    line,
    patch,
    styled_figure,
)

MOST_CAUSES: Final = 12  # bars that fit one column
MOST_NATS_LABELLED: Final = 6  # more of them run into each other
LINEAR_NATS: Final = 10.0  # up to which the axis of log Bayes factors is linear
UNSEEN: Final = 0.005  # a probability whose bar is too short to be seen
EXTENDED: Final = "#d95f02"
SINGLE_BAND: Final = "#d2d2d2"
FAMILY_BAND: Final = "#ececec"
BEFORE: Final[dict[str, Any]] = {
    "ls": "", "marker": "o", "ms": 4.0, "color": POSTERIOR, "label": "baseline",
}  # fmt: skip
AFTER: Final[dict[str, Any]] = {
    "ls": "", "marker": "D", "ms": 3.4, "mfc": "none", "color": EXTENDED, "label": "extended",
}  # fmt: skip
_POINTS: Final = 2_500  # of a curve: more than a page has pixels


def innovation_figure(
    baseline: Sequence[InnovationRows], extended: Sequence[InnovationRows] = ()
) -> Figure | None:
    """Innovations per event and body axis, N m s, with running means before and after.

    Grey: the baseline's innovations; blue: their running mean over 61 rows; orange: that of the
    extended model.
    """
    if not baseline:
        return None
    with styled_figure(10.0, 1.9 * len(baseline) + 0.6) as figure:
        events = [event.event for event in baseline]
        across, up = "time since first row (s)", "innovation (N m s)"
        panels = axis_panels(figure, events, across, up, sharex="row")
        for row, event in enumerate(baseline):
            step = max(1, len(event.time_s) // _POINTS)
            for c, panel in enumerate(panels[row]):
                residual = event.residual_n_m_s[:, c]
                style = {"ms": 1.2, "color": "#c4c4c4", "rasterized": True}
                panel.plot(event.time_s[::step], residual[::step], ".", **style)
                mean = running_mean(residual, WINDOW_ROWS)
                panel.plot(event.time_s, mean, lw=1.4, color=POSTERIOR, label="baseline")
                if len(extended):
                    after = running_mean(extended[row].residual_n_m_s[:, c], WINDOW_ROWS)
                    panel.plot(
                        extended[row].time_s, after, lw=1.2, color=EXTENDED, label="extended"
                    )
                panel.axhline(0.0, lw=0.6, color=INK)
                limit = 1.15 * float(np.quantile(np.abs(residual), 0.997))
                panel.set_ylim(-limit, limit)
        handles, labels = panels[0, 0].get_legend_handles_labels()
        labels = [f"{label}: mean of {WINDOW_ROWS} rows" for label in labels]
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def correlation_figure(
    event: str, before: InnovationTests, after: InnovationTests | None
) -> Figure:
    """Correlation of one event's innovations with every driver, per body axis, with bands.

    In standard deviations if the model is true; linear within ten, logarithmic beyond. Dark band:
    95 % of one driver alone; light band: 95 % of all drivers, axes and events together.
    """
    names = list(dict.fromkeys(t.driver for t in before.drivers if t.event == event))
    places = dict(zip(names, range(len(names) - 1, -1, -1), strict=True))
    with styled_figure(10.0, 0.2 * len(names) + 1.5) as figure:
        panels = figure.subplots(1, 3, sharex=True, sharey=True)
        for panel, axis in zip(panels, "xyz", strict=True):
            panel.axvspan(-before.family_z, before.family_z, color=FAMILY_BAND, lw=0)
            panel.axvspan(-POINTWISE, POINTWISE, color=SINGLE_BAND, lw=0)
            panel.axvline(0.0, lw=0.6, color=INK)
            for shown, style in ((before, BEFORE), (after, AFTER)):
                tests = () if shown is None else shown.drivers
                tests_of = [t for t in tests if (t.event, t.axis) == (event, axis)]
                panel.plot([t.z for t in tests_of], [places[t.driver] for t in tests_of], **style)
            for t in before.drivers:
                if _untested(t, event, axis):
                    place = {"ha": "center", "va": "center"}
                    panel.text(0.0, places[t.driver], "no test", fontsize=6.5, **place)
            panel.set_title(f"{shortened(event, LONGEST_TITLE)}, {axis.upper()}", loc="left")
            panel.set_xscale("symlog", linthresh=10.0, linscale=3.0)
            panel.set_ylim(-0.7, len(names) - 0.3)
            panel.set_xlabel("standardised correlation (σ)")
            panel.xaxis.set_major_locator(FixedLocator([-100, -10, -5, 0, 5, 10, 100]))
            panel.xaxis.set_major_formatter(ScalarFormatter())
        limit = 1.3 * max(10.0, *_largest((before, after), event))
        panels[0].set_xlim(-limit, limit)
        panels[0].set_yticks(list(places.values()), names)
        _band_legend(figure, before.family_z, after, "all drivers, axes and events", "σ")
    return figure


def _untested(tested: Tested, event: str, axis: str) -> bool:
    return (tested.event, tested.axis) == (event, axis) and not np.isfinite(tested.z)


def _largest(shown: Sequence[InnovationTests | None], event: str) -> list[float]:
    tests = [t for tests_of in shown if tests_of is not None for t in tests_of.drivers]
    return [abs(t.z) for t in tests if t.event == event and np.isfinite(t.z)]


def _band_legend(
    figure: Figure, family: float, after: InnovationTests | None, what: str, unit: str
) -> None:
    handles = [
        *(line(**look) for look in ([BEFORE] if after is None else [BEFORE, AFTER])),
        patch(color=SINGLE_BAND, label=f"95 % of one alone (±{POINTWISE:.2f} {unit})"),
        patch(color=FAMILY_BAND, label=f"95 % of {what} (±{family:.2f} {unit})"),
    ]
    legend_below(figure, handles, ncols=4)


def whiteness_figure(before: InnovationTests, after: InnovationTests | None) -> Figure | None:
    """Autocorrelation of every event's innovations against lag in rows, with bands."""
    events = list(dict.fromkeys(white.event for white in before.whiteness))
    if not events:
        return None
    with styled_figure(10.0, 1.7 * len(events) + 0.8) as figure:
        labels = ("lag (rows)", "autocorrelation (1)")
        panels = axis_panels(figure, events, *labels, sharex=True, sharey="row")
        for row, event in zip(panels, events, strict=True):
            for panel, axis in zip(row, "xyz", strict=True):
                for shown, style in ((before, BEFORE), (after, AFTER)):
                    curves = () if shown is None else shown.whiteness
                    for curve in (w for w in curves if (w.event, w.axis) == (event, axis)):
                        lags = np.arange(1, len(curve.value) + 1)
                        if shown is before:
                            unit = curve.rows**-0.5
                            for z, colour in (
                                (before.family_lag_z, FAMILY_BAND),
                                (POINTWISE, SINGLE_BAND),
                            ):
                                panel.axhspan(-z * unit, z * unit, color=colour, lw=0)
                        panel.plot(lags, curve.value, **style)
                panel.axhline(0.0, lw=0.6, color=INK)
        _band_legend(figure, before.family_lag_z, after, "all lags, axes and events", "/√rows")
    return figure


def discrepancy_figure(curves: Sequence[Curve]) -> Figure | None:
    """Unexplained momentum against time per event and body axis, mean and 90 % interval."""
    if not curves:
        return None
    with styled_figure(10.0, 1.9 * len(curves) + 0.7) as figure:
        events = [curve.event for curve in curves]
        across, up = "time since first row (s)", "unexplained (N m s)"
        panels = axis_panels(figure, events, across, up, sharex="row", sharey="row")
        for row, curve in zip(panels, curves, strict=True):
            for c, panel in enumerate(row):
                panel.fill_between(
                    curve.time_s, curve.low[:, c], curve.high[:, c], color=POSTERIOR, alpha=0.22,
                    lw=0, label="pointwise central 90 % credible interval",
                )  # fmt: skip
                panel.plot(
                    curve.time_s, curve.mean[:, c], color=POSTERIOR, lw=1.4, label="posterior mean"
                )
                panel.axhline(0.0, lw=0.6, color=INK)
        legend_below(figure, panels[0, 0], ncols=2)
    return figure


def cause_figure(causes: Sequence[Mapping[str, Any]]) -> Figure:
    """Posterior probability and log Bayes factor against ``none`` of the most probable causes."""
    shown = list(causes[:MOST_CAUSES])[::-1]
    names = [str(cause["name"]) for cause in shown]
    with styled_figure(8.6, 0.27 * len(shown) + 1.3) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        colours = ["#777777" if name in ("none", "unknown") else POSTERIOR for name in names]
        places = np.arange(len(shown))
        left.barh(places, [cause["probability"] for cause in shown], color=colours)
        left.set_yticks(places, names)
        left.set_xlim(0.0, 1.0)
        left.set_xlabel("posterior probability (1)")
        factors = np.array([cause["log_bayes_factor"] for cause in shown])
        right.barh(places, factors, color=colours)
        right.axvline(0.0, lw=0.8, color=VERDICT_COLOURS["conflict"])
        evidence_axis(right, far=bool(np.nanmax(np.abs(factors)) > LINEAR_NATS))
    return figure


def evidence_axis(axes: Axes, *, far: bool) -> None:
    """Log Bayes factors along x, logarithmic beyond ten nats where some are that ``far``.

    After everything is drawn: what is labelled depends on how far the axis goes.
    """
    if far:
        axes.set_xscale("symlog", linthresh=LINEAR_NATS)
        ticks = nats_to_label(*axes.get_xlim())
        axes.set_xticks(ticks, [f"{tick:,.0f}".replace("-", "−") for tick in ticks])
        axes.set_xticks([], minor=True)
    axes.set_xlabel("log Bayes factor against none (nats)")


def nats_to_label(low: float, high: float) -> list[float]:
    """Nats to label between two: 0, ±5, ±10, ±20, ±50, …, or powers alone where these are many."""
    powers = 10.0 ** np.arange(1, int(np.log10(max(-low, high, LINEAR_NATS))) + 1)
    beyond = np.outer(powers, (1.0, 2.0, 5.0)).ravel()
    for sizes in (np.r_[5.0, beyond], *(powers[::-every] for every in range(1, 5))):
        ticks = np.sort(np.concatenate([-sizes, [0.0], sizes]))
        within = ticks[(ticks >= low) & (ticks <= high)]
        if len(within) <= MOST_NATS_LABELLED:
            break
    return [float(tick) for tick in within]


def width_figure(probability: pd.DataFrame, most: int = 7) -> Figure:
    """Probability of causes (rows, most probable first) at prior widths (columns)."""
    shown = probability.head(most).iloc[::-1]
    colours = ("#a6c4e0", POSTERIOR, "#d95f02")
    with styled_figure(7.4, 0.45 * len(shown) + 1.2) as figure:
        axes = figure.subplots()
        places = np.arange(len(shown))
        for i, width in enumerate(shown.columns):
            colour, label = colours[i % len(colours)], f"width × {width:g}"
            at = places + 0.25 * (1 - i)
            axes.barh(at, shown[width], height=0.24, color=colour, label=label)
        for place in places[shown.to_numpy().max(axis=1) < UNSEEN]:
            axes.text(0.005, place, f"below {UNSEEN:g}", va="center", fontsize=7, color="#777777")
        axes.set_yticks(places, [str(name) for name in shown.index])
        axes.set_xlim(0.0, 1.0)
        axes.set_xlabel("posterior probability (1)")
        figure.legend(loc="outside lower center", ncols=3)
    return figure
