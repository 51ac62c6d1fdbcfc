"""Twelve moments of inertia, predicted and estimated at four dates: how good are the estimates?

Between the slews of 2000 and 2003 the predictions stay within 0.15 %, while the same method's
estimates change by +2.3, +3.1 and +1.4 %. A wheel inertia that is wrong scales all estimates of all
dates alike, and a prediction's bias all dates of an axis: neither changes from date to date.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import logsumexp
from scipy.stats import chi2

from cassini_bayes.computing.arrays import Array
from cassini_bayes.published import inertia_comparisons, inertia_tensors

AXES: Final = ("xx", "yy", "zz")
WHEEL_SD: Final = 0.01  # of the wheels' spin inertia, common to all (paper 003)
BIAS_SD: Final = 0.02  # of the predictions of an axis, same at all dates: a judgement
PREDICTION_SD: Final = 0.003  # of one prediction beyond that: propellant and released masses
CLAIMED_SD: Final = 0.01  # "± 1 %" read as one standard deviation, the lenient reading
SDS: Final = np.geomspace(0.002, 0.10, 200)
"""Estimator's errors that are weighed, as likely per factor."""


@dataclass(frozen=True)
class EstimatorError:
    """Posterior of the estimator's error (one standard deviation, relative), and a test."""

    sds: Array
    weights: Array
    p_claimed: float  # of changes between dates as large as these if the claimed error held
    wheel: tuple[float, float]  # mean and sd of the wheel-inertia scale, relative

    @property
    def mean(self) -> float:
        """Posterior mean."""
        return float(self.weights @ self.sds)

    def quantile(self, level: float) -> float:
        """Posterior quantile."""
        return float(np.interp(level, np.cumsum(self.weights), self.sds))


def moment_ratios() -> tuple[Array, tuple[str, ...]]:
    """Logarithm of estimated over predicted moments (4 dates, 3 axes), and the dates."""
    result: dict[str, dict[str, dict[str, float]]] = {}
    for tensor in inertia_tensors():
        if tensor.paper == "000":
            for axis in AXES:
                own = result.setdefault(tensor.date.isoformat(), {}).setdefault(axis, {})
                own[tensor.kind] = tensor.elements[axis].value
    for cell in inertia_comparisons():
        if cell.element in AXES:
            result.setdefault(cell.slew_day.isoformat(), {})[cell.element] = {
                "predicted": cell.predicted_kg_m2.value,
                "estimated": cell.estimated_kg_m2.value,
            }
    dates = tuple(sorted(result))
    ratios = [
        [np.log(result[d][axis]["estimated"] / result[d][axis]["predicted"]) for axis in AXES]
        for d in dates
    ]
    return np.array(ratios), dates


def estimator_error(ratios: Array, claimed_sd: float = CLAIMED_SD) -> EstimatorError:
    """Weigh the estimator's error; bias of every axis and wheel scale are integrated out.

    ratio_da = w − b_a + ε_da, all normal: w the wheel scale, b_a the bias of an axis's predictions.
    """
    dates, axes = ratios.shape
    same_axis = np.kron(np.ones((dates, dates)), np.eye(axes))
    shared = WHEEL_SD**2 + BIAS_SD**2 * same_axis
    y = ratios.ravel()

    def covariance(sd: float) -> Array:
        return np.asarray(shared + (sd**2 + PREDICTION_SD**2) * np.eye(len(y)))

    log_density, wheel = [], []
    for sd in SDS:
        matrix = covariance(sd)
        solved = np.linalg.solve(matrix, y)
        log_density.append(-0.5 * (y @ solved + np.linalg.slogdet(2 * np.pi * matrix)[1]))
        ones = np.ones(len(y))
        gain = WHEEL_SD**2 * np.linalg.solve(matrix, ones)
        wheel.append((gain @ y, WHEEL_SD**2 * (1.0 - gain @ ones)))
    weights = np.exp(np.array(log_density) - logsumexp(log_density))
    mean, variance = np.array(wheel).T
    centre = float(weights @ mean)
    within = ratios - ratios.mean(0)
    statistic = float((within**2).sum() / (claimed_sd**2 + PREDICTION_SD**2))
    return EstimatorError(
        SDS,
        weights,
        float(chi2.sf(statistic, (dates - 1) * axes)),
        (centre, float(np.sqrt(weights @ (variance + (mean - centre) ** 2)))),
    )
