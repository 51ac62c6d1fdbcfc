"""The navigation requirement (paper 001): ΔV predicted to 3 % of nominal, 3 sigma, per component.

The nominal value is the predictive median; "3 sigma" is read as a probability of 99.73 %. Where a
component is next to nothing (X and Y of a wheel bias: couples cancel) 3 % of it has no meaning, so
only components of at least 1 mm/s are judged; the others' spread is reported. Predictive
distributions have long tails (a restless limit cycle), so spread is half the central 68.27 %
interval, which is the standard deviation of a normal and does not hang on the tails.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.prediction.learning import Learned
from cassini_bayes.prediction.predict import SOURCES, predict
from cassini_bayes.prediction.requests import BiasRequest

TOLERANCE: Final = 0.03  # of nominal in each component, 3 σ (paper 001)
REQUIRED_PROBABILITY: Final = 0.9973  # of a normal within 3 σ
LEAST_COMPONENT_M_S: Final = 1e-3
_ONE_SIGMA: Final = (0.158655, 0.841345)


@dataclass(frozen=True)
class Requirement:
    """How well one ΔV component meets the requirement.

    ``probability`` that the outcome lies within 3 % of the predicted median (NaN for a component
    below 1 mm/s); ``without_m_s`` is the spread that is left when a source is known exactly.
    """

    axis: str
    nominal_m_s: float
    spread_m_s: float
    probability: float
    without_m_s: Mapping[str, float]

    @property
    def met(self) -> bool:
        """Whether the requirement holds at 3 sigma."""
        return self.probability >= REQUIRED_PROBABILITY


def requirements(learned: Learned, request: BiasRequest, seed: int) -> tuple[Requirement, ...]:
    """Judge every body component of the computed ΔV; empty without a ΔV.

    The same random numbers serve all sources: differences are not noise of the draws.
    """
    draws = _delta_v(learned, request, seed)
    if draws is None:
        return ()
    held = {source: _delta_v(learned, request, seed, source) for source in SOURCES}
    result = []
    for axis, name in enumerate("xyz"):
        along = draws[:, axis]
        nominal = float(np.median(along))
        judged = abs(nominal) >= LEAST_COMPONENT_M_S
        probability = float((np.abs(along - nominal) <= TOLERANCE * abs(nominal)).mean())
        without = {
            str(source): spread(other[:, axis])
            for source, other in held.items()
            if other is not None
        }
        result.append(
            Requirement(name, nominal, spread(along), probability if judged else np.nan, without)
        )
    return tuple(result)


def spread(draws: Array) -> float:
    """Half the central 68.27 % interval of draws (n,), in their unit."""
    low, high = np.quantile(draws, _ONE_SIGMA)
    return float(0.5 * (high - low))


def _delta_v(learned: Learned, request: BiasRequest, seed: int, *sources: str) -> Array | None:
    hold = frozenset(source for source in SOURCES if source in sources)
    return predict(learned, request, np.random.default_rng(seed), hold).delta_v_computed_m_s
