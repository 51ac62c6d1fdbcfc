"""Thruster records late: a record stamped t shows the counters of t − offset.

What had been delivered but was shown later is a column at four offsets. A pulse that a late record
hides is still being delivered: of all that began within an offset o it has given ∫ D(a) da over
ages a to o, D its delivered share, which is about o less the mean time L from a command to its
impulse. A row shortly after a pulse would see it either way.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.balance.statistics import ExtraColumn, RowContext
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.changes import with_columns
from cassini_bayes.effects.effect import FittedRows, Kind, Setting, Values
from cassini_bayes.effects.firings import TAIL_S, FiredIntervals
from cassini_bayes.effects.wording import Clause

OFFSETS_S: Final = (-2.0, -1.0, 0.0, 1.0, 2.0)
"""Offsets that have columns (zero needs none): whole samples at 1 Hz, to the prior's bounds."""
LAG_S: Final = 0.056
"""Mean time from a command to its impulse, less half the pulse's width: 0.047 to 0.060 s for pulses
of 15 to 500 ms at τ_delay, τ_rise, τ_fall = 10, 20, 50 ms (their thrust curve's mean time)."""
PULSE_S: Final = 0.06
"""Width of a usual pulse: by how little of it is seen that is hidden for less than its time."""


def column_name(thruster: str, offset_s: float) -> str:
    """Name of the column of counters looked up later by ``offset_s``."""
    return f"shift:{offset_s:g}@{thruster}"


def columns(thrusters: Sequence[str]) -> tuple[ExtraColumn, ...]:
    """On-time of every thruster that a late record does not show yet."""
    return tuple(
        ExtraColumn(column_name(name, offset), partial(_shifted, place, offset))
        for place, name in enumerate(thrusters)
        for offset in OFFSETS_S
        if offset != 0.0
    )


def _shifted(place: int, offset_s: float, context: RowContext) -> Array:
    """Effective on-time delivered at the rows, less what a record late by ``offset_s`` shows."""
    time, shown = context.counter_time_s, context.time_s
    on_time, pulses = context.on_time_s[:, place], context.pulses[:, place]
    counted = on_time + TAIL_S * pulses
    width, begun = np.diff(on_time), np.diff(pulses)
    lag = LAG_S + 0.5 * np.divide(width, begun, out=np.zeros_like(width), where=begun > 0.0)
    return delivered(shown + offset_s, time, counted, lag) - np.interp(shown, time, counted)


def delivered(at_s: Array, time_s: Array, counted: Array, lag_s: Array) -> Array:
    """What is delivered at times (n,) of readings (m,) at ``time_s``, each increment with its lag.

    An increment between two readings is evenly spread over that interval, ``lag_s`` (m − 1,) later.
    Lags of at most an interval are exact.
    """
    last = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(time_s) - 2)
    result = np.array(counted[np.maximum(last - 1, 0)])
    for back in (1, 0):
        interval = last - back
        here = np.maximum(interval, 0)
        start, end = time_s[here] + lag_s[here], time_s[here + 1] + lag_s[here]
        share = np.clip((at_s - start) / (end - start), 0.0, 1.0)
        result += np.where(interval >= 0, share * (counted[here + 1] - counted[here]), 0.0)
    return result


def seen_offset(offset_s: Array) -> Array:
    """Offsets at which straight lines between the columns are what usual pulses show, n of them.

    With D rising evenly to 1 within 2 L of a command, a record that is late by o < 1 s hides
    e(o)/e(1) of what it hides at 1 s: e = o²/(4 L) at first, then o − L. One that is early by o < 1
    s shows pulses too soon; rows follow a pulse by a reading at least, so that nothing is wrong
    until 1 s − 2 L, and then ((o − 1 s)/(2 L) + 1)² of what is at 1 s. (Of counters every second
    or slower: with faster ones an early record looks earlier than it is.)
    """
    lag = LAG_S + 0.5 * PULSE_S
    late, early = np.clip(offset_s, 0.0, 1.0), np.clip(-offset_s, 0.0, 1.0)
    rising = np.minimum(late, 2.0 * lag)
    hidden = (rising**2 / (4.0 * lag) + late - rising) / (1.0 - lag)
    shown = np.maximum((early - 1.0) / (2.0 * lag) + 1.0, 0.0) ** 2
    beyond = offset_s - np.clip(offset_s, -1.0, 1.0)
    return np.asarray(hidden - shown + beyond)


def hat_weights(value: Array, nodes: Array) -> Array:
    """Weights (n, nodes) of piecewise linear interpolation at values (n,), held at the ends."""
    inside = np.clip(value, nodes[0], nodes[-1])
    place = np.clip(np.searchsorted(nodes, inside, side="right") - 1, 0, len(nodes) - 2)
    share = (inside - nodes[place]) / (nodes[place + 1] - nodes[place])
    result = np.zeros((*inside.shape, len(nodes)))
    np.put_along_axis(result, place[..., None], (1.0 - share)[..., None], axis=-1)
    np.put_along_axis(result, place[..., None] + 1, share[..., None], axis=-1)
    return result


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """The on-time that every thruster's record is late by."""
    shares = hat_weights(seen_offset(values["time_offset_s"]), np.array(OFFSETS_S))
    weights = {
        column_name(name, offset): shares[..., i]
        for name in setting.thrusters
        for i, offset in enumerate(OFFSETS_S)
        if offset != 0.0
    }
    return with_columns(physics, weights)


def late_firings(firings: FiredIntervals, time_s: Array, offset_s: float) -> tuple[Array, Array]:
    """Columns (n, 3, s), N m s, and variances (s,) of firings of which a late record shows a part.

    A row at t shows what had been delivered by t + offset, which lies within a counter interval:
    the share f of its time has gone by, but a pulse has been fired or not, with variance f (1 − f).
    One unknown for every firing, √(f (1 − f)) of its momentum at the rows at ``time_s`` (n,).
    """
    length = firings.end_s - firings.start_s
    since = time_s[:, None] + offset_s - (firings.start_s + LAG_S + 0.5 * PULSE_S)
    share = np.clip(since / length, 0.0, 1.0)
    spread = np.sqrt(share * (1.0 - share))
    partly = np.flatnonzero(spread.any(0))
    return spread[:, None, partly] * firings.momentum_n_m_s[partly].T, firings.scatter[partly]


def left_open(
    firings: FiredIntervals, rows: FittedRows, values: Values, _: Setting
) -> tuple[Array, Array]:
    """Firings that late records show in part."""
    return late_firings(firings, rows.time_s, float(values["time_offset_s"][0]))


# Pulses start with control cycles, and a firing goes on for some of them, nobody knows when: found
# sizes are off by 0.07 s beside what their draws say (24 flights at 0.125 s a cycle, rows every
# second), as two cycles are. Where rows have late pulses, these are late by some 0.05 to 0.1 s on
# average themselves, as far as a controller likes.
KIND: Final = Kind(
    "time_offset",
    change,
    columns=columns,
    left_open=left_open,
    known_to={"time_offset_s": None},
    says=Clause("thruster records are late by {0}", (("ms", 1e3),)),
    needs_quiet_rows=True,
)
