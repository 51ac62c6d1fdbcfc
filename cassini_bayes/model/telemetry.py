"""A telemetry event as a term of a model: its momentum balance and its measured velocity change.

Everything about rows is in the event's Gram matrices, so a call costs the same for any number of
rows. Initial momentum, steady torque and cut tails are integrated out given the thrusts
(docs/topics/telemetry-likelihood.md §6).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final, NamedTuple

import numpy as np

from cassini_bayes.balance.accelerometer import (
    ACCELEROMETER_PARAMETERS,
    ROUNDING_COUNTS_2,
    AccelerometerStatistics,
    accelerometer_information,
    count_columns,
)
from cassini_bayes.balance.flat_motion import (
    in_channel_units,
    in_thrust_units,
    pushed_information,
    with_likely_noise,
)
from cassini_bayes.balance.inertia import ELEMENTS, WITHOUT_WHEELS, elements_of, without_wheels
from cassini_bayes.balance.kernel import without_own
from cassini_bayes.balance.measured_delta_v import (
    DELTA_V_PARAMETERS,
    DeltaVStatistics,
    delta_v_columns,
    delta_v_information,
)
from cassini_bayes.balance.physics import (
    INERTIA_PARAMETERS,
    PULSE_PARAMETERS,
    Modifier,
    Physics,
    delta_v_variance,
    effective_on_times,
    physics_of,
)
from cassini_bayes.balance.telemetry_balance import (
    TelemetryBalance,
    make_balance,
    merged_bands,
)
from cassini_bayes.balance.telemetry_information import row_information
from cassini_bayes.balance.telemetry_noise import mean_pulse_s
from cassini_bayes.balance.telemetry_system import EventSystem, event_system
from cassini_bayes.balance.telemetry_weights import without_idle_columns
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.effects.effect import Effect
from cassini_bayes.errors import InputError
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.terms import (
    STEP,
    TORQUE,
    Points,
    Shared,
    TermDraws,
    TermEvent,
    Variable,
    slopes_of,
)
from cassini_bayes.model.thrusts import ThrustInformation, normal_log_density
from cassini_bayes.priors.reader import Priors
from cassini_bayes.spacecraft import thruster_directions
from cassini_bayes.spacecraft.description import CENTRE_OF_MASS
from cassini_bayes.spacecraft.parameters import (
    CLOSE_SHARE,
    LATE_FACTOR,
    NOISE_LEVELS,
    OPEN_FACTOR,
    PAIR_FACTOR,
)

INITIAL: Final = "initial_momentum_n_m_s"
TAILS: Final = "cut_tails"
TORQUE_NOISE: Final = "torque_noise_n_m_s05"


@dataclass(frozen=True)
class TelemetryTerm:
    """One telemetry event as a term."""

    event: ReducedEvent
    balance: TelemetryBalance
    parameters: tuple[str, ...]
    modifiers: tuple[Modifier, ...] = ()  # effects beyond the standard physics
    density_name: ClassVar[str] = "event_data"
    most_points: ClassVar[int] = 1_000  # worked up at a time: normal equations take 10 kB each
    integrated: ClassVar[tuple[str, ...]] = ()

    @property
    def id(self) -> str:
        """Id of the event."""
        return self.event.id

    @property
    def events(self) -> tuple[TermEvent, ...]:
        """The event."""
        of_event = self.balance.unknowns.own
        return (
            TermEvent(self.id, self.event.kind, self.event.fires, of_event.stop - of_event.start),
        )

    def physics(self, points: Points) -> Physics:
        """The event's physics."""
        return points.physics(self.modifiers)

    def at(self, points: Points) -> TelemetryAt:
        """The event at n points."""
        return TelemetryAt(self, points)

    def thrust_factor(self, points: Points) -> Array | None:
        """Factors (n, 1, K) of effects on the levels; (n, 0, K) where nothing fires."""
        factor = self.physics(points).thrust_factor
        if not np.ndim(factor):
            return None
        whole = np.broadcast_to(factor, (points.n, np.shape(factor)[-1]))[:, None]
        return whole if self.event.fires else whole[:, :0]

    def draw_prior(self, torque_n_m: Array, rng: np.random.Generator) -> TermDraws:
        """The initial momentum from its prior; of tails nothing is known beforehand."""
        normals = rng.standard_normal((len(torque_n_m), 3))
        initial = self.balance.initial_mean_n_m_s + self.balance.initial_sd_n_m_s * normals
        return {TORQUE: torque_n_m, INITIAL: initial}

    def log_prior(self, draws: TermDraws) -> Mapping[str, Array]:
        """That of the initial momentum."""
        shift = draws[INITIAL] - self.balance.initial_mean_n_m_s
        return {
            "initial momentum": normal_log_density(shift, self.balance.initial_sd_n_m_s).sum(-1)
        }

    def observed(self) -> Mapping[str, Variable]:
        """On-times and pulses from the first to the last reading."""
        reading, each = self.event.reading, ("event", "thruster")
        fired = np.array([reading.on_time_s, reading.pulses])
        if not self.event.fires:
            fired = np.full((2, 1), np.nan)
        return {
            "on_time_s": (each, fired[:1], "s", "commanded on-time"),
            "pulses": (each, fired[1:], "1", "number of pulses"),
            "delta_v_m_s": (("event", "axis"), _UNKNOWN, "m s-1", "velocity change, body axes"),
        }

    def constants(self) -> Mapping[str, Variable]:
        """Duration, rows read and used."""
        reading, each = self.event.reading, ("event",)
        used = np.array([float(self.event.statistics.rows)])
        duration = np.array([reading.end_s - reading.start_s])
        read = np.array([float(reading.rows)])
        return {
            "duration_s": (each, duration, "s", "duration of the event"),
            "rows_read": (each, read, "1", "rows of telemetry read"),
            "rows_used": (each, used, "1", "rows of telemetry in the momentum balance"),
            "thrust_predicted_n": (each, _UNKNOWN[0], "N", "thrust printed with the event"),
        }

    def with_modifiers(self, added: Sequence[tuple[Effect, Modifier]]) -> TelemetryTerm:
        """The same with those effects that act in the event, as changes of its rows' physics."""
        acting = (modifier for effect, modifier in added if effect.acts_in(self.id))
        return replace(self, modifiers=(*self.modifiers, *acting))

    def without_idle_columns(self, points: Points) -> TelemetryTerm:
        """The same without columns that no point gives weight."""
        walks = bool(np.any(points.parameters[TORQUE_NOISE] > 0.0))
        balance = without_idle_columns(self.balance, self.physics(points), walks=walks)
        return replace(self, balance=balance)

    def with_thrusts(self, thrusts_n: Array, nominal: Points, likely: Points) -> TelemetryTerm:
        """The same with the event's thrusts (K,) to some percent, told at what is ``likely``.

        All else is at the prior means (n = 1). Where rows have late pulses it is at what is likely
        (n = 1), its noise of rates, too.
        """
        told = self.physics(likely)
        told_by_s = float(mean_pulse_s(self.balance, told)[0])
        balance = replace(self.balance, thrusts_n=thrusts_n, told_by_s=told_by_s)
        if balance.late is None:
            physics, parameters = self.physics(nominal), nominal.parameters
            return replace(self, balance=in_channel_units(balance, physics, parameters))
        parameters = likely.parameters
        balance = in_channel_units(with_likely_noise(balance, parameters), told, parameters)
        return replace(self, balance=in_thrust_units(balance, told, self.delivered(told, 1)))

    def delivered(self, physics: Physics, n: int) -> Array:
        """Momentum (n, 3, K) that every thruster delivers per newton, N m s/N.

        With what the columns of effects bring or take, such as thrust that a warm-up lacks.
        """
        effective = np.array(self.effective_s(physics, n))
        statistics = self.balance.statistics
        ends = dict(zip(statistics.layout.extra, statistics.extra_end, strict=True))
        for _, thruster, name in self.balance.pattern.brought:
            if name in physics.extra:
                effective[:, 0, thruster] += np.asarray(physics.extra[name]) * ends[name]
        return np.asarray(physics.arms_m * effective)

    def effective_s(self, physics: Physics, n: int) -> Array:
        """Effective on-times (n, 1, K), s, by the counters' totals."""
        reading = self.event.reading
        on_time, pulses = np.array([reading.on_time_s]), np.array([reading.pulses])
        effective = effective_on_times(self.event.sampling.pulse_shape, physics, on_time, pulses)
        return np.broadcast_to(effective, (n, *on_time.shape))

    def with_bands_merged(self) -> TelemetryTerm:
        """The same with equal bands as one."""
        return replace(self, balance=merged_bands(self.balance))


