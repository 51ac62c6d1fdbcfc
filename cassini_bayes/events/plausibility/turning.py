"""Do body rates and the turns of the attitude tell the same motion?

Turn over step y = M x + bias, x the mean recorded rate of the step; M is the identity if both are
right. Rates are a noisy regressor, and plain least squares would find a factor below 1 out of noise
alone. The rates just before and after the step know the same motion with other noise: as
instruments z they give Σ (y − M x) zᵀ = 0 on average at the true M, with the covariance
Σ_u ⊗ Σ z zᵀ of its moments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.arrays import Array
from cassini_bayes.events.plausibility.attitudes import turns_rad
from cassini_bayes.events.plausibility.rows import Motion

GYRO_SD: Final = 0.01
"""Scale factors and misalignments of a gyro that are physics: the catalogue's rate_scale."""
LONGEST_STEP: Final = 3.0
"""Of the median: over longer gaps the mean of two rates is no mean rate."""
LEAST_STEPS: Final = 20


@dataclass(frozen=True, eq=False)
class Turning:
    """Moments of turns with rates: what any map of recorded rates to true ones leaves of them."""

    turned: Array  # Σ y zᵀ (3, 3)
    recorded: Array  # Σ x zᵀ (3, 3)
    instruments: Array  # Σ z zᵀ (3, 3)
    variance: Array  # (3,) of one step's residual, by axis of the turn
    steps: int

    @property
    def map(self) -> Array:
        """M at its best; NaN where the recorded rates do not vary."""
        if np.linalg.matrix_rank(self.recorded) < 3:
            return np.full((3, 3), np.nan)
        return np.asarray(np.linalg.solve(self.recorded.T, self.turned.T).T)

    def sd_of_map(self) -> Array:
        """Standard deviations (3, 3) of the map."""
        if np.linalg.matrix_rank(self.recorded) < 3:
            return np.full((3, 3), np.inf)
        inverse = np.linalg.inv(self.recorded)
        spread = np.diag(inverse.T @ self.instruments @ inverse)
        return np.sqrt(np.outer(self.variance, spread))

    def factor(self, axes: Sequence[int]) -> float:
        """The one factor of recorded rates that brings turns about some axes nearest."""
        inverse = np.linalg.inv(self.instruments)
        weights = 1.0 / self.variance[list(axes)]
        turned, recorded = self.turned[list(axes)], self.recorded[list(axes)]
        common = float(np.sum(weights[:, None] * (turned @ inverse) * recorded))
        own = float(np.sum(weights[:, None] * (recorded @ inverse) * recorded))
        return common / own if own > 0.0 else np.nan

    def misfit(self, rate: Array, axes: Sequence[int] = (0, 1, 2)) -> float:
        """χ² of the moments if true rates are ``rate`` (3, 3) times those recorded.

        A gyro's scale factors and misalignments may lean away from it at a price.
        """
        recorded = rate @ self.recorded
        total = 0.0
        for axis in axes:
            gap = self.turned[axis] - recorded[axis]
            lean = GYRO_SD**2 * recorded.T @ recorded
            total += float(gap @ np.linalg.solve(self.variance[axis] * self.instruments + lean, gap))
        return total


def turning_of(motion: Motion) -> Turning | None:
    """The moments; None where there are too few steps or nothing varies."""
    step_s = np.diff(motion.time_s)
    rates = motion.rate_rad_s
    if len(step_s) < LEAST_STEPS:
        return None
    turned = turns_rad(motion.attitude) / step_s[:, None]
    mean = 0.5 * (rates[1:] + rates[:-1])
    around = np.zeros_like(mean)
    around[1:-1] = 0.5 * (rates[:-3] + rates[3:])
    good = step_s <= LONGEST_STEP * np.median(step_s)
    good[[0, -1]] = False
    y, x, z = (v[good] - v[good].mean(axis=0) for v in (turned, mean, around))
    scale = np.abs(z).max(axis=0)
    z = z / np.where(scale > 0.0, scale, 1.0)
    # a trace of ridge: a rate that never varies is no instrument, and must not divide by zero
    inner = z.T @ z + 1e-9 * np.eye(3)
    moments = Turning(y.T @ z, x.T @ z, inner, np.ones(3), len(y))
    best = moments.map
    left = y - x @ best.T if np.isfinite(best).all() else y
    variance = np.maximum(np.mean(left**2, axis=0), 1e-24)
    return Turning(moments.turned, moments.recorded, inner, variance, len(y))
