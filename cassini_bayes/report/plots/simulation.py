"""Pictures of simulated events, and of simulated totals beside flight's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report.plots.style import INK, POSTERIOR, PRIOR, styled_figure, symbols
from cassini_bayes.simulation import SimulatedEvent

LEAST_MOMENTUM_N_M_S = 1e-3
"""Below it a gain of momentum is rounding: the axis is not stretched over that."""
AXIS_COLOURS = ("#332288", "#117733", "#CC6677")
_LABELS = {"fsds": "FSDS"}
_COLUMN_STYLE = {
    "ideal": ("#BBBBBB", "x"),
    "calibrated": ("#999933", "s"),
    "fsds": ("#AA4499", "D"),
    "flight": ("#222222", "o"),
}


def motion_figure(event: SimulatedEvent) -> Figure:
    """Attitude error, rates, wheel speeds, momentum and firings of one event, over time.

    Dotted lines are the dead-band under thruster control. Wheel speeds of a quiescent period are
    drawn as their drift, and momentum is what the event gained in the inertial frame, so that a
    flat line means conservation.
    """
    with styled_figure(7.5, 9.5) as figure:
        panels = figure.subplots(5, 1, sharex=True)
        motion = event.motion
        _small(panels[0], motion.time_s, motion.attitude_error_rad, ("attitude error", "rad"))
        if event.plan.event.kind in ("bias", "delta_v"):
            for axis, band in enumerate(event.plan.rcs.dead_band_rad):
                for side in (-1e3, 1e3):
                    panels[0].axhline(side * band, color=AXIS_COLOURS[axis], lw=0.6, ls=":")
        _small(panels[1], motion.time_s, motion.rate_rad_s, ("rate", "rad/s"))
        _wheels(panels[2], event)
        momentum = motion.momentum_inertial_n_m_s()
        gained = momentum - momentum[0]
        _by_axis(panels[3], motion.time_s, gained, "inertial momentum\ngained [N m s]")
        if np.abs(gained).max() < LEAST_MOMENTUM_N_M_S:
            panels[3].set_ylim(-LEAST_MOMENTUM_N_M_S, LEAST_MOMENTUM_N_M_S)
        _firings(panels[4], event)
        panels[4].set_xlabel("time [s]")
        figure.suptitle(f"{event.plan.event.id} ({event.plan.event.kind})")
    return figure


def _small(axes: Axes, time: Array, values: Array, quantity: tuple[str, str]) -> None:
    """Values per axis in mrad or, where all are below 0.1 mrad, in μrad (or nrad)."""
    name, unit = quantity
    size = float(np.abs(values).max())
    prefix, factor = next(
        ((p, f) for p, f in (("m", 1e3), ("μ", 1e6)) if size * f >= 0.1), ("n", 1e9)
    )
    _by_axis(axes, time, factor * values, f"{name} [{prefix}{unit}]")


def _by_axis(axes: Axes, time: Array, values: Array, label: str) -> None:
    for axis, name in enumerate("XYZ"):
        axes.plot(time, values[:, axis], color=AXIS_COLOURS[axis], lw=0.9, label=name)
    axes.set_ylabel(label)
    _legend_above(axes)


def _legend_above(axes: Axes) -> None:
    """A legend that hides no curve."""
    above: dict[str, Any] = {
        "loc": "lower right",
        "bbox_to_anchor": (1.0, 0.96),
        "borderaxespad": 0.0,
    }
    axes.legend(ncols=4, frameon=False, fontsize=8, **above)


def _wheels(axes: Axes, event: SimulatedEvent) -> None:
    motion = event.motion
    quiet = event.plan.event.kind == "quiescent"
    speeds = motion.wheels_rpm - (motion.wheels_rpm[0] if quiet else 0.0)
    for j, number in enumerate(event.plan.wheel_numbers):
        look: dict[str, Any] = {"color": AXIS_COLOURS[j % 3], "ls": ("-", "--", ":")[j % 3]}
        axes.plot(motion.time_s, speeds[:, j], label=f"wheel {number}", **look)
    axes.set_ylabel("wheel speed,\ndrift [rpm]" if quiet else "wheel speed [rpm]")
    _legend_above(axes)


def _firings(axes: Axes, event: SimulatedEvent) -> None:
    """Every pulse as a mark at its start (shorter below 125 ms), and a bar as long as it lasts."""
    names = [name.upper() for name in event.motion.pulses]
    for row, log in enumerate(event.motion.pulses.values()):
        top = row + 0.4 - 6.4 * np.minimum(log.width_s, 0.125)
        axes.vlines(log.start_s, row + 0.4, top, color=INK, lw=0.7)
        rows = np.full(log.start_s.shape, row)
        axes.hlines(rows, log.start_s, log.start_s + log.width_s, INK, lw=3)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_ylabel("firings")
    if not any(log.start_s.size for log in event.motion.pulses.values()):
        axes.text(0.5, 0.5, "no thruster fires", transform=axes.transAxes, ha="center", va="center")


@dataclass(frozen=True)
class OnTimePanel:
    """One event's on-times less flight's, s: printed columns by name, simulated mean and sd."""

    event: str
    printed: Mapping[str, Array]  # (U,) each
    mean: Array  # (U,)
    spread: Array  # (U,)


def comparison_figure(events: Sequence[OnTimePanel], units: Sequence[str]) -> Figure:
    """On-times of every event and unit: simulated (mean ± sd over seeds) and the printed columns,
    as differences to flight.
    """
    with styled_figure(7.5, 8.0) as figure:
        panels = figure.subplots((len(events) + 1) // 2, 2, sharex=True).ravel()
        place = np.arange(len(units))
        for axes, shown in zip(panels, events, strict=False):
            axes.axhline(0.0, color=PRIOR, lw=0.8)
            for i, (column, difference) in enumerate(shown.printed.items()):
                colour, marker = _COLUMN_STYLE[column]
                at, label = place + 0.15 * (i - 1.5), _LABELS.get(column, column)
                symbols(axes, at, difference, marker, 4, colour, label=label)
            look = {"fmt": "o", "color": POSTERIOR, "ms": 4, "lw": 1.2, "label": "this simulation"}
            axes.errorbar(place + 0.25, shown.mean, shown.spread, **look)
            axes.set_title(shown.event)
            axes.set_xticks(place, [unit.replace("_", "–").upper() for unit in units])
            axes.set_ylim(-6.5, 4.5)
            axes.set_ylabel("on-time − flight [s]")
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, ncols=len(names), loc="outside upper center")
    return figure
