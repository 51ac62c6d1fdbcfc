"""Noise of a telemetry event's balance: in rows by band, in turns, and what counters leave open.

Derivations: docs/topics/telemetry-likelihood.md §3, §5 and §7.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.balance.kernel import TurnVariances, gain_and_covariance, summed_over_couples
from cassini_bayes.balance.open_counters import OpenScales
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.rounded_wheels import HARMONICS, WheelSquares, coherent_shares
from cassini_bayes.balance.statistics.pulse_columns import PULSE_COLUMNS
from cassini_bayes.balance.statistics.sampling import LostTails, lost_tails
from cassini_bayes.balance.telemetry_balance import ChannelVariances, OpenCounters, TelemetryBalance
from cassini_bayes.computing.arrays import Array
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

LEAST_PULSE: Final = 0.1  # of what pulses deliver where the event's thrusts were told
LEAST_RATE_RAD_S: Final = 1e-9  # noise that no gyro goes below: without any, turns have no say
LEAST_WHEEL_RPM: Final = 1e-4  # nor any tachometer: far below it sums of squares lose all digits


def noise_covariance(
    event: TelemetryBalance,
    physics: Physics,
    parameters: Mapping[str, Array],
) -> Array:
    """Covariance (n, 3, 3) of the white noise of a row's balance, (N m s)²."""
    of_wheels = wheel_covariance(event, physics, parameters)
    other = covariance_beside_wheels(event, physics, channel_variances(event, parameters))
    return np.asarray(other + of_wheels + late_covariance(event, physics))


def wheel_covariance(
    event: TelemetryBalance,
    physics: Physics,
    parameters: Mapping[str, Array],
    kept: Array | None = None,
) -> Array:
    """Covariance (n, 3, 3) of what wheel rates put into a row, (N m s)².

    ``kept`` (n, W, W) is the share of their noise that stays where their true rates are estimated.
    """
    wheels = event.wheel_weights(physics)
    left = wheels if kept is None else wheels @ kept
    noise = wheel_variance(event, parameters)[:, None, :]
    return np.asarray((left * noise) @ np.swapaxes(wheels, -1, -2))


def wheel_variance(event: TelemetryBalance, parameters: Mapping[str, Array]) -> Array:
    """Variance (n, W) of a measured wheel rate, its rounding included, rad²/s²."""
    return _wheel_variances(event, parameters, event.wheels, lasting_shares(event, parameters))


def channel_variances(event: TelemetryBalance, parameters: Mapping[str, Array]) -> ChannelVariances:
    """Variances of all channels; of wheel rates by band, as their rounding is not white."""
    statistics, shares = event.statistics, lasting_shares(event, parameters)
    averaged = statistics.counters.averaged
    rounding = statistics.steps.rate_rad_s**2 / 12.0
    rate = (parameters["rate_noise_rad_s"] ** 2 + rounding) / averaged
    attitude = parameters["attitude_noise_rad"] ** 2
    of_turns = TurnVariances(
        np.maximum(rate, LEAST_RATE_RAD_S**2),
        attitude,
        _white_variances(event, parameters, event.wheels, shares),
        statistics.steps.wheel_rad_s**2 / 12.0 * shares,
        parameters["torque_noise_n_m_s05"] ** 2,
    )
    wheels = _wheel_variances(event, parameters, event.band_wheels, shares)
    return ChannelVariances(rate, attitude / averaged, wheels, of_turns)


def _wheel_variances(
    event: TelemetryBalance, parameters: Mapping[str, Array], squares: WheelSquares, shares: Array
) -> Array:
    """Variance (n, …, W) of wheel rates by the mean squares of their noise, rad²/s².

    ``shares`` (n, H) are those of :func:`lasting_shares`.
    """
    rounding = event.statistics.steps.wheel_rad_s**2 / 12.0
    repeated = np.tensordot(rounding * shares, squares.lasting, 1)
    return _white_variances(event, parameters, squares, shares) + repeated


def _white_variances(
    event: TelemetryBalance, parameters: Mapping[str, Array], squares: WheelSquares, shares: Array
) -> Array:
    """Variance (n, …, W) of wheel rates but for roundings that last or repeat, rad²/s²."""
    noise = np.maximum(parameters["wheel_noise_rpm"], LEAST_WHEEL_RPM) * RAD_S_PER_RPM
    rounding = event.statistics.steps.wheel_rad_s**2 / 12.0
    rounding = rounding * (1.0 - shares.sum(axis=1))
    of_row = (noise**2 + rounding) / event.statistics.counters.averaged
    return np.asarray(np.multiply.outer(of_row, squares.moving) + squares.seen)


