"""A model: terms that add up to one collapsed posterior.

What all events share (pulse shape, centre of mass, geometry, wheels, inertia, noise) is walked;
thrusts, torques and what else an event has of its own are linear-Gaussian and integrated out, each
event's own first, then the shared thrust levels. The dimension that is walked does not grow with
events.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters
from cassini_bayes.computing.arrays import Array, joined
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.effects.effect import Effect, columns_of
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.telemetry import TORQUE_NOISE, TelemetryTerm, telemetry_terms
from cassini_bayes.model.terms import Points, Shared, Term, TermAt, TermEvent
from cassini_bayes.model.thrusts import (
    CollapsedThrusts,
    ThrustPrior,
    collapse_thrusts,
    level_factor,
    thrust_moments,
    thrust_prior_of,
)
from cassini_bayes.model.totals import DeltaVUse, TotalsTerm, totals_terms
from cassini_bayes.model.unknowns import Unknowns
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.priors.reader import Priors
from cassini_bayes.priors.starts import Starts
from cassini_bayes.spacecraft.parameters import EFFECT_BLOCK, LATE_FACTOR, TORQUES, ParameterSpec
from cassini_bayes.spacecraft.pulses import shape_named

TAIL: Final = "tau_fall_s"
RATE_NOISE: Final = "rate_noise_rad_s"
Event = TotalsEvent | ReducedEvent
_POINTS: Final = 4  # draws of the prior at which a column without weight is found
_BLOCK: Final = 400  # points at once, whose arrays stay in the processor's cache
_ROUGH: Final = 0.3  # of the expected thrust, wide beside any that data have told
_ROUGH_LATE: Final = 0.15  # the same where data tell them badly: judgement, twice what priors have
_ROUGH_STEPS: Final = np.linspace(-4.0, 4.0, 25)  # prior standard deviations
_ROUGH_TIMES: Final = 4  # about the expected thrust, and about what comes of that
_LEAST_ROUGH: Final = 0.3  # of the expected thrust: a logarithm is expanded about it
_UNLIKE: Final = 1.0  # of noise: prior standard deviations from the median
_FARTHEST_START: Final = 4.0  # prior standard deviations: what rows show may be beyond its bounds
_TAIL_STARTS: Final = (-2.0, 2.0)  # of a search, prior standard deviations beside the others
_FAR: Final = 30.0  # standard normals: beyond it quantiles overflow


@dataclass(frozen=True)
class Model(Shared):
    """Everything that stays constant during a fit.

    Events are those of the terms, totals rows first, then telemetry in order; thrusts are those of
    the events that fire.
    """

    space: ParameterSpace
    specs: Mapping[str, ParameterSpec]
    totals: tuple[TotalsTerm, ...]
    telemetry: tuple[TelemetryTerm, ...]
    idle: Mapping[str, float]  # parameters of wheels that no event uses
    priors: Priors
    effects: tuple[Effect, ...] = ()  # beyond the standard physics

    @property
    def terms(self) -> tuple[Term, ...]:
        """All terms in order."""
        return (*self.totals, *self.telemetry)

    @property
    def totals_rows(self) -> TotalsTerm:
        """The term of its totals rows, for those who take a model that has some."""
        (term,) = self.totals
        return term

    @property
    def sources(self) -> tuple[Event, ...]:
        """The events as they were given: totals rows, then reduced telemetry."""
        rows = (row for term in self.totals for row in term.rows)
        return (*rows, *(term.event for term in self.telemetry))

    @property
    def events(self) -> tuple[TermEvent, ...]:
        """All events in order."""
        return tuple(event for term in self.terms for event in term.events)

    @property
    def event_ids(self) -> tuple[str, ...]:
        """Ids of all events."""
        return tuple(event.id for event in self.events)

    @property
    def fired_ids(self) -> tuple[str, ...]:
        """Ids of the events with thrusts."""
        return tuple(event.id for event in self.events if event.fires)

    @property
    def thrusters(self) -> tuple[str, ...]:
        """Names of the branch's thrusters."""
        return self.spacecraft.thruster_names(self.branch)

    @property
    def integrated(self) -> tuple[str, ...]:
        """Parameters whose priors act although they are integrated out."""
        integrated_names = dict.fromkeys(name for term in self.terms for name in term.integrated)
        return (*self.thrust_prior.integrated, *TORQUES, *integrated_names)

    @cached_property
    def fired_of_term(self) -> tuple[slice, ...]:
        """Where every term's events are among those that fire."""
        return _side_by_side(sum(event.fires for event in term.events) for term in self.terms)

    @cached_property
    def events_of_term(self) -> tuple[slice, ...]:
        """Where every term's events are among all."""
        return _side_by_side(len(term.events) for term in self.terms)

    @property
    def unknowns(self) -> Unknowns:
        """Places of everything unknown, walked or integrated out."""
        prior = self.thrust_prior
        levels, departures = prior.shared.shape[1], prior.departures.shape[1]
        events = ((event.fires, event.nuisances) for event in self.events)
        return Unknowns.of(self.space.dimension, levels, departures, events)

    @property
    def starts(self) -> Starts:
        """Where searches for the mode begin: at the centre of the prior, and elsewhere.

        A density may have two modes, and from the centre alone a search ended at the lower one.
        In slews noise of rates can stand for that of wheels (50 nats too low): where rows show a
        noise unlike the expected one, a search begins with it. Slow rises with long tails that cut
        each other can stand for short tails (550 nats too low, a rise 8 standard deviations off):
        searches begin on both sides of the expected tail, always where rows have late pulses, and
        else where the mode is odd.
        """
        shown = _with_shown_noise(self.space, self.telemetry)
        starts = [np.zeros(self.space.dimension)]
        if np.abs(shown).max(initial=0.0) > _UNLIKE:
            starts.append(shown)
        points = np.stack(starts)
        if not self.telemetry or TAIL not in self.space.names:
            return Starts.of(points)
        of_tail = np.eye(self.space.dimension)[self.space.names.index(TAIL)]
        tails = np.stack([points[-1] + side * of_tail for side in _TAIL_STARTS])
        late = any(term.event.statistics.counters.has_late_pulses for term in self.telemetry)
        return Starts.of(np.concatenate([points, tails])) if late else Starts(points, tails)

    def require_walked(self) -> None:
        """Check that something is walked.

        Raises
        ------
        InputError
            All is fixed or integrated out: there is nothing to search or to sample.
        """
        if not self.space.names:
            raise InputError(
                f"{self.priors.path}: parameters",
                "a distribution for a parameter that is walked (thrusts and torques are not)",
                "all of them fixed",
                f"give one a distribution, e.g. {next(iter(self.space.fixed))}",
            )

    def points(self, z: Array) -> Points:
        """Every parameter the physics may ask for at walked coordinates z (n, d)."""
        return self.points_at(self.space.to_parameters(z), len(z))

    def points_at(self, parameters: Parameters, n: int) -> Points:
        """The same at n values of the walked and fixed parameters."""
        arrays = {
            name: value if isinstance(value, np.ndarray) else np.full(n, value)
            for name, value in {**self.idle, **parameters}.items()
        }
        return Points(self, arrays, n)

    def batches(self, n: int) -> Iterator[slice]:
        """Slices that cover n points, as many at a time as every term may have."""
        size = min(term.most_points for term in self.terms)
        for start in range(0, n, size):
            yield slice(start, min(start + size, n))


