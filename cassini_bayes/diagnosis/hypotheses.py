"""Hypotheses on the momentum balance: the baseline, with effects, and with a discrepancy.

``none`` is the baseline without torque noise, a cause is ``none`` with an effect more, ``unknown``
is the baseline with torque noise (and totals' hold rates) at a wide prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.processes import over_parts
from cassini_bayes.diagnosis.case import NONE, UNKNOWN
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.effects.effect import Effect, settled_for
from cassini_bayes.model.posterior import (
    Model,
    build_model,
    log_posterior,
    with_effects,
    with_equal_bands_merged,
    without_idle,
)
from cassini_bayes.model.telemetry import TORQUE_NOISE, TelemetryTerm
from cassini_bayes.model.terms import Points
from cassini_bayes.priors.distributions import Distribution

HOLD_RATE: Final = "hold_rate_rad_s"
FARTHEST: Final = 8.0
"""Prior standard deviations at which a wall stands for what every model has: what lies further has
a prior of 1e-15 (judgement)."""
EFFECT_FARTHEST: Final = 30.0
"""Of the sizes of an effect, which may be far larger than anybody expects: beyond, likelihoods stay
what they are at the edge (:func:`~cassini_bayes.model.posterior.log_posterior`). With the wall of
the others a leak of 0.4 mN, thirteen of its prior's scales, was ``unknown`` by 30,000 nats."""
UNKNOWN_FARTHEST: Final = 6.0
"""With a discrepancy nothing needs a nuisance that far out, and where inertias and a torque noise
of many standard deviations trade with each other the likelihood is not one of anything that flies:
it won by 1,900 nats in a blind trial (docs/results/diagnosis-campaigns.md)."""
WALL: Final = 1e3  # nats per squared standard deviation: steeper than any likelihood bends back
LEAST: Final = -1e12  # log density where the likelihood has no value: below all that have one


@dataclass(frozen=True)
class Hypothesis:
    """A model to weigh: its name, log posterior density in z, and prior probability."""

    name: str
    model: Model
    prior_probability: float
    farthest: float = FARTHEST

    @property
    def effects(self) -> tuple[Effect, ...]:
        """What it has beyond the baseline; their coordinates are the last ones of the space."""
        return self.model.effects

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(effect.name for effect in self.effects)

    @property
    def log_penalty(self) -> float:
        """What searches before the fit cost (nats)."""
        return sum(result.log_looks for result in settled_for(self.effects))

    @property
    def dimension(self) -> int:
        """Number of walked coordinates."""
        return len(self.model.space.names)

    @property
    def sizes(self) -> slice:
        """Places of the effects' coordinates."""
        own = sum(len(effect.parameters) for effect in self.effects)
        return slice(self.dimension - own, self.dimension)

    def part_of(self, other: Hypothesis, z: Array) -> Array:
        """What a point z of a hypothesis that has all coordinates of this one is here (d,)."""
        at = dict(zip(other.model.space.names, z, strict=True))
        return np.array([at[name] for name in self.model.space.names])

    def log_density(self, z: Array) -> Array:
        """Log likelihood plus log prior (n,) at z (n, d).

        Beyond ``farthest`` prior standard deviations, of effects :data:`EFFECT_FARTHEST`, a steep
        wall stands in, and points where the likelihood has no value get the least there is:
        searches may step there.
        """
        reach = np.full(self.dimension, self.farthest)
        reach[self.sizes] = EFFECT_FARTHEST
        inside = np.clip(z, -reach, reach)
        wall = WALL * ((z - inside) ** 2).sum(-1)
        try:
            return np.asarray(over_parts(self._inside, inside) - wall)
        except np.linalg.LinAlgError:
            values = np.concatenate([self._one(point[None]) for point in inside])
            return np.asarray(values - wall)

    def _one(self, z: Array) -> Array:
        try:
            return self._inside(z)
        except np.linalg.LinAlgError:
            return np.array([LEAST])

    def _inside(self, z: Array) -> Array:
        return np.nan_to_num(log_posterior(self.model, z), nan=LEAST, neginf=LEAST)


_BASELINES: Final[WeakKeyDictionary[Events, Hypothesis]] = WeakKeyDictionary()


def none_hypothesis(events: Events) -> Hypothesis:
    """The baseline without torque noise; made once for the same events."""
    if events not in _BASELINES:
        _BASELINES[events] = _none_hypothesis(events)
    return _BASELINES[events]


def _none_hypothesis(events: Events) -> Hypothesis:
    priors = events.priors
    if events.telemetry:
        priors = priors.with_fixed(TORQUE_NOISE, 0.0)
    model = build_model(events.all, priors, keep_idle=True)
    model.require_walked()
    return Hypothesis(NONE, model, events.catalogue.odds.none)


def unknown_hypothesis(events: Events) -> Hypothesis:
    """The baseline with a discrepancy: torque noise and totals' hold rates at wide priors."""
    priors, unknown = events.priors, events.catalogue.unknown
    if events.telemetry:
        priors = priors.with_distribution(TORQUE_NOISE, unknown.torque_noise)
    if events.rows:
        middle = priors.parameters[HOLD_RATE].mean
        wider = {"s": unknown.hold_rate_log_sd, "scale": unknown.hold_rate_factor * middle}
        priors = priors.with_distribution(HOLD_RATE, Distribution("lognorm", wider))
    model = build_model(events.all, priors, keep_idle=True)
    return Hypothesis(UNKNOWN, model, events.catalogue.odds.unknown, farthest=UNKNOWN_FARTHEST)


def thrust_factors(term: TelemetryTerm, located: Points) -> Array:
    """By what effects multiply the levels of an event's thrusters at n points, (n, K); else 1."""
    thrusters = term.balance.pattern.thrusters
    factor = term.thrust_factor(located) if thrusters else None
    return np.ones((located.n, thrusters)) if factor is None else factor[:, 0]


def expected_thrusts_n(term: TelemetryTerm, located: Points) -> Array:
    """Mean levels (n, K), N, of an event's thrusters at n points, times effects' factors."""
    factors = thrust_factors(term, located)
    return located.mean_levels_n[:, : factors.shape[1]] * factors


def extend(base: Hypothesis, effects: Sequence[Effect]) -> Hypothesis:
    """A hypothesis with more effects; its walked coordinates come after those there are."""
    probability = base.prior_probability if base.effects else 1.0
    for effect in effects:
        probability *= effect.prior_probability
    model = with_effects(base.model, effects)
    return Hypothesis("+".join(effect.name for effect in model.effects), model, probability)


def compact(hypothesis: Hypothesis) -> Hypothesis:
    """The same hypothesis without columns that have no weight and bands that are alike: faster."""
    return replace(hypothesis, model=with_equal_bands_merged(without_idle(hypothesis.model)))
