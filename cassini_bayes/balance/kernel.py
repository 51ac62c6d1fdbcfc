"""Normal equations of a telemetry event at a batch of parameter points, compiled.

Columns combine into P new ones per axis, y_c,k(t) = Σ_b w[b, c] C_c,b(t), over the columns b that
are of new column k; what the likelihood needs are the inner products of these under the noise of
every band. Each of the B columns is of one new column: where several are made of the same, it is
there as often. Other threads may work on other points. The noise of turns, and determinants of that
of rows, are here for the sake of the same small matrices.

Linear algebra on three or four wheels is written out: calls of LAPACK from
compiled code hold the interpreter's lock and cost more than the work. So are copies: an assignment
to a slice takes a second and more to compile.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.computing.compilation import compiled_sums

LEAST_SQUARE: Final = 1e-18  # rad²/s², or of the noise: wheels not measured to move at all
_LEAST_SPREAD: Final = 1e-14  # of the noise in a mean square: all the rest is motion
_SWEEPS: Final = 30  # Jacobi converges quadratically: more than any small matrix needs
_TURNED: Final = 1e-15  # of the geometric mean of two diagonal elements
_TOGETHER: Final = 16
"""Points that share what is read of a Gram matrix, and the operations of vectors: of eight of them
the compiler makes no vectors, and they take three times as long; more gain nothing."""
_TILE: Final = 4  # rows whose inner products are taken together


class Entries(NamedTuple):
    """Which columns are of which new column: of k those from ``start[k]`` to ``start[k + 1]``."""

    start: Places  # (P + 1,)
    wheels: Places  # (W,) measured wheel rates
    turned: Places  # (V,) what integrated columns weigh in their own way


class SlowBands(NamedTuple):
    """S bands of R modes together: columns' coordinates on them.

    Of band s are the modes from ``first[s]`` to ``first[s + 1]``.
    """

    projection: Array  # (3, B, R)
    first: Places  # (S + 1,)
    walk: Array  # (R,) variances of a unit random walk but for its slowest cosines, s


class FastBands(NamedTuple):
    """F bands of Gram matrices, and what is said of the wheels' motion in them.

    Tables are a cubic spline's nodes (T,) and coefficients (4, T − 1, 2); none where nothing is
    said of it.
    """

    grams: Array  # (F, B, 3, 3, B): what a column needs lies together
    rows: Array  # (F,)
    walk: Array  # (F,) s
    nodes: Array  # (F, T)
    coefficients: Array  # (F, 4, T − 1, 2)


class Turns(NamedTuple):
    """T bands of integrated columns, white noise in each.

    The first S have few modes and are given by columns' coordinates on these, of band t those from
    ``first[t]`` to ``first[t + 1]``; the others by Gram matrices.
    """

    projection: Array  # (3, B, M)
    first: Places  # (S + 1,)
    grams: Array  # (T − S, B, 3, 3, B)
    contrasts: Array  # (T,)


class TurnSums(NamedTuple):
    """Mean squares per contrast of T bands of turns (:class:`.bands.TurnBand`)."""

    summed_s2: Array  # (T,) of summed white noise
    rounded_s2: Array  # (T, H, W) of every wheel's rounding, by harmonic


class FlatRows(NamedTuple):
    """Bands of rows in which wheels move by any amount: S of modes, then f of Gram matrices.

    Of band s are the modes from ``first[s]`` to ``first[s + 1]``.
    """

    first: Places  # (S + 1,)
    walk: Array  # (M,) variances of a unit random walk, s
    constant: Array  # (M,) a constant of unit length on the modes
    fast: Places  # (f,) places among the fast bands
    rows: Array  # (f,)
    fast_walk: Array  # (f,) s


class TurnVariances(NamedTuple):
    """Variances of channels at n points, for turns: of each as many as points, or one for all."""

    rate: Array  # (n,) variance of a measured body rate, rad²/s²
    attitude: Array  # (n,) variance of an attitude, rad²
    wheel: Array  # (n, W) variance of a wheel rate but for what lasts or repeats, rad²/s²
    repeated: Array  # (n, H) that of roundings that do, by harmonic, rad²/s²
    torque: Array  # (n,) density of torque noise, N² m² s


class Noise(NamedTuple):
    """Noise and wheels at n points."""

    wheels: Array  # (n, 3, W) momentum per wheel rate
    beside: Array  # (n, S + F, 3, 3) covariance without wheels and torque noise, (N m s)²
    wheel: Array  # (n, S + F, W) variance of measured wheel rates, rad²/s²
    walk: Array  # (n,) density of torque noise, N² m² s
    turns: Array  # (n, T, 3, 3) covariance of a contrast of integrated columns, (N m s²)²


class Placed(NamedTuple):
    """Priors of the unknowns, by which the slow bands place them.

    The first ``normals`` unknowns are standard normals, of momentum too slow for the fast bands.
    Means, standard deviations of thrusts (one number) and of the event's own.
    """

    normals: int
    mean: Array  # (n, P − 1)
    thrust_sd: float
    own_sd: Array  # (n, U)


@compiled_sums
def normal_equations(
    weights: Array,
    turned: Array,
    noise: Noise,
    entries: Entries,
    slow: SlowBands,
    fast: FastBands,
    turns: Turns,
    placed: Placed,
) -> tuple[Array, Array, Array]:  # pragma: no cover - compiled
    """Inner products of the new columns with the noise whitened away.

    Parameters
    ----------
    weights
        (n, B, 3) weight of every column per axis; those of measured wheel rates, and those that
        integrated columns have otherwise, are overwritten.
    turned
        (n, T, V, 3) those of integrated columns, by band, where they are others.
    noise, entries, slow, fast, turns, placed
        See there.

    Returns
    -------
    Inner products (n, P, P); the log of all determinants and of the density of measured wheel rates
    (n,), constants left out, −∞ where a covariance is not positive; the matrices (n, F, W, W)
    that take measured wheel rates to the estimate of the true ones in the fast bands
    (docs/topics/telemetry-likelihood.md §3).
    """
    n, width, wheels = len(weights), entries.start.size - 1, noise.wheels.shape[2]
    size, slow_bands, bands = slow.projection.shape[1], slow.first.size - 1, fast.rows.size
    most = max(slow.walk.size, turns.projection.shape[2])
    by_modes = turns.first.size - 1
    normal, log_scale = np.zeros((n, width, width)), np.empty(n)
    kept, lacking = np.empty((n, bands, wheels, wheels)), np.empty((n, 3, size))
    seen, products = np.empty((3, wheels)), np.empty((3 + wheels, 3 + wheels))
    other, covariance = np.empty((3, 3)), np.empty((3, 3))
    axes = np.empty((max(slow_bands, by_modes), 3, 3))
    precision = np.empty((_TOGETHER, 3, 3))
    gain, on_modes = np.empty((3, most)), np.zeros((_filled(width, _TILE), 3 * most))
    place_of = np.full(size, -1)
    for v in range(entries.turned.size):
        place_of[entries.turned[v]] = v
    no_place = np.full(size, -1)
    is_told = fast.nodes.size > 0
    for i in range(n):
        used, own = weights[i], noise.wheels[i]
        log_scale[i] = 0.0
        for j in range(wheels):
            for c in range(3):
                used[entries.wheels[j], c] = own[c, j]
        for s in range(slow_bands):
            _add_wheels(noise.beside[i, s], noise.wheel[i, s], own, own, covariance)
            _diagonalise(covariance, axes[s])
            for e in range(3):
                for m in range(slow.first[s], slow.first[s + 1]):
                    variance = covariance[e, e] + noise.walk[i] * slow.walk[m]
                    gain[e, m] = 1.0 / variance
                    log_scale[i] -= 0.5 * np.log(variance)
        _put_on_modes(
            slow.projection, slow.first, entries, used, turned[i], no_place, axes, gain, on_modes
        )
        _add_squares(on_modes, 3 * slow.walk.size, normal[i])
        if is_told:
            _place(entries, used, normal[i], placed, i, lacking[i])
    # band by band and some points at a time: Gram matrices are read from the cache less often
    for f in range(bands):
        for i in range(0, n, _TOGETHER):
            part = slice(i, min(i + _TOGETHER, n))
            for p in range(part.start, part.stop):
                used, own = weights[p], noise.wheels[p]
                for c in range(3):
                    for e in range(3):
                        other[c, e] = noise.beside[p, slow_bands + f, c, e]
                    other[c, c] += noise.walk[p] * fast.walk[f]
                if is_told:
                    _moments(fast.grams[f], entries.wheels, lacking[p], fast.rows[f], products)
                    log_scale[p] += estimated_wheels(
                        fast.rows[f],
                        fast.nodes[f],
                        fast.coefficients[f],
                        products,
                        other,
                        own,
                        noise.wheel[p, slow_bands + f],
                        kept[p, f],
                    )
                else:
                    _set_one(kept[p, f])
                _see(own, kept[p, f], entries.wheels, used, seen)
                _add_wheels(other, noise.wheel[p, slow_bands + f], seen, own, covariance)
                log_determinant = _invert(covariance, precision[p - i])
                if not is_told:
                    log_scale[p] -= 0.5 * fast.rows[f] * log_determinant
            _contract(
                fast.grams[f], entries, weights[part], precision, placed.normals, normal[part]
            )
    for i in range(n):
        for j in range(wheels):
            for c in range(3):
                weights[i, entries.wheels[j], c] = noise.wheels[i, c, j]
        for t in range(by_modes):
            for c in range(3):
                for e in range(3):
                    covariance[c, e] = noise.turns[i, t, c, e]
            _diagonalise(covariance, axes[t])
            for e in range(3):
                log_scale[i] -= 0.5 * turns.contrasts[t] * np.log(covariance[e, e])
                for m in range(turns.first[t], turns.first[t + 1]):
                    gain[e, m] = 1.0 / covariance[e, e]
        _put_on_modes(
            turns.projection,
            turns.first,
            entries,
            weights[i],
            turned[i],
            place_of,
            axes,
            gain,
            on_modes,
        )
        _add_squares(on_modes, 3 * turns.first[by_modes], normal[i])
    for t in range(by_modes, turns.contrasts.size):
        for i in range(0, n, _TOGETHER):
            part = slice(i, min(i + _TOGETHER, n))
            for p in range(part.start, part.stop):
                used = weights[p]
                for v in range(entries.turned.size):
                    for c in range(3):
                        used[entries.turned[v], c] = turned[p, t, v, c]
                log_determinant = _invert(noise.turns[p, t], precision[p - i])
                log_scale[p] -= 0.5 * turns.contrasts[t] * log_determinant
            _contract(turns.grams[t - by_modes], entries, weights[part], precision, 0, normal[part])
    for i in range(n):
        is_fine = np.isfinite(log_scale[i])
        for k in range(width):
            for before in range(k):
                normal[i, before, k] = normal[i, k, before]
            is_fine = is_fine and np.isfinite(normal[i, k, k])
        if not is_fine:
            for k in range(width):
                for before in range(width):
                    normal[i, k, before] = 0.0
            log_scale[i] = -np.inf
    return normal, log_scale, kept


@compiled_sums
def without_first(
    normal: Array, count: int, log_scale: Array
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """The first unknowns, standard normals beforehand, integrated out of normal equations.

    Parameters
    ----------
    normal, log_scale
        (n, P, P) and (n,), as :func:`normal_equations` returns them.
    count
        C of the unknowns.

    Returns
    -------
    Normal equations (n, P − C, P − C) of the others, and log scale (n,).
    """
    n, left = len(normal), normal.shape[1] - count
    result, scale = np.empty((n, left, left)), log_scale.copy()
    precision, factor = np.empty((count, count)), np.empty((count, count))
    coupling = np.empty((count, left))
    for i in range(n):
        if not np.isfinite(scale[i]):
            result[i] = 0.0
            continue
        for u in range(count):
            for v in range(count):
                precision[u, v] = normal[i, u, v]
            precision[u, u] += 1.0
        scale[i] -= 0.5 * _factor(precision, factor)
        if not np.isfinite(scale[i]):
            result[i], scale[i] = 0.0, -np.inf
            continue
        for u in range(count):
            for a in range(left):
                coupling[u, a] = normal[i, u, count + a]
            for before in range(u):
                share = factor[u, before]
                for a in range(left):
                    coupling[u, a] -= share * coupling[before, a]
            for a in range(left):
                coupling[u, a] /= factor[u, u]
        for a in range(left):
            for b in range(left):
                result[i, a, b] = normal[i, count + a, count + b]
        for u in range(count):
            for a in range(left):
                for b in range(left):
                    result[i, a, b] -= coupling[u, a] * coupling[u, b]
    return result, scale


@compiled_sums
def without_own(
    normal: Array, thrusters: int, mean: Array, sd: Array, common: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:  # pragma: no cover - compiled
    """An event's own unknowns integrated out of its normal equations.

    Parameters
    ----------
    normal
        (n, P, P) of K thrusts, U own unknowns and the measured momentum.
    thrusters
        K.
    mean, sd
        (U,) and (n, U) of the own unknowns' priors.
    common
        (n,) level about which the thrusts are taken, N.

    Returns
    -------
    Lower factor (n, U, U) of the own unknowns' precision in standardised coordinates, their shift
    (n, U) and coupling (n, U, K) to the thrusts; information on the thrusts: matrix (n, K, K),
    vector (n, K) and constant (n,), −∞ where the precision is not positive.
    """
    n, k, own, last = len(normal), thrusters, len(mean), normal.shape[1] - 1
    factor, solved = np.empty((n, own, own)), np.empty((n, own, k + 1))
    matrix, vector, constant = np.empty((n, k, k)), np.empty((n, k)), np.empty(n)
    precision, target = np.empty((own, own)), np.empty(last)
    for i in range(n):
        square = normal[i, last, last]
        for a in range(last):
            # the measured momentum less that of the own unknowns at their prior means
            target[a] = normal[i, a, last]
            for u in range(own):
                target[a] -= normal[i, a, k + u] * mean[u]
        for u in range(own):
            square -= mean[u] * (target[k + u] + normal[i, k + u, last])
            for v in range(own):
                precision[u, v] = sd[i, u] * normal[i, k + u, k + v] * sd[i, v]
            precision[u, u] += 1.0
            for a in range(k):
                solved[i, u, a] = sd[i, u] * normal[i, k + u, a]
            solved[i, u, k] = sd[i, u] * target[k + u]
        total = -0.5 * (square + _factor(precision, factor[i]))
        for u in range(own):
            for before in range(u):
                for a in range(k + 1):
                    solved[i, u, a] -= factor[i, u, before] * solved[i, before, a]
            for a in range(k + 1):
                solved[i, u, a] /= factor[i, u, u]
            total += 0.5 * solved[i, u, k] ** 2
        for a in range(k):
            vector[i, a] = target[a]
            for u in range(own):
                vector[i, a] -= solved[i, u, a] * solved[i, u, k]
            for b in range(k):
                matrix[i, a, b] = normal[i, a, b]
            for u in range(own):
                for b in range(k):
                    matrix[i, a, b] -= solved[i, u, a] * solved[i, u, b]
        for a in range(k):
            by_common = 0.0
            for b in range(k):
                by_common += matrix[i, a, b]
            total += common[i] * (vector[i, a] - 0.5 * common[i] * by_common)
            vector[i, a] -= common[i] * by_common
        constant[i] = total
        if not np.isfinite(total):
            _set_one(factor[i])
            solved[i], matrix[i], vector[i] = 0.0, 0.0, 0.0
            constant[i] = -np.inf
    return factor, solved[:, :, k], solved[:, :, :k], matrix, vector, constant


@compiled_sums
def gain_and_covariance(
    by_rate: Array,
    inertia: Array,
    wheels: Array,
    noise: TurnVariances,
    left_open: Array,
    sums: TurnSums,
    torque_s3: Array,
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """Gain and covariance of turns, given the rows (:func:`.telemetry_noise.turn_noise`).

    Parameters
    ----------
    by_rate, inertia
        (n, 3, 3) momentum per measured rate, and per rate of the body.
    wheels
        (n, 3, W) momentum per wheel rate.
    noise, sums
        See there.
    left_open
        (n or 1, T, 3, 3) what counters leave open, (N m s²)².
    torque_s3
        (T,) what of a unit random walk is in the noise of every band.
    """
    n, bands, count = len(by_rate), sums.summed_s2.size, wheels.shape[2]
    gain, covariance = np.empty((n, bands, 3, 3)), np.empty((n, bands, 3, 3))
    gyro, turn, precision = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    shared, more, half = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    variance = np.empty(count)
    for i in range(n):
        own = min(i, noise.rate.size - 1)
        attitude, wheel = min(i, noise.attitude.size - 1), min(i, len(noise.wheel) - 1)
        repeated, torque = min(i, len(noise.repeated) - 1), min(i, noise.torque.size - 1)
        is_open = min(i, len(left_open) - 1)
        for c in range(3):
            for d in range(3):
                gyro[c, d] = turn[c, d] = 0.0
                for k in range(3):
                    gyro[c, d] += by_rate[i, c, k] * by_rate[i, d, k]
                    turn[c, d] += inertia[i, c, k] * inertia[i, d, k]
                gyro[c, d] *= noise.rate[own]
                turn[c, d] *= noise.attitude[attitude]
        _invert(gyro, precision)
        for t in range(bands):
            for w in range(count):
                variance[w] = sums.summed_s2[t] * noise.wheel[wheel, w]
                for h in range(noise.repeated.shape[1]):
                    variance[w] += noise.repeated[repeated, h] * sums.rounded_s2[t, h, w]
            for c in range(3):
                for d in range(3):
                    value = left_open[is_open, t, c, d]
                    for w in range(count):
                        value += wheels[i, c, w] * variance[w] * wheels[i, d, w]
                    shared[c, d] = value
                shared[c, c] += noise.torque[torque] * torque_s3[t]
            for c in range(3):
                for d in range(3):
                    value = 0.0
                    for k in range(3):
                        value += shared[c, k] * precision[k, d]
                    gain[i, t, c, d] = value / sums.summed_s2[t]
                    more[c, d] = gain[i, t, c, d] + (1.0 if c == d else 0.0)
            for c in range(3):
                for d in range(3):
                    half[c, d] = 0.0
                    for k in range(3):
                        half[c, d] += more[c, k] * turn[k, d]
            for c in range(3):
                for d in range(3):
                    value = 0.0
                    for k in range(3):
                        value += half[c, k] * more[d, k] + more[c, k] * shared[k, d]
                    covariance[i, t, c, d] = value
    return gain, covariance


@compiled_sums
def summed_over_couples(torque: Array, square: Array) -> Array:  # pragma: no cover - compiled
    """Covariances Σ_g v_bg T_g T_gᵀ (n, B, 3, 3) of torques (n, 3, G) with variances (n, B, G)."""
    n, bands, couples = square.shape
    result = np.empty((n, bands, 3, 3))
    for i in range(n):
        for band in range(bands):
            for c in range(3):
                for d in range(c + 1):
                    value = 0.0
                    for g in range(couples):
                        value += square[i, band, g] * torque[i, c, g] * torque[i, d, g]
                    result[i, band, c, d] = result[i, band, d, c] = value
    return result


@compiled_sums
def turned_weights(
    gyro: Array, inertia: Array, gain: Array
) -> Array:  # pragma: no cover - compiled
    """Weights (n, T, G + 3, 3) of integrated columns: of the gyro's −w Qᵀ, of turns (1 + Q) I.

    ``gyro`` (n, G, 3) are its weights w in rows, ``inertia`` (n, 3, 3), and ``gain`` (n, T, 3, 3)
    Q (:func:`.telemetry_weights.turn_weights`).
    """
    n, bands, count = len(gain), gain.shape[1], gyro.shape[1]
    result = np.empty((n, bands, count + 3, 3))
    for i in range(n):
        for t in range(bands):
            for c in range(3):
                for g in range(count):
                    value = 0.0
                    for k in range(3):
                        value -= gain[i, t, c, k] * gyro[i, g, k]
                    result[i, t, g, c] = value
                for j in range(3):
                    value = inertia[i, c, j]
                    for k in range(3):
                        value += gain[i, t, c, k] * inertia[i, k, j]
                    result[i, t, count + j, c] = value
    return result


@compiled_sums
def log_of_flat_rows(
    white: Array, left_open: Array, wheels: Array, variance: Array, torque: Array, flat: FlatRows
) -> Array:  # pragma: no cover - compiled
    """Log determinants (n,) of the noise of bands of rows, the constant of the slow ones left out.

    Σ_m log det V_m + Σ_a log Σ_m c_m²/λ_am + Σ_f R_f log det V_f, with λ_am the eigenvalues of the
    noise V_m = V + t_m σ² of a mode in order of their size, t_m the walk's variance there and c_m
    the constant (docs/topics/telemetry-likelihood.md §3).

    Parameters
    ----------
    white
        (n, 3, 3) covariance of what rates and attitudes put into a row, (N m s)².
    left_open
        (n or 1, S + F, 3, 3) what counters leave open, (N m s)².
    wheels, variance
        (n, 3, W) momentum per wheel rate; (n or 1, S + F, W) their noise, rad²/s².
    torque
        (n or 1,) density of torque noise, N² m² s.
    flat
        The bands.
    """
    n, slow = len(white), flat.first.size - 1
    result, held = np.zeros(n), np.empty(3)
    beside, covariance, spare = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(n):
        is_open, noise = min(i, len(left_open) - 1), min(i, len(variance) - 1)
        walk, own = torque[min(i, torque.size - 1)], wheels[i]
        held[:] = 0.0
        for s in range(slow):
            for c in range(3):
                for d in range(3):
                    beside[c, d] = white[i, c, d] + left_open[is_open, s, c, d]
            _add_wheels(beside, variance[noise, s], own, own, covariance)
            _diagonalise(covariance, spare)
            values = np.sort(np.array([covariance[0, 0], covariance[1, 1], covariance[2, 2]]))
            for m in range(flat.first[s], flat.first[s + 1]):
                for a in range(3):
                    value = values[a] + walk * flat.walk[m]
                    result[i] += np.log(value)
                    held[a] += flat.constant[m] ** 2 / value
        for a in range(3):
            result[i] += np.log(held[a])
        for f in range(flat.fast.size):
            place = slow + flat.fast[f]
            for c in range(3):
                for d in range(3):
                    beside[c, d] = white[i, c, d] + left_open[is_open, place, c, d]
                beside[c, c] += walk * flat.fast_walk[f]
            _add_wheels(beside, variance[noise, place], own, own, covariance)
            result[i] += flat.rows[f] * _factor(covariance, spare)
    return result


@compiled_sums
def log_determinants(matrices: Array) -> Array:  # pragma: no cover - compiled
    """Log of |determinant| (n,) of matrices (n, 3, 3)."""
    result = np.empty(len(matrices))
    for i in range(len(matrices)):
        result[i] = _log_determinant(matrices[i])
    return result


@compiled_sums
def log_of_turns(
    gain: Array, at_reference: Array, covariance: Array, contrasts: Array
) -> Array:  # pragma: no cover - compiled
    """Σ_t c_t [log |det (1 + Q)(1 + Q₀)⁻¹| + ½ log det Σ̃] (n,) over bands of turns.

    Q is the ``gain`` (n, T, 3, 3) of turns, Q₀ that at the reference noise, Σ̃ the ``covariance``
    there, c the ``contrasts`` (T,) (:func:`.flat_motion.log_measure`). Of each there may be one for
    all points.
    """
    n = max(len(gain), len(at_reference))
    result, more = np.zeros(n), np.empty((3, 3))
    for i in range(n):
        own, reference = min(i, len(gain) - 1), min(i, len(at_reference) - 1)
        for t in range(contrasts.size):
            value = 0.5 * _log_determinant(covariance[reference, t])
            for sign, which in ((1.0, gain[own, t]), (-1.0, at_reference[reference, t])):
                for c in range(3):
                    for d in range(3):
                        more[c, d] = which[c, d] + (1.0 if c == d else 0.0)
                value += sign * _log_determinant(more)
            result[i] += contrasts[t] * value
    return result


@compiled_sums
def _log_determinant(matrix: Array) -> float:  # pragma: no cover - compiled
    """Log of |determinant| of a matrix (3, 3)."""
    value = 0.0
    for i in range(3):
        minor = matrix[1, i - 2] * matrix[2, i - 1] - matrix[1, i - 1] * matrix[2, i - 2]
        value += matrix[0, i] * minor
    return float(np.log(np.abs(value)))


@compiled_sums
def _see(
    own: Array, kept: Array, places: Places, used: Array, seen: Array
) -> None:  # pragma: no cover - compiled
    """Momentum (3, W) per measured wheel rate, also among the weights (B, 3)."""
    wheels = own.shape[1]
    for c in range(3):
        for j in range(wheels):
            value = 0.0
            for k in range(wheels):
                value += own[c, k] * kept[k, j]
            seen[c, j] = value
            used[places[j], c] = value


@compiled_sums
def _add_wheels(
    beside: Array, variance: Array, seen: Array, own: Array, out: Array
) -> None:  # pragma: no cover - compiled
    """Covariance (3, 3) of a row, with what measured wheel rates put in."""
    for c in range(3):
        for d in range(c + 1):
            value = 0.0
            for j in range(own.shape[1]):
                value += seen[c, j] * variance[j] * own[d, j]
            out[c, d] = out[d, c] = beside[c, d] + value


@compiled_sums
def _looked_up(
    rows: float, nodes: Array, coefficients: Array, square: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Log density of R measured rates, and E[1/(1 + s)], by their mean square over the noise."""
    # below the table's end the density is flat, above it is all motion
    log_square = max(np.log(max(square, LEAST_SQUARE)), -nodes[-1])
    t = max(-log_square, nodes[0])
    place, beyond = 0, nodes.size - 1
    while beyond - place > 1:
        middle = (place + beyond) // 2
        if nodes[middle] <= t:
            place = middle
        else:
            beyond = middle
    x = t - nodes[place]
    found = coefficients[:, place]
    log_density = ((found[0, 0] * x + found[1, 0]) * x + found[2, 0]) * x + found[3, 0]
    explained = ((found[0, 1] * x + found[1, 1]) * x + found[2, 1]) * x + found[3, 1]
    spread = min(max(explained * np.exp(-log_square), _LEAST_SPREAD), 1.0)
    return log_density - 0.5 * rows * log_square, spread