def _side_by_side(counts: Iterable[int]) -> tuple[slice, ...]:
    return tuple(slice(a, b) for a, b in pairwise(accumulate(counts, initial=0)))


def _with_shown_noise(space: ParameterSpace, terms: Sequence[TelemetryTerm]) -> Array:
    """The centre of the prior (d,), noise as differences of rows show it on average of events."""
    shown = [dict(term.event.sampling.reference_noise) for term in terms]
    centre = np.zeros(space.dimension)
    known = set(space.names).intersection(*shown) if shown else set()
    if not known:
        return centre
    levels = {name: np.exp(np.mean([np.log(own[name]) for own in shown])) for name in known}
    moved = space.to_standard({**space.to_parameters(centre), **levels})
    return np.clip(moved, -_FARTHEST_START, _FARTHEST_START)


def build_model(
    events: Sequence[Event],
    priors: Priors,
    *,
    pulse_shape: str = "first_order",
    delta_v: DeltaVUse = "as-declared",
    effects: Sequence[Effect] = (),
    keep_idle: bool = False,
) -> Model:
    """Assemble the model of any mix of totals rows and reduced telemetry events.

    Parameters
    ----------
    events
        Of one thruster branch. Telemetry is reduced already (:mod:`.event_reduction`).
    priors
        The priors file; every parameter the model needs must be in it.
    pulse_shape
        Of the totals rows: key of :data:`cassini_bayes.spacecraft.pulses.PULSE_SHAPES`.
    delta_v
        Of the totals rows. ``as-declared``: each row's ``delta_v_source`` decides; ``ignore``: ΔV
        is left out; ``as-measured``: every ΔV is taken as a measurement of thrust (a what-if).
    effects
        Beyond the standard physics (:func:`cassini_bayes.effects.catalogue.named_effects`); their
        parameters are walked after all others.
    keep_idle
        Keep the columns of telemetry that have no weight yet, for effects to be added;
        :func:`without_idle` drops them.

    Raises
    ------
    InputError
        No event; an id twice; events of another branch or wheel set; unknown pulse shape; a
        parameter that is missing, or that leaves nothing to estimate.
    """
    shape_named(pulse_shape, "model.pulse_shape")
    _require_distinct([event.id for event in events])
    rows = [event for event in events if isinstance(event, TotalsEvent)]
    reduced = [_with_columns(e, effects) for e in events if isinstance(e, ReducedEvent)]
    fires = bool(rows) or any(event.fires for event in reduced)
    shared = shared_of(priors, {number for event in events for number in event.wheels}, fires=fires)
    totals = totals_terms(rows, priors, shared, pulse_shape=pulse_shape, delta_v=delta_v)
    telemetry = telemetry_terms(reduced, priors, shared)
    terms: tuple[Term, ...] = (*totals, *telemetry)
    names = dict.fromkeys(name for term in terms for name in term.parameters)
    space = priors.space(names)
    model = Model(
        spacecraft=shared.spacecraft,
        branch=shared.branch,
        wheels=shared.wheels,
        thrust_prior=_chained(shared.thrust_prior, priors, space, terms),
        torque_mean_n_m=shared.torque_mean_n_m,
        torque_sd_n_m=shared.torque_sd_n_m,
        space=space,
        specs={name: prior.spec for name, prior in priors.parameters.items()},
        totals=totals,
        telemetry=telemetry,
        idle={name: 0.0 for name in priors.spacecraft.wheel_parameters() if name not in names},
        priors=priors,
    )
    model = with_effects(_with_rough_thrusts(model), effects)
    return model if keep_idle else without_idle(model)


