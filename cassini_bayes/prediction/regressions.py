"""Small linear-Gaussian regressions, integrated out exactly per draw of the physics.

y = X β + ε, ε_e ~ N(0, s² v_e), β ~ N(m, diag(sd²)), and s² scaled inverse χ² with few degrees of
freedom. All functions broadcast over a leading axis of draws and return one draw of
β (and s²) per draw of X, so the uncertainty of the physics and that of β stay together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array

SCALE_WEIGHT: Final = 4.0
"""Virtual observations of s² that its scaled inverse χ² prior stands for."""


@dataclass(frozen=True)
class Regression:
    """One draw of coefficients (n, p) and noise scale s² (n,) per draw of the physics."""

    coefficients: Array
    scale_square: Array


def regress(
    design: Array,
    target: Array,
    variance: Array,
    prior: Sequence[tuple[float, float]],
    rng: np.random.Generator,
    *,
    size: int,
    scale: float = 1.0,
) -> Regression:
    """Draw β, s² given data: s² from its distribution at the mode of β, then β given s².

    design (..., E, p), target (..., E), variance (E,), ``prior`` mean and standard deviation of
    each β. s² is drawn from the scaled inverse χ² of the residuals at the conditional mean of β for
    s² = ``scale``, that of its prior (a plug-in for the joint draw; the data are few, and what it
    neglects is smaller than the prior of s²).
    """
    prior_mean, prior_sd = np.array(prior).T.copy()
    design = np.broadcast_to(design, (size, *design.shape[-2:]))
    target = np.broadcast_to(target, (size, target.shape[-1]))
    p = design.shape[-1]
    centre, _ = conditional(design, target, variance, prior_mean, prior_sd, scale)
    left = target - (design @ centre[..., None])[..., 0]
    total = SCALE_WEIGHT * scale + (left**2 / variance).sum(-1)
    square = total / rng.chisquare(SCALE_WEIGHT + target.shape[-1], size)
    mean, factor = conditional(design, target, variance, prior_mean, prior_sd, square)
    normals = rng.standard_normal((size, p, 1))
    step = np.linalg.solve(np.swapaxes(factor, -1, -2), normals)[..., 0]
    return Regression(np.asarray(mean + prior_sd * step), square)


def conditional(
    design: Array,
    target: Array,
    variance: Array,
    prior_mean: Array,
    prior_sd: Array,
    square: Array | float,
) -> tuple[Array, Array]:
    """Mean (n, p) of β given s², and the Cholesky factor of the precision of β / prior_sd."""
    weight = 1.0 / np.sqrt(np.asarray(square)[..., None] * variance)
    white = design * prior_sd * weight[..., None]
    misfit = (target - design @ prior_mean) * weight
    precision = np.swapaxes(white, -1, -2) @ white + np.eye(len(prior_sd))
    shift = np.swapaxes(white, -1, -2) @ misfit[..., None]
    mean = np.linalg.solve(precision, shift)[..., 0]
    return np.asarray(prior_mean + prior_sd * mean), np.asarray(np.linalg.cholesky(precision))