@compiled_sums
def estimated_wheels(
    rows: float,
    nodes: Array,
    coefficients: Array,
    moments: Array,
    other: Array,
    weights: Array,
    variance: Array,
    kept: Array,
) -> float:  # pragma: no cover - compiled
    """Best estimate of the true wheel rates of a fast band, and the log density of the band.

    The wheels are seen twice: measured, and through the momentum that everything else lacks,
    u = H ρ + e. The mean squares of both together say how much of it is motion
    (docs/topics/telemetry-likelihood.md §3).

    Parameters
    ----------
    rows
        R of the band.
    nodes, coefficients
        Its table, as in :class:`FastBands`.
    moments
        (3 + W, 3 + W) mean products of u, N m s, and the measured rates, rad/s.
    other
        (3, 3) covariance of e.
    weights
        (3, W) H, momentum per wheel rate.
    variance
        (W,) of measured wheel rates.
    kept
        (W, W), to be filled with the matrix that takes measured rates to their estimate.

    Returns
    -------
    The log density of u and ρ_m beyond their quadratic form at that estimate; constants left out.
    """
    wheels = weights.shape[1]
    lower = np.empty((3, 3))
    log_other = _factor(other, lower)
    by_other = np.empty((3, wheels))  # other⁻¹ H
    for j in range(wheels):
        for c in range(3):
            by_other[c, j] = weights[c, j]
        _solve(lower, by_other[:, j])
        _solve_transposed(lower, by_other[:, j])
    precision, factor = np.empty((wheels, wheels)), np.empty((wheels, wheels))
    for j in range(wheels):
        for k in range(wheels):
            value = 0.0
            for c in range(3):
                value += by_other[c, j] * weights[c, k]
            precision[j, k] = value
        precision[j, j] += 1.0 / variance[j]
    _factor(precision, factor)
    # of unit noise: what both say of the wheels together
    together = np.zeros((wheels, 3 + wheels))
    for j in range(wheels):
        for c in range(3):
            together[j, c] = by_other[c, j]
        together[j, 3 + j] = 1.0 / variance[j]
    for column in range(3 + wheels):
        _solve(factor, together[:, column])
    squares, half_way = np.empty((wheels, wheels)), np.empty(3 + wheels)
    for j in range(wheels):
        for a in range(3 + wheels):
            value = 0.0
            for b in range(3 + wheels):
                value += together[j, b] * moments[b, a]
            half_way[a] = value
        for k in range(j + 1):
            value = 0.0
            for a in range(3 + wheels):
                value += half_way[a] * together[k, a]
            squares[j, k] = squares[k, j] = value
    axes = np.empty((wheels, wheels))
    _diagonalise(squares, axes)
    # K = S (S + Σ)⁻¹ for S = X (1/q − 1) Xᵀ, q the spread: well conditioned for any q in 0 … 1;
    # in units of every wheel's own noise
    log_total = -0.5 * rows * log_other
    for j in range(wheels):
        log_total -= 0.5 * rows * np.log(variance[j])
    inner = np.empty((wheels, wheels))
    for a in range(wheels):
        log_density, spread = _looked_up(rows, nodes, coefficients, squares[a, a])
        log_total += log_density + 0.5 * rows * max(squares[a, a], LEAST_SQUARE) * spread
        inner[a, a] = spread
        _solve_transposed(factor, axes[:, a])
        for j in range(wheels):
            axes[j, a] *= np.sqrt((1.0 - spread) / variance[j])
    for a in range(wheels):
        for b in range(a + 1):
            value = inner[a, a] if a == b else 0.0
            for j in range(wheels):
                value += axes[j, a] * axes[j, b]
            inner[a, b] = inner[b, a] = value
    _factor(inner, factor)
    for j in range(wheels):
        _solve(factor, axes[j])
    own = 0.0
    for j in range(wheels):
        for k in range(wheels):
            value = 0.0
            for a in range(wheels):
                value += axes[j, a] * axes[k, a]
            # back from units of the noise: K = Σ^½ K′ Σ^−½
            kept[j, k] = value * np.sqrt(variance[j] / variance[k])
            left = (1.0 if j == k else 0.0) - value
            own += left * moments[3 + k, 3 + j] / np.sqrt(variance[j] * variance[k])
    log_total -= 0.5 * rows * own
    return log_total