def _with_rough_thrusts(model: Model) -> Model:
    """The model whose telemetry knows its thrusts to some percent.

    What counters leave open is momentum by the thrust that there is, not by the one that the prior
    expects (docs/topics/telemetry-likelihood.md §7). These are the posterior means of a wide prior,
    at the prior means of all else and without torque noise: the same for all hypotheses. Events
    whose rows have late pulses tell less (§4): :func:`_with_likely_thrusts`.
    """
    if not any(term.event.fires for term in model.telemetry):
        return model
    if any(term.balance.late is not None for term in model.telemetry):
        return _with_likely_thrusts(model)
    wide = _with_wide_thrusts(model, _ROUGH)
    nominal = _nominal(wide)
    # columns that effects may use have no weight yet, and are most of them
    collapsed = _collapse_at(without_idle(model), nominal)
    rough, _ = thrust_moments(wide.thrust_prior, collapsed.thrusts)
    return _with_thrusts(model, np.maximum(rough[0], 0.0), nominal, nominal)


def _with_likely_thrusts(model: Model) -> Model:
    """The same by the likeliest tail, factor on what is late and noise of rates (§4).

    A tail that is 20 ms off makes thrusts two thirds too small, where thrusters mostly push to and
    fro. Of events with late pulses all thrusts are the same: one by one they are told by what their
    pulses on the whole differ. Noise of rates is searched for with the factor, as both look alike
    in single rows; the measure of flat motion of such events is taken at what is likeliest. Events
    that fire decide: at prior means slews are 1e5 nats too bad, which noise of rates would take up.
    """
    wide = _with_wide_thrusts(model, _ROUGH_LATE)
    nominal, lean = _nominal(wide), without_idle(model)
    pairs = [(TAIL, LATE_FACTOR)]
    if RATE_NOISE in model.space.names:
        pairs.append((LATE_FACTOR, RATE_NOISE))
    is_late = np.zeros((len(model.fired_ids), 1), dtype=np.bool_)
    for term, fired in zip(model.telemetry, model.fired_of_term[len(model.totals) :], strict=True):
        is_late[fired] = term.balance.late is not None
    likely, names = np.zeros(model.space.dimension), model.space.names
    for _ in range(_ROUGH_TIMES):
        firing = replace(lean, telemetry=tuple(t for t in lean.telemetry if t.event.fires))
        for pair in pairs:
            z = _on_grid(likely, [names.index(name) for name in pair if name in names])
            points = wide.points_at(_searched(wide, z), len(z))
            collapsed = _collapse_at(firing, points)
            likeliest = int(np.argmax(collapsed.log_likelihood - 0.5 * (z**2).sum(axis=1)))
            likely = z[likeliest]
        rough = thrust_moments(wide.thrust_prior, collapsed.thrusts)[0][likeliest]
        rough = np.where(is_late, rough.mean(axis=1, keepdims=True), rough)
        rough = np.maximum(rough, _LEAST_ROUGH * wide.thrust_prior.common_mean_n)
        points = model.points_at(_searched(model, likely[None]), 1)
        model, lean = (_with_thrusts(own, rough, nominal, points) for own in (model, lean))
    return model