_UNKNOWN: Final = np.full((1, 1), np.nan)


class _Collapsed(NamedTuple):
    """An event's own unknowns u integrated out: what is left of them, and of the thrusts F.

    With M the normal equations and v = (u − mean)/sd, given F, v is normal: its precision is
    1 + s M_vv s with the lower ``factor`` (n, U, U), its mean factor⁻ᵀ (shift − coupling F),
    ``shift`` (n, U) and ``coupling`` (n, U, K). ``matrix``, ``vector`` and ``constant`` are the
    information on the thrusts.
    """

    factor: Array
    shift: Array
    coupling: Array
    matrix: Array
    vector: Array
    constant: Array


@dataclass(frozen=True)
class TelemetryAt:
    """A telemetry event at n points."""

    term: TelemetryTerm
    points: Points

    @property
    def physics(self) -> Physics:
        """The event's physics."""
        return self.term.physics(self.points)

    @cached_property
    def system(self) -> EventSystem:
        """Normal equations, worked out when they are asked for."""
        shared = self.points.shared
        return event_system(
            self.term.balance,
            self.physics,
            self.points.parameters,
            shared.torque_mean_n_m,
            shared.torque_sd_n_m,
        )

    @cached_property
    def _collapsed(self) -> _Collapsed:
        """Own unknowns integrated out."""
        system = self.system
        left = _Collapsed(
            *without_own(
                system.normal,
                self.term.balance.pattern.thrusters,
                system.own_mean,
                system.own_sd,
                np.ascontiguousarray(self.points.common_n),
            )
        )
        return left._replace(constant=system.log_scale + left.constant)

    @property
    def log_likelihood(self) -> Array:
        """That of an event that does not fire, (n,)."""
        return np.zeros(self.points.n) if self.term.event.fires else self._collapsed.constant

    @property
    def information(self) -> ThrustInformation:
        """Information of momentum and of a measured velocity change on the event's thrusts."""
        left = self._collapsed
        matrix, vector, constant = left.matrix, left.vector, left.constant
        if not self.term.event.fires:
            return ThrustInformation.nothing(
                self.points.n, len(self.points.shared.thrust_prior.shared)
            )
        for part in self._of_thrusts(self.points.common_n):
            matrix, vector, constant = matrix + part[0], vector + part[1], constant + part[2]
        return ThrustInformation(matrix[:, None], vector[:, None], constant[:, None])

    def _of_thrusts(self, reference_n: Array) -> Iterator[tuple[Array, Array, Array]]:
        """Information beside the rows': of a velocity change, an accelerometer, late pulses."""
        event, balance = self.term.event, self.term.balance
        if balance.answered is not None:
            delivered = self.term.delivered(self.physics, self.points.n)
            yield pushed_information(balance, delivered, reference_n)
        given = self.physics, self._directions, self.points.parameters, reference_n
        if event.delta_v is not None:
            yield delta_v_information(event.delta_v, *given)
        if event.accelerometer is not None:
            yield accelerometer_information(event.accelerometer, *given)

    @property
    def _directions(self) -> Array:
        shared = self.points.shared
        return thruster_directions(shared.spacecraft, shared.branch)

    @property
    def stretch(self) -> Array:
        """Effective over commanded on-time (n, 1, K), from the counters' totals."""
        event, n = self.term.event, self.points.n
        if not event.fires:
            return np.zeros((n, 0, len(self.points.shared.thrust_prior.shared)))
        on_time, pulses = np.array([event.reading.on_time_s]), np.array([event.reading.pulses])
        fired = (on_time > 0) & (pulses > 0)
        effective = self.term.effective_s(self.physics, n)
        return np.where(fired, effective / np.where(fired, on_time, 1.0), 1.0)

    def draw(self, thrust_n: Array, rng: np.random.Generator) -> TermDraws:
        """Initial momentum, torque and cut tails given the thrusts."""
        left = self._collapsed
        pull = left.shift - (left.coupling @ thrust_n.reshape(self.points.n, -1, 1))[..., 0]
        white = pull + rng.standard_normal(pull.shape)
        v = np.linalg.solve(np.swapaxes(left.factor, -1, -2), white[..., None])[..., 0]
        own = self.system.own_mean + self.system.own_sd * v
        places = self.term.balance.unknowns.at(0)
        return {
            INITIAL: own[:, places.initial],
            TORQUE: own[:, None, places.torque],
            TAILS: own[:, places.tails],
        }

    def log_density(self, thrust_n: Array, draws: TermDraws) -> Array:
        """Log density (n, 1) of the event's data given everything, its thrusts included.

        The torque noise is integrated out: it has no value of its own in the fit.
        """
        unknowns = unknowns_of(thrust_n, draws)
        vector = np.concatenate([-unknowns, np.ones((self.points.n, 1))], axis=1)
        square = np.einsum("ni,nij,nj->n", vector, self.system.normal, vector)
        density = self.system.log_scale - 0.5 * square
        for matrix, linear, constant in self._of_thrusts(np.zeros(self.points.n)):
            thrusts = thrust_n[:, 0]
            square = np.einsum("nk,nkl,nl->n", thrusts, matrix, thrusts)
            density = density + constant + (linear * thrusts).sum(-1) - 0.5 * square
        return np.asarray(density[:, None])

    def expected_information(self, first: int) -> Iterator[tuple[int, Array]]:
        """Of the rows' balance, and of a measured velocity change."""
        prior = self.points.shared.thrust_prior
        factor = self.term.thrust_factor(self.points)
        thrust = np.full(self.term.balance.pattern.thrusters, prior.common_mean_n)
        if factor is not None and self.term.event.fires:
            thrust, prior = thrust * factor[0, 0], prior.scaled(factor[0, 0])
        mean = np.concatenate([thrust, self.system.own_mean])
        total = row_information(
            self.term.balance,
            self.physics,
            self.points.parameters,
            self.system.kept[0],
            mean=mean,
            own_sd=self.system.own_sd[0],
            levels=np.concatenate([prior.shared, prior.departures], axis=1),
            step=STEP,
        )
        if self.term.event.delta_v is not None:
            columns = self._delta_v_columns(self.term.event.delta_v)
            size = len(columns)
            gram = self.term.event.delta_v.centred_gram
            noise = delta_v_variance(self.points.parameters)[0]
            total[:size, :size] += (
                np.einsum("uca,ab,vcb->uv", columns, gram, columns, optimize=True) / noise
            )
        if self.term.event.accelerometer is not None:
            counts = self._count_slopes(self.term.event.accelerometer)
            inner = counts @ self.term.event.accelerometer.centred_gram @ counts.T
            total[: len(counts), : len(counts)] += inner / ROUNDING_COUNTS_2
        yield first, total

    def _count_slopes(self, statistics: AccelerometerStatistics) -> Array:
        """Slopes (unknown, B + 1) of the accelerometer's counts: walked, levels, departures."""
        prior, given = self.points.shared.thrust_prior, self.points.parameters
        each, drift = count_columns(statistics, self.physics, self._directions, given)
        walked = slopes_of(prior.common_mean_n * each.sum(1) + drift)
        return np.concatenate([walked, prior.shared.T @ each[0], prior.departures.T @ each[0]])

    def _delta_v_columns(self, statistics: DeltaVStatistics) -> Array:
        """Slopes (unknown, 3, B) of the velocity change: walked, levels, departures."""
        prior = self.points.shared.thrust_prior
        each = delta_v_columns(statistics, self.physics, self._directions, self.points.parameters)
        walked = slopes_of(prior.common_mean_n * each.sum(1))
        levels = np.einsum("kca,kq->qca", each[0], prior.shared)
        own = np.einsum("kca,kq->qca", each[0], prior.departures)
        return np.concatenate([walked, levels, own])

    def variables(self, draws: TermDraws) -> Mapping[str, Variable]:
        """Initial momentum, inertia without the wheels' spin, and the mass where ΔV needs it."""
        n, total = self.points.n, "total angular momentum at the first row, body axes"
        result: dict[str, Variable] = {
            INITIAL: (("event", "axis"), draws[INITIAL][:, None], "N m s", total)
        }
        shared = self.points.shared
        hub = without_wheels(self.physics, shared.spacecraft, shared.wheels)
        values = np.broadcast_to(elements_of(hub), (n, len(ELEMENTS)))
        label = "inertia about the centre of mass less the wheels' spin inertia, Σ I_w a aᵀ"
        for i, element in enumerate(ELEMENTS):
            name = WITHOUT_WHEELS.format(element)
            result[name] = ((), values[:, i], "kg m2", f"{element} element of the {label}")
        if self.term.event.delta_v is not None or self.term.event.accelerometer is not None:
            mass = self.points.parameters["mass_kg"][:, None]
            result["mass_kg"] = (("event",), mass, "kg", "wet mass")
        return result

    def replicates(
        self, _thrust_n: Array, _draws: TermDraws, _rng: np.random.Generator
    ) -> Mapping[str, Variable]:
        """None: channels are replicated row by row (:mod:`cassini_bayes.results.replicates`)."""
        return {}

    def statistics(self, _thrust_n: Array) -> Mapping[str, Variable]:
        """None."""
        return {}


