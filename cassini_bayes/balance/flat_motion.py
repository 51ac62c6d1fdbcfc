"""Measure in which the true motion is flat, in bands where nothing is known of it.

In the slow band of a bias, in all bands of a slew and in the turns of quiet pieces, the true motion
has a flat distribution. Flat in which coordinates is a choice. Flat wheel rates give the density of
the channels a factor |det I| per row, flat body rates give it |det T I_w|. At the true parameters,
the slope of the log likelihood in log I is zero on average for neither: the first draws the inertia
upwards, the second downwards. The factor for which it is zero is the root of the determinant of the
balance's own noise, at noise levels that stay fixed. It is taken at a body of nominal size and
grows with |det I|, so that the common scale of inertia, wheels and thrusts is not drawn either
(docs/topics/telemetry-likelihood.md §3).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.telemetry_balance import TelemetryBalance
from cassini_bayes.balance.telemetry_noise import (
    TurnNoise,
    band_covariances,
    band_wheel_variances,
    open_counters,
    turn_noise,
)
from cassini_bayes.computing.arrays import Array


def log_measure(
    event: TelemetryBalance,
    physics: Physics,
    parameters: Mapping[str, Array],
    by_turn: TurnNoise,
) -> Array:
    """Log determinants (n,) that take the density of the balance to that of the channels.

    With V the covariance of the balance of a row and Σ̃_θ that of the turns, both at the event's
    reference noise, and with what counters leave open at the nominal physics; I the momentum per
    measured rate; Q the gain of the turns and Q₀ that at the reference noise,

        (N − R) log |det I| + ½ Σ_R log det V + Σ_θ [log |det (1 + Q)(1 + Q₀)⁻¹| + ½ log det Σ̃_θ],

    R the rows of bands in which wheels move by any amount. The initial momentum takes up a constant
    of the slow band: its body rate is flat, too. All this is at body and wheels of nominal size,
    with the determinant of the prior means; log |det I| grows by its difference, for each rate but
    one and each turn. The unit is that of :func:`in_channel_units`.

    Parameters
    ----------
    physics
        The physics at n points.
    parameters
        Noise levels, name → (n,) array, of which those of the reference are replaced.
    by_turn
        The turns' noise at the noise levels of the points. (Its torque noise lacks the slowest
        cosines, which the likelihood has as unknowns; that of the measure is whole.)
    """
    reference = _at_reference(event, parameters, len(physics.inertia_kg_m2))
    growth = _log_size(event, physics) - event.log_size
    physics = _of_size(physics, np.exp(-growth / 3.0))
    result = _of_rows(event, physics, reference) + _count(event) * growth - event.log_unit
    if event.turns:
        walked = [band.walked_s3 for band in event.turns]
        noise = turn_noise(event, physics, reference, event.nominally_open.turns, walked)
        more = _log_det(np.eye(3) + by_turn.gain) - _log_det(np.eye(3) + noise.gain)
        contrasts = np.array([band.contrasts for band in event.turns], dtype=np.float64)
        result = result + (more + 0.5 * _log_det(noise.covariance)) @ contrasts
    return result


def in_channel_units(
    event: TelemetryBalance, physics: Physics, parameters: Mapping[str, Array]
) -> TelemetryBalance:
    """The same event with a measure that is |det I| per rate and turn at one point (n = 1).

    So log densities are those of the channels, in their units. What counters leave open is taken
    at that point, too: it is noise, not motion.
    """
    event = replace(
        event,
        log_unit=0.0,
        log_size=float(_log_size(event, physics)[0]),
        nominally_open=open_counters(event, physics),
    )
    nothing = np.zeros((1, len(event.turns), 3, 3))
    flat = log_measure(event, physics, parameters, TurnNoise(nothing, nothing))
    unit = flat - _count(event) * _log_det(physics.momentum_per_rate)
    return replace(event, log_unit=float(unit[0]))


def _count(event: TelemetryBalance) -> int:
    """Rates and turns whose motion has a density: all rows but one, and contrasts of turns."""
    return event.statistics.rows - 1 + sum(band.contrasts for band in event.turns)


def _log_size(event: TelemetryBalance, physics: Physics) -> Array:
    """Log (n,) of the size that the measure grows with, as the cube of a common scale.

    That of the body; where pulses are late in rows, that of the wheels. There thrusters answer what
    is late, so that the slope in log I of the quadratic form is that of the gyro's noise alone. And
    rows tell the ratio of body and wheels so badly that it matters with which of them J grows.
    """
    if event.late is None:
        return _log_det(physics.inertia_kg_m2)
    inertias = np.linalg.norm(event.wheel_weights(physics), axis=-2)
    return np.asarray(3.0 * np.log(inertias).mean(axis=-1))


def _of_size(physics: Physics, factor: Array) -> Physics:
    """The physics with the inertia of body and wheels times a factor (n,)."""
    return replace(
        physics,
        inertia_kg_m2=factor[:, None, None] * physics.inertia_kg_m2,
        wheel_inertia_kg_m2=factor[:, None] * physics.wheel_inertia_kg_m2,
    )


def _at_reference(
    event: TelemetryBalance, parameters: Mapping[str, Array], n: int
) -> dict[str, Array]:
    """Parameters (n,) with the event's reference noise."""
    fixed = {name: np.full(n, value) for name, value in event.sampling.reference_noise}
    return {**parameters, **fixed}


def _of_rows(event: TelemetryBalance, physics: Physics, reference: Mapping[str, Array]) -> Array:
    """The part of the rows."""
    by_torque = reference["torque_noise_n_m_s05"][:, None, None] ** 2
    wheels = event.wheel_weights(physics)[:, None]
    variance = band_wheel_variances(event, reference)[:, :, None]
    white = band_covariances(event, physics, reference, event.nominally_open.rows)
    noise = white + (wheels * variance) @ np.swapaxes(wheels, -1, -2)
    bands = len(event.slow)
    modes = np.array([band.rows for band in event.slow])
    values = np.repeat(np.linalg.eigvalsh(noise[:, :bands]), modes, axis=1)
    walk = np.concatenate([band.walk for band in event.slow])
    slow = np.swapaxes(values, 1, 2) + by_torque * walk
    result = np.log(slow).sum((1, 2)) + np.log((event.constant**2 / slow).sum(-1)).sum(-1)
    others = event.statistics.rows - modes.sum()
    for band, own in zip(event.fast, np.moveaxis(noise[:, bands:], 1, 0), strict=True):
        if band.motion is None:
            result = result + band.rows * _log_det(own + band.walk.mean() * by_torque * np.eye(3))
            others -= band.rows
    return np.asarray(0.5 * result + others * _log_det(physics.momentum_per_rate))


def _log_det(matrices: Array) -> Array:
    """Log of |determinant| of matrices (…, 3, 3), written out: a call for each costs more."""
    a, b, c = (matrices[..., row, :] for row in range(3))
    result = sum(
        a[..., i] * (b[..., i - 2] * c[..., i - 1] - b[..., i - 1] * c[..., i - 2])
        for i in range(3)
    )
    return np.asarray(np.log(np.abs(result)))