def _on_grid(z: Array, places: Sequence[int]) -> Array:
    """Points (n, d) like z (d,) but for some coordinates, which have all pairs of likely values."""
    grid = np.meshgrid(*(_ROUGH_STEPS for _ in places), indexing="ij")
    result = np.tile(z, (_ROUGH_STEPS.size ** len(places), 1))
    for place, own in zip(places, grid, strict=True):
        result[:, place] = own.ravel()
    return result


def _searched(model: Model, z: Array) -> dict[str, Array]:
    """Parameters (n,) of which what is searched for is as at z (n, d), all else at prior means.

    Without torque noise, which not every hypothesis has.
    """
    moved = model.space.to_parameters(z)
    searched = (name for name in (TAIL, LATE_FACTOR, RATE_NOISE) if name in model.space.names)
    means = {name: np.full(len(z), mean) for name, mean in model.priors.means().items()}
    found: dict[str, Array] = {name: np.asarray(moved[name]) for name in searched}
    return {**means, TORQUE_NOISE: np.zeros(len(z)), **found}


def _with_wide_thrusts(model: Model, width: float) -> Model:
    """The model with a wide prior of thrusts, as a share of the expected one."""
    prior = model.thrust_prior
    sd = width * prior.common_mean_n
    shared = level_factor(sd, prior.individual_sd_n, len(prior.shared))
    prior = replace(prior, shared=shared, common_is_walked=False, chained=None)
    return replace(model, thrust_prior=prior)


