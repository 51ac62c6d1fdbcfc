"""The ideal on-time calculation of paper 001 as a simulation that a diagnosis can doubt.

Wheel changes and rectangular pulses give ideal on-times: about the couple axis the pair that pushes
the right way, about the other two the two single thrusters that need least
(docs/topics/prediction.md §7). With p the parameters (geometry, wheels, thrust of every thruster)
an event's on-times are y_e = f_e(p) + ε_e. ε_e holds the event's own thrusts, body rates left in
the dead-band and one control cycle per printed on-time. Effects change the physics as everywhere,
or what the controller makes of it (``fire`` of their kind).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Physics, physics_of
from cassini_bayes.balance.totals_terms import hold_rate_covariance
from cassini_bayes.computing.arrays import Array, Flags
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.diagnosis.case import NONE
from cassini_bayes.diagnosis.gauss_newton import Model
from cassini_bayes.effects.controller import Fired
from cassini_bayes.effects.effect import Effect
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.order import in_order_of_time
from cassini_bayes.prediction.beliefs import Beliefs
from cassini_bayes.prediction.demand import PairLayout, pair_layout, pair_solver
from cassini_bayes.prediction.firing import Features, expected_minor
from cassini_bayes.prediction.ground_software import (
    GroundInputs,
    ground_manager,
    ideal_on_times,
    prior_parameters,
)
from cassini_bayes.prediction.wheel_profile import (
    SETTLING_TIMES,
    WheelManager,
    duration_s,
    ramp_end_s,
    rates_rpm,
)
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.priors.reader import Priors
from cassini_bayes.spacecraft import inertia_tensor
from cassini_bayes.spacecraft.description import CENTRE_OF_MASS, CONTROL_CYCLE_S
from cassini_bayes.spacecraft.parameters import THRUST_COMMON, THRUST_LEVELS
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

TAIL_STEP: Final = 0.5
"""Of the wheels' loop time, for pieces of the profile after a ramp: on-times agree with those of 1
s pieces to 10 ms (tests/diagnosis/test_on_time_case.py)."""
CHANCE: Final = ("minor_quantum_s", "event_spread", "shared_shape")
LEAST_FACTOR: Final = 1e-2
"""Effective per commanded second: a thruster that pushes less is none, and a search may step
there."""


@dataclass(frozen=True)
class OnTimes:
    """Events whose on-times are predicted: what was commanded, what was seen.

    Attributes
    ----------
    printed_s
        (E, U) printed on-times of the layout's units.
    steps_rad_s
        (E, S, W) changes of the wheel rates over pieces of the profile, all wheels in file order.
    share
        (E, S) part of the event's duration that a piece takes.
    thrust_n
        (E,) thrust that the calculation is given, N; the prior's departs from ``thrust_centre_n``.
    fixed
        Prior centres of what is not inferred here (inertia, pulse times, hold rate).
    """

    priors: Priors
    layout: PairLayout
    event_ids: tuple[str, ...]
    printed_s: Array
    steps_rad_s: Array
    share: Array
    duration_s: Array
    thrust_n: Array
    thrust_centre_n: float
    space: ParameterSpace
    fixed: Mapping[str, float]
    thrust_sd_n: Mapping[str, float]
    pulses_per_second: float
    beliefs: Beliefs
    order: tuple[str, ...] = ()  # of the events in time

    @property
    def thrusters(self) -> int:
        """Number of thrusters of the branch."""
        return int(self.layout.pairs.shape[1])


@dataclass(frozen=True)
class Nudge:
    """Small changes of single events, by which their own noise reaches the on-times; (n, E, …)."""

    force_n: Array | float = 0.0  # (n, E, K)
    momentum_n_m_s: Array | float = 0.0  # (n, E, 3)
    opposing_s: Array | float = 0.0  # (n, E, 2) ring, couple


@dataclass(frozen=True)
class OnTimeHypothesis:
    """The ideal calculation with some effects: a model of the on-times and its parameters."""

    name: str
    effects: tuple[Effect, ...]
    prior_probability: float
    space: ParameterSpace  # of the baseline and the effects; individual thrusts come after it
    model: Model = field(repr=False)

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(effect.name for effect in self.effects)

    @property
    def log_penalty(self) -> float:
        """Nothing is searched for before the fit."""
        return 0.0


def read_on_times(events: Sequence[TotalsEvent], priors: Priors, beliefs: Beliefs) -> OnTimes:
    """Wheel profiles, prior knowledge and printed on-times of events of one branch.

    Raises
    ------
    InputError
        No event, or events of another branch or other wheels than the priors file's.
    """
    spacecraft = priors.spacecraft
    if not events:
        raise InputError("events", "at least one", "none", "name totals rows")
    for event in events:
        if event.branch != priors.branch or not set(event.wheels) <= set(priors.wheels):
            raise InputError(
                f"event {event.id}",
                f"branch {priors.branch} and wheels out of {list(priors.wheels)}",
                f"branch {event.branch}, wheels {list(event.wheels)}",
                "use the priors of that branch and those wheels",
            )
    centre = prior_parameters(priors)
    layout = pair_layout(spacecraft, priors.branch)
    manager = ground_manager(
        GroundInputs(spacecraft, priors.branch, centre, centre[THRUST_COMMON], 1.0)
    )
    pieces = [_pieces(event, manager, priors) for event in events]
    most = max(len(share) for _, share in pieces)
    first = [unit[0] for unit in layout.units]
    wheels = [n for w in spacecraft.wheels if w.number in priors.wheels for n in w.parameters]
    positions = spacecraft.geometry[priors.branch].parameters
    names = tuple(dict.fromkeys([*CENTRE_OF_MASS, *positions, *wheels, THRUST_COMMON]))
    space = priors.space(names)
    return OnTimes(
        priors=priors,
        layout=layout,
        event_ids=tuple(event.id for event in events),
        printed_s=np.array([event.on_time_s[first] for event in events]),
        steps_rad_s=np.stack([np.pad(s, ((0, most - len(s)), (0, 0))) for s, _ in pieces]),
        share=np.stack([np.pad(share, (0, most - len(share))) for _, share in pieces]),
        duration_s=np.array([_duration(event, manager) for event in events]),
        thrust_n=np.array([event.thrust_predicted_n or centre[THRUST_COMMON] for event in events]),
        thrust_centre_n=centre[THRUST_COMMON],
        space=space,
        fixed={name: value for name, value in centre.items() if name not in space.names},
        thrust_sd_n=dict(zip(THRUST_LEVELS, priors.normal(THRUST_LEVELS)[1], strict=True)),
        pulses_per_second=beliefs.moments("pulses_per_second")[0],
        beliefs=beliefs,
        order=in_order_of_time(events),
    )


def _duration(event: TotalsEvent, manager: WheelManager) -> float:
    return duration_s(manager, event.wheels, event.rwa_end_rpm - event.rwa_start_rpm)


def _pieces(event: TotalsEvent, manager: WheelManager, priors: Priors) -> tuple[Array, Array]:
    """Changes of all wheels' rates (S, W), rad/s, and shares of the duration (S,)."""
    total = _duration(event, manager)
    ends = ramp_end_s(manager, event.wheels, event.rwa_end_rpm - event.rwa_start_rpm)
    tail = manager.loop_s * np.arange(0.0, SETTLING_TIMES + TAIL_STEP, TAIL_STEP)
    time = np.unique(np.clip([0.0, total, *(end + t for end in ends for t in tail)], 0.0, total))
    rates = rates_rpm(manager, event.wheels, event.rwa_start_rpm, event.rwa_end_rpm, time)
    rates[-1] = event.rwa_end_rpm
    numbers = [wheel.number for wheel in priors.spacecraft.wheels]
    steps = np.zeros((len(time) - 1, len(numbers)))
    steps[:, [numbers.index(n) for n in event.wheels]] = np.diff(rates, axis=0) * RAD_S_PER_RPM
    return steps, np.diff(time) / total


