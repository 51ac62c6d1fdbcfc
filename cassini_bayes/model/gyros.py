"""Attitude against integrated rates as a term of a model, where effects are errors of the gyros.

The balance takes measured rates as they are; that the quaternions do not agree with them is said
here (:mod:`cassini_bayes.balance.rate_information`). The term has no events: it is of parameters
alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from cassini_bayes.balance.rate_information import RateInformation, rate_log_likelihood
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.effect import Effect
from cassini_bayes.model.terms import ALL_POINTS, TORQUE, Points, TermDraws, TermEvent, Variable
from cassini_bayes.model.thrusts import ThrustInformation
from cassini_bayes.model.unknowns import Unknowns


@dataclass(frozen=True)
class GyroTerm:
    """What all attitudes and rates say of the gyros' bias and scale, which effects add up to."""

    information: RateInformation
    effects: tuple[Effect, ...]
    events: tuple[TermEvent, ...] = ()
    parameters: tuple[str, ...] = ()
    integrated: tuple[str, ...] = ()
    density_name: str = "gyros"
    most_points: int = ALL_POINTS

    def at(self, points: Points) -> GyrosAt:
        """The channel at n points."""
        bias, scale = np.zeros((points.n, 3)), np.zeros((points.n, 3))
        for effect in self.effects:
            if effect.kind.rate_errors is not None:
                setting = effect.setting(points.shared.spacecraft, points.shared.branch)
                added = effect.kind.rate_errors(effect.values(points.parameters), setting)
                bias, scale = bias + added[0], scale + added[1]
        return GyrosAt(self, points, bias, scale)

    def draw_prior(self, torque_n_m: Array, _rng: np.random.Generator) -> TermDraws:
        """Nothing of its own."""
        return {TORQUE: torque_n_m}

    def log_prior(self, _draws: TermDraws) -> Mapping[str, Array]:
        """Nothing."""
        return {}

    def observed(self) -> Mapping[str, Variable]:
        """Nothing: the channels are those of the telemetry terms."""
        return {}

    def constants(self) -> Mapping[str, Variable]:
        """Nothing."""
        return {}


@dataclass(frozen=True)
class GyrosAt:
    """The channel at n points, with bias (n, 3) rad/s and scale (n, 3) there."""

    term: GyroTerm
    points: Points
    bias_rad_s: Array
    scale: Array

    @property
    def log_likelihood(self) -> Array:
        """Log likelihood ratio (n,) against gyros without errors."""
        return rate_log_likelihood(self.term.information, self.bias_rad_s, self.scale)

    @property
    def information(self) -> ThrustInformation:
        """None on thrusts."""
        return ThrustInformation.nothing(self.points.n, len(self.points.shared.thrust_prior.shared))

    @property
    def stretch(self) -> Array:
        """Of no event, (n, 0, K)."""
        return self.information.vector

    def draw(self, _thrust_n: Array, _rng: np.random.Generator) -> TermDraws:
        """No event, no torque."""
        return {TORQUE: np.zeros((self.points.n, 0, 3))}

    def log_density(self, _thrust_n: Array, _draws: TermDraws) -> Array:
        """Of no event, (n, 0)."""
        return np.zeros((self.points.n, 0))

    def expected_information(
        self, unknowns: Unknowns, _first: int, step: float
    ) -> Iterator[tuple[int, Array]]:
        """On walked parameters alone; counted with the first event, whose unknowns have them."""
        d = unknowns.walked.stop
        errors = np.stack([self.bias_rad_s, self.scale], axis=-1)
        slopes = (errors[1 : d + 1] - errors[d + 1 :]) / (2.0 * step)
        total = np.zeros((len(unknowns.of_event(0)),) * 2)
        precision = self.term.information.precision
        total[:d, :d] = np.einsum("uai,aij,vaj->uv", slopes, precision, slopes)
        yield 0, total

    def variables(self, _draws: TermDraws) -> Mapping[str, Variable]:
        """Nothing: sizes of effects are walked."""
        return {}

    def replicates(
        self, _thrust_n: Array, _draws: TermDraws, _rng: np.random.Generator
    ) -> Mapping[str, Variable]:
        """Nothing."""
        return {}

    def statistics(self, _thrust_n: Array) -> Mapping[str, Variable]:
        """Nothing."""
        return {}
