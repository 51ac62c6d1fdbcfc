"""Expected information of a telemetry event on all unknowns, from its Gram matrices alone.

The balance is linearised about one point: a parameter's effect on every row is a combination of the
same columns that the likelihood has. Noise levels act on the scatter of the rows, not on their
mean, and have no place here.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cassini_bayes.balance.bands import Band
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.telemetry_terms import (
    TelemetryBalance,
    balance_weights,
    noise_covariance,
)
from cassini_bayes.balance.totals_terms import RAD_S_PER_RPM
from cassini_bayes.computing.arrays import Array


def row_information(
    event: TelemetryBalance,
    physics: Physics,
    parameters: Mapping[str, Array],
    kept: Array,
    *,
    mean: Array,
    own_sd: Array,
    levels: Array,
    step: float,
) -> Array:
    """Information of the rows on standardised unknowns: walked, thrusts', the event's own.

    Parameters
    ----------
    physics, parameters
        At 1 + 2 d points: the centre, then one step up and one down along each of d coordinates.
    kept
        (1 + F, W, W) of every band at the centre, the slow one first.
    mean
        (P,) values of the unknowns at the centre.
    own_sd
        (U,) prior sd of the event's own unknowns.
    levels
        (K, r) thrusts per standardised coordinate.
    step
        Size of the steps.
    """
    nominal = {name: values[:1] for name, values in parameters.items()}
    total: Array | float = 0.0
    bands = zip((event.slow, *event.fast), (None, *event.reduced.grams), kept, strict=True)
    for band, gram, estimate in bands:
        weights = balance_weights(event, physics, _scale(event, mean), estimate[None])
        columns = _columns(event, weights, mean, own_sd, levels, step)
        noise = noise_covariance(event, physics, parameters, estimate[None])[0]
        total = total + _whitened(event, band, gram, columns, noise, nominal)
    return np.asarray(total)


def _scale(event: TelemetryBalance, mean: Array) -> float:
    """Thrust that scales the cut tails."""
    return float(mean[0]) if event.fires else 0.0


def _columns(
    event: TelemetryBalance,
    weights: Array,
    mean: Array,
    own_sd: Array,
    levels: Array,
    step: float,
) -> Array:
    """Coefficients (unknown, 3, A) of the derivative of the residual in standardised unknowns.

    weights (1 + 2d, B, 3).
    """
    pattern, reduced, places = event.pattern, event.reduced, event.unknowns
    owner = np.repeat(np.arange(len(pattern.start) - 1), np.diff(pattern.start))
    by_owner = np.zeros((len(weights), places.measured + 1, 3, reduced.slow.shape[1]))
    for b, column in zip(reduced.entries, reduced.row, strict=True):
        by_owner[:, owner[b], :, column] += weights[:, b]
    residual = np.einsum("nuca,u->nca", by_owner, np.append(-mean, 1.0))
    d = (len(weights) - 1) // 2
    walked = (residual[1 : d + 1] - residual[d + 1 :]) / (2.0 * step)
    own = -by_owner[0, places.own] * own_sd[:, None, None]
    if not event.fires:
        return np.concatenate([walked, own])
    thrust = np.einsum("kca,kq->qca", -by_owner[0, places.thrusts], levels)
    return np.concatenate([walked, thrust, own])


def _whitened(
    event: TelemetryBalance,
    band: Band,
    gram: Array | None,
    columns: Array,
    noise: Array,
    nominal: Mapping[str, Array],
) -> Array:
    """Inner products of the derivatives over one band's rows, white and torque noise whitened."""
    values, vectors = np.linalg.eigh(noise)
    count, size = len(columns), event.reduced.slow.shape[1]
    variance = values[:, None] + nominal["torque_noise_n_m_s05"][0] ** 2 * band.walk  # (3, R)
    modes = event.reduced.slow.reshape(3 * size, -1)
    quiet = _channel_noise(event, band, nominal)
    result = np.zeros((count, count))
    for own, axis in zip(variance, vectors.T, strict=True):
        along = (axis[:, None] * columns).reshape(count, -1)
        if gram is None:
            on_modes = along @ modes
            result += (on_modes / own) @ on_modes.T
        else:
            flat = gram.transpose(0, 2, 1, 3).reshape(3 * size, 3 * size)
            result += along @ flat @ along.T / own.mean()
        scalar = np.einsum("a,uac->uc", axis, columns)
        result -= (scalar * quiet) @ scalar.T / own.mean()
    return result


def _channel_noise(event: TelemetryBalance, band: Band, nominal: Mapping[str, Array]) -> Array:
    """Square (A,) that the channels' own noise adds to each scalar column over a band's rows.

    Noise that drives a regressor tells nothing; the likelihood's Jacobian sees to the same.
    """
    layout = event.statistics.layout
    used = event.reduced.columns
    square = np.zeros(len(used))
    square[(used >= layout.rate.start) & (used < layout.rate.stop)] = (
        nominal["rate_noise_rad_s"][0] ** 2
    )
    square[(used >= layout.wheel.start) & (used < layout.wheel.stop)] = (
        nominal["wheel_noise_rpm"][0] * RAD_S_PER_RPM
    ) ** 2
    return band.rows * square