@dataclass(frozen=True)
class IdealController:
    """The ideal calculation at n points, as effects on the firings see it (:class:`Controller`).

    ``torque_n_m`` (n, E, 3, K) is that of every thruster per commanded second, ``steps_n_m_s``
    (n, E, S, 3) what is to be turned, ``nudge_s`` (n, E, 2) a change of the opposing firings.
    """

    data: OnTimes
    torque_n_m: Array
    steps_n_m_s: Array
    nudge_s: Array | float

    @cached_property
    def _demand(self) -> Features:
        layout, nothing = self.data.layout, np.zeros(())
        demand = self._pair_on_times(self.steps_n_m_s)  # (n, E, 6)
        couple = demand[..., [2 * layout.couple_axis, 2 * layout.couple_axis + 1]].sum(-1)
        a, b = (demand[..., [2 * axis, 2 * axis + 1]].sum(-1) for axis in layout.ring_axes)
        return Features(self.data.duration_s, nothing, nothing, a + b, couple, np.minimum(a, b))

    def common_s(self) -> Array:
        """What the thruster that both axes of the ring demand has to fire alone, (n, E)."""
        return self._demand.common_s

    def expected_opposing(self, values: Mapping[str, Array]) -> Array:
        """Mean opposing firings (n, E, 2) of the firing model (docs/topics/prediction.md §2)."""
        at = {key: value[:, None] for key, value in values.items()}
        return np.stack(expected_minor(at, self._demand), axis=-1)

    def opposing(self, each_s: Array) -> Array:
        """On-times (n, E, K) of opposing firings, as nudged."""
        layout, each = self.data.layout, each_s + self.nudge_s
        ring = np.zeros(layout.pairs.shape[1])
        ring[layout.ring.ravel()] = 1.0
        return np.asarray(each[..., :1] * ring + each[..., 1:] * (1.0 - ring))

    def rest(self, opposing_s: Array) -> Array:
        """Momentum steps less what opposing firings turn, evenly over the event."""
        turned = np.einsum("neak,nek->nea", self.torque_n_m, opposing_s)
        return np.asarray(self.steps_n_m_s - self.data.share[..., None] * turned[..., None, :])

    def singles(self, steps_n_m_s: Array) -> Array:
        """On-times (n, E, K) of the two single thrusters that need least."""
        return np.asarray(ideal_on_times(steps_n_m_s, self.torque_n_m, self.data.layout).sum(-2))

    def pairs(self, steps_n_m_s: Array) -> Array:
        """On-times (n, E, K) of pairs, both thrusters alike."""
        return np.asarray(self._pair_on_times(steps_n_m_s) @ self.data.layout.pairs)

    def _pair_on_times(self, steps: Array) -> Array:
        """On-times (n, E, 6) of the pairs that answer momentum steps (n, E, S, 3)."""
        n, e = self.torque_n_m.shape[:2]
        solver = pair_solver(
            self.torque_n_m.reshape(n * e, 3, -1),
            np.ones((n * e, self.torque_n_m.shape[-1])),
            self.data.layout.pairs,
        )
        fired = solver.on_times(steps.reshape(n * e, -1, 3)).sum(1)
        return np.asarray(fired.reshape(n, e, 6))