@compiled_sums
def _filled(size: int, step: int) -> int:  # pragma: no cover - compiled
    """The least multiple of a step that is not below a size."""
    return (size + step - 1) // step * step


@compiled_sums
def _put_on_modes(
    projection: Array,
    first: Places,
    entries: Entries,
    used: Array,
    turned: Array,
    place_of: Places,
    axes: Array,
    gain: Array,
    seen: Array,
) -> None:  # pragma: no cover - compiled
    """Coordinates of the new columns on the modes of all bands, whitened: rows of ``seen``.

    gain_m,e^½ Σ_c axes_c,e Σ_t φ_m(t) y_c,k(t), the ``axes`` (S, 3, 3) and the modes from
    ``first[s]`` to ``first[s + 1]`` those of band s. A column b with a ``place_of[b]`` v has the
    weight ``turned[s, v]`` in band s, and not ``used[b]``.
    """
    width, bands, modes = entries.start.size - 1, first.size - 1, first[first.size - 1]
    body, turn = np.empty((3, modes)), np.empty((3, 3, modes))
    for s in range(bands):
        for e in range(3):
            for m in range(first[s], first[s + 1]):
                root = np.sqrt(gain[e, m])
                for c in range(3):
                    turn[e, c, m] = axes[s, c, e] * root
    for k in range(width):
        body[:] = 0.0
        for b in range(entries.start[k], entries.start[k + 1]):
            for c in range(3):
                if place_of[b] >= 0:
                    for s in range(bands):
                        weight = turned[s, place_of[b], c]
                        for m in range(first[s], first[s + 1]):
                            body[c, m] += weight * projection[c, b, m]
                elif used[b, c] != 0.0:
                    weight = used[b, c]
                    for m in range(modes):
                        body[c, m] += weight * projection[c, b, m]
        for e in range(3):
            for m in range(modes):
                seen[k, e * modes + m] = (
                    turn[e, 0, m] * body[0, m]
                    + turn[e, 1, m] * body[1, m]
                    + turn[e, 2, m] * body[2, m]
                )


