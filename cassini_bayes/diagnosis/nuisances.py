"""What the baseline takes up in place of a cause: its free quantities with and without that cause.

About a mode the balance is linear in all unknowns (:mod:`.innovations`): with X its columns, P the
prior precision and m the prior mean as departures from the mode, they are normal about

    c = G⁻¹ (Xᵀ y + P m),   G = XᵀX + P,

with covariance G⁻¹. Walked parameters are standard normals z there, thrust levels are their common
mean and ``shared`` times coefficients that are standard normal before the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.sizes import effect_draws, effect_values
from cassini_bayes.effects.effect import Remainder

LEAST_SHIFT: Final = 0.5
"""Prior standard deviations that a cause gives back before a quantity is said to take it up."""
MOST_SHIFTS: Final = 4  # of these: more are not read
LEVEL: Final = "thrust level of"
DRAWS: Final = 2_000  # of a trade: its contours are drawn, not read


@dataclass(frozen=True)
class NuisanceShift:
    """A quantity that the baseline bends: departures from its prior mean in prior σ.

    ``baseline`` without the cause, ``extended`` with it.
    """

    quantity: str
    baseline: float
    extended: float


@dataclass(frozen=True)
class Trade:
    """A size of a cause against the free quantity that it trades with most.

    ``posterior`` (n, 2) and ``prior`` (n, 2) are draws of both, size first, in the units of their
    names or in ``unit``; ``correlation`` is that of the posterior.
    """

    cause: str
    size: str
    quantity: str
    correlation: float
    posterior: Array
    prior: Array
    unit: str = ""

    @property
    def record(self) -> dict[str, Any]:
        """Without the draws."""
        return {
            "cause": self.cause,
            "size": self.size,
            "quantity": self.quantity,
            "correlation": self.correlation,
        }


@dataclass(frozen=True)
class _Gaussian:
    """Normal approximation: walked coordinates, then the coefficients of thrust levels."""

    mean: Array
    covariance: Array


def nuisance_shifts(
    before: Weighed[Hypothesis], after: Weighed[Hypothesis]
) -> list[dict[str, Any]]:
    """What the baseline bends further from its prior than the extended model, most first.

    Both with what they leave of telemetry.
    """
    without, with_cause = _departures(before), _departures(after)
    result = [
        NuisanceShift(name, value, with_cause[name])
        for name, value in without.items()
        if name in with_cause
    ]
    taken_up = [b for b in result if abs(b.baseline) - abs(b.extended) > LEAST_SHIFT]
    taken_up.sort(key=lambda b: abs(b.extended) - abs(b.baseline))
    return [asdict(b) for b in taken_up[:MOST_SHIFTS]]


def traded(weighed: Weighed[Hypothesis], rng: np.random.Generator) -> Trade | None:
    """The first size of a cause with what it trades with most; None where nothing else is free."""
    assert weighed.remainder is not None
    effect = weighed.hypothesis.effects[0]
    size = (effect.kind.reported or tuple(p.key for p in effect.parameters))[0]
    posterior = _values(weighed, _drawn(weighed, rng))
    others = {name: values for name, values in posterior[1].items() if values.std() > 0.0}
    sizes = posterior[0][size]
    if not others or not sizes.std() > 0.0:
        return None
    correlation = {name: float(np.corrcoef(sizes, values)[0, 1]) for name, values in others.items()}
    quantity = max(correlation, key=lambda name: abs(correlation[name]))
    width = len(weighed.mode.point) + weighed.hypothesis.model.thrust_prior.shared.shape[-1]
    before = _values(weighed, rng.standard_normal((DRAWS, width)))
    return Trade(
        effect.name,
        size,
        quantity,
        correlation[quantity],
        np.stack([sizes, others[quantity]], axis=1),
        np.stack([before[0][size], before[1][quantity]], axis=1),
        "N" if quantity.startswith(LEVEL) else "",
    )


def _gaussian(weighed: Weighed[Hypothesis]) -> _Gaussian:
    left: Remainder | None = weighed.remainder
    assert left is not None
    point = weighed.mode.point
    kept = len(point) + weighed.hypothesis.model.thrust_prior.shared.shape[-1]
    gram = left.linear.gram()
    mean = np.linalg.solve(gram, left.linear.columns.along(left.target))[:kept]
    covariance = np.linalg.solve(gram, np.eye(len(gram), kept))[:kept]
    return _Gaussian(np.asarray(mean, dtype=np.float64), np.asarray(covariance, dtype=np.float64))


def _drawn(weighed: Weighed[Hypothesis], rng: np.random.Generator) -> Array:
    """Draws (n, d + q): walked coordinates as sizes have them, levels' coefficients given these."""
    z, weights = effect_draws(weighed, rng, DRAWS)
    z = z[rng.choice(len(z), DRAWS, p=weights / weights.sum())]
    gaussian, d = _gaussian(weighed), z.shape[1]
    of_model, across = gaussian.covariance[:d, :d], gaussian.covariance[:d, d:]
    slope = np.linalg.solve(of_model, across)
    left = gaussian.covariance[d:, d:] - across.T @ slope
    spread = np.linalg.cholesky(0.5 * (left + left.T))
    levels = gaussian.mean[d:] + (z - gaussian.mean[:d]) @ slope
    levels += rng.standard_normal((DRAWS, len(left))) @ spread.T
    return np.concatenate([z, levels], axis=1)


def _values(
    weighed: Weighed[Hypothesis], drawn: Array
) -> tuple[Mapping[str, Array], dict[str, Array]]:
    """Sizes of the effects, and everything else that is free, by name, each (n,)."""
    model = weighed.hypothesis.model
    d = len(weighed.mode.point)
    of_effects = {p.name for effect in weighed.hypothesis.effects for p in effect.parameters}
    walked = model.space.to_parameters(drawn[:, :d])
    free = {name: np.asarray(walked[name]) for name in model.space.names if name not in of_effects}
    prior = model.thrust_prior
    levels = model.points(drawn[:, :d]).mean_levels_n + drawn[:, d:] @ prior.shared.T
    free |= {_level(name): levels[:, k] for k, name in enumerate(_thrusters(weighed))}
    return effect_values(weighed.hypothesis, drawn[:, :d]), free


def _departures(weighed: Weighed[Hypothesis]) -> dict[str, float]:
    """Departures from the prior mean in prior standard deviations, by name."""
    mean, prior = _gaussian(weighed).mean, weighed.hypothesis.model.thrust_prior
    d = len(weighed.mode.point)
    result = dict(zip(weighed.hypothesis.model.space.names, mean[:d].tolist(), strict=True))
    spread = np.sqrt((prior.shared**2).sum(-1))
    level = (prior.shared @ mean[d:]) / np.where(spread > 0.0, spread, np.inf)
    return result | {
        _level(name): float(z) for name, z in zip(_thrusters(weighed), level, strict=True)
    }


def _level(thruster: str) -> str:
    return f"{LEVEL} {thruster.upper()}"


def _thrusters(weighed: Weighed[Hypothesis]) -> tuple[str, ...]:
    model = weighed.hypothesis.model
    count = len(model.thrust_prior.shared)
    return model.spacecraft.thruster_names(model.branch)[:count]