@dataclass(frozen=True)
class Flown:
    """On-times (n, E, U), and all firings where an effect changes them."""

    on_time_s: Array
    fired: Fired | None = None

    def where(self, acts: Flags, other: Flown) -> Flown:
        """These, and in the events (E,) where it acts, the others."""
        mine, theirs = self.fired, other.fired
        on_time = np.where(acts[:, None], other.on_time_s, self.on_time_s)
        one = mine or theirs
        if one is None:
            return Flown(on_time)
        # without a doubted firing logic nothing is left to its chance
        nothing = Fired(
            0.0 * one.on_time_s, 0.0 * one.opposing_s, 0.0 * one.common_s, 0.0 * one.alone
        )
        mine, theirs = mine or nothing, theirs or nothing
        return Flown(
            on_time,
            Fired(
                np.where(acts[:, None], theirs.on_time_s, mine.on_time_s),
                np.where(acts[:, None], theirs.opposing_s, mine.opposing_s),
                np.where(acts, theirs.common_s, mine.common_s),
                np.where(acts[:, None], theirs.alone, mine.alone),
            ),
        )


def hypothesis(
    data: OnTimes, effects: tuple[Effect, ...] = (), prior_probability: float = 1.0
) -> OnTimeHypothesis:
    """The ideal calculation with some effects added."""
    base, added = data.space, [p for effect in effects for p in effect.parameters]
    space = ParameterSpace(
        (*base.names, *(p.name for p in added)),
        {**base.fixed, **data.fixed},
        (*base.distributions, *(p.distribution for p in added)),
        (*base.blocks, *("effect" for _ in added)),
    )

    acting = np.array([[effect.acts_in(name) for effect in effects] for name in data.event_ids])
    together, which = np.unique(acting, axis=0, return_inverse=True)

    def flown(z: Array, nudge: Nudge) -> Flown:
        each = [_fly(data, _some(effects, acts), space, z, nudge) for acts in together]
        result = each[0]
        for i, other in enumerate(each[1:], 1):
            result = result.where(which == i, other)
        return result

    return OnTimeHypothesis(
        "+".join(effect.name for effect in effects) or NONE,
        effects,
        prior_probability,
        space,
        Model(
            lambda z: flown(z, Nudge()).on_time_s,
            lambda z: _noise(data, flown, z),
            space.dimension + data.thrusters,
        ),
    )