@compiled_sums
def _add_squares(seen: Array, size: int, normal: Array) -> None:  # pragma: no cover - compiled
    """Add the inner products of rows, of so many elements, to the lower triangle (P, P).

    Eight at a time, of four rows with two: each element that is read serves several products.
    Rows are filled up with zeros to a multiple of four.
    """
    width = len(normal)
    for k in range(0, width, _TILE):
        for other in range(0, min(k + _TILE, width), 2):
            left_0 = left_1 = left_2 = left_3 = 0.0
            right_0 = right_1 = right_2 = right_3 = 0.0
            for j in range(size):
                left, right = seen[other, j], seen[other + 1, j]
                left_0 += seen[k, j] * left
                left_1 += seen[k + 1, j] * left
                left_2 += seen[k + 2, j] * left
                left_3 += seen[k + 3, j] * left
                right_0 += seen[k, j] * right
                right_1 += seen[k + 1, j] * right
                right_2 += seen[k + 2, j] * right
                right_3 += seen[k + 3, j] * right
            lefts = (left_0, left_1, left_2, left_3)
            rights = (right_0, right_1, right_2, right_3)
            for i in range(min(_TILE, width - k)):
                normal[k + i, other] += lefts[i]
                if other + 1 < width:
                    normal[k + i, other + 1] += rights[i]


