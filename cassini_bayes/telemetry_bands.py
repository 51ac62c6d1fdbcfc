"""Bands of a telemetry event's rows, and the wheel rates as latent variables in each.

The rows of an event are turned into modes (a constant and cosines, orthonormal over the rows that
are used, diagonal for a random walk) and a remainder that is faster than all of them. White channel
noise is the same in every band, the motion of the wheels is not: slow bands hold all of it. So what
a measured wheel rate says of the true one differs by band: docs/telemetry-likelihood.md §3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cassini_bayes.statistics import EventStatistics, Layout
from cassini_bayes.terms import RAD_S_PER_RPM

Array = NDArray[np.float64]
EDGES: Final = (32, 128)  # of the bands, in modes: what is slower than T/16, then T/64
ROWS_PER_MODE: Final = 2
SPARSE_S: Final = 4.0  # per row and more: a wheel's ramp takes 16 s to end, within a few rows
SPARSE_EDGES: Final = (0.5, 0.75)  # of the bands of sparse rows, in rows
STILL: Final = 0.5  # probability that wheels do not move in a band
SPARSE_STILL: Final = 0.2  # the same in the fast bands of sparse rows
_INDEPENDENT: Final = 1e-9  # least share of the largest square that a mode of its own has
_LEAST_SQUARE: Final = 1e-18  # rad²/s², or of the noise: wheels not measured to move at all
_LEAST_SPREAD: Final = 1e-14
LOG_MOTION: Final = (-9.0, 34.0)  # range of the log of the wheels' motion over their noise
_LOG_NOISE: Final = (-32.0, 12.0)  # range of the log of the noise over the measured mean square
_NODES: Final = 800


@dataclass(frozen=True)
class Band:
    """Part of the row space: modes of similar frequency, or all that is faster than the modes.

    ``values`` (W,) are the measured wheel rates' mean squares, rad²/s², along the principal axes
    ``vectors`` (W, W); ``walk`` (R,) or (1,) are the variances of a unit random walk's modes, s.
    ``motion`` is None where wheels move by any amount at all frequencies.
    """

    rows: int
    values: Array
    vectors: Array
    walk: Array
    motion: CubicSpline | None  # of :func:`motion_table`


Bands = tuple[Band, tuple[Band, ...], Array, tuple[Array, ...]]
_MADE: WeakKeyDictionary[EventStatistics, Bands] = WeakKeyDictionary()


def make_bands(statistics: EventStatistics) -> Bands:
    """Split an event's rows into bands, once for all models of the event.

    In slews the wheels are what turns the body, at every frequency that the controller has: nothing
    is said of them in any band, and next to nothing lost, the rates being far above their noise.

    Returns the slow band, the fast bands (octaves of the faster modes, and all that no mode
    explains), all columns' coordinates (3, A, M) on the slow modes, and the Gram matrices
    (3, 3, A, A) of the fast bands.
    """
    if statistics not in _MADE:
        _MADE[statistics] = _bands(statistics)
    return _MADE[statistics]


def _bands(statistics: EventStatistics) -> Bands:
    walk, modes = turned_modes(statistics)
    turning = statistics.kind == "slew"
    edges, still = _edges(statistics, len(walk)), STILL
    bands, grams, rest = [], [], statistics.gram
    for start, stop in pairwise(edges):
        part = modes[..., start:stop]
        gram = np.einsum("cam,dbm->cdab", part, part)
        motion = None if turning else motion_table(stop - start, still)
        bands.append(_band(statistics.layout, gram, walk[start:stop], stop - start, motion))
        grams.append(gram)
        rest = rest - gram
        still = SPARSE_STILL if is_sparse(statistics) else STILL
    rows = statistics.rows - len(walk)
    if rows > 0:
        # Σ 1/m² over the cosines that are not there: all of their variance on the rows left
        beyond = 2.0 * statistics.duration_s / np.pi**2 / (len(walk) - 0.5)
        left = np.array([beyond * statistics.rows / rows])
        motion = None if turning else motion_table(rows, still)
        bands.append(_band(statistics.layout, rest, left, rows, motion))
        grams.append(rest)
    return bands[0], tuple(bands[1:]), modes[..., : bands[0].rows], tuple(grams[1:])


def is_sparse(statistics: EventStatistics) -> bool:
    """Whether wheels still move at the highest frequencies that an event's rows can show."""
    return statistics.kind != "slew" and statistics.duration_s > SPARSE_S * statistics.rows


