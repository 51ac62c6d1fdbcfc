"""Figures of predictions: one bias, leave-one-event-out, the ΔV requirement, plans."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.prediction.leave_one_out import HeldOut, draws_by_kind, outcome_by_kind
from cassini_bayes.prediction.navigation import TOLERANCE, Requirement
from cassini_bayes.prediction.planning import Plan
from cassini_bayes.prediction.predict import SOURCES, Prediction
from cassini_bayes.report.plots.style import (
    INK,
    POSTERIOR,
    event_axis,
    label_axes,
    legend_below,
    styled_figure,
    symbols,
)

COLUMN_STYLES: Final[Mapping[str, tuple[str, str, str]]] = {
    "gsw_ideal": ("ideal", "x", "#999933"),
    "gsw": ("calibrated", "s", "#CC6677"),
    "fsds": ("FSDS", "^", "#117733"),
}
_SOURCE_COLOURS: Final = ("#4477AA", "#EECC66", "#994455", "#88CCEE", "#777777")
PREDICTED: Final = ("predicted, central 90 %", "predicted, central 50 %", "predicted median")
_SHOWN_S: Final = 3.0  # either side of no error; what lies beyond is drawn at the edge


def prediction_figure(prediction: Prediction) -> Figure:
    """On-times, pulses, ΔVz and hydrazine of one bias: median, central 50 and 90 % intervals.

    ΔV and hydrazine have their panels where any event of the fit printed masses or grams.
    """
    vectors = {
        "computed on board": prediction.delta_v_computed_m_s,
        "delivered": prediction.delta_v_delivered_m_s,
    }
    known = {label: vector for label, vector in vectors.items() if vector is not None}
    grams = prediction.hydrazine_g
    rows = 2 if known or grams is not None else 1
    with styled_figure(9.0, 2.8 * rows + 0.4 * (rows == 1)) as figure:
        grid = figure.subplots(rows, 2, squeeze=False)
        names = [name.replace("_", "–") for name in prediction.unit_names()]
        _intervals(grid[0, 0], prediction.unit_on_time_s(), names, "on-time [s]")
        _intervals(grid[0, 1], prediction.unit_pulses(), names, "pulses [count]")
        if known:
            _density(grid[1, 0], known)
        elif rows == 2:
            grid[1, 0].set_visible(False)
        if grams is not None:
            grid[1, 1].hist(grams, bins=40, range=_shown(grams), density=True, color=POSTERIOR)
            label_axes(grid[1, 1], "hydrazine [g]", "density [1/g]")
        elif rows == 2:
            grid[1, 1].set_visible(False)
        request = prediction.request
        changes = ", ".join(
            f"wheel {n}: {a:g} → {b:g}"
            for n, a, b in zip(request.wheels, request.start_rpm, request.end_rpm, strict=True)
        )
        title = f"{request.id}, {prediction.epoch.date()} — {changes} rev/min"
        figure.suptitle(title, fontsize=9.5)
        densities = "; densities: central 99 % of the draws" if rows == 2 else ""
        bars = f"dots: medians; thick and thin bars: central 50 and 90 % intervals{densities}"
        figure.supxlabel(bars, fontsize=8)
    return figure


def _intervals(axes: Axes, draws: Array, names: Sequence[str], label: str) -> None:
    x = np.arange(len(names), dtype=np.float64)
    _bars(axes, x, draws, ("", "", ""))
    axes.set_xticks(x, names)
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0)


def _bars(axes: Axes, x: Array, draws: Array, labels: Sequence[str] = PREDICTED) -> None:
    """Central 90 and 50 % intervals of draws (n, len(x)) as bars, their medians as dots."""
    low, q1, median, q3, high = np.quantile(draws, [0.05, 0.25, 0.5, 0.75, 0.95], axis=0)
    wide, narrow, middle = labels
    axes.vlines(x, low, high, color=POSTERIOR, lw=1.2, label=wide)
    axes.vlines(x, q1, q3, color=POSTERIOR, lw=4.0, label=narrow)
    axes.plot(x, median, "o", color="white", mec=POSTERIOR, ms=4.5, label=middle)


def _shown(draws: Array) -> tuple[float, float]:
    """Ends of the central 99 %: the tails are long and would flatten the rest."""
    low, high = np.quantile(draws, [0.005, 0.995])
    return float(low), float(high)


def _density(axes: Axes, vectors: Mapping[str, Array]) -> None:
    for (label, vector), colour in zip(vectors.items(), (POSTERIOR, "#BB8800"), strict=False):
        along_z = 1e3 * vector[:, 2]
        look: dict[str, Any] = {"color": colour, "lw": 1.4, "label": label}
        shown = _shown(along_z)
        axes.hist(along_z, bins=40, range=shown, density=True, histtype="step", **look)
    label_axes(axes, "ΔV along body Z [mm/s]", "density [s/mm]")
    axes.legend(loc="best")


def leave_one_out_figure(
    folds: Sequence[HeldOut], columns: Mapping[str, Sequence[TotalsEvent]]
) -> Figure:
    """On-times of every held-out event less flight: intervals, and the published columns."""
    with styled_figure(11.0, 6.4) as figure:
        grid = figure.subplots(2, -(-len(folds) // 2), sharey=True, squeeze=False).ravel()
        for axes, held in zip(grid, folds, strict=False):
            _event_panel(axes, held, columns)
        for axes in grid[:: max(len(grid) // 2, 1)]:
            axes.set_ylabel("on-time − flight [s]")
        for axes in grid[len(folds) :]:
            axes.set_visible(False)
        legend_below(figure, grid[0], ncols=6)
    return figure


def _event_panel(axes: Axes, held: HeldOut, columns: Mapping[str, Sequence[TotalsEvent]]) -> None:
    prediction = held.prediction
    first = [unit[0] for unit in prediction.units]
    flight = held.event.on_time_s[first]
    difference = prediction.unit_on_time_s() - flight
    x = np.arange(len(first), dtype=np.float64)
    axes.axhline(0.0, color=INK, lw=0.8)
    _bars(axes, x - 0.15, difference)
    for i, (printed, label, marker, colour) in _printed(held, columns):
        off = printed.on_time_s[first] - flight
        at = x + 0.1 + 0.13 * i
        inside = np.abs(off) <= _SHOWN_S
        symbols(axes, at[inside], off[inside], marker, 4.0, colour, label=label)
        arrow = {"arrowstyle": "->", "color": colour, "lw": 0.8}
        look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 6.5, "color": colour}
        for position, value in zip(at[~inside], off[~inside], strict=True):
            edge = np.copysign(_SHOWN_S, value)
            end, text = (position, edge), (position, 0.82 * edge)
            axes.annotate(f"{value:.1f}", end, xytext=text, arrowprops=arrow, **look)
    names = [name.upper().replace("_", "–") for name in prediction.unit_names()]
    axes.set_xticks(x, names, rotation=30)
    axes.set_ylim(-1.05 * _SHOWN_S, 1.05 * _SHOWN_S)
    axes.set_title(held.event.id.removesuffix("-bias"))


def _printed(
    held: HeldOut, columns: Mapping[str, Sequence[TotalsEvent]]
) -> Iterator[tuple[int, tuple[TotalsEvent, str, str, str]]]:
    """Place, event, label, marker and colour of every published column that has the event."""
    for i, (source, style) in enumerate(COLUMN_STYLES.items()):
        for event in columns.get(source, ()):
            if event.id == held.event.id:
                yield i, (event, *style)
                break


def totals_figure(folds: Sequence[HeldOut], columns: Mapping[str, Sequence[TotalsEvent]]) -> Figure:
    """ΔVz and hydrazine of every held-out event less flight, with the published columns."""
    with styled_figure(9.0, 4.0) as figure:
        panels = figure.subplots(1, 2)
        names = [held.event.id.removesuffix("-bias") for held in folds]
        for axes, kind, label in (
            (panels[0], "delta_v_z", "ΔVz − flight [mm/s]"),
            (panels[1], "hydrazine", "hydrazine − flight [g]"),
        ):
            event_axis(axes, names)
            axes.axhline(0.0, color=INK, lw=0.8)
            for x, held in enumerate(folds):
                _totals_slot(axes, x, held, kind, columns)
            axes.set_ylabel(label)
        handles, labels = panels[0].get_legend_handles_labels()
        unique = dict(zip(labels, handles, strict=True))
        legend_below(figure, list(unique.values()), ncols=5)
    return figure


def _totals_slot(
    axes: Axes, x: int, held: HeldOut, kind: str, columns: Mapping[str, Sequence[TotalsEvent]]
) -> None:
    draws = draws_by_kind(held.prediction).get(kind)
    outcome = outcome_by_kind(held.event, held.prediction.units).get(kind)
    if draws is None or outcome is None:
        return
    low, median, high = np.quantile(draws[:, 0] - outcome[0], [0.05, 0.5, 0.95])
    axes.vlines(x - 0.2, low, high, color=POSTERIOR, lw=2.0, label="predicted, central 90 %")
    axes.plot(x - 0.2, median, "o", color="white", mec=POSTERIOR, ms=4.5, label="predicted median")
    for i, (printed, label, marker, colour) in _printed(held, columns):
        value = outcome_by_kind(printed, held.prediction.units)[kind][0] - outcome[0]
        symbols(axes, x + 0.02 + 0.14 * i, value, marker, 4.0, colour, label=label)


def requirement_figure(judged: Mapping[str, Requirement]) -> Figure:
    """Spread of the predicted ΔVz per event, what is left without each source, and 1 %."""
    with styled_figure(9.0, 4.0) as figure:
        axes = figure.subplots()
        names = [name.removesuffix("-bias") for name in judged]
        event_axis(axes, names)
        width = 0.14
        for i, source in enumerate(("all", *SOURCES)):
            heights = [
                100.0 * {**own.without_m_s, "all": own.spread_m_s}[source] / abs(own.nominal_m_s)
                for own in judged.values()
            ]
            x, colour = np.arange(len(names)) + (i - 2.5) * width, (INK, *_SOURCE_COLOURS)[i]
            label = "all sources" if source == "all" else f"without: {source}"
            axes.bar(x, heights, width, color=colour, label=label)
        axes.axhline(100.0 * TOLERANCE / 3.0, color="#b2182b", lw=1.2, label="required: 1 %")
        axes.set_ylabel("spread of ΔVz [% of nominal]")
        figure.legend(loc="outside lower center", ncols=4)
    return figure


def plan_figure(found: Plan) -> Figure:
    """Expected information on the quantity against hydrazine, with the best trade-offs."""
    with styled_figure(6.4, 4.2) as figure:
        axes = figure.subplots()
        grams = [c.cost for c in found.candidates]
        nats = [c.information_nats for c in found.candidates]
        axes.scatter(grams, nats, s=7, color="#9fb8d4", lw=0, label="candidate bias")
        front = found.front()
        look: dict[str, Any] = {
            "color": POSTERIOR,
            "ms": 3.5,
            "lw": 1.0,
            "label": "best for its cost",
        }
        axes.plot([c.cost for c in front], [c.information_nats for c in front], "-o", **look)
        cost = "hydrazine [g]" if found.has_hydrazine else "on-time of all thrusters [s]"
        label_axes(axes, f"expected {cost}", f"expected information on {found.quantity} [nats]")
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="upper left")
    return figure
