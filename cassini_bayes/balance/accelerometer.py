"""Counts of an accelerometer along Z as information on thrust (paper 000, App. D).

A count is a step κ of velocity, and the sensor drifts: with N the counts so far and b the bias,

    κ N(t) + b (t − t0)  =  c + Σ_k d_kz F_k s_k(t)/M + κ u,    |u| ≤ ½,

M the wet mass and s_k the effective on-time of the momentum balance. The rounding u is bounded and
the same for as long as the velocity stays within a step, so a stretch of rows with one count is one
reading, at its mean time; taken row by row it would average away. Rows during which a pulse is
delivered are left out, as in the balance. Both scale and bias are parameters: rows before the burn
determine the bias, if there are enough of them for a count or two.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.balance.measured_delta_v import (
    on_time_columns,
    on_time_weights,
    rows_at_rest,
    velocity_information,
)
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.statistics import Samples, Sampling
from cassini_bayes.computing.arrays import Array, joined
from cassini_bayes.errors import InputError

LEAST_READINGS: Final = 2  # the constant takes one
ACCELEROMETER_PARAMETERS: Final = ("mass_kg", "accelerometer_scale_m_s", "accelerometer_bias_m_s2")
ROUNDING_COUNTS_2: Final = 1.0 / 12.0
"""Variance of a reading, counts²: what a uniform rounding of one step has."""
_ALONG: Final = 2  # the body axis that is sensed


@dataclass(frozen=True)
class AccelerometerStatistics:
    """Inner products of the columns of one event's accelerometer readings.

    Columns: per thruster its pulse columns (B of all), the constant, the time since the first
    reading in s. ``gram`` (B + 2, B + 2), ``cross`` (B + 2,) with the counts since the first
    reading, ``square`` their sum of squares; ``readings`` is how many stretches of one count there
    are.
    """

    sampling: Sampling
    readings: int
    gram: Array
    cross: Array
    square: float

    @property
    def centred_gram(self) -> Array:
        """Inner products (B + 1, B + 1) of on-times and time, the constant eliminated."""
        others = np.delete(np.arange(len(self.gram)), len(self.gram) - 2)
        one = self.gram[others, -2]
        return np.asarray(self.gram[others[:, None], others] - np.outer(one, one) / self.readings)


def accelerometer_statistics(
    event_id: str, parts: Iterable[tuple[Samples, Array]], sampling: Sampling
) -> AccelerometerStatistics:
    """Reduce an event: ``parts`` are its rows in order, each with counts (n,), NaN where none.

    Raises
    ------
    InputError
        Fewer than two stretches of counts at which no thruster was delivering.
    """
    stretches = list(parts)
    samples = joined([part for part, _ in stretches])
    counts = np.concatenate([values for _, values in stretches])
    rows = rows_at_rest(samples, np.isfinite(counts), sampling.guard_s)
    columns = on_time_columns(samples, rows, sampling)
    shown = np.column_stack([columns, counts[rows]])
    first = np.flatnonzero(np.r_[True, np.any(np.diff(shown, axis=0) != 0.0, axis=1)])
    if len(rows) == 0 or len(first) < LEAST_READINGS:
        raise InputError(
            f"event {event_id}: telemetry",
            f"at least {LEAST_READINGS} accelerometer counts while no thruster delivers",
            str(min(len(rows), len(first))),
            "let the telemetry begin before the burn and end after it",
        )
    sizes = np.diff(np.r_[first, len(rows)])
    time = np.add.reduceat(samples.time_s[rows], first) / sizes
    table = np.column_stack([columns[first], np.ones(len(first)), time - time[0]])
    values = counts[rows][first] - counts[rows[0]]
    return AccelerometerStatistics(
        sampling, len(first), table.T @ table, table.T @ values, float((values**2).sum())
    )


def accelerometer_information(
    statistics: AccelerometerStatistics,
    physics: Physics,
    directions: Array,
    parameters: Mapping[str, Array],
    common_n: Array,
) -> tuple[Array, Array, Array]:
    """Information on the thrusts: matrix (n, K, K), vector (n, K) and constant (n,).

    As :func:`cassini_bayes.balance.measured_delta_v.delta_v_information`, of the velocities
    κ N + b t; the constant is the log density of the counts.
    """
    n, k = len(common_n), directions.shape[1]
    scale = np.broadcast_to(parameters["accelerometer_scale_m_s"], (n,))
    bias = np.broadcast_to(parameters["accelerometer_bias_m_s2"], (n,))
    gram, cross = statistics.gram, statistics.cross
    # inner products with κ N + b t, of columns and constant, then of itself
    velocity = scale[:, None] * cross[:-1] + bias[:, None] * gram[:-1, -1]
    square = scale**2 * statistics.square + 2.0 * scale * bias * cross[-1] + bias**2 * gram[-1, -1]
    matrix, vector, constant = velocity_information(
        on_time_weights(statistics.sampling, physics, n, k),
        gram[:-1, :-1],
        velocity[..., None],
        square,
        scale**2 * ROUNDING_COUNTS_2,
        np.broadcast_to(parameters["mass_kg"], (n,)),
        directions[_ALONG : _ALONG + 1],
        common_n,
    )
    return matrix, vector, constant + statistics.readings * np.log(scale)


def count_columns(
    statistics: AccelerometerStatistics,
    physics: Physics,
    directions: Array,
    parameters: Mapping[str, Array],
) -> tuple[Array, Array]:
    """Counts on the columns of :attr:`AccelerometerStatistics.centred_gram`.

    Per newton of every thruster (n, K, B + 1), and without thrust (n, B + 1): the bias.
    """
    n, k = len(parameters["mass_kg"]), directions.shape[1]
    scale = np.broadcast_to(parameters["accelerometer_scale_m_s"], (n,))
    weights = on_time_weights(statistics.sampling, physics, n, k)
    along = directions[_ALONG][None, :, None] / (parameters["mass_kg"] * scale)[:, None, None]
    fired = np.concatenate([along * weights, np.zeros((n, k, 1))], axis=2)
    drift = np.zeros((n, fired.shape[2]))
    drift[:, -1] = -np.asarray(parameters["accelerometer_bias_m_s2"]) / scale
    return fired, drift