def unknowns_of(thrust_n: Array, draws: TermDraws) -> Array:
    """All unknowns of an event (n, P) in the order of its normal equations.

    thrust_n (n, 1, K), or (n, 0, K) where nothing fires.
    """
    integrated = (draws[INITIAL], draws[TORQUE][:, 0], draws[TAILS])
    return np.concatenate([thrust_n.reshape(len(thrust_n), -1), *integrated], axis=1)


def telemetry_parameters(
    shared: Shared,
    wheels: Sequence[int],
    *,
    fires: bool,
    has_delta_v: bool = False,
    has_accelerometer: bool = False,
    has_late_pulses: bool = False,
    has_coarse_counters: bool = False,
) -> tuple[str, ...]:
    """Names of the parameters that an event needs, in the order in which they are walked.

    ``has_delta_v``: its velocity change was measured; ``has_accelerometer``: in counts;
    ``has_late_pulses``: hardly a row is without firing; ``has_coarse_counters``: their steps leave
    on-times open.
    """
    names = [*INERTIA_PARAMETERS, *NOISE_LEVELS]
    names += shared.spacecraft.wheel_parameters(wheels)
    if fires:
        names += [*PULSE_PARAMETERS, CLOSE_SHARE, *CENTRE_OF_MASS]
        names += [*shared.spacecraft.geometry[shared.branch].parameters]
        names += shared.thrust_prior.walked
    if has_late_pulses:
        names.append(LATE_FACTOR)
    elif fires:
        names.append(PAIR_FACTOR)
    if has_coarse_counters:
        names.append(OPEN_FACTOR)
    if has_delta_v:
        names += DELTA_V_PARAMETERS
    if has_accelerometer:
        names += [name for name in ACCELEROMETER_PARAMETERS if name not in names]
    return tuple(names)


