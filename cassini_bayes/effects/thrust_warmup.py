"""A cold catalyst bed: F = F∞ (1 − deficit · exp(−u/t_w)), u the thruster's own on-time so far.

On-time lost per unit of deficit is ∫ exp(−u/t_w) du = t_w (1 − exp(−u/t_w)), and a pulse's tail is
as weak as its pulse. Both are columns at seven time constants. A warm-up of any other is the sum of
these that is nearest, in least squares, to the on-time that it loses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.balance.statistics import ExtraColumn, RowContext
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.changes import with_columns
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Clause

LEAST_S: Final = 0.5  # time constants outside these bounds, which are
MOST_S: Final = 32.0  # those of the catalogue's table, are taken as the bounds
_AT: Final = np.cos(np.pi * (np.arange(7)[::-1] + 0.5) / 7)
NODES_S: Final = tuple((math.sqrt(LEAST_S * MOST_S) * (MOST_S / LEAST_S) ** (0.5 * _AT)).tolist())
"""Time constants that have columns: Chebyshev's in the logarithm between the bounds."""
FITTED_S: Final = np.concatenate([[0.0], np.geomspace(0.02, 400.0, 80)])
"""On-times at which a sum of columns is nearest to a warm-up: from short pulses to warm beds."""


def on_time_column(thruster: str, time_constant_s: float) -> str:
    """Name of the column of on-time lost in a warm-up of this time constant."""
    return f"warmup:{time_constant_s:g}@{thruster}"


def tail_column(thruster: str, time_constant_s: float) -> str:
    """Name of the column of the tails that such a warm-up weakens."""
    return f"warmup-tail:{time_constant_s:g}@{thruster}"


def columns(thrusters: Sequence[str]) -> tuple[ExtraColumn, ...]:
    """On-time and tails lost by every thruster at every time constant."""
    return tuple(
        column
        for place, name in enumerate(thrusters)
        for node in NODES_S
        for column in (
            ExtraColumn(on_time_column(name, node), partial(_on_time_lost, place, node)),
            ExtraColumn(tail_column(name, node), partial(_tails_lost, place, node)),
        )
    )


def _on_time_lost(place: int, time_constant_s: float, context: RowContext) -> Array:
    """Commanded on-time lost per unit of deficit so far: ∫ exp(−u/t_w) du over the on-time u.

    u is counted from the first reading, as counters need not begin at 0.
    """
    on_time = context.on_time_at(context.time_s)[:, place] - context.on_time_s[0, place]
    return on_time_lost(on_time, np.asarray(time_constant_s))


def _tails_lost(place: int, time_constant_s: float, context: RowContext) -> Array:
    """Tails lost per unit of deficit so far: Σ exp(−u/t_w) over pulses that ended at on-time u.

    Pulses between two readings are taken to be alike.
    """
    on_time = context.on_time_s[:, place] - context.on_time_s[0, place]
    count = np.diff(context.pulses[:, place])
    width = np.divide(np.diff(on_time), count, out=np.zeros_like(count), where=count > 0.0)
    ratio = np.exp(-width / time_constant_s)
    alike = np.divide(1.0 - ratio**count, 1.0 - ratio, out=np.array(count), where=ratio < 1.0)
    lost = np.exp(-on_time[:-1] / time_constant_s) * ratio * alike
    lost = np.where(count > 0.0, lost, 0.0)
    return np.concatenate([[0.0], np.cumsum(lost)])[context.reading(context.time_s)]


def on_time_lost(on_time_s: Array, time_constant_s: Array) -> Array:
    """On-time t_w (1 − exp(−u/t_w)) lost per unit of deficit, in s; the arguments broadcast."""
    return np.asarray(time_constant_s * -np.expm1(-on_time_s / time_constant_s))


_FIT: Final = np.linalg.pinv(on_time_lost(FITTED_S[:, None], np.array(NODES_S)))


def node_weights(time_constant_s: Array) -> Array:
    """Weights (n, nodes) of the columns at the nodes, for time constants (n,), s.

    Least squares over :data:`FITTED_S`. On-times lost are right to 0.2 % of t_w, and to 26 ms.
    """
    inside = np.clip(time_constant_s, LEAST_S, MOST_S)
    return np.asarray(on_time_lost(FITTED_S, inside[..., None]) @ _FIT.T)


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """Every thruster loses on-time and tails by its own history."""
    shares = node_weights(values["warmup_time_s"])
    tail = np.asarray(physics.tau_s[2]) - np.asarray(physics.tau_s[1])  # of a first-order valve
    weights = {}
    for name in setting.thrusters:
        for i, node in enumerate(NODES_S):
            lost = -(values["warmup_deficit"] * shares[..., i])
            weights[on_time_column(name, node)] = lost
            weights[tail_column(name, node)] = lost * tail
    return with_columns(physics, weights)


KIND: Final = Kind(
    "thrust_warmup",
    change,
    columns=columns,
    says=Clause(
        "every thruster starts cold, {0} too weak, and warms up within {1} of its own firing",
        (("%", 100.0), ("s", 1.0)),
    ),
)