def lasting_shares(event: TelemetryBalance, parameters: Mapping[str, Array]) -> Array:
    """Shares (n, H) of the rounding of wheel rates that last or repeat; none without steps."""
    step, noise = event.statistics.steps.wheel_rad_s, parameters["wheel_noise_rpm"]
    if step == 0.0:
        return np.zeros((len(noise), HARMONICS))
    return coherent_shares(noise * RAD_S_PER_RPM / step)


def covariance_beside_wheels(
    event: TelemetryBalance, physics: Physics, variances: ChannelVariances
) -> Array:
    """Covariance (n, 3, 3) of what rates and attitudes put into a row, (N m s)²."""
    by_rate = physics.momentum_per_rate
    rate, attitude = variances.rate[:, None, None], variances.attitude[:, None, None]
    return np.asarray(rate * by_rate @ np.swapaxes(by_rate, -1, -2) + attitude * event.spin)


def band_covariances(
    event: TelemetryBalance, physics: Physics, variances: ChannelVariances, left_open: Array
) -> Array:
    """Covariance (n, S + F, 3, 3) in every band but for wheels and torque noise, (N m s)².

    What counters leave open is slower than the rows: ``left_open`` (:class:`OpenCounters`) differs
    by band.
    """
    white = covariance_beside_wheels(event, physics, variances)
    return np.ascontiguousarray(white[:, None] + left_open)


@dataclass(frozen=True)
class TurnNoise:
    """What turns of quiet pieces say once the rows are known, by band (n, T, 3, 3).

    ``gain`` is Q = D A⁻¹, of the covariance D of what rates and turns see alike and that A of the
    gyro's own noise; ``covariance``, (N m s²)², is that of the balance of the turns with Q times
    the momentum by which turns and gyro differ (:func:`turn_weights`).
    """

    gain: Array
    covariance: Array


def turn_noise(
    event: TelemetryBalance,
    physics: Physics,
    variances: ChannelVariances,
    left_open: Array,
    torque_s3: Sequence[float],
) -> TurnNoise:
    """Noise of the turns of quiet pieces, given the rows.

    A contrast of the integrated rows has the noise a + d, of the gyro and of all that is shared;
    that of the turns θ + d. Given the former, the latter is θ + d − A-weighted guess of d: its
    balance plus Q times turn less gyro has the covariance

        (1 + Q) I Σ_θ Iᵀ (1 + Q)ᵀ + D + Q D,      Q = D A⁻¹

    (docs/topics/telemetry-likelihood.md §5). ``left_open`` is that of :class:`OpenCounters`, and
    ``torque_s3`` (T,) what of a unit random walk is in the noise of every band
    (:class:`.TurnBand`).
    """
    gain, covariance = gain_and_covariance(
        np.ascontiguousarray(physics.momentum_per_rate),
        np.ascontiguousarray(physics.inertia_kg_m2),
        np.ascontiguousarray(event.wheel_weights(physics)),
        variances.turns,
        of_bands(left_open, len(event.turns)),
        event.turn_sums,
        np.asarray(torque_s3, dtype=np.float64),
    )
    return TurnNoise(gain, covariance)


def of_bands(left_open: Array, count: int) -> Array:
    """What is left open of so many bands (n, B, 3, 3) for compiled code; one may stand for all."""
    return np.ascontiguousarray(np.broadcast_to(left_open, (len(left_open), count, 3, 3)))


def late_covariance(event: TelemetryBalance, physics: Physics) -> Array:
    """Covariance (n, 3, 3) of what is late in rows, (N m s)²: of means over blocks of rows.

    The variance of pulses at any time (:mod:`cassini_bayes.balance.statistics.late`), by couple,
    times a factor that is inferred.
    """
    if event.late is None:
        return np.zeros((len(physics.inertia_kg_m2), 3, 3))
    variances = late_variances(event, physics)[:, None]
    return summed_over_couples(couple_torques(event, physics), variances)[:, 0]


def late_variances(event: TelemetryBalance, physics: Physics) -> Array:
    """Variance (n, G), s², of what is late in rows, by couple: none where nothing is."""
    n = len(physics.inertia_kg_m2)
    if event.late is None:
        return np.zeros((n, len(event.statistics.layout.couples)))
    rise, fall = (np.broadcast_to(tau, (n,)) for tau in physics.tau_s[1:])
    factor = np.broadcast_to(physics.late_factor, (n,)) / event.statistics.counters.averaged
    late_s2 = event.late.variance_s2(rise, fall, mean_offset(physics, n))
    return np.asarray(factor[:, None] * late_s2)


