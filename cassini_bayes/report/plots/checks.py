"""Model against measurement: on-times, momentum balance; and convergence of the sampling."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from cassini_bayes.report.plots.powers import label_powers
from cassini_bayes.report.plots.quantities import (
    INTERVAL_SHORT,
    NORMAL_90,
    NORMAL_INTERVAL,
    readable_unit,
    short_events,
    short_name,
)
from cassini_bayes.report.plots.style import (
    INK,
    POSTERIOR,
    ThrusterStyle,
    event_axis,
    headline,
    legend_below,
    line,
    new_figure,
    patch,
    symbol,
    symbols,
    thruster_styles,
)
from cassini_bayes.report.plots.tables import all_events_of, grid, thrusters_of
from cassini_bayes.results.review import Review

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cassini_bayes.report.plots.style import Handle

BAND: Final = "#e6e6e6"
TAIL: Final = "#CC6677"
LEGEND_COLUMN_IN: Final = 2.3  # inches for one entry
NOT_REPLICATED_S: Final = 1e-9  # a replicate that never varies: set by the limit cycle


def predictive_figure(review: Review) -> Figure:
    """Measured on-times on the replicates' interval; below, measured minus predicted."""
    events = list(dict.fromkeys(review.predictive["event"].astype(str)))
    styles = thruster_styles(thrusters_of(review))
    figure = new_figure(float(np.clip(1.5 * len(events) + 1.5, 9.6, 16.0)), 7.4)
    totals, residuals = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.15))
    measured, mean, low, high, sd = (
        grid(review.predictive, column, review, events=events)
        for column in ("measured_s", "mean_s", "hdi_90_low_s", "hdi_90_high_s", "sd_s")
    )
    spread = np.linspace(-0.38, 0.38, len(styles)) if len(styles) > 1 else np.zeros(1)
    for k, (offset, style) in enumerate(zip(spread, styles.values(), strict=True)):
        x = np.arange(len(events)) + offset
        answers = sd[:, k] > NOT_REPLICATED_S
        for axes, zero in ((totals, np.zeros(len(events))), (residuals, mean[:, k])):
            ends = (low[:, k] - zero)[answers], (high[:, k] - zero)[answers]
            axes.vlines(x[answers], *ends, color=style.colour, lw=5, alpha=0.35)
            _measured(axes, x, measured[:, k] - zero, answers, style)
    totals.set_yscale("symlog", linthresh=1.0, linscale=0.6)
    ticks = (-1, -0.5, 0, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
    totals.set_yticks(ticks, [f"{t:g}".replace("-", "−") for t in ticks])
    totals.set_yticks([], minor=True)
    top = np.nanmax([np.nanmax(measured, initial=1.0), np.nanmax(high, initial=1.0)])
    totals.set_ylim(max(-1.0, float(np.nanmin(low, initial=0.0))) - 0.15, 1.35 * float(top))
    totals.set_ylabel("on-time [s]\n(linear below 1 s)")
    residuals.set_ylabel("measured − predicted mean [s]")
    residuals.axhline(0.0, color=INK, lw=0.8)
    for axes in (totals, residuals):
        event_axis(axes, short_events(events))
        axes.tick_params(axis="x", rotation=0)
        axes.grid(axis="y")
    totals.xaxis.label.set_visible(False)
    headline(
        figure,
        f"On-times: measured, and the same bias flown again – {INTERVAL_SHORT} of the replicates",
    )
    columns = int(figure.get_figwidth() / LEGEND_COLUMN_IN)
    title = "symbols: measured on-time of each thruster"
    legend_below(figure, _predictive_legend(styles), columns, title=title)
    return figure


def _measured(
    axes: Axes, x: np.ndarray, y: np.ndarray, answers: np.ndarray, style: ThrusterStyle
) -> None:
    """Filled where the model predicts the on-time, hollow where the limit cycle sets it."""
    look = (style.marker, 5, style.colour)
    symbols(axes, x[answers], y[answers], *look, zorder=4)
    hollow = (style.marker, 4.2, style.colour)
    symbols(axes, x[~answers], y[~answers], *hollow, hollow=True, mew=0.8, zorder=4)


def _predictive_legend(styles: Mapping[str, ThrusterStyle]) -> list[Handle]:
    return [
        *(symbol(style.marker, 5.5, style.colour, name) for name, style in styles.items()),
        patch(facecolor="#777777", alpha=0.35, label=f"replicates, {INTERVAL_SHORT}"),
        symbol("o", 4, "#555555", "hollow: set by the limit cycle", hollow=True),
    ]


def balance_figure(review: Review) -> Figure:
    """Momentum left over per event and axis, on the band of noise the model allows for."""
    events, table = all_events_of(review), review.balance
    axis_names = list(dict.fromkeys(table["axis"]))
    figure = new_figure(11.0, 3.9)
    panels = figure.subplots(1, len(axis_names), sharey=True, squeeze=False).ravel()
    for axes, name in zip(panels, axis_names, strict=True):
        rows = table[table["axis"] == name].set_index("event").reindex(events)
        x = np.arange(len(events))
        noise = NORMAL_90 * rows["noise_sd_n_m_s"].to_numpy(dtype=float)
        axes.bar(x, 2 * noise, bottom=-noise, width=0.8, color=BAND, edgecolor="#c4c4c4", lw=0.6)
        residual = rows["residual_n_m_s"].to_numpy(dtype=float)
        reach = NORMAL_90 * rows["sd_n_m_s"].to_numpy(dtype=float)
        axes.vlines(x, residual - reach, residual + reach, color=POSTERIOR, lw=2.2, zorder=3)
        symbols(axes, x, residual, "o", 5, POSTERIOR, hollow=True, mew=1.3, zorder=4)
        axes.axhline(0.0, color=INK, lw=0.8)
        event_axis(axes, short_events(events))
        axes.grid(axis="y")
        axes.set_title(f"body axis {name}", loc="left", fontweight="bold")
        axes.set_ylabel("momentum left over [N m s]")
        axes.yaxis.label.set_visible(axes is panels[0])
    headline(figure, "Momentum balance: thruster impulse plus torque minus the momentum gained")
    posterior = {"color": POSTERIOR, "marker": "o", "mfc": "white", "lw": 2.2}
    noise = f"noise the model allows for, {NORMAL_INTERVAL}"
    handles = [
        line(**posterior, label=f"posterior, {NORMAL_INTERVAL}"),
        patch(facecolor=BAND, edgecolor="#c4c4c4", label=noise),
    ]
    legend_below(figure, handles, ncols=2)
    return figure


def convergence_figure(review: Review) -> Figure:
    """R-hat between ensembles, and bulk and tail effective sample sizes, of every scalar."""
    table: pd.DataFrame = review.summary[review.summary["sd"] > 0]
    quantities = list(dict.fromkeys(table["quantity"]))
    figure = new_figure(10.0, 0.26 * len(quantities) + 1.9)
    agreement, sizes = figure.subplots(1, 2, sharey=True)
    for place, quantity in enumerate(quantities):
        rows = table[table["quantity"] == quantity]
        jitter = np.linspace(-0.25, 0.25, len(rows)) if len(rows) > 1 else np.zeros(1)
        for axes, column in ((agreement, "rhat"), (sizes, "ess_bulk")):
            symbols(axes, rows[column], place + jitter, "o", 3, POSTERIOR, alpha=0.7)
        look = ("^", 3.2, TAIL)
        symbols(sizes, rows["ess_tail"], place + jitter, *look, hollow=True, mew=0.8)
    agreement.axvline(1.01, color=INK, lw=1.0, ls="--")
    worst = float(np.nanmax(table["rhat"], initial=1.0))
    agreement.set_xlim(
        min(0.9995, float(np.nanmin(table["rhat"], initial=1.0)) - 2e-4),
        max(1.0115, worst * 1.0005),
    )
    agreement.ticklabel_format(axis="x", useOffset=False)
    agreement.set_xlabel("R-hat between ensembles [–]; dashed: limit 1.01")
    names = [
        f"{_name(table, q)} ({n})"
        if (n := int((table["quantity"] == q).sum())) > 1
        else _name(table, q)
        for q in quantities
    ]
    agreement.set_yticks(range(len(quantities)), names)
    agreement.set_ylim(len(quantities) - 0.4, -0.6)
    agreement.set_ylabel("quantity (number of scalars)")
    sizes.set_ylabel("quantity (number of scalars)")
    sizes.yaxis.label.set_visible(False)
    sizes.set_xscale("log")
    label_powers(sizes.xaxis, minor=True)
    sizes.set_xlabel("effective sample size [draws]")
    target = review.fit.attributes.get("target_ess")
    if isinstance(target, int | float):
        sizes.axvline(float(target), color=INK, lw=1.0, ls="--")
        sizes.set_xlabel(f"effective sample size [draws]; dashed: target {target:g}")
    for axes in (agreement, sizes):
        axes.grid(axis="x")
    headline(figure, "Convergence of every scalar")
    figure.legend(
        handles=[symbol("o", 5, POSTERIOR, "bulk"), symbol("^", 5, TAIL, "tail", hollow=True)],
        loc="outside lower right",
        ncols=2,
        title="effective sample size",
    )
    return figure


def _name(table: pd.DataFrame, quantity: str) -> str:
    unit = str(table[table["quantity"] == quantity]["unit"].iloc[0])
    return f"{short_name(quantity, unit)} [{readable_unit(unit)}]"