@compiled_sums
def _place(
    entries: Entries, used: Array, normal: Array, placed: Placed, point: int, lacking: Array
) -> None:  # pragma: no cover - compiled
    """Column weights (3, B) of the momentum that all but the wheels leaves to them.

    Unknowns are taken where the slow band (lower triangle ``normal``) and their priors have them:
    good enough to tell how much the wheels move at higher frequencies.
    """
    unknowns = entries.start.size - 2
    thrusters = unknowns - placed.own_sd.shape[1]
    sd, at = np.empty(unknowns), np.empty(unknowns)
    for k in range(unknowns):
        if k < placed.normals:
            sd[k] = 1.0
        else:
            sd[k] = placed.thrust_sd if k < thrusters else placed.own_sd[point, k - thrusters]
    precision, factor = np.empty((unknowns, unknowns)), np.empty((unknowns, unknowns))
    for k in range(unknowns):
        target = normal[unknowns, k]
        for other in range(unknowns):
            value = normal[max(k, other), min(k, other)]
            target -= value * placed.mean[point, other]
            precision[k, other] = sd[k] * value * sd[other]
        precision[k, k] += 1.0
        at[k] = sd[k] * target
    _factor(precision, factor)
    _solve(factor, at)
    _solve_transposed(factor, at)
    lacking[:] = 0.0
    for k in range(placed.normals, unknowns + 1):
        sign = -1.0 if k == unknowns else placed.mean[point, k] + sd[k] * at[k]
        for b in range(entries.start[k], entries.start[k + 1]):
            for c in range(3):
                lacking[c, b] = sign * used[b, c]
    for place in entries.wheels:
        for c in range(3):
            lacking[c, place] = 0.0