def open_counters(
    event: TelemetryBalance, physics: Physics, scales: OpenScales | None = None
) -> OpenCounters:
    """Covariances of tails and on-times that counters leave open, and of late pulses, at n points.

    What is late does not last: it is the same in all bands of rows. ``scales`` are those of
    :func:`open_scales`, where they are known.
    """
    own, of_rows = event.left_open, len(event.slow) + len(event.fast)
    result = np.zeros((len(physics.inertia_kg_m2), len(own.pairs), 3, 3))
    if event.fires and own:
        scales = scales or open_scales(event, physics)
        square = scales.variance_s2(own.pairs, own.columns)
        result = summed_over_couples(np.ascontiguousarray(scales.torque_n_m), square)
    late = late_covariance(event, physics)[:, None]
    return OpenCounters(result[:, :of_rows] + late, result[:, of_rows:])


def open_scales(event: TelemetryBalance, physics: Physics) -> OpenScales:
    """Torques of couples, what pairs scatter, and weights of pulse columns.

    Torques are those of the event's own thrusts: a factor on what the prior expects is in them.
    Where rows have late pulses, what pairs scatter has the factor that is inferred of what is late:
    of thrusters that fire all the time pairs are no independent draws. Elsewhere it has a factor of
    its own, as a controller's pairs may be more alike than the gaps of single pulses let expect.
    What coarse counters leave open has one, too.
    """
    n = len(physics.inertia_kg_m2)
    if not event.fires:
        nothing = LostTails(np.zeros(n), np.zeros(n))
        return OpenScales(np.zeros((n, 3, 0)), nothing, np.zeros((n, len(PULSE_COLUMNS))))
    counters, offset = event.statistics.counters, mean_offset(physics, n)
    cut = np.broadcast_to(event.sampling.cut_tail_s(physics.tau_s, offset), (n,))
    fall, share = np.broadcast_to(physics.tau_s[2], (n,)), close_share(physics, n)
    pulse = event.sampling.pulses.of_thrusters(physics.tau_s, offset[:, None])[:, 0]
    if counters.are_coarse:
        pulse = pulse * np.sqrt(np.reshape(physics.open_factor, (-1, 1)))
    lost = lost_tails(counters.gaps_s, event.sampling.control_cycle_s, cut, fall, share, offset)
    if event.late is not None:
        lost = lost._replace(variance_s2=physics.late_factor * lost.variance_s2)
    else:
        lost = lost._replace(variance_s2=physics.pair_factor * lost.variance_s2)
    return OpenScales(
        couple_torques(event, physics), lost, np.broadcast_to(pulse, (n, pulse.shape[-1]))
    )


def mean_offset(physics: Physics, n: int) -> Array:
    """By how much pulses last longer (n,), s, on average of thrusters: for the size of noises."""
    of_all = np.broadcast_to(physics.impulse_offset_s, (n, physics.arms_m.shape[-1]))
    return np.asarray(of_all.mean(axis=1))


def mean_pulse_s(event: TelemetryBalance, physics: Physics) -> Array:
    """Mean effective time (n,), s, of the event's pulses at n points."""
    n = len(physics.inertia_kg_m2)
    found = event.sampling.mean_pulse_s(physics.tau_s, mean_offset(physics, n))
    return np.broadcast_to(found, (n,))


def own_thrusts_n(event: TelemetryBalance, physics: Physics) -> Array:
    """The event's own thrusts (n, K), N, at n points: by what its pulses deliver there.

    Telemetry tells momentum, F g with g the effective time of pulses: at time constants for which
    they deliver half as much the same telemetry tells twice the thrust.
    """
    least_s = LEAST_PULSE * event.told_by_s  # of pulses of which next to nothing would be left
    more = event.told_by_s / np.maximum(mean_pulse_s(event, physics), least_s)
    return np.asarray(more[:, None] * event.thrusts_n)


def couple_torques(event: TelemetryBalance, physics: Physics) -> Array:
    """Torques (n, 3, G) of all couples, N m, by the event's own thrusts."""
    shape = (len(physics.inertia_kg_m2), 3, event.pattern.thrusters)
    each = np.broadcast_to(physics.arms_m, shape) * own_thrusts_n(event, physics)[:, None]
    together = [each[..., list(own)].sum(-1) for own in event.statistics.layout.couples]
    return np.stack(together, axis=-1)


def close_share(physics: Physics, n: int) -> Array:
    """Share (n,) of close pulses, which widened priors may take out of its bounds."""
    return np.asarray(np.clip(np.broadcast_to(physics.close_share, (n,)), 0.0, 1.0))