def _edges(statistics: EventStatistics, modes: int) -> list[int]:
    """First modes of the bands, and the end of the last."""
    inner = {*EDGES}
    if is_sparse(statistics):
        places = [int(share * statistics.rows) for share in SPARSE_EDGES]
        inner = {*(edge for edge in EDGES if edge < places[0]), *places}
    return [0, *sorted(edge for edge in inner if 0 < edge < modes), modes]


def _band(layout: Layout, gram: Array, walk: Array, rows: int, motion: CubicSpline | None) -> Band:
    square = gram[0, 0, layout.wheel, layout.wheel]
    values, vectors = np.linalg.eigh(square / rows)
    return Band(rows, np.maximum(values, _LEAST_SQUARE), vectors, walk, motion)


def turned_modes(statistics: EventStatistics) -> tuple[Array, Array]:
    """Constant and cosines, turned to be orthonormal over the rows with a diagonal random walk.

    Momentum gained from white torque noise of density a² has a mean of variance a² T/3 and cosine
    coefficients of variance 2 a² T/(m π)² (Karhunen-Loève expansion of a random walk about its
    mean). Returns the variances (M,) over a² and all columns' coordinates (3, A, M).
    """
    layout, gram = statistics.layout, statistics.gram
    count = len(statistics.mode_gram)
    order = np.arange(1, count + 1)
    scale = np.sqrt(statistics.duration_s) * np.r_[1.0 / np.sqrt(3.0), np.sqrt(2.0) / order / np.pi]
    one = layout.one
    mixed = statistics.projection[:, 0, one]
    square = np.block(
        [[gram[0, 0, one, one][None, None], mixed[None]], [mixed[:, None], statistics.mode_gram]]
    )
    values, turn = np.linalg.eigh(scale[:, None] * square * scale)
    most = max(statistics.rows // (1 if is_sparse(statistics) else ROWS_PER_MODE), 1)
    kept = np.flatnonzero(values > _INDEPENDENT * values[-1])[::-1][:most]
    values, turn = values[kept], turn[:, kept]
    constant = np.stack([gram[0, c, one] for c in range(3)])
    seen = np.concatenate([constant[None], statistics.projection])
    return values, np.einsum("lm,l,lca->cam", turn / np.sqrt(values), scale, seen)


def latent_wheels(band: Band, parameters: Mapping[str, Array]) -> tuple[Array, Array]:
    """Best linear estimate of the true wheel rates of the slow band, and their own log density.

    Along every principal axis the R measured rates have variance V = S + σ². With even odds there
    is no motion, S = 0, or the log of S/σ² is uniform on :data:`LOG_MOTION`. Returns the matrix
    E[S/V] (n, W, W) that takes measured rates to their estimate, and the log density (n,),
    constants left out; in slews all is motion, and the density flat.
    """
    if band.motion is None:
        n = len(parameters["wheel_noise_rpm"])
        return np.broadcast_to(np.eye(len(band.values)), (n, *band.vectors.shape)), np.zeros(n)
    noise = (parameters["wheel_noise_rpm"][:, None] * RAD_S_PER_RPM) ** 2
    log_density, spread = _looked_up(band, band.values / noise)
    kept = (band.vectors * (1.0 - spread)[:, None, :]) @ band.vectors.T
    return kept, (log_density - 0.5 * band.rows * np.log(noise)).sum(-1)


def estimated_wheels(
    band: Band, moments: Array, other: Array, weights: Array, noise: Array
) -> tuple[Array, Array]:
    """Best estimate of the true wheel rates of a fast band, and the log density of the band.

    The wheels are seen twice: measured, and through the momentum that everything else lacks,
    u = H ρ + e. The mean squares of both together say how much of it is motion
    (docs/telemetry-likelihood.md §3).

    Parameters
    ----------
    moments
        (n, 3 + W, 3 + W) mean products of u, N m s, and the measured rates, rad/s.
    other
        (n, 3, 3) covariance of e.
    weights
        (n, 3, W) H, momentum per wheel rate.
    noise
        (n,) variance of measured wheel rates.

    Returns
    -------
    The matrix (n, W, W) that takes measured rates to their estimate, and the log density (n,) of
    u and ρ_m beyond their quadratic form at that estimate; constants left out.
    """
    wheels, half = weights.shape[-1], 0.5 * band.rows
    each = np.eye(wheels) / noise[:, None, None]
    by_other = np.swapaxes(np.linalg.solve(other, weights), -1, -2)
    factor = np.linalg.cholesky(each + by_other @ weights)
    # of unit noise: what both say of the wheels together
    together = np.linalg.solve(factor, np.concatenate([by_other, each], axis=-1))
    squares, axes = np.linalg.eigh(together @ moments @ np.swapaxes(together, -1, -2))
    log_density, spread = _looked_up(band, squares)
    # K = S (S + σ²)⁻¹ for S = X (1/q − 1) Xᵀ, q the spread: well conditioned for any q in 0 … 1
    axes = np.linalg.solve(np.swapaxes(factor, -1, -2), axes)
    moving = axes * np.sqrt((1.0 - spread) / noise[:, None])[:, None, :]
    inner = np.swapaxes(moving, -1, -2) @ moving + spread[:, :, None] * np.eye(wheels)
    kept = moving @ np.linalg.solve(inner, np.swapaxes(moving, -1, -2))
    explained = np.maximum(squares, _LEAST_SQUARE) * spread
    own = np.einsum("nab,nba->n", np.eye(wheels) - kept, moments[:, 3:, 3:]) / noise
    log_total = log_density.sum(-1) + half * (
        explained.sum(-1) - own - np.linalg.slogdet(other)[1] - wheels * np.log(noise)
    )
    return kept, log_total


def _looked_up(band: Band, squares: Array) -> tuple[Array, Array]:
    """Log density of measured rates, and E[1/(1 + s)], by their mean squares over the noise."""
    assert band.motion is not None
    # below the table's end the density is flat, above it is all motion
    log_square = np.clip(np.log(np.maximum(squares, _LEAST_SQUARE)), -_LOG_NOISE[1], None)
    log_density, explained = np.moveaxis(band.motion(np.maximum(-log_square, _LOG_NOISE[0])), -1, 0)
    spread = np.clip(explained * np.exp(-log_square), _LEAST_SPREAD, 1.0)
    return log_density - 0.5 * band.rows * log_square, spread


def motion_table(rows: int, no_motion: float = STILL) -> CubicSpline:
    """Log density of R measured rates and E[V̂/(σ² (1 + s))], against t = log(σ²/V̂).

    With V̂ their mean square, h = R/2 and s = S/σ² zero, of probability ``no_motion``, or of density
    ds/s on e^LOG_MOTION, the density times V̂^h is the mean of
    exp(−h (t + log(1 + s) + e^(−t)/(1 + s))). Both depend on R and ``no_motion`` alone.
    Gauss-Legendre sums over log s: about the peak at s = e^(−t) − 1, whose width in log V
    is (2/R)^½, and on either side of it.
    """
    half = 0.5 * rows
    width = half**-0.5
    low, high = np.arcsinh(np.array(_LOG_NOISE) / width)
    t = np.clip(width * np.sinh(np.linspace(low, high, _NODES)), *_LOG_NOISE)[:, None]
    peak = np.maximum(np.expm1(np.maximum(-t, 0.0)), width)
    spread = np.minimum(width * (1.0 + peak) / peak, 1.0)
    inner = [np.clip(np.log(peak) + sign * 12.0 * spread, *LOG_MOTION) for sign in (-1.0, 1.0)]
    edges = [np.full_like(t, LOG_MOTION[0]), *inner, np.full_like(t, LOG_MOTION[1])]
    parts = [_legendre(a, b, n) for (a, b), n in zip(pairwise(edges), (48, 160, 48), strict=True)]
    log_s, weight = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    log_v = np.logaddexp(0.0, log_s)
    exponent = -half * (t + log_v + np.exp(-t - log_v))
    still = -half * (t + np.exp(-t))
    top = np.maximum(exponent.max(axis=1, keepdims=True), still)
    moves = (1.0 - no_motion) / (LOG_MOTION[1] - LOG_MOTION[0])
    density = moves * weight * np.exp(exponent - top)
    at_rest = no_motion * np.exp(still - top)[:, 0]
    total = density.sum(axis=1) + at_rest
    noise_share = (at_rest + (density * np.exp(-log_v)).sum(axis=1)) / total
    explained = np.exp(-t[:, 0]) * noise_share
    return CubicSpline(t[:, 0], np.stack([top[:, 0] + np.log(total), explained], axis=1))


def _legendre(low: Array, high: Array, count: int) -> tuple[Array, Array]:
    """Nodes and weights (T, count) of Gauss-Legendre sums between bounds (T, 1)."""
    node, weight = np.polynomial.legendre.leggauss(count)
    half = 0.5 * (high - low)
    return low + half * (1.0 + node), half * weight