@compiled_sums
def _moments(
    gram: Array, places: Places, weights: Array, rows: float, out: Array
) -> None:  # pragma: no cover - compiled
    """Mean products (3 + W, 3 + W) of a vector column, of weights (3, B), and scalar columns."""
    size = gram.shape[0]
    for c in range(3):
        for d in range(c + 1):
            value = 0.0
            for b in range(size):
                weight = weights[c, b]
                if weight == 0.0:
                    continue
                # the square of one axis is symmetric: below the diagonal, and twice
                end = b if c == d else size
                part = 0.0
                for a in range(end):
                    part += gram[b, c, d, a] * weights[d, a]
                value += weight * (2.0 * part + gram[b, c, d, b] * weight if c == d else part)
            out[c, d] = out[d, c] = value / rows
        for j in range(places.size):
            value = 0.0
            for a in range(size):
                value += gram[places[j], 0, c, a] * weights[c, a]
            out[c, 3 + j] = out[3 + j, c] = value / rows
    for j in range(places.size):
        for k in range(places.size):
            out[3 + j, 3 + k] = gram[places[j], 0, 0, places[k]] / rows


@compiled_sums
def _contract(
    gram: Array, entries: Entries, used: Array, precision: Array, first: int, normal: Array
) -> None:  # pragma: no cover - compiled
    """Add the inner products Σ_t y_k(t)ᵀ W y_l(t) of a band to lower triangles (m, P, P).

    For m points, sixteen at most, of weights (m, B, 3) and matrices W (≥ m, 3, 3). Only new columns
    from the ``first`` on are in the band. Points lie side by side, so that one operation is for
    several; places of points that are not there have zeros. All nine products of axes are written
    out: a sum is read and written once for them.
    """
    start, size, points = entries.start, gram.shape[0], len(used)
    weight, white = np.zeros((size, 3, _TOGETHER)), np.zeros((3, 3, _TOGETHER))
    by = np.empty((3, 3, _TOGETHER))
    products, total = np.empty((size, _TOGETHER)), np.empty(_TOGETHER)
    for p in range(points):
        for c in range(3):
            for d in range(3):
                white[c, d, p] = precision[p, c, d]
            for b in range(size):
                weight[b, c, p] = used[p, b, c]
    for k in range(first, start.size - 1):
        products[: start[k + 1]] = 0.0
        for b in range(start[k], start[k + 1]):
            if gram[b, 0, 0, b] == 0.0 and gram[b, 1, 1, b] == 0.0 and gram[b, 2, 2, b] == 0.0:
                continue  # zero in this band: cut tails in quiet pieces, turns in rows
            own = gram[b]
            for c in range(3):
                for d in range(3):
                    for p in range(_TOGETHER):
                        by[c, d, p] = white[c, d, p] * weight[b, d, p]
            for a in range(start[k + 1]):
                for p in range(_TOGETHER):
                    products[a, p] += (
                        weight[a, 0, p]
                        * (
                            by[0, 0, p] * own[0, 0, a]
                            + by[0, 1, p] * own[1, 0, a]
                            + by[0, 2, p] * own[2, 0, a]
                        )
                        + weight[a, 1, p]
                        * (
                            by[1, 0, p] * own[0, 1, a]
                            + by[1, 1, p] * own[1, 1, a]
                            + by[1, 2, p] * own[2, 1, a]
                        )
                        + weight[a, 2, p]
                        * (
                            by[2, 0, p] * own[0, 2, a]
                            + by[2, 1, p] * own[1, 2, a]
                            + by[2, 2, p] * own[2, 2, a]
                        )
                    )
        for before in range(first, k + 1):
            total[:] = 0.0
            for b in range(start[before], start[before + 1]):
                for p in range(_TOGETHER):
                    total[p] += products[b, p]
            for p in range(points):
                normal[p, k, before] += total[p]


