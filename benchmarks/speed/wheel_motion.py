"""True wheel rates of every band, written again for numpy and for JAX: ``xp`` is the module.

Ours is :mod:`cassini_bayes.balance.bands`; docs/topics/telemetry-likelihood.md §3 has the formulas.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from cassini_bayes.balance.bands import Band

Values = Any  # arrays of either module
_LEAST_SQUARE = 1e-18
_LEAST_SPREAD = 1e-14


def slow_motion(xp: ModuleType, band: Band, noise: Values) -> tuple[Values, Values]:
    """Matrix (W, W) from measured to true wheel rates of the slow band; their log density.

    ``noise`` is the variance of measured wheel rates, rad²/s².
    """
    log_density, spread = _looked_up(xp, band, xp.asarray(band.values) / noise)
    kept = (band.vectors * (1.0 - spread)) @ band.vectors.T
    return kept, xp.sum(log_density - 0.5 * band.rows * xp.log(noise))


def fast_motion(
    xp: ModuleType, band: Band, moments: Values, other: Values, weights: Values, noise: Values
) -> tuple[Values, Values]:
    """Matrix (W, W) from measured to true wheel rates of a fast band; the band's log density.

    ``moments`` (3 + W, 3 + W) are mean products of the momentum that all but the wheels leaves to
    them and of the measured rates; ``other`` (3, 3) is the covariance of that momentum, wheels
    apart; ``weights`` (3, W) are momentum per wheel rate.
    """
    wheels = weights.shape[1]
    each = xp.eye(wheels) / noise
    by_other = xp.linalg.solve(other, weights).T
    factor = xp.linalg.cholesky(each + by_other @ weights)
    together = xp.linalg.solve(factor, xp.concatenate([by_other, each], axis=1))
    squares, axes = xp.linalg.eigh(together @ moments @ together.T)
    log_density, spread = _looked_up(xp, band, squares)
    axes = xp.linalg.solve(factor.T, axes)
    motion = (axes * ((1.0 - spread) / spread)) @ axes.T
    kept = xp.linalg.solve(motion + noise * xp.eye(wheels), motion)
    kept = 0.5 * (kept + kept.T)
    explained = xp.sum(xp.maximum(squares, _LEAST_SQUARE) * spread)
    own = xp.trace((xp.eye(wheels) - kept) @ moments[3:, 3:]) / noise
    log_det = xp.linalg.slogdet(other)[1] + wheels * xp.log(noise)
    return kept, xp.sum(log_density) + 0.5 * band.rows * (explained - own - log_det)


def _looked_up(xp: ModuleType, band: Band, squares: Values) -> tuple[Values, Values]:
    """Log density of measured rates, and their share of noise, by mean squares over the noise."""
    assert band.motion is not None  # slews have no table, and are not compared
    table, knots = xp.asarray(band.motion.c), xp.asarray(band.motion.x)
    log_square = xp.log(xp.maximum(squares, _LEAST_SQUARE))
    t = xp.clip(-log_square, band.motion.x[0], band.motion.x[-1])
    place = xp.clip(xp.searchsorted(knots, t, side="right") - 1, 0, len(band.motion.x) - 2)
    step = (t - knots[place])[:, None]
    cubic = table[:, place]
    found = ((cubic[0] * step + cubic[1]) * step + cubic[2]) * step + cubic[3]
    spread = xp.clip(found[:, 1] * xp.exp(-log_square), _LEAST_SPREAD, 1.0)
    return found[:, 0] - 0.5 * band.rows * log_square, spread


def mean_walk(band: Band) -> float:
    """Variance that a unit random walk has in a row of a fast band, s."""
    return float(np.mean(band.walk))
