"""Measure in which the true motion is flat, in bands where nothing is known of it.

In the slow band of a bias, in all bands of a slew and in the turns of quiet pieces, the true motion
has a flat distribution. Flat in which coordinates is a choice. Flat wheel rates give the density of
the channels a factor |det I| per row, flat body rates give it |det T I_w|. At the true parameters,
the slope of the log likelihood in log I is zero on average for neither: the first draws the inertia
upwards, the second downwards. The factor for which it is zero is the root of the determinant of the
balance's own noise, at noise levels that stay fixed. It is taken at a body of nominal size and
grows with |det I|, so that the common scale of inertia, wheels and thrusts is not drawn either
(docs/topics/telemetry-likelihood.md §3). Where rows have late pulses, thrusters answer what is
late: there the measure grows with what they deliver, by the share of that noise, less what of it
the body itself has at the same time (§4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.kernel import log_determinants, log_of_flat_rows, log_of_turns
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.statistics.channel_noise import ChannelNoise
from cassini_bayes.balance.statistics.late import body_share
from cassini_bayes.balance.telemetry_balance import (
    NOTHING_OPEN,
    Answered,
    ChannelVariances,
    TelemetryBalance,
)
from cassini_bayes.balance.telemetry_noise import (
    TurnNoise,
    band_covariances,
    channel_variances,
    couple_torques,
    covariance_beside_wheels,
    late_variances,
    of_bands,
    open_counters,
    turn_noise,
)
from cassini_bayes.computing.arrays import Array

LEAST_SHARE: Final = 0.01  # of the variance of what is late about an axis, for a couple to count
LEAST_VARIANCE: Final = 1e-30  # (N m s)²: none at all
LEAST_PUSH: Final = 0.05  # of what thrusters deliver at the nominal point: has a logarithm


def log_measure(
    event: TelemetryBalance,
    physics: Physics,
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
    one and each turn. Where rows have late pulses body and wheels have their own size, the body
    also grows by its rows of :class:`.Answered`, and the thrusts' part is that of
    :func:`pushed_information`. The unit is that of :func:`in_channel_units`.

    Parameters
    ----------
    physics
        The physics at n points.
    by_turn
        The turns' noise at the noise levels of the points. (Its torque noise lacks the slowest
        cosines, which the likelihood has as unknowns; that of the measure is whole.)
    """
    growth = _body_growth(event, physics)
    physics = _of_size(physics, np.exp(-growth / 3.0))
    result = _of_rows(event, physics) + _count(event) * growth - event.log_unit
    if event.answered is not None:
        grown = _log_per_rate(physics) - event.answered.log_per_rate
        result = result + grown @ event.answered.body_rows
    if event.turns:
        walked = [band.walked_s3 for band in event.turns]
        left_open = event.nominally_open.turns
        noise = turn_noise(event, physics, _reference(event), left_open, walked)
        result += log_of_turns(by_turn.gain, noise.gain, noise.covariance, event.contrasts)
    return result


def with_likely_noise(event: TelemetryBalance, parameters: Mapping[str, Array]) -> TelemetryBalance:
    """The same event with the noise of rates at one point (n = 1) for reference, if not seen.

    Where thrusters fire all the time no differences of rows show it, and all is in how much of a
    row's noise it is.
    """
    if event.statistics.noise.rate_rad_s > 0.0:
        return event
    likely = ChannelNoise(rate_rad_s=float(parameters["rate_noise_rad_s"][0]))
    return replace(event, sampling=likely.seen_by(event.sampling))


def in_channel_units(
    event: TelemetryBalance, physics: Physics, parameters: Mapping[str, Array]
) -> TelemetryBalance:
    """The same event with a measure that is |det I| per rate and turn at one point (n = 1).

    So log densities are those of the channels, in their units. What counters leave open is taken
    at that point, too: it is noise, not motion.
    """
    event = replace(
        event,
        answered=None,
        log_unit=0.0,
        log_size=float(_log_det(physics.inertia_kg_m2)[0]),
        nominally_open=open_counters(event, physics),
        reference=channel_variances(event, _at_reference(event, parameters)),
    )
    nothing = np.zeros((1, len(event.turns), 3, 3))
    flat = log_measure(event, physics, TurnNoise(nothing, nothing))
    unit = flat - _count(event) * _log_det(physics.momentum_per_rate)
    return replace(event, log_unit=float(unit[0]))


