"""Thruster records late: a record stamped t shows the counters of t − offset.

What had been delivered but was shown later is a column at four offsets; between them, and zero,
straight lines.
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
from cassini_bayes.effects.firings import TAIL_S, Firings
from cassini_bayes.effects.wording import Clause

OFFSETS_S: Final = (-2.0, -1.0, 0.0, 1.0, 2.0)
"""Offsets that have columns (zero needs none): whole samples at 1 Hz, to the prior's bounds."""


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
    """Effective on-time that had been delivered but was shown ``offset_s`` later."""

    def counted(values: Array) -> Array:
        later = np.interp(context.time_s + offset_s, context.counter_time_s, values[:, place])
        now = np.interp(context.time_s, context.counter_time_s, values[:, place])
        return np.asarray(later - now)

    return counted(context.on_time_s) + TAIL_S * counted(context.pulses)


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
    shares = hat_weights(values["time_offset_s"], np.array(OFFSETS_S))
    weights = {
        column_name(name, offset): shares[..., i]
        for name in setting.thrusters
        for i, offset in enumerate(OFFSETS_S)
        if offset != 0.0
    }
    return with_columns(physics, weights)


def late_firings(firings: Firings, time_s: Array, offset_s: float) -> tuple[Array, Array]:
    """Columns (n, 3, s), N m s, and variances (s,) of firings of which a late record shows a part.

    A row at t shows what had been fired by t + offset, which lies within a counter interval: the
    share f of its time has gone by, but a pulse has been fired or not, with variance f (1 − f). One
    unknown for every firing, √(f (1 − f)) of its momentum at the rows at ``time_s`` (n,).
    """
    length = firings.end_s - firings.start_s
    share = np.clip((time_s[:, None] + offset_s - firings.start_s) / length, 0.0, 1.0)
    spread = np.sqrt(share * (1.0 - share))
    partly = np.flatnonzero(spread.any(0))
    return spread[:, None, partly] * firings.momentum_n_m_s[partly].T, firings.scatter[partly]


def left_open(
    firings: Firings, rows: FittedRows, values: Values, _: Setting
) -> tuple[Array, Array]:
    """Firings that late records show in part."""
    return late_firings(firings, rows.time_s, float(values["time_offset_s"][0]))


# Pulses start with control cycles, and rows with a pulse under way do not enter the balance: those
# that do cannot tell records late by τ from records late by the whole cycles in τ. Where rows have
# late pulses, these are late by some 0.05 to 0.1 s on average themselves, as far as a controller
# likes.
KIND: Final = Kind(
    "time_offset",
    change,
    columns=columns,
    left_open=left_open,
    known_to={"time_offset_s": None},
    says=Clause("thruster records are late by {0}", (("ms", 1e3),)),
    needs_quiet_rows=True,
)
