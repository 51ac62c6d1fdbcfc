"""Baseline and extended models: the joint model with effects, ``none`` and ``unknown``.

``none`` is the baseline without torque noise, a cause is ``none`` with one effect more, ``unknown``
is the baseline with torque noise (and totals' hold rates) at a wide prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics import ExtraColumn, Samples
from cassini_bayes.diagnosis.kinematics import (
    RateInformation,
    combined,
    rate_information,
    rate_log_likelihood,
)
from cassini_bayes.effects.catalogue import AXES, Catalogue, Effect
from cassini_bayes.effects.columns import telemetry_columns
from cassini_bayes.effects.modifiers import modifier_of
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.event_reduction import ReducedEvent, reduce_samples, sampling_of
from cassini_bayes.model.posterior import (
    Event,
    Model,
    build_model,
    log_posterior,
    with_equal_bands_merged,
    without_idle,
)
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.priors.reader import Priors

Array = NDArray[np.float64]
TORQUE_NOISE = "torque_noise_n_m_s05"
HOLD_RATE = "hold_rate_rad_s"
RATE_KINDS = ("rate_bias", "rate_scale")
HOLD_LOG_SD = 1.0
FARTHEST = 8.0
# With a discrepancy nothing needs a nuisance that far out, and where inertias and a torque noise of
# many standard deviations trade with each other the likelihood is not one of anything that flies.
UNKNOWN_FARTHEST = 6.0
WALL = 1e3
LEAST = -1e12


@dataclass(frozen=True)
class TelemetrySource:
    """One event's telemetry, kept as rows: a diagnosis looks at it more than once."""

    id: str
    kind: str
    wheels: tuple[int, ...]
    thrusters: tuple[str, ...]
    samples: Samples

    @property
    def duration_s(self) -> float:
        """Time of the last row."""
        return float(self.samples.time_s[-1])


@dataclass(frozen=True)
class Oscillation:
    """A damped oscillation about a body axis (0, 1, 2): frequency and damping of it clamped.

    Departures from them are counted in what ``span_s`` can tell apart: 1/T of the frequency,
    1/(ΩT) of the damping. ``step_s`` lies between the rates that tell how the body moves.
    """

    frequency_hz: float
    damping: float
    axis: int
    log_looks: float = 0.0  # nats that the search costs
    log_gain: float = 0.0  # nats that it found, about what the fit had left
    span_s: float = 3_600.0
    step_s: float = 1.0


@dataclass(frozen=True)
class Case:
    """All that is diagnosed together, reduced with the catalogue's columns.

    ``oscillation`` is what the columns of ``flexible_mode`` were made from, if there are any.
    """

    priors: Priors
    sources: tuple[TelemetrySource, ...]
    reduced: tuple[ReducedEvent, ...]
    totals: tuple[TotalsEvent, ...]
    rates: RateInformation
    oscillation: Oscillation | None = None

    @property
    def inputs(self) -> tuple[str, ...]:
        """Kinds of input there are."""
        found = ("telemetry",) if self.sources else ()
        return (*found, "totals") if self.totals else found

    @property
    def events(self) -> tuple[Event, ...]:
        """All events, totals rows first."""
        return (*self.totals, *self.reduced)

    @property
    def wheels(self) -> tuple[int, ...]:
        """Wheels that the events use."""
        return tuple(sorted({number for event in self.events for number in event.wheels}))

    def without(self, event: str) -> Case:
        """The case with one telemetry event left out."""
        keep = [i for i, source in enumerate(self.sources) if source.id != event]
        sources = tuple(self.sources[i] for i in keep)
        return replace(
            self,
            sources=sources,
            reduced=tuple(self.reduced[i] for i in keep),
            rates=combined([rate_information(source.samples) for source in sources]),
        )


def prepare(
    sources: Sequence[TelemetrySource],
    priors: Priors,
    totals: Sequence[TotalsEvent] = (),
    pulse_shape: str = "first_order",
) -> Case:
    """Reduce telemetry with every column that an effect may need."""
    reduced = tuple(
        reduce_source(source, priors, telemetry_columns(source.thrusters), pulse_shape)
        for source in sources
    )
    rates = combined([rate_information(source.samples) for source in sources])
    return Case(priors, tuple(sources), reduced, tuple(totals), rates)


def reduce_source(
    source: TelemetrySource,
    priors: Priors,
    extra: Sequence[ExtraColumn],
    pulse_shape: str = "first_order",
) -> ReducedEvent:
    """One event's Gram matrices with extra columns, which see the whole event at once."""
    sampling = sampling_of(priors, source.thrusters, source.duration_s, pulse_shape, extra)
    return reduce_samples(
        source.id, source.kind, source.wheels, source.thrusters, source.samples, sampling
    )