@compiled_sums
def _set_one(matrix: Array) -> None:  # pragma: no cover - compiled
    """Fill a square matrix with the unit matrix."""
    for i in range(len(matrix)):
        for j in range(len(matrix)):
            matrix[i, j] = 1.0 if i == j else 0.0


@compiled_sums
def _diagonalise(matrix: Array, vectors: Array) -> None:  # pragma: no cover - compiled
    """Turn a symmetric matrix (m, m) to diagonal form in place; columns of ``vectors`` the axes.

    Jacobi's rotations, cyclic; accurate relative to each eigenvalue of a positive matrix.
    """
    m = len(matrix)
    _set_one(vectors)
    for _ in range(_SWEEPS):
        is_diagonal = True
        for p in range(m - 1):
            for q in range(p + 1, m):
                off = matrix[p, q]
                if not abs(off) > _TURNED * np.sqrt(abs(matrix[p, p] * matrix[q, q])):
                    continue
                is_diagonal = False
                slope = 0.5 * (matrix[q, q] - matrix[p, p]) / off
                t = 1.0 / (abs(slope) + np.sqrt(slope * slope + 1.0))
                t = -t if slope < 0.0 else t
                cosine = 1.0 / np.sqrt(t * t + 1.0)
                sine = t * cosine
                matrix[p, p] -= t * off
                matrix[q, q] += t * off
                matrix[p, q] = matrix[q, p] = 0.0
                for k in range(m):
                    if k not in (p, q):
                        one, two = matrix[k, p], matrix[k, q]
                        matrix[k, p] = matrix[p, k] = cosine * one - sine * two
                        matrix[k, q] = matrix[q, k] = sine * one + cosine * two
                    one, two = vectors[k, p], vectors[k, q]
                    vectors[k, p] = cosine * one - sine * two
                    vectors[k, q] = sine * one + cosine * two
        if is_diagonal:
            return


