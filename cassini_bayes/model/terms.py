"""What a model adds up: terms that depend on thrusts and parameters.

Totals rows and telemetry events are two kinds of :class:`Term`. A model knows of a term only what
stands here, so what it adds up is a plain sum.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np

from cassini_bayes.balance.physics import Modifier, Physics, physics_of
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.model.thrusts import ThrustInformation, ThrustPrior
from cassini_bayes.spacecraft import Spacecraft

Variable = tuple[tuple[str, ...], Array, str, str]
"""Dims, values, unit and meaning of a quantity of the record."""
TermDraws = Mapping[str, Array]
"""What a term has of its own beside thrusts, drawn: name → (n, …)."""
TORQUE = "external_torque_n_m"
"""The steady external torque (n, E, 3) of a term's events, which every term has."""
STEP: Final = 0.05
"""In prior standard deviations, of walked coordinates about the prior's centre."""
ALL_POINTS: Final = 1_000_000
"""As many points at once as anybody asks for: for terms whose points are small."""


def slopes_of(values: Array) -> Array:
    """Slopes (d, …) in the walked coordinates of values (1 + 2 d, …) at the centre, up and down."""
    d = len(values) // 2
    return np.asarray((values[1 : d + 1] - values[d + 1 :]) / (2.0 * STEP))


@dataclass(frozen=True)
class Shared:
    """What all terms of a model share: spacecraft, branch, priors of what is integrated out."""

    spacecraft: Spacecraft
    branch: str
    wheels: tuple[int, ...]  # numbers of those that any event uses, in file order
    thrust_prior: ThrustPrior
    torque_mean_n_m: Array  # (3,)
    torque_sd_n_m: Array  # (3,)

    @property
    def fires(self) -> bool:
        """Whether any event has thrusters that fired."""
        return len(self.thrust_prior.shared) > 0


@dataclass(frozen=True)
class Points:
    """n points: every parameter as an (n,) array, and the physics there.

    Physics is worked out once for all terms that have the same effects.
    """

    shared: Shared
    parameters: Mapping[str, Array]
    n: int
    _physics: dict[tuple[Modifier, ...], Physics] = field(default_factory=dict, repr=False)

    @cached_property
    def common_n(self) -> Array:
        """The level about which thrusts are counted, (n,) N."""
        return self.shared.thrust_prior.common_at(self.parameters, self.n)

    @cached_property
    def mean_levels_n(self) -> Array:
        """Expected thrust levels without effects, (n, K) N: common, walked or of an earlier fit."""
        prior = self.shared.thrust_prior
        mean = prior.mean_at(self.parameters, self.common_n)
        return np.broadcast_to(mean, (self.n, len(prior.shared)))

    def physics(self, modifiers: tuple[Modifier, ...]) -> Physics:
        """The physics with some effects."""
        if modifiers not in self._physics:
            shared = self.shared
            self._physics[modifiers] = physics_of(
                shared.spacecraft, shared.branch, self.parameters, modifiers, fires=shared.fires
            )
        return self._physics[modifiers]


class TermAt(Protocol):
    """A term at n points, everything of its own integrated out."""

    @property
    def log_likelihood(self) -> Array:
        """Log likelihood (n,) of what does not depend on thrusts."""

    @property
    def information(self) -> ThrustInformation:
        """Information of the events that fire on their thrusts, (n, E', …)."""

    @property
    def stretch(self) -> Array:
        """Effective over commanded on-time (n, E', K) of the events that fire."""

    def draw(self, thrust_n: Array, rng: np.random.Generator) -> TermDraws:
        """What is integrated out, drawn back given the thrusts (n, E', K)."""

    def log_density(self, thrust_n: Array, draws: TermDraws) -> Array:
        """Log density (n, E) of each event's data given everything, its thrusts included."""

    def expected_information(self, first: int) -> Iterator[tuple[int, Array]]:
        """Expected information on the standardised unknowns of every event, with its number.

        The points are the prior's centre, then one :data:`STEP` up and one down along every walked
        coordinate; ``first`` is the number of the term's first event.
        """

    def variables(self, draws: TermDraws, /) -> Mapping[str, Variable]:
        """Quantities of the record beside thrusts, torques and walked parameters.

        An ``event`` dimension holds the term's own events, a ``wheel`` one all wheels there are.
        """

    def replicates(
        self, thrust_n: Array, draws: TermDraws, rng: np.random.Generator, /
    ) -> Mapping[str, Variable]:
        """Data of the same events flown again, and what is left of their balance."""

    def statistics(self, thrust_n: Array, /) -> Mapping[str, Variable]:
        """Figures of merit of every draw."""


@dataclass(frozen=True)
class TermEvent:
    """One event of a term: its id and kind, whether it fires, how many nuisances are its own."""

    id: str
    kind: str
    fires: bool
    nuisances: int


class Term(Protocol):
    """Some events of one kind, as a part of a model."""

    @property
    def events(self) -> tuple[TermEvent, ...]:
        """Its events in order."""

    @property
    def most_points(self) -> int:
        """At how many points it may be worked out at once: telemetry takes 10 kB for each."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters it needs, in the order in which they are walked."""

    @property
    def integrated(self) -> tuple[str, ...]:
        """Its own parameters whose priors act although they are not walked."""

    @property
    def density_name(self) -> str:
        """Variable of the record for the log density of its events' data."""

    def at(self, points: Points) -> TermAt:
        """The term at n points."""

    def thrust_factor(self, points: Points) -> Array | None:
        """Factors (n, E', K) of effects on the levels in the events that fire, if any."""

    def draw_prior(self, torque_n_m: Array, rng: np.random.Generator) -> TermDraws:
        """Its own unknowns from their priors, with the torques (n, E, 3) already drawn."""

    def log_prior(self, draws: TermDraws) -> Mapping[str, Array]:
        """Log prior densities (n,) of its own draws but the torque, by block."""

    def observed(self) -> Mapping[str, Variable]:
        """What was measured, per event."""

    def constants(self) -> Mapping[str, Variable]:
        """Known figures, per event."""
