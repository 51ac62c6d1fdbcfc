"""Measured velocity changes of telemetry as information on thrust (paper 000, App. D).

Per row in body axes, M ΔV(t) = Σ_k d_k F_k s_k(t), with the effective on-time s_k of the momentum
balance and the event's wet mass M. Rows during which a pulse is being delivered are left out, as in
the balance; the first reading stays in, because on-times and velocity change are counted from it,
whatever a counter had summed up before. The noise of a row is white, and that of the first reading
is an unknown offset of its own.
Like the balance this is linear in the thrusts, so a few inner products are all that is kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import DELTA_V_NOISE, Physics, delta_v_variance
from cassini_bayes.balance.statistics import Samples, Sampling
from cassini_bayes.balance.statistics.columns import effective_increments
from cassini_bayes.balance.statistics.pulse_columns import PULSE_COLUMNS
from cassini_bayes.balance.statistics.rows import quiet_rows
from cassini_bayes.computing.arrays import Array, Flags, Places, joined
from cassini_bayes.errors import InputError

OFFSET_SD_M_S: Final = 0.1  # of the first reading: flat against noise of mm/s
LEAST_ROWS: Final = 2  # the first is where counting begins
DELTA_V_PARAMETERS: Final = ("mass_kg", *DELTA_V_NOISE)


@dataclass(frozen=True)
class DeltaVStatistics:
    """Inner products of the columns of one event's measured velocity change.

    Columns: per thruster its pulse columns (B = K C of all), then the constant. ``gram`` (B + 1,
    B + 1), ``cross`` (B + 1, 3) with the ΔV measured since the first reading, ``square`` its sum of
    squares over rows and axes; ``last_m_s`` (3,) is the last one.
    """

    sampling: Sampling
    rows: int
    gram: Array
    cross: Array
    square: float
    last_m_s: Array

    @property
    def centred_gram(self) -> Array:
        """Inner products (B, B) with the unknown constant eliminated."""
        gram, one = self.gram[:-1, :-1], self.gram[:-1, -1]
        return np.asarray(gram - np.outer(one, one) / self.rows)


def delta_v_statistics(
    event_id: str, parts: Iterable[tuple[Samples, Array]], sampling: Sampling
) -> DeltaVStatistics:
    """Reduce an event: ``parts`` are its rows in order, each with ΔV (n, 3) m/s, NaN where none.

    A burn is short: all rows are held at once.

    Raises
    ------
    InputError
        Fewer than two rows with ΔV at which no thruster was delivering.
    """
    stretches = list(parts)
    samples = joined([part for part, _ in stretches])
    measured = np.concatenate([values for _, values in stretches])
    rows = rows_at_rest(samples, np.isfinite(measured).all(1), sampling.guard_s)
    if len(rows) < LEAST_ROWS:
        raise InputError(
            f"event {event_id}: telemetry",
            f"at least {LEAST_ROWS} rows with a velocity change while no thruster delivers",
            str(len(rows)),
            "let the telemetry begin before the burn and end after it",
        )
    table = np.concatenate([on_time_columns(samples, rows, sampling), np.ones((len(rows), 1))], 1)
    values = measured[rows] - measured[rows[0]]
    return DeltaVStatistics(
        sampling,
        len(rows),
        table.T @ table,
        table.T @ values,
        float((values**2).sum()),
        values[-1],
    )


def rows_at_rest(samples: Samples, measured: Flags, guard_s: float) -> Places:
    """Rows (R,) among the ``measured`` ones at which no thruster delivers, and the first reading.

    The first reading is where on-times and velocity change begin to be counted.
    """
    counted = np.flatnonzero(samples.has_counters)
    time = samples.time_s[counted]
    counters = np.concatenate([samples.on_time_s[counted], samples.pulses[counted]], axis=1)
    rows = np.flatnonzero(measured)
    quiet = quiet_rows(samples.time_s[rows], time, counters, guard_s)
    quiet |= samples.time_s[rows] == time[0]
    return np.asarray(rows[quiet])


def on_time_columns(samples: Samples, rows: Places, sampling: Sampling) -> Array:
    """Pulse columns of every thruster up to some rows, (R, B)."""
    counted = np.flatnonzero(samples.has_counters)
    time = samples.time_s[counted]
    on_time, pulses = samples.on_time_s[counted], samples.pulses[counted]
    gained = effective_increments(
        np.diff(on_time, axis=0), np.diff(pulses, axis=0), sampling.pulses.expected_columns
    )
    flat = gained.reshape(len(gained), -1)
    total = np.concatenate([np.zeros((1, flat.shape[1])), np.cumsum(flat, axis=0)])
    place = np.searchsorted(time, samples.time_s[rows] + 1e-6, side="right") - 1
    return np.asarray(total[place])


def delta_v_information(
    statistics: DeltaVStatistics,
    physics: Physics,
    directions: Array,
    parameters: Mapping[str, Array],
    common_n: Array,
) -> tuple[Array, Array, Array]:
    """Information on the thrusts: matrix (n, K, K), vector (n, K) and constant (n,).

    With d = F − common, log L = constant + vectorᵀ d − ½ dᵀ matrix d. ``directions`` (3, K) are the
    thrusters' force directions, ``parameters`` has those of :data:`DELTA_V_PARAMETERS`, (n,) each.
    """
    n, k = len(common_n), directions.shape[1]
    return velocity_information(
        on_time_weights(statistics.sampling, physics, n, k),
        statistics.gram,
        np.broadcast_to(statistics.cross, (n, *statistics.cross.shape)),
        np.full(n, statistics.square),
        delta_v_variance(parameters),
        parameters["mass_kg"],
        directions,
        common_n,
    )


def velocity_information(
    weights: Array,
    gram: Array,
    cross: Array,
    square: Array,
    variance: Array,
    mass_kg: Array,
    directions: Array,
    common_n: Array,
) -> tuple[Array, Array, Array]:
    """Information on the thrusts of velocities along A axes, their constants eliminated.

    As :func:`delta_v_information`, for any velocities: ``weights`` (n, K, B) of
    :func:`on_time_weights`, ``gram`` (B + 1, B + 1) of the columns and the constant, ``cross``
    (n, B + 1, A) with the velocities, ``square`` (n,) their sum of squares, ``variance`` (n,) of
    each, (m/s)², ``directions`` (A, K) of the forces along the axes.
    """
    axes = len(directions)
    rows = gram[-1, -1]
    fired = weights @ gram[:-1, :-1] @ np.swapaxes(weights, 1, 2)
    to_one = weights @ gram[:-1, -1]
    with_data = weights @ cross[:, :-1]
    of_one = cross[:, -1]
    scale = 1.0 / (mass_kg**2 * variance)
    # the offset of each axis, eliminated: its precision is rows/σ² + 1/sd²
    ones = rows / variance + OFFSET_SD_M_S**-2
    lost = scale / (variance * ones)
    inner = directions.T @ directions
    matrix = inner * (
        scale[:, None, None] * fired - lost[:, None, None] * to_one[:, :, None] * to_one[:, None, :]
    )
    by_mass = 1.0 / (mass_kg * variance)
    shifted = with_data - to_one[:, :, None] * (of_one / (variance * ones)[:, None])[:, None, :]
    vector = by_mass[:, None] * np.einsum("ck,nkc->nk", directions, shifted)
    left = square / variance - (of_one**2).sum(-1) / (variance**2 * ones)
    constant = (
        -0.5 * left
        - 0.5 * axes * rows * np.log(2.0 * np.pi * variance)
        - 0.5 * axes * np.log(ones * OFFSET_SD_M_S**2)
    )
    by_common = matrix.sum(-1)
    return (
        matrix,
        vector - common_n[:, None] * by_common,
        constant + common_n * vector.sum(-1) - 0.5 * common_n**2 * by_common.sum(-1),
    )


def delta_v_columns(
    statistics: DeltaVStatistics,
    physics: Physics,
    directions: Array,
    parameters: Mapping[str, Array],
) -> Array:
    """Velocity change per newton of every thruster on the columns, (n, K, 3, B)."""
    n, k = len(parameters["mass_kg"]), directions.shape[1]
    weights = on_time_weights(statistics.sampling, physics, n, k)
    per_newton = weights / parameters["mass_kg"][:, None, None]
    return np.asarray(directions.T[None, :, :, None] * per_newton[:, :, None, :])


def on_time_weights(sampling: Sampling, physics: Physics, n: int, k: int) -> Array:
    """Weights (n, K, B) that make each thruster's effective on-time out of the columns."""
    offset = np.broadcast_to(physics.impulse_offset_s, (n, k))
    own = np.broadcast_to(
        sampling.pulses.of_thrusters(physics.tau_s, offset), (n, k, len(PULSE_COLUMNS))
    )
    return np.asarray(own[:, :, None] * np.eye(k)[:, :, None]).reshape(n, k, -1)