@dataclass(frozen=True)
class Hypothesis:
    """A model to weigh: its name, log posterior density in z, and prior probability.

    ``effects`` are those it has beyond the baseline; their walked coordinates are the last ones of
    the model's space.
    """

    name: str
    model: Model
    effects: tuple[Effect, ...]
    prior_probability: float
    rates: RateInformation | None
    oscillation: Oscillation | None = None  # that of flexible_mode
    farthest: float = FARTHEST

    @property
    def log_penalty(self) -> float:
        """What a search before the fit cost (nats)."""
        return 0.0 if self.oscillation is None else self.oscillation.log_looks

    @property
    def dimension(self) -> int:
        """Number of walked coordinates."""
        return len(self.model.space.names)

    def log_density(self, z: Array) -> Array:
        """Log likelihood plus log prior (n,) at z (n, d).

        Beyond ``farthest`` prior standard deviations a steep wall stands in, and points where the
        likelihood has no value get the least there is: searches may step there.
        """
        inside = np.clip(z, -self.farthest, self.farthest)
        wall = WALL * ((z - inside) ** 2).sum(-1)
        try:
            return np.asarray(self._inside(inside) - wall)
        except np.linalg.LinAlgError:
            found = np.concatenate([self._one(point[None]) for point in inside])
            return np.asarray(found - wall)

    def _one(self, z: Array) -> Array:
        try:
            return self._inside(z)
        except np.linalg.LinAlgError:
            return np.array([LEAST])

    def _inside(self, z: Array) -> Array:
        value = np.nan_to_num(log_posterior(self.model, z), nan=LEAST, neginf=LEAST)
        if self.rates is None:
            return value
        parameters = self.model.space.to_parameters(z)
        errors = {kind: np.zeros((len(z), 3)) for kind in RATE_KINDS}
        for effect in self.effects:
            if effect.kind in RATE_KINDS:
                column = AXES.index(effect.target)
                errors[effect.kind][:, column] += parameters[effect.parameters[0].name]
        return value + rate_log_likelihood(self.rates, errors[RATE_KINDS[0]], errors[RATE_KINDS[1]])


def none_hypothesis(case: Case, catalogue: Catalogue) -> Hypothesis:
    """The baseline without torque noise."""
    priors = case.priors
    if case.sources:
        priors = priors.with_fixed(TORQUE_NOISE, 0.0)
    model = build_model(case.events, priors, keep_idle=True)
    return Hypothesis("none", model, (), catalogue.none_probability, None)


def unknown_hypothesis(case: Case, catalogue: Catalogue) -> Hypothesis:
    """The baseline with a discrepancy: torque noise and totals' hold rates at wide priors."""
    priors = case.priors
    if case.sources:
        priors = priors.with_distribution(TORQUE_NOISE, catalogue.unknown.torque_noise)
    if case.totals:
        priors = priors.with_distribution(HOLD_RATE, _wider_hold(priors, catalogue))
    model = build_model(case.events, priors, keep_idle=True)
    return Hypothesis(
        "unknown", model, (), catalogue.unknown_probability, None, farthest=UNKNOWN_FARTHEST
    )


def _wider_hold(priors: Priors, catalogue: Catalogue) -> Distribution:
    middle = priors.parameters[HOLD_RATE].mean
    return Distribution(
        "lognorm", {"s": HOLD_LOG_SD, "scale": catalogue.unknown.hold_rate_factor * middle}
    )


def extend(base: Hypothesis, effects: Sequence[Effect], case: Case) -> Hypothesis:
    """A hypothesis with more effects; its walked coordinates come after those there are."""
    old = base.model
    parameters = [parameter for effect in effects for parameter in effect.parameters]
    space = ParameterSpace(
        (*old.space.names, *(p.name for p in parameters)),
        old.space.fixed,
        (*old.space.distributions, *(p.distribution for p in parameters)),
        (*old.space.blocks, *("effect" for _ in parameters)),
    )
    line = case.oscillation
    setting = (old.spacecraft, old.branch, 2 if line is None else line.axis)
    added = tuple(modifier_of(effect, *setting) for effect in effects)
    in_rows = tuple(modifier_of(effect, *setting, rows=True) for effect in effects)
    model = replace(
        old,
        space=space,
        totals=tuple(replace(t, modifiers=(*t.modifiers, *added)) for t in old.totals),
        telemetry=tuple(replace(t, modifiers=(*t.modifiers, *in_rows)) for t in old.telemetry),
    )
    together = (*base.effects, *effects)
    uses_rates = any(effect.kind in RATE_KINDS for effect in together)
    probability = base.prior_probability if base.effects else 1.0
    for effect in effects:
        probability *= effect.prior_probability
    return Hypothesis(
        "+".join(effect.name for effect in together),
        model,
        together,
        probability,
        case.rates if uses_rates else None,
        line if any(effect.kind == "flexible_mode" for effect in together) else None,
    )


def compact(hypothesis: Hypothesis) -> Hypothesis:
    """The same hypothesis without columns that have no weight and bands that are alike: faster."""
    return replace(hypothesis, model=with_equal_bands_merged(without_idle(hypothesis.model)))
