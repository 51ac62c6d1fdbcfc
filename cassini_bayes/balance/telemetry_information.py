"""Expected information of a telemetry event on all unknowns, from its Gram matrices alone.

The balance is linearised about one point: a parameter's effect on every row is a combination of the
same columns that the likelihood has. Noise levels act on the scatter of the rows, not on their
mean, and have no place here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.bands import Band, TurnBand
from cassini_bayes.balance.kernel import without_first
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.telemetry_balance import ColumnProducts, TelemetryBalance
from cassini_bayes.balance.telemetry_noise import (
    band_covariances,
    channel_variances,
    open_counters,
    turn_noise,
    wheel_covariance,
    wheel_variance,
)
from cassini_bayes.balance.telemetry_weights import balance_weights, turn_weights, walk_weights
from cassini_bayes.computing.arrays import Array

LEAST_SEEN: Final = 30  # rows or contrasts: their noise is then told to some 10 %


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

    Symmetric, and in no direction negative.

    Parameters
    ----------
    physics, parameters
        At 1 + 2 d points: the centre, then one step up and one down along each of d coordinates.
    kept
        (F, W, W) of every fast band at the centre.
    mean
        (P,) values of the unknowns at the centre.
    own_sd
        (U,) prior sd of the event's own unknowns.
    levels
        (K, r) thrusts per standardised coordinate.
    step
        Size of the steps.
    """
    products = event.products.of(event.reduced.columns)
    parameters = {**parameters, **_noise_seen(event, products, parameters)}
    nominal = {name: values[:1] for name, values in parameters.items()}
    total: Array | float = 0.0
    left_open, of_channels = open_counters(event, physics), channel_variances(event, parameters)
    with_open = band_covariances(event, physics, of_channels, left_open.rows)[0]
    walk = _walk_columns(event, nominal)
    weights = balance_weights(event, physics)
    columns = np.r_[walk, _columns(event, weights, mean, own_sd, levels, step)]
    modes = np.split(products.slow, np.cumsum([band.rows for band in event.slow[:-1]]), axis=2)
    of_wheels = wheel_covariance(event, physics, parameters)[0]
    for band, own, noise in zip(event.slow, modes, with_open, strict=False):
        square = partial(_of_modes, own)
        total = total + _whitened(event, band, columns, noise + of_wheels, nominal, square)
    bands = zip(event.fast, products.grams, kept, with_open[len(event.slow) :], strict=True)
    for band, gram, estimate, noise in bands:
        own = balance_weights(event, physics, estimate[None])
        columns = np.r_[np.zeros_like(walk), _columns(event, own, mean, own_sd, levels, step)]
        noise = noise + wheel_covariance(event, physics, parameters, estimate[None])[0]
        square = partial(_of_gram, gram)
        total = total + _whitened(event, band, columns, noise, nominal, square)
    faster = [band.faster_s3 for band in event.turns]
    by_turn = turn_noise(event, physics, of_channels, left_open.turns, faster)
    # how much of both is weighed against each other is no effect of a parameter
    gain = np.repeat(by_turn.gain[:1], len(weights), axis=0)
    turned = np.repeat(weights[:, None], gain.shape[1], axis=1)
    turned[:, :, event.pattern.turned] = turn_weights(event, physics, weights, gain)
    bands_of_turns = zip(event.turns, products.turns, by_turn.covariance[0], strict=True)
    for place, (turn, gram, noise) in enumerate(bands_of_turns):
        own = _columns(event, turned[:, place], mean, own_sd, levels, step)
        columns = np.r_[walk, own]
        total = total + _of_turns(event, turn, gram, columns, noise, nominal)
    (total,), _ = without_first(np.asarray(total)[None], len(walk), np.zeros(1))
    # noise that happens to be less than it is taken for leaves less than nothing of a regressor
    values, vectors = np.linalg.eigh(total)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _walk_columns(event: TelemetryBalance, nominal: Mapping[str, Array]) -> Array:
    """Coefficients (3 D, 3, A') of the slowest cosines of torque noise, standard normals."""
    weights = walk_weights(event, nominal)[0]
    columns = np.zeros((*weights.shape, len(event.reduced.columns)))
    columns[np.arange(len(weights)), :, event.reduced.walk] = weights
    return columns