@compiled_sums
def _factor(matrix: Array, lower: Array) -> float:  # pragma: no cover - compiled
    """Cholesky's lower factor (m, m) of a positive matrix, and the log of its determinant.

    Not a number where it is not positive.
    """
    m, log_determinant = len(matrix), 0.0
    for j in range(m):
        for i in range(j, m):
            value = matrix[i, j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if i == j:
                lower[j, j] = np.sqrt(value)
                log_determinant += np.log(value)
            else:
                lower[i, j] = value / lower[j, j]
                lower[j, i] = 0.0
    return log_determinant


@compiled_sums
def _solve(lower: Array, vector: Array) -> None:  # pragma: no cover - compiled
    """Replace a vector (m,) by L⁻¹ of it."""
    for i in range(len(vector)):
        value = vector[i]
        for k in range(i):
            value -= lower[i, k] * vector[k]
        vector[i] = value / lower[i, i]


@compiled_sums
def _solve_transposed(lower: Array, vector: Array) -> None:  # pragma: no cover - compiled
    """Replace a vector (m,) by L⁻ᵀ of it."""
    for i in range(len(vector) - 1, -1, -1):
        value = vector[i]
        for k in range(i + 1, len(vector)):
            value -= lower[k, i] * vector[k]
        vector[i] = value / lower[i, i]


@compiled_sums
def _invert(matrix: Array, inverse: Array) -> float:  # pragma: no cover - compiled
    """Inverse (m, m) of a positive matrix, and the log of its determinant."""
    lower = np.empty((len(matrix), len(matrix)))
    log_determinant = _factor(matrix, lower)
    _set_one(inverse)
    for column in range(len(matrix)):
        _solve(lower, inverse[:, column])
        _solve_transposed(lower, inverse[:, column])
    return log_determinant