def in_thrust_units(
    event: TelemetryBalance, physics: Physics, delivered: Array
) -> TelemetryBalance:
    """The same event with what thrusters answer, which is 1 at its thrusts and one point (n = 1).

    ``delivered`` is that of :func:`pushed_information`. Weights of couples are their shares of the
    variance of what is late about an axis. A couple that next to none of it is of has none: its
    torque may be zero. Nor has an axis that is not pushed.
    """
    torque, late = couple_torques(event, physics)[0], late_variances(event, physics)[0]
    variance = torque**2 * late
    share = variance / np.maximum(variance.sum(axis=1, keepdims=True), LEAST_VARIANCE)
    share = np.where(share > LEAST_SHARE, share, 0.0)
    is_pushed = share.any(axis=1)
    share[is_pushed] /= share[is_pushed].sum(axis=1, keepdims=True)
    weights = np.zeros((3, event.pattern.thrusters))
    for couple, members in enumerate(map(np.array, event.statistics.layout.couples)):
        seen = np.flatnonzero(share[:, couple])
        whole = delivered[0][:, members] @ event.thrusts_n[members]
        weights[np.ix_(seen, members)] = (share[seen, couple] / whole[seen])[:, None]
    of_body = _body_share(event, physics) * variance.sum(axis=1)
    answered_rows = _answered_rows(event, physics, of_body)
    rows, of_body = np.where(is_pushed, answered_rows, 0.0)
    answered = Answered(rows - of_body, weights, of_body, _log_per_rate(physics)[0])
    return replace(event, answered=answered)


def pushed_information(
    event: TelemetryBalance, delivered: Array, common_n: Array
) -> tuple[Array, Array, Array]:
    """What the measure says of the thrusts where thrusters answer the noise.

    With m_c the rows about axis c whose noise they answer, and S_c the mean over couples of what
    they deliver, in that of the event's thrusts F₀ at the nominal point (:class:`.Answered`),

        S_c(F) = Σ_k w_ck d_ck t_k F_k,      Σ_c m_c log S_c(F) ≈ Σ_c m_c (log S₀ + x − ½ x²),

    with S₀ = S_c(F₀) and x = S_c(F)/S₀ − 1: F₀ is good to a fifth, and so it is quadratic in the
    thrusts (docs/topics/telemetry-likelihood.md §4).

    Parameters
    ----------
    delivered
        (n, 3, K) of d_ck t_k, m s: lever arm times effective on-time, N m s per N.
    common_n
        (n,) the level about which thrusts are counted.

    Returns
    -------
    Matrix (n, K, K), vector (n, K) and constant (n,), as of :class:`.ThrustInformation`.
    """
    assert event.answered is not None  # in_thrust_units has it
    rows, weights = event.answered.rows, event.answered.weights
    of_each = weights * delivered
    whole = np.maximum(of_each @ event.thrusts_n, LEAST_PUSH)
    along = of_each / whole[..., None]
    shift = np.einsum("nck,nk->nc", along, common_n[:, None] - event.thrusts_n)
    matrix = np.einsum("c,nck,ncl->nkl", rows, along, along)
    vector = np.einsum("nc,nck->nk", rows * (1.0 - shift), along)
    return matrix, vector, (np.log(whole) + shift - 0.5 * shift**2) @ rows


def _count(event: TelemetryBalance) -> int:
    """Rates and turns whose motion has a density: all rows but one, and contrasts of turns."""
    return event.statistics.rows - 1 + sum(band.contrasts for band in event.turns)


def _body_growth(event: TelemetryBalance, physics: Physics) -> Array:
    """Log (n,) of |det I| over that at the prior means; 0 where thrusters answer what is late."""
    if event.late is not None:
        return np.zeros(len(physics.inertia_kg_m2))
    return _log_det(physics.inertia_kg_m2) - event.log_size