def telemetry_terms(
    events: Sequence[ReducedEvent], priors: Priors, shared: Shared
) -> tuple[TelemetryTerm, ...]:
    """One term per event.

    Raises
    ------
    InputError
        Wheels or parameters that the priors file lacks, or a walked valve delay where events fire.
    """
    used = {number for event in events for number in event.wheels}
    if not used <= set(priors.wheels):
        raise InputError(
            f"{priors.path}: spacecraft.wheels",
            f"every wheel the events use, {sorted(used)}",
            str(list(priors.wheels)),
            "list them, with their priors",
        )
    return tuple(_term(event, priors, shared) for event in events)


def _term(event: ReducedEvent, priors: Priors, shared: Shared) -> TelemetryTerm:
    spacecraft = shared.spacecraft
    names = telemetry_parameters(
        shared,
        event.wheels,
        fires=event.fires,
        has_delta_v=event.delta_v is not None,
        has_accelerometer=event.accelerometer is not None,
        has_late_pulses=event.statistics.counters.has_late_pulses,
        has_coarse_counters=event.statistics.counters.are_coarse,
    )
    priors.require(names, "the model of these events")
    if event.fires and priors.parameters["tau_delay_s"].distribution is not None:
        raise InputError(
            f"{priors.path}: parameters.tau_delay_s",
            "a fixed value (telemetry sees pulses only after they are over)",
            "a distribution",
            "fix it; the delay cancels in first_order pulses",
        )
    nominal = {**dict.fromkeys(spacecraft.wheel_parameters(), 0.0), **priors.means()}
    thrust = shared.thrust_prior.common_mean_n
    balance = make_balance(event.statistics, event.sampling, spacecraft, nominal, thrust)
    at_nominal = {name: np.full(1, value) for name, value in nominal.items()}
    physics = physics_of(spacecraft, shared.branch, at_nominal, fires=event.fires)
    return TelemetryTerm(event, in_channel_units(balance, physics, at_nominal), names)