def _noise_seen(
    event: TelemetryBalance, products: ColumnProducts, parameters: Mapping[str, Array]
) -> dict[str, Array]:
    """Noise of rates and attitudes that is no more than what the fastest rows and turns show.

    That is the fastest band with :data:`LEAST_SEEN` rows or contrasts, the fullest without one.
    Prior means of noise levels are good to a factor only, and what a channel's noise is taken for
    must not exceed all that there is in it.
    """
    layout = event.statistics.layout
    rows, contrasts = [band.rows for band in event.fast], [band.contrasts for band in event.turns]
    seen = {}
    for name, columns, grams, counts in (
        ("rate_noise_rad_s", layout.rate, products.grams, rows),
        ("attitude_noise_rad", layout.turn, products.turns, contrasts),
    ):
        if len(grams) > 0:
            own = _are(event, columns)
            full = np.flatnonzero(np.array(counts) >= LEAST_SEEN)
            last = full[-1] if len(full) > 0 else int(np.argmax(counts))
            largest = np.sqrt(np.diagonal(grams[last][0, 0])[own].mean() / counts[last])
            seen[name] = np.minimum(parameters[name], largest)
    return seen


def _of_turns(
    event: TelemetryBalance,
    band: TurnBand,
    gram: Array,
    columns: Array,
    noise: Array,
    nominal: Mapping[str, Array],
) -> Array:
    """Inner products of the derivatives over one band of turns, its noise whitened."""
    values, vectors = np.linalg.eigh(noise)
    # the root on both sides: on one alone, what is known of two unknowns would have an order
    whitened = np.einsum("dc,ec,uea->uda", vectors / np.sqrt(values), vectors, columns)
    crossed = np.einsum("ucb,cdba->uda", whitened, gram).reshape(len(columns), -1)
    quiet = _channel_square(event, nominal, band.summed_s2)
    own = np.einsum("uca,a,vca->uv", whitened, band.contrasts * quiet, whitened)
    return np.asarray(crossed @ whitened.reshape(len(columns), -1).T - own)


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
    owner = pattern.owner
    by_owner = np.zeros((len(weights), places.measured + 1, 3, len(reduced.columns)))
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
    columns: Array,
    noise: Array,
    nominal: Mapping[str, Array],
    square: Callable[[Array, Array], Array],
) -> Array:
    """Inner products of the derivatives over one band's rows, white and torque noise whitened.

    ``square`` has those along a principal axis of the noise, by columns along it (U, 3, A') and the
    variances (R,) of its modes.
    """
    values, vectors = np.linalg.eigh(noise)
    walked = nominal["torque_noise_n_m_s05"][0] ** 2 * band.faster
    quiet = band.rows * _channel_square(event, nominal, 1.0)
    result = np.zeros((len(columns), len(columns)))
    for value, axis in zip(values, vectors.T, strict=True):
        variance = value + walked
        scalar = np.einsum("c,uca->ua", axis, columns)
        result += square(axis[:, None] * columns, variance)
        result -= (scalar * quiet) @ scalar.T / variance.mean()
    return result


def _of_modes(modes: Array, along: Array, variance: Array) -> Array:
    """Inner products on modes (3, A', R)."""
    on_modes = np.einsum("uca,cam->um", along, modes, optimize=True)
    return np.asarray((on_modes / variance) @ on_modes.T)


def _of_gram(gram: Array, along: Array, variance: Array) -> Array:
    """Inner products by a Gram matrix (3, 3, A', A')."""
    crossed = np.einsum("uca,cdab->udb", along, gram, optimize=True)
    return np.asarray(np.einsum("udb,vdb->uv", crossed, along) / variance.mean())


def _channel_square(event: TelemetryBalance, nominal: Mapping[str, Array], summed: float) -> Array:
    """Square (A,) per row that the channels' own noise adds to each scalar column.

    Noise that drives a regressor tells nothing; the likelihood's Jacobian sees to the same.
    ``summed`` is the factor of what is integrated: of rates and wheels, not of turns.
    """
    layout = event.statistics.layout
    square = np.zeros(len(event.reduced.columns))
    square[_are(event, layout.rate)] = summed * nominal["rate_noise_rad_s"][0] ** 2
    square[_are(event, layout.wheel)] = summed * wheel_variance(event, nominal)[0]
    square[_are(event, layout.turn)] = nominal["attitude_noise_rad"][0] ** 2
    return square


def _are(event: TelemetryBalance, columns: slice) -> NDArray[np.bool_]:
    """Which of the columns that are left (A',) are some of the layout's."""
    used = event.reduced.columns
    return np.asarray((used >= columns.start) & (used < columns.stop))
