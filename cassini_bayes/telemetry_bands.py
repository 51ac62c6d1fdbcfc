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

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc, gammaln

from cassini_bayes.statistics import EventStatistics, Layout
from cassini_bayes.terms import RAD_S_PER_RPM

Array = NDArray[np.float64]
EDGES: Final = (32, 64)  # of the bands, in modes: what is slower than T/16, and octaves
ROWS_PER_MODE: Final = 4
_INDEPENDENT: Final = 1e-9  # least share of the largest square that a mode of its own has
_LEAST_SQUARE: Final = 1e-18  # rad²/s²: wheels that were not measured to move at all
_LOG_RANGE: Final = 14.0  # of the variance of wheel rates that move, over their noise
_UNDERFLOW: Final = 1e-250


@dataclass(frozen=True)
class Band:
    """Part of the row space: modes of similar frequency, or all that is faster than the modes.

    ``values`` (W,) are the measured wheel rates' mean squares, rad²/s², along the principal axes
    ``vectors`` (W, W); ``walk`` (R,) or (1,) are the variances of a unit random walk's modes, s.
    """

    rows: int
    values: Array
    vectors: Array
    walk: Array


def make_bands(
    statistics: EventStatistics,
) -> tuple[Band, tuple[Band, ...], Array, tuple[Array, ...]]:
    """Split an event's rows into bands.

    Returns the slow band, the fast bands (octaves of the faster modes, and all that no mode
    explains), all columns' coordinates (3, A, M) on the slow modes, and the Gram matrices
    (3, 3, A, A) of the fast bands.
    """
    walk, modes = turned_modes(statistics)
    edges = [0, *(edge for edge in EDGES if edge < len(walk)), len(walk)]
    bands, grams, rest = [], [], statistics.gram
    for start, stop in pairwise(edges):
        part = modes[..., start:stop]
        gram = np.einsum("cam,dbm->cdab", part, part)
        bands.append(_band(statistics.layout, gram, stop - start, walk[start:stop]))
        grams.append(gram)
        rest = rest - gram
    bands.append(_band(statistics.layout, rest, statistics.rows - len(walk), np.zeros(1)))
    return bands[0], tuple(bands[1:]), modes[..., : bands[0].rows], (*grams[1:], rest)


def _band(layout: Layout, gram: Array, rows: int, walk: Array) -> Band:
    square = gram[0, 0, layout.wheel, layout.wheel]
    values, vectors = np.linalg.eigh(square / max(rows, 1))
    return Band(rows, np.maximum(values, _LEAST_SQUARE), vectors, walk)


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
    most = np.maximum(statistics.rows // ROWS_PER_MODE, 1)
    kept = np.flatnonzero(values > _INDEPENDENT * values[-1])[::-1][:most]
    values, turn = values[kept], turn[:, kept]
    constant = np.stack([gram[0, c, one] for c in range(3)])
    seen = np.concatenate([constant[None], statistics.projection])
    return values, np.einsum("lm,l,lca->cam", turn / np.sqrt(values), scale, seen)


def latent_wheels(band: Band, parameters: Mapping[str, Array]) -> tuple[Array, Array]:
    """Best linear estimate of the true wheel rates in a band, and the wheels' own log density.

    Along every principal axis the R measured rates have variance V = S + σ². Either the wheels do
    not move in this band, S = 0, or log V is anywhere within e^14 above σ², with even odds. With
    h = R/2 and x = h V̂/σ², V̂ the mean square, the two have marginal densities

        σ^(−R) e^(−x)   and   (h V̂)^(−h) γ(h, x)/14,

    and in the second E[σ²/V] = γ(h + 1, x)/(x γ(h, x)). Returns the matrix 1 − E[σ²/V] (n, W, W)
    that takes measured rates to their estimate, and the log density (n,), constants left out.
    """
    noise = (parameters["wheel_noise_rpm"][:, None] * RAD_S_PER_RPM) ** 2
    half = 0.5 * band.rows
    x = half * band.values / noise
    still = -half * np.log(noise) - x
    below = _log_gamma_below(half, x)
    moving = below + gammaln(half) - half * np.log(half * band.values) - np.log(_LOG_RANGE)
    total = np.logaddexp(still, moving)
    noise_share = half / x * np.exp(_log_gamma_below(half + 1.0, x) - below)
    share = np.exp(moving - total) * (1.0 - np.minimum(noise_share, 1.0))
    kept = (band.vectors * share[:, None, :]) @ band.vectors.T
    return kept, total.sum(-1)


def _log_gamma_below(a: float, x: Array) -> Array:
    """Log of the regularised lower incomplete gamma function, far below its bulk as well.

    For x ≪ a the first terms of the series x^a e^(−x)/Γ(a+1) (1 + x/(a+1) + …) (DLMF 8.7.1).
    """
    value = gammainc(a, x)
    below = value < _UNDERFLOW
    ratio = np.minimum(x, a) / (a + 1.0)
    series = a * np.log(x) - x - gammaln(a + 1.0) - np.log1p(-ratio)
    return np.asarray(np.where(below, series, np.log(np.where(below, 1.0, value))))