def _nominal(model: Model) -> Points:
    """The prior means, without torque noise (n = 1)."""
    means = {name: np.full(1, mean) for name, mean in model.priors.means().items()}
    return model.points_at({**means, TORQUE_NOISE: np.zeros(1)}, 1)


def _with_thrusts(model: Model, thrusts_n: Array, nominal: Points, likely: Points) -> Model:
    """The model whose telemetry has these thrusts (E', K), told at what is ``likely`` (n = 1).

    All else is at the prior means (n = 1), where rows have late pulses at what is likely.
    """
    places = model.fired_of_term[len(model.totals) :]
    terms = [
        term.with_thrusts(thrusts_n[fired][0], nominal, likely) if term.event.fires else term
        for term, fired in zip(model.telemetry, places, strict=True)
    ]
    return replace(model, telemetry=tuple(terms))


def _with_columns(event: ReducedEvent, effects: Sequence[Effect]) -> ReducedEvent:
    """The event with the columns that effects need, reduced again if it lacks one."""
    columns = columns_of((effect.kind for effect in effects), event.thrusters)
    lacks = {column.name for column in columns} - set(event.statistics.layout.extra)
    return event.with_columns(columns) if lacks else event


def with_effects(model: Model, effects: Sequence[Effect]) -> Model:
    """The model with more effects: their parameters are walked after those there are.

    Its telemetry has the columns that they need.
    """
    if not effects:
        return model
    old, place = model.space, (model.spacecraft, model.branch)
    parameters = [parameter for effect in effects for parameter in effect.parameters]
    space = replace(
        old,
        names=(*old.names, *(p.name for p in parameters)),
        distributions=(*old.distributions, *(p.distribution for p in parameters)),
        blocks=(*old.blocks, *(EFFECT_BLOCK for _ in parameters)),
    )
    specs = {spec.name: spec for effect in effects for spec in effect.specs}
    added = [(effect, effect.modifier(*place)) for effect in effects]
    return replace(
        model,
        space=space,
        specs={**model.specs, **specs},
        totals=tuple(term.with_modifiers(added) for term in model.totals),
        telemetry=tuple(term.with_modifiers(added) for term in model.telemetry),
        effects=(*model.effects, *effects),
    )


def shared_of(priors: Priors, wheels: Collection[int], *, fires: bool) -> Shared:
    """What terms share, of events that use some wheels and fire or do not.

    Raises
    ------
    InputError
        A prior that is missing, or that cannot be integrated out.
    """
    spacecraft = priors.spacecraft
    torque_mean, torque_sd = (np.array(values) for values in priors.normal(TORQUES))
    return Shared(
        spacecraft,
        priors.branch,
        tuple(wheel.number for wheel in spacecraft.wheels if wheel.number in wheels),
        thrust_prior_of(priors, len(spacecraft.thruster_names(priors.branch)) if fires else 0),
        torque_mean,
        torque_sd,
    )


def _require_distinct(ids: Sequence[str]) -> None:
    if not ids:
        raise InputError("events", "at least one event", "none", "name an event folder or CSV")
    for name in ids:
        if ids.count(name) > 1:
            raise InputError(
                f"event {name}", "each event once in a fit", "the same id twice", "rename one"
            )


def _chained(
    prior: ThrustPrior, priors: Priors, space: ParameterSpace, terms: Sequence[Term]
) -> ThrustPrior:
    """Thrust levels from an earlier fit, given the parameters that both walk."""
    if priors.earlier is None or not len(prior.shared):
        return prior
    if any(term.integrated for term in terms):
        raise InputError(
            f"{priors.path}: from_fit",
            "events without a computed velocity change",
            "one that the flight software computed, whose constants are not handed on",
            'set delta_v = "ignore" in the run file: it informs no thrust',
        )
    levels, factor = priors.earlier.levels(space.names)
    factor.setflags(write=False)
    return replace(prior, shared=factor, chained=levels)