def _of_size(physics: Physics, factor: Array) -> Physics:
    """The physics with the inertia of body and wheels times a factor (n,)."""
    return replace(
        physics,
        inertia_kg_m2=factor[:, None, None] * physics.inertia_kg_m2,
        wheel_inertia_kg_m2=factor[:, None] * physics.wheel_inertia_kg_m2,
    )


def _at_reference(event: TelemetryBalance, parameters: Mapping[str, Array]) -> dict[str, Array]:
    """Parameters (n,) with the event's reference noise (1,), the same at all points."""
    fixed = {name: np.array([value]) for name, value in event.sampling.reference_noise}
    return {**parameters, **fixed}


def _reference(event: TelemetryBalance) -> ChannelVariances:
    assert event.reference is not None  # in_channel_units has it
    return event.reference


def _answered_rows(event: TelemetryBalance, physics: Physics, of_body: Array) -> Array:
    """Rows (2, 3) about every axis: of noise that is not the channels', and of it the body's.

    The former is what is late and the torque, the latter has the variance ``of_body`` (3,). Counted
    at one point (n = 1), where the event's slow motion is flat, but for the constant.
    """
    of_channels, whole = (
        np.diagonal(_band_noise(event, physics, left_open)[0], axis1=-2, axis2=-1)
        for left_open in (NOTHING_OPEN.rows, event.nominally_open.rows)
    )
    by_torque = _reference(event).turns.torque
    bands = len(event.slow)
    modes = np.repeat(np.arange(bands), [band.rows for band in event.slow])
    noise = whole[modes] + np.outer(event.flat_rows.walk, by_torque)
    moves = 1.0 - event.constant**2
    result = np.stack([moves @ (1.0 - of_channels[modes] / noise), moves @ (of_body / noise)])
    for place, band in enumerate(event.fast, bands):
        if band.motion is None:
            noise = whole[place] + band.walk.mean() * by_torque
            shares = np.stack([1.0 - of_channels[place] / noise, of_body / noise])
            result = result + band.rows * shares
    return result


def _body_share(event: TelemetryBalance, physics: Physics) -> float:
    """What of the noise that is late the body itself has, at one point (n = 1)."""
    counters = event.statistics.counters
    delay, rise, fall = (float(np.mean(tau)) for tau in physics.tau_s)
    return body_share(
        event.sampling.pulse_shape,
        (delay, rise, fall),
        counters.late_width_s,
        counters.late_first_s,
        counters.late_every_s,
    )


def _log_per_rate(physics: Physics) -> Array:
    """Log of the momentum per measured rate (n, 3) about the axis of the rate."""
    return np.log(np.abs(np.diagonal(physics.momentum_per_rate, axis1=-2, axis2=-1)))


def _band_noise(event: TelemetryBalance, physics: Physics, left_open: Array) -> Array:
    """Covariance (n, S + F, 3, 3) of every band but for torque noise, (N m s)²."""
    wheels = event.wheel_weights(physics)[:, None]
    variance = _reference(event).wheels[:, :, None]
    white = band_covariances(event, physics, _reference(event), left_open)
    return np.asarray(white + (wheels * variance) @ np.swapaxes(wheels, -1, -2))


def _of_rows(event: TelemetryBalance, physics: Physics) -> Array:
    """The part of the rows."""
    flat, left_open, variances = event.flat_rows, event.nominally_open.rows, _reference(event)
    result = log_of_flat_rows(
        covariance_beside_wheels(event, physics, variances),
        of_bands(left_open, len(event.slow) + len(event.fast)),
        np.ascontiguousarray(event.wheel_weights(physics)),
        variances.wheels,
        variances.turns.torque,
        flat,
    )
    others = event.statistics.rows - flat.first[-1] - flat.rows.sum()
    return np.asarray(0.5 * result + others * _log_det(physics.momentum_per_rate))


def _log_det(matrices: Array) -> Array:
    """Log of |determinant| (n,) of matrices (n, 3, 3)."""
    return log_determinants(np.ascontiguousarray(matrices))
