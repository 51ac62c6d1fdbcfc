"""Two laws of thrust against tank pressure, and what each predicts of the recharge of 2006.

From the thrust at launch and in 2005 alone: proportional, or affine with an intercept whose prior
is centred on the proportional law. The recharge is printed as about +50 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import logsumexp
from scipy.stats import norm

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.mission.circumstances import KPA_PER_PSI
from cassini_bayes.published.anchors import anchors, thrust_anchors

DRAWS: Final = 400_000
THRUST_ERROR: Final = 0.02
"""Of a predicted thrust by itself. The thrust equation is good to 5-10 % (paper 000), but errors
that all its predictions share leave their ratio alone: a judgement."""
PRESSURE_ERROR: Final = 0.02  # of "about" 2635 kPa and "about" 255 psia, and of the planned 400
BEFORE: Final = (0.98, 0.02)
"""Pressure just before the recharge over that of early 2005, printed nowhere: a judgement."""
RATIO_ERROR: Final = 0.033  # of "approximately 50 %": ± 5 % of 1.5


@dataclass(frozen=True)
class LawPrediction:
    """What a law predicts of the thrust after the recharge over that before."""

    mean: float
    sd: float
    log_density: float  # of the printed ratio, in its logarithm
    intercept: tuple[float, float]  # mean and sd of the intercept's share given launch and 2005


def recharge_prediction(intercept_sd: float, rng: np.random.Generator) -> LawPrediction:
    """Predictive of one law; ``intercept_sd`` is 0 for the proportional law.

    Intercept and errors of the figures are drawn from their priors, weighed by launch over 2005.
    """
    launch = next(a.value.value for a in thrust_anchors("prediction"))
    of_2005 = next(a.value.value for a in thrust_anchors("prediction") if "day" in a.place)
    pressures = [a for a in anchors() if a.quantity == "pressure"]
    kpa = [a.value.value * (KPA_PER_PSI if a.unit == "psia" else 1.0) for a in pressures]
    share = intercept_sd * rng.standard_normal(DRAWS)
    errors = 1.0 + PRESSURE_ERROR * rng.standard_normal((3, DRAWS))
    start, middle, after = (value * error for value, error in zip(kpa, errors, strict=True))
    before = middle * (BEFORE[0] + BEFORE[1] * rng.standard_normal(DRAWS))
    sd = np.hypot(THRUST_ERROR, THRUST_ERROR)
    fell = np.log(_scale(share, start / kpa[1]) / _scale(share, middle / kpa[1]))
    weights = norm.logpdf(np.log(launch / of_2005), fell, sd)
    weights -= logsumexp(weights)
    rose = np.log(_scale(share, after / kpa[1]) / _scale(share, before / kpa[1]))
    printed = next(a.value.value for a in anchors() if a.quantity == "thrust_ratio")
    density = logsumexp(weights + norm.logpdf(np.log(printed), rose, RATIO_ERROR))
    mean, spread = _moments(np.exp(rose), np.exp(weights))
    return LawPrediction(mean, spread, float(density), _moments(share, np.exp(weights)))


def _scale(share: Array, relative: Array) -> Array:
    """Thrust over that of 2005, by the law u(p) = λ + (1 − λ) p."""
    return np.asarray(np.maximum(share + (1.0 - share) * relative, 1e-3))


def _moments(values: Array, weights: Array) -> tuple[float, float]:
    mean = float(weights @ values)
    return mean, float(np.sqrt(weights @ (values - mean) ** 2))