def _some(effects: Sequence[Effect], acts: Flags) -> tuple[Effect, ...]:
    return tuple(effect for effect, is_there in zip(effects, acts, strict=True) if is_there)


def parameters_at(space: ParameterSpace, z: Array) -> dict[str, Array]:
    """Parameters by name, (n,), at standard coordinates z (n, d)."""
    return {
        name: np.broadcast_to(np.asarray(value, dtype=np.float64), len(z))
        for name, value in space.to_parameters(z[:, : space.dimension]).items()
    }


def _fly(
    data: OnTimes, effects: tuple[Effect, ...], space: ParameterSpace, z: Array, nudge: Nudge
) -> Flown:
    parameters = parameters_at(space, z)
    # rectangular pulses: the tail adds what the rise takes
    parameters["tau_fall_s"] = parameters["tau_rise_s"]
    spacecraft, branch = data.priors.spacecraft, data.priors.branch
    modifiers = tuple(effect.modifier(spacecraft, branch) for effect in effects)
    physics = physics_of(spacecraft, branch, parameters, modifiers)
    level = parameters[THRUST_COMMON] - data.thrust_centre_n
    departures = level[:, None] + data.thrust_sd_n["thrust_individual_n"] * z[:, space.dimension :]
    factor = np.broadcast_to(physics.thrust_factor, departures.shape)[:, None, :]
    thrust = factor * (data.thrust_n[:, None] + departures[:, None, :]) + nudge.force_n
    torque = physics.arms_m[:, None] * (thrust * _per_second(data, physics))[:, :, None, :]
    steps = np.einsum("esw,naw->nesa", data.steps_rad_s, physics.wheel_weights)
    between = np.asarray(nudge.momentum_n_m_s - _steady(data, physics))
    steps = steps + data.share[..., None] * between[..., None, :]
    controller = IdealController(data, torque, steps, nudge.opposing_s)
    for effect in effects:
        if effect.kind.fire is not None:
            fired = effect.kind.fire(controller, effect.values(parameters))
            return Flown(_units(data, fired.on_time_s), fired)
    return Flown(_units(data, controller.singles(steps)))


