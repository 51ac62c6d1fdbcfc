"""Pictures of simulated events, and of simulated totals beside flight's."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cassini_bayes.bias_comparison import PRINTED, UNITS, Comparison, printed_rows
from cassini_bayes.plots.style import INK, POSTERIOR, PRIOR, STYLE
from cassini_bayes.simulation import SimulatedEvent

AXIS_COLOURS = ("#332288", "#117733", "#CC6677")
_COLUMN_STYLE = {
    "ideal": ("#BBBBBB", "x"),
    "calibrated": ("#999933", "s"),
    "fsds": ("#AA4499", "D"),
    "flight": ("#222222", "o"),
}


def motion_figure(event: SimulatedEvent) -> Figure:
    """Attitude error, rates, wheel speeds, momentum and firings of one event, over time."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(7.5, 9.5), layout="constrained")
        panels = figure.subplots(5, 1, sharex=True)
        motion = event.motion
        _by_axis(panels[0], motion.time_s, 1e3 * motion.attitude_error_rad, "attitude error [mrad]")
        if event.plan.event.kind in ("bias", "delta_v"):
            for axis, band in enumerate(event.plan.rcs.dead_band_rad):
                for side in (-1e3, 1e3):
                    panels[0].axhline(side * band, color=AXIS_COLOURS[axis], lw=0.6, ls=":")
        _by_axis(panels[1], motion.time_s, 1e3 * motion.rate_rad_s, "rate [mrad/s]")
        for j, number in enumerate(event.plan.wheel_numbers):
            label = f"wheel {number}"
            panels[2].plot(
                motion.time_s, motion.wheels_rpm[:, j], color=AXIS_COLOURS[j % 3], label=label
            )
        panels[2].set_ylabel("wheel speed [rpm]")
        panels[2].legend(ncols=4, loc="best")
        momentum = motion.momentum_inertial_n_m_s()
        _by_axis(
            panels[3],
            motion.time_s,
            momentum - momentum[0],
            "inertial momentum\ngained [N m s]",
        )
        _firings(panels[4], event)
        panels[4].set_xlabel("time [s]")
        figure.suptitle(f"{event.plan.event.id} ({event.plan.event.kind})")
    return figure


def _by_axis(axes: Axes, time: np.ndarray, values: np.ndarray, label: str) -> None:
    for axis, name in enumerate("XYZ"):
        axes.plot(time, values[:, axis], color=AXIS_COLOURS[axis], lw=0.9, label=name)
    axes.set_ylabel(label)
    axes.legend(ncols=3, loc="best")


def _firings(axes: Axes, event: SimulatedEvent) -> None:
    names = list(event.motion.pulses)
    for row, log in enumerate(event.motion.pulses.values()):
        axes.vlines(
            log.start_s,
            row - 0.4,
            row - 0.4 + 6.4 * np.minimum(log.width_s, 0.125),
            color=INK,
            lw=0.7,
        )
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_ylabel("firings")


def comparison_figure(comparison: Comparison) -> Figure:
    """On-times of every event and unit: simulated (mean ± sd over seeds) and the printed columns,
    as differences to flight.
    """
    with matplotlib.rc_context(dict(STYLE)):
        n = len(comparison.tables)
        figure = Figure(figsize=(7.5, 8.0), layout="constrained")
        panels = figure.subplots((n + 1) // 2, 2, sharex=True).ravel()
        place = np.arange(len(UNITS))
        rows = slice(0, len(UNITS))
        for axes, table in zip(panels, comparison.tables, strict=False):
            flight = printed_rows(table, "flight")[rows]
            mean = comparison.mean(table.event)[rows] - flight
            axes.axhline(0.0, color=PRIOR, lw=0.8)
            for i, column in enumerate(PRINTED[:3]):
                colour, marker = _COLUMN_STYLE[column]
                difference = printed_rows(table, column)[rows] - flight
                axes.plot(
                    place + 0.15 * (i - 1.5), difference, marker, color=colour, ms=4, label=column
                )
            axes.errorbar(
                place + 0.25,
                mean,
                comparison.spread(table.event)[rows],
                fmt="o",
                color=POSTERIOR,
                ms=4,
                lw=1.2,
                label="this simulation",
            )
            axes.set_title(table.event)
            axes.set_xticks(place, [unit.replace("_", "–") for unit in UNITS])
            axes.set_ylim(-6.5, 4.5)
            axes.set_ylabel("on-time − flight [s]")
        panels[0].legend(ncols=2, loc="lower left", fontsize=7)
    return figure
