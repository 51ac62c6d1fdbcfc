"""ΔV: what is printed, what the on-board computation would give, and what it does to thrust."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cassini_bayes.report.plots.panels import bars, finish, limits_of, outer_labels, thruster_panels
from cassini_bayes.report.plots.quantities import INTERVAL, NORMAL_90, NORMAL_INTERVAL, short_events
from cassini_bayes.report.plots.style import (
    INK,
    POSTERIOR,
    event_axis,
    headline,
    legend_below,
    line,
    new_figure,
    symbol,
    symbols,
)
from cassini_bayes.report.plots.tables import grid, thrusters_of
from cassini_bayes.results.review import Review

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def delta_v_figure(review: Review) -> Figure:
    """Printed ΔV against the fit of the on-board computation.

    The thick bar is what is known of the computed value, the thin one adds the channel's own noise,
    as fitted: the printed value belongs in the thin one.
    """
    table = review.delta_v
    events = [str(e) for e in table["event"]]
    columns = ("printed_mm_s", "computed_mean_mm_s", "computed_sd_mm_s", "noise_sd_mm_s")
    printed, mean, sd, noise = (table[c].to_numpy(dtype=float) for c in columns)
    figure = new_figure(10.0, 4.6)
    values, differences = figure.subplots(1, 2)
    x, reach = np.arange(len(events)), NORMAL_90 * sd
    scatter = NORMAL_90 * np.hypot(sd, noise)
    for axes, zero in ((values, 0.0), (differences, mean)):
        axes.vlines(x, mean - zero - reach, mean - zero + reach, color=POSTERIOR, lw=6, alpha=0.4)
        axes.vlines(x, mean - zero - scatter, mean - zero + scatter, color=POSTERIOR, lw=1.2)
        axes.plot(x, mean - zero, ls="", marker="_", ms=11, mew=1.4, color=POSTERIOR)
        symbols(axes, x, printed - zero, "D", 5, INK, hollow=True, mew=1.2, zorder=4)
        event_axis(axes, short_events(events))
        axes.grid(axis="y")
    values.set_ylabel("ΔV [mm/s]")
    values.set_ylim(bottom=0.0)
    differences.set_ylabel("ΔV minus the fit's mean [mm/s]")
    headline(figure, "ΔV: printed, and the on-board computation as fitted")
    handles = [
        symbol("D", 5, INK, "printed with the event", hollow=True),
        line(color=POSTERIOR, lw=6, alpha=0.4, label="computed value"),
        line(color=POSTERIOR, lw=1.2, label="with the channel's own noise"),
    ]
    legend_below(figure, handles, ncols=3, title=f"bars: {NORMAL_INTERVAL}")
    return figure


def delta_v_thrust_figure(review: Review) -> Figure:
    """Thrust under the uses of ΔV, one panel per thruster."""
    table, thrusters = review.variants, thrusters_of(review)
    events = list(dict.fromkeys(table["event"].astype(str)))
    variants = list(dict.fromkeys(table["variant"]))
    labels = short_events(events)
    grids = {
        variant: [
            grid(table[table["variant"] == variant], column, review, events=events)
            for column in ("mean_n", "hdi_90_low_n", "hdi_90_high_n")
        ]
        for variant in variants
    }
    limits = limits_of(*(g for three in grids.values() for g in three[1:]))
    figure, panels = thruster_panels(thrusters, len(labels))
    looks = _variant_styles(len(variants))
    for k, (name, axes) in enumerate(zip(thrusters, panels, strict=True)):
        for variant, (colour, marker, offset) in zip(variants, looks, strict=True):
            mean, low, high = grids[variant]
            bars(axes, mean[:, k], low[:, k], high[:, k], colour, marker, offset=offset, width=2.4)
        finish(axes, name, labels, limits)
    outer_labels(panels)
    headline(figure, f"Thrust under the uses of ΔV – posterior mean and {INTERVAL}")
    legend_below(
        figure,
        [
            line(color=colour, marker=marker, lw=2.4, ms=5, mfc="white", label=variant)
            for variant, (colour, marker, _) in zip(variants, looks, strict=True)
        ],
    )
    return figure


def _variant_styles(count: int) -> list[tuple[str, str, float]]:
    colours, markers = ("#222222", "#4477AA", "#CC6677", "#999933"), ("o", "s", "^", "D")
    offsets = np.linspace(-0.27, 0.27, count) if count > 1 else np.zeros(1)
    return [(colours[i % 4], markers[i % 4], float(offsets[i])) for i in range(count)]