def of_events(model: Model, ids: Collection[str]) -> Model | None:
    """The model of some of its telemetry events, each prepared as it is in the whole.

    None where these need another model: beside totals rows, or where they fire with other thrusters
    or wheels, or walk fewer parameters.
    """

    def needed(terms: Sequence[TelemetryTerm]) -> tuple[set[str], set[int], bool]:
        return (
            {name for term in terms for name in term.parameters},
            {number for term in terms for number in term.event.wheels},
            any(term.event.fires for term in terms),
        )

    kept = tuple(term for term in model.telemetry if term.id in ids)
    if model.totals or needed(kept) != needed(model.telemetry):
        return None
    return replace(model, telemetry=kept)


def without_idle(model: Model) -> Model:
    """The model without columns that no parameter point gives weight: call it after a change."""
    points = model.points(model.space.sample(np.random.default_rng(0), _POINTS))
    kept = tuple(term.without_idle_columns(points) for term in model.telemetry)
    return replace(model, telemetry=kept)


def with_equal_bands_merged(model: Model) -> Model:
    """The model with the bands of a slew joined, where no torque noise makes them differ."""
    if model.space.fixed.get(TORQUE_NOISE) != 0.0:
        return model
    return replace(model, telemetry=tuple(term.with_bands_merged() for term in model.telemetry))


@dataclass(frozen=True)
class Collapsed:
    """The collapsed posterior at a batch of points, with all that drawing back needs."""

    log_likelihood: Array
    thrusts: CollapsedThrusts
    terms: tuple[TermAt, ...]


def collapse(model: Model, z: Array) -> Collapsed:
    """Everything linear integrated out at walked coordinates z (n, d)."""
    return _collapse_at(model, model.points(z))


def _collapse_at(model: Model, points: Points) -> Collapsed:
    terms = tuple(term.at(points) for term in model.terms)
    prior, common = points.shared.thrust_prior, points.common_n
    factor = thrust_factor(model, points)
    thrusts = collapse_thrusts(
        prior,
        joined([term.information for term in terms], axis=1),
        common,
        prior.offset_at(points.parameters, common),
        factor,
    )
    constant = sum(term.log_likelihood for term in terms)
    return Collapsed(np.asarray(constant + thrusts.log_likelihood), thrusts, terms)


def thrust_factor(model: Model, points: Points) -> Array | None:
    """Factors (n, E', K) of effects on the levels in all events that fire; None without."""
    factors = [term.thrust_factor(points) for term in model.terms]
    if not model.fires or all(factor is None for factor in factors):
        return None
    thrusters = len(model.thrust_prior.shared)
    return np.concatenate(
        [
            np.ones((points.n, fired.stop - fired.start, thrusters)) if factor is None else factor
            for factor, fired in zip(factors, model.fired_of_term, strict=True)
        ],
        axis=1,
    )


def log_likelihood(model: Model, z: Array) -> Array:
    """Collapsed log likelihood (n,) at walked coordinates z (n, d).

    Worked up in blocks whose arrays stay in the processor's cache.
    """
    blocks = [z[start : start + _BLOCK] for start in range(0, len(z), _BLOCK)]
    return np.concatenate([collapse(model, block).log_likelihood for block in blocks])


def log_posterior(model: Model, z: Array) -> Array:
    """Collapsed log likelihood plus log prior density in z, (n,); each prior counts once.

    Far out in a proposal's tails, where the prior has 1e-190, quantiles overflow: the likelihood
    stays there what it is at the edge.
    """
    inside = np.clip(z, -_FAR, _FAR)
    return np.asarray(log_likelihood(model, inside) + model.space.log_prior_terms(z).sum(-1))


def conditional_thrusts(model: Model, z: Array) -> tuple[Array, Array]:
    """Mean and variance (n, E', K) of the thrusts given the walked coordinates z (n, d)."""
    parts = [
        thrust_moments(model.thrust_prior, collapse(model, z[rows]).thrusts)
        for rows in model.batches(len(z))
    ]
    mean, variance = zip(*parts, strict=True)
    return np.concatenate(mean), np.concatenate(variance)