def _per_second(data: OnTimes, physics: Physics) -> Array:
    """Effective per commanded second of every thruster (n, 1, K), at equally wide pulses."""
    rate = data.pulses_per_second
    tau = (np.asarray(value)[..., None] for value in physics.tau_s)
    shape = PULSE_SHAPES["first_order"]
    factor = rate * shape.longer_time(1.0 / rate, physics.impulse_offset_s, *tau)
    return np.asarray(np.maximum(factor, LEAST_FACTOR) * np.ones(data.thrusters))[:, None, :]


def _steady(data: OnTimes, physics: Physics) -> Array:
    """Momentum (n, E, 3) or (1, E, 3) that a steady torque brings in."""
    torque = np.broadcast_to(np.asarray(physics.steady_torque_n_m), (len(physics.arms_m), 3))
    return np.asarray(torque[:, None, :] * data.duration_s[:, None])


def _units(data: OnTimes, on_time: Array) -> Array:
    return np.asarray(on_time[..., [unit[0] for unit in data.layout.units]])


def _noise(data: OnTimes, flown: Callable[[Array, Nudge], Flown], z: Array) -> Array:
    """Covariance (E, U, U) of an event's own departures at z (d,), s²."""
    events, k = len(data.event_ids), data.thrusters
    held = hold_rate_covariance(
        inertia_tensor(data.fixed), np.asarray(data.fixed["hold_rate_rad_s"])
    )
    forces = np.vstack(
        [
            data.thrust_sd_n["thrust_jitter_n"] * np.eye(k),
            data.thrust_sd_n["thrust_event_n"] * np.ones((1, k)),
        ]
    )
    size = k + 1 + 3
    force = np.zeros((size, events, k))
    force[: k + 1] = forces[:, None, :]
    momentum = np.zeros((size, events, 3))
    momentum[k + 1 :] = np.linalg.cholesky(held).T[:, None, :]
    both = Nudge(np.concatenate([force, -force]), np.concatenate([momentum, -momentum]))
    up, down = np.split(flown(np.tile(z, (2 * size, 1)), both).on_time_s, 2)
    columns = [*(0.5 * (up - down)), *_chance(data, flown, z)]
    slopes = np.stack(columns, axis=-1)
    floor = CONTROL_CYCLE_S**2 + data.fixed["on_time_resolution_s"] ** 2 / 12.0
    return np.asarray(slopes @ np.swapaxes(slopes, -1, -2) + floor * np.eye(slopes.shape[1]))


def _chance(data: OnTimes, flown: Callable[[Array, Nudge], Flown], z: Array) -> list[Array]:
    """One-sigma changes (E, U) of the on-times by the chance of a doubted firing logic.

    Opposing firings M come in quanta q and vary from event to event by their own size, variance
    q M + (g M)²; the common thruster's are negative binomial in control cycles N, variance
    N + N²/k (docs/topics/prediction.md §2).
    """
    events = len(data.event_ids)
    nudge = np.zeros((3, events, 2))
    nudge[1, :, 0] = nudge[2, :, 1] = CONTROL_CYCLE_S
    nudged = flown(np.tile(z, (3, 1)), Nudge(opposing_s=nudge))
    if nudged.fired is None:
        return []
    middle = {name: data.beliefs.distributions[name].mean() for name in CHANCE}
    minor = nudged.fired.opposing_s[0]
    quantum, spread = middle["minor_quantum_s"], middle["event_spread"]
    sd = np.sqrt(quantum * minor + (spread * minor) ** 2)
    slopes = (nudged.on_time_s[1:] - nudged.on_time_s[0]) / CONTROL_CYCLE_S
    cycles = nudged.fired.common_s[0] / CONTROL_CYCLE_S
    alone = CONTROL_CYCLE_S * np.sqrt(cycles + cycles**2 / middle["shared_shape"])
    return [
        slopes[0] * sd[:, :1],
        slopes[1] * sd[:, 1:],
        _units(data, nudged.fired.alone)[0] * alone[:, None],
    ]
