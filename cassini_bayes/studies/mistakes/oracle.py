"""What a mistake does to the answer, and whether the data could have told: by Laplace's posterior.

The model is fitted to the data as they should be and as they are recorded. A mistake matters if it
moves the mean of any inferred scalar by more than three posterior standard deviations. It cannot be
known if the recorded data, read as they stand, are as dense under physics at its best as they are
under the mistake: less than two nats apart. Physics is given what the catalogue of effects holds:
priors of geometry, inertias, thrusts and tails five times as wide, all at once, and besides any one
effect with the catalogue's own prior (late counters, a leak, a gyro's scale, …) or a torque that
nobody catalogued. The data as they should be are given the same. Left out is what a search settles
before the fit: a boom's frequency. No threshold of the checks enters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import UNKNOWN
from cassini_bayes.diagnosis.events import Events, prepare
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.modes import LOG_2_PI, Mode, mode_at
from cassini_bayes.diagnosis.search import newton_search
from cassini_bayes.errors import CassiniBayesError
from cassini_bayes.events.telemetry import Chunk, TelemetryEvent
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.draws import draw
from cassini_bayes.model.event_reduction import (
    ReducedEvent,
    reduce_samples,
    samples_of,
    sampling_of,
)
from cassini_bayes.model.posterior import (
    Model,
    build_model,
    log_posterior,
    with_effects,
    without_idle,
)
from cassini_bayes.model.telemetry import TORQUE_NOISE
from cassini_bayes.priors.reader import Priors
from cassini_bayes.sampling.warmstart import highest_mode, laplace

MATTERS: Final = 3.0
"""Posterior standard deviations that a scalar moves by: what a 90 % interval no longer holds."""
TELLS: Final = 2.0
"""Nats between a mistake and physics from which on data tell them apart: a ratio of seven."""
DRAWS: Final = 400  # widths to 4 %: a scalar that moves by three is no question of that
CATALOGUE_WIDTH: Final = 5.0
"""Of priors: the catalogue's effects have five to ten times the baseline's."""
_WIDENED: Final = ("thrust_", "cm_", "rwa", "inertia_", "tau_fall", "thruster_")


Recorded = tuple[TelemetryEvent, Chunk] | TotalsEvent
"""An event as its reader gives it."""


@dataclass(frozen=True)
class Answer:
    """Means and standard deviations of inferred scalars."""

    mean: Mapping[str, float]
    sd: Mapping[str, float]

    def moved(self, other: Answer) -> float:
        """The largest shift of a scalar to another answer, in standard deviations of this one.

        Of scalars that both have: a mistake in counters may leave rows without late pulses.
        """
        both = ((name, sd) for name, sd in self.sd.items() if name in other.mean)
        return max(abs(other.mean[name] - self.mean[name]) / sd for name, sd in both)


@dataclass(frozen=True)
class Physics:
    """Log density of data at its best under wide priors, and under each cause besides (nats).

    ``rows`` are those of telemetry that enter the density; 1 for totals.
    """

    log_density: float
    causes: Mapping[str, float]
    rows: int

    @property
    def best(self) -> float:
        """Log density under what fits best; no effect is physics too."""
        return max(self.log_density, *self.causes.values())


def answer_of(recorded: Sequence[Recorded], priors: Priors) -> Answer | None:
    """Laplace's posterior of telemetry or totals; None where the package declines the data."""
    try:
        return _laplace(build_model([_taken(one, priors) for one in recorded], priors))
    except CassiniBayesError:
        return None


def physics_of(recorded: Sequence[Recorded], priors: Priors) -> Physics | None:
    """How dense data are under the catalogue; None where the package declines them."""
    try:
        events = [_taken(one, priors) for one in recorded]
        telemetry = [event for event in events if isinstance(event, ReducedEvent)]
        totals = [event for event in events if isinstance(event, TotalsEvent)]
        rows = sum(event.statistics.rows for event in telemetry) if telemetry else 1
        return _densest(prepare(telemetry, priors, totals), rows)
    except CassiniBayesError:
        return None


def with_catalogue(priors: Priors) -> Priors:
    """Priors as wide as the catalogue's effects."""
    free = [name for name in priors.parameters if name.startswith(_WIDENED)]
    return priors.scaled(free, CATALOGUE_WIDTH)


def _taken(recorded: Recorded, priors: Priors) -> ReducedEvent | TotalsEvent:
    """An event as a model takes it."""
    if isinstance(recorded, TotalsEvent):
        return recorded
    event, samples = recorded[0], samples_of(recorded[1])
    sampling = sampling_of(priors, event.thrusters, float(samples.time_s[-1]), "first_order")
    return reduce_samples(event.id, event.kind, event.wheels, event.thrusters, samples, sampling)


def _densest(events: Events, rows: int) -> Physics:
    """Wide priors, and on them every single effect and a torque of nobody's catalogue, at best.

    Targets and sizes of effects are those of the priors as they are.
    """
    wide, catalogue = with_catalogue(events.priors), events.catalogue
    full = build_model(events.all, wide, keep_idle=True)
    base = _mode(without_idle(full))
    causes = {}
    for effect in catalogue.effects:
        if not effect.needs_search:
            model = without_idle(with_effects(full, [effect]))
            cause = Hypothesis(effect.name, model, effect.prior_probability)
            causes[effect.name] = _peak(newton_search(cause, base).mode)
    if events.telemetry:
        unknown = wide.with_distribution(TORQUE_NOISE, catalogue.unknown.torque_noise)
        causes[UNKNOWN] = _peak(_mode(build_model(events.all, unknown)))
    return Physics(_peak(base), causes, rows)


def _peak(mode: Mode) -> float:
    """Log density at a mode, with priors at their peaks as one: a coordinate more is no loss."""
    return mode.value + 0.5 * LOG_2_PI * len(mode.point)


def _mode(model: Model) -> Mode:
    density = partial(log_posterior, model)
    start = highest_mode(density, model.starts)
    return mode_at(density, *laplace(density, start))


def _laplace(model: Model) -> Answer:
    found = _mode(model)
    rng = np.random.default_rng(0)
    z = found.point + rng.standard_normal((DRAWS, len(found.point))) @ found.factor.T
    draws = draw(model, z, rng)
    values: dict[str, Array] = {
        name: np.asarray(draws.parameters[name]) for name in model.space.names
    }
    for e, event in enumerate(model.fired_ids):
        for k, thruster in enumerate(model.thrusters):
            values[f"thrust_n[{event},{thruster}]"] = draws.thrusts.thrust_n[:, e, k]
    return Answer(
        {name: float(value.mean()) for name, value in values.items()},
        {name: float(value.std()) for name, value in values.items() if np.ptp(value) > 0.0},
    )
