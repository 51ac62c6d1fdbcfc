"""Do body rates and the turns of the attitude tell the same motion?

Turn over step y = M x + bias, x the mean recorded rate of the step; M is the identity if both are
right. Rates are a noisy regressor, and plain least squares would find a factor below 1 out of noise
alone. The rates just before and after the step know the same motion with other noise: their mean
and their difference as instruments z give Σ (y − M x) zᵀ = 0 on average at the true M, with the
covariance Σ_u ⊗ Σ z zᵀ of its moments. The mean shows factors, axes and signs, the difference
rates that come early or late.
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
LAG_SD_S: Final = 0.5
"""Delays of a gyro's filter that are physics."""
INSTRUMENTS: Final = 6
LONGEST_STEP: Final = 3.0
"""Of the median: over longer gaps the mean of two rates is no mean rate."""
LEAST_STEPS: Final = 20


@dataclass(frozen=True, eq=False)
class Turning:
    """Moments of turns with rates: what any map of recorded rates to true ones leaves of them."""

    turned: Array  # Σ y zᵀ (3, 6)
    recorded: Array  # Σ x zᵀ (3, 6)
    quickened: Array  # Σ ẋ zᵀ (3, 6)
    instruments: Array  # Σ z zᵀ (6, 6)
    squares: tuple[Array, Array, Array]  # Σ y yᵀ, Σ x yᵀ, Σ x xᵀ (3, 3)
    steps: int

    def variance(self, rate: Array) -> Array:
        """Variance (3,) of one step's turn about the rates times ``rate``, by axis."""
        turned, common, recorded = self.squares
        left = turned - 2.0 * rate @ common + rate @ recorded @ rate.T
        return np.maximum(np.diag(left) / self.steps, 1e-24)

    def factor(self, axes: Sequence[int]) -> float:
        """The one factor of recorded rates that brings turns about some axes nearest."""
        inverse = np.linalg.inv(self.instruments)
        weights = 1.0 / self.variance(np.eye(3))[list(axes)]
        turned, recorded = self.turned[list(axes)], self.recorded[list(axes)]
        common = float(np.sum(weights[:, None] * (turned @ inverse) * recorded))
        own = float(np.sum(weights[:, None] * (recorded @ inverse) * recorded))
        return common / own if own > 0.0 else np.nan

    def misfit(self, rate: Array, axes: Sequence[int] = (0, 1, 2)) -> float:
        """χ² of the moments if true rates are ``rate`` (3, 3) times those recorded.

        A gyro's scale factors, misalignments and delays may lean away from it at a price.
        """
        recorded, quickened = rate @ self.recorded, LAG_SD_S * (rate @ self.quickened)
        variance, total = self.variance(rate), 0.0
        for axis in axes:
            gap = self.turned[axis] - recorded[axis]
            lean = GYRO_SD**2 * recorded.T @ recorded
            lean += np.outer(quickened[axis], quickened[axis])
            total += float(gap @ np.linalg.solve(variance[axis] * self.instruments + lean, gap))
        return total


def turning_of(motion: Motion) -> Turning | None:
    """The moments; None where there are too few steps or nothing varies."""
    step_s = np.diff(motion.time_s)
    rates = motion.rate_rad_s
    if len(step_s) < LEAST_STEPS:
        return None
    turned = turns_rad(motion.attitude) / step_s[:, None]
    mean = 0.5 * (rates[1:] + rates[:-1])
    quick = np.diff(rates, axis=0) / step_s[:, None]
    around = np.zeros((len(mean), INSTRUMENTS))
    around[1:-1] = np.concatenate([rates[:-3] + rates[3:], rates[3:] - rates[:-3]], axis=1)
    good = step_s <= LONGEST_STEP * np.median(step_s)
    good[[0, -1]] = False
    y, x, dx, z = (v[good] - v[good].mean(axis=0) for v in (turned, mean, quick, around))
    scale = np.abs(z).max(axis=0)
    z = z / np.where(scale > 0.0, scale, 1.0)
    # a trace of ridge: a rate that never varies is no instrument, and must not divide by zero
    inner = z.T @ z + 1e-9 * np.eye(INSTRUMENTS)
    return Turning(y.T @ z, x.T @ z, dx.T @ z, inner, (y.T @ y, x.T @ y, x.T @ x), len(y))
