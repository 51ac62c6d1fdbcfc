"""Totals rows as a term of a model: one balance per event, and the ΔV printed with it.

Given the walked parameters the balance is linear-Gaussian in the thrusts and torques, apart from
the response Jacobian, whose logarithm is expanded to second order about the reference thrust
(``jacobian_expansion_error`` of the record measures what that leaves out).
``docs/topics/totals-likelihood.md`` derives the formulae.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Literal

import numpy as np

from cassini_bayes.balance.computed_delta_v import (
    ComputedDeltaV,
    channel_log_likelihood,
    computed_channel,
    draw_software,
    event_channel_log_likelihood,
)
from cassini_bayes.balance.physics import (
    DELTA_V_NOISE,
    INERTIA_PARAMETERS,
    PULSE_PARAMETERS,
    Modifier,
    delta_v_variance,
)
from cassini_bayes.balance.totals_system import (
    NOISE,
    TotalsBalance,
    TotalsSystem,
    totals_system,
)
from cassini_bayes.balance.totals_terms import TotalsStack, stack_events
from cassini_bayes.computing.arrays import Array, Flags, Places
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.effects.effect import Effect
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.terms import (
    ALL_POINTS,
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
from cassini_bayes.spacecraft import check_axis_pairs, thruster_directions
from cassini_bayes.spacecraft.description import CENTRE_OF_MASS
from cassini_bayes.spacecraft.parameters import SOFTWARE, THRUST_COMMON
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES, PulseShape
from cassini_bayes.spacecraft.units import RPM_PER_RAD_S

DeltaVUse = Literal["as-declared", "ignore", "as-measured"]

MASS: Final = "mass_factor"
KIND: Final = "totals"


@dataclass(frozen=True)
class TotalsTerm:
    """Totals rows of one thruster branch as a term."""

    rows: tuple[TotalsEvent, ...]
    balance: TotalsBalance
    parameters: tuple[str, ...]
    delta_v: DeltaVUse
    computed: ComputedDeltaV | None  # ΔV computed on board, where events have it
    modifiers: tuple[Modifier, ...] = ()  # effects beyond the standard physics
    acting: tuple[tuple[bool, ...], ...] = ()  # of every modifier: in which rows
    density_name: ClassVar[str] = "totals"
    most_points: ClassVar[int] = ALL_POINTS

    @property
    def stack(self) -> TotalsStack:
        """The rows as arrays."""
        return self.balance.stack

    @property
    def pulse_shape(self) -> PulseShape:
        """The shape that the rows' pulses are taken to have."""
        return self.balance.pulse_shape

    @property
    def event_ids(self) -> tuple[str, ...]:
        """Ids of the rows."""
        return self.stack.event_ids

    @cached_property
    def events(self) -> tuple[TermEvent, ...]:
        """The rows: all fire, and each has a torque of its own."""
        return tuple(TermEvent(name, KIND, True, 3) for name in self.event_ids)

    @property
    def integrated(self) -> tuple[str, ...]:
        """The constants of the on-board ΔV."""
        return () if self.computed is None else SOFTWARE

    def with_modifiers(self, added: Sequence[tuple[Effect, Modifier]]) -> TotalsTerm:
        """The same with more effects, as changes of the physics of the rows in which they act."""
        acting = (tuple(effect.acts_in(row) for row in self.event_ids) for effect, _ in added)
        modifiers = (*self.modifiers, *(modifier for _, modifier in added))
        return replace(self, modifiers=modifiers, acting=(*self.acting, *acting))

    def at(self, points: Points) -> TotalsAt:
        """The balances at n points."""
        shared = points.shared
        systems = [
            totals_system(
                self.balance,
                points.physics(modifiers),
                points.parameters,
                shared.thrust_prior.common_mean_n,
                shared.torque_mean_n_m,
                shared.torque_sd_n_m,
            )
            for modifiers in self._sets
        ]
        return TotalsAt(self, points, TotalsSystem.of_rows(systems, self._set_of_row))

    @cached_property
    def _sets(self) -> tuple[tuple[Modifier, ...], ...]:
        """Sets of effects that act together in some row."""
        return tuple(dict.fromkeys(self._of_row(row) for row in range(len(self.rows))))

    @cached_property
    def _set_of_row(self) -> Places:
        """Which of these acts in every row, (E,)."""
        return np.array([self._sets.index(self._of_row(row)) for row in range(len(self.rows))])

    def _of_row(self, row: int) -> tuple[Modifier, ...]:
        each = zip(self.modifiers, self.acting, strict=True)
        return tuple(modifier for modifier, acts in each if acts[row])

    def thrust_factor(self, points: Points) -> Array | None:
        """Factors (n, E, K) of effects on the levels in the rows."""
        factors = [points.physics(modifiers).thrust_factor for modifiers in self._sets]
        if not any(np.ndim(factor) for factor in factors):
            return None
        shape = (points.n, len(points.shared.thrust_prior.shared))
        whole = [np.broadcast_to(factor, shape) for factor in factors]
        return np.stack([whole[i] for i in self._set_of_row], axis=1)

    def draw_prior(self, torque_n_m: Array, rng: np.random.Generator) -> TermDraws:
        """Constants of the on-board ΔV from their prior."""
        if self.computed is None:
            return {TORQUE: torque_n_m}
        normals = rng.standard_normal((len(torque_n_m), 2))
        software = self.computed.prior_mean + self.computed.prior_sd * normals
        return {TORQUE: torque_n_m, **dict(zip(SOFTWARE, software.T, strict=True))}

    def log_prior(self, draws: TermDraws) -> Mapping[str, Array]:
        """That of the constants of the on-board ΔV."""
        if self.computed is None:
            return {}
        shift = software_of(draws) - self.computed.prior_mean
        return {"flight software": normal_log_density(shift, self.computed.prior_sd).sum(-1)}

    def observed(self) -> Mapping[str, Variable]:
        """On-times, pulses and velocity changes as printed."""
        stack, each, along = self.stack, ("event", "thruster"), ("event", "axis")
        return {
            "on_time_s": (each, stack.on_time_s, "s", "commanded on-time"),
            "pulses": (each, stack.pulses, "1", "number of pulses"),
            "delta_v_m_s": (along, stack.delta_v_m_s, "m s-1", "velocity change, body axes"),
        }

    def constants(self) -> Mapping[str, Variable]:
        """Durations, wheel rates at both ends, printed thrust."""
        stack = self.stack
        start = stack.wheel_start_rad_s * RPM_PER_RAD_S
        end = stack.wheel_end_rad_s * RPM_PER_RAD_S
        each, wheel, printed = ("event",), ("event", "wheel"), stack.thrust_predicted_n
        return {
            "duration_s": (each, stack.duration_s, "s", "duration of the event"),
            "rwa_start_rpm": (wheel, start, "rpm", "wheel rate at the start"),
            "rwa_end_rpm": (wheel, end, "rpm", "wheel rate at the end"),
            "thrust_predicted_n": (each, printed, "N", "thrust printed with the event"),
        }


@dataclass(frozen=True)
class TotalsAt:
    """Totals rows at n points."""

    term: TotalsTerm
    points: Points
    system: TotalsSystem

    @property
    def log_likelihood(self) -> Array:
        """That of the ΔV computed on board (n,): it does not depend on thrusts."""
        computed = self.term.computed
        if computed is None:
            return np.zeros(self.points.n)
        return channel_log_likelihood(computed, delta_v_variance(self.points.parameters))

    @cached_property
    def information(self) -> ThrustInformation:
        """Information of the rows on their thrusts, the external torques integrated out.

        With A the whitened design, b the whitened misfit at the common level's mean, and g, H the
        gradient and Hessian of the response Jacobian there, a row's information on its thrusts is
        G = AᵀA − H with linear term ν = Aᵀb + g + H d0; d0 is the distance of a walked common level
        from the reference.
        """
        system, common = self.system, self.points.common_n
        misfit = system.target - common[..., None, None] * system.design.sum(-1)
        factor = np.linalg.cholesky(system.covariance + system.torque_covariance)
        white = np.linalg.solve(factor, np.concatenate([system.design, misfit[..., None]], axis=-1))
        log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
        rows = factor.shape[-1]
        jacobian = system.jacobian
        shift = common[..., None, None] - system.reference_n
        bent = (jacobian.hessian @ shift[..., None])[..., 0]
        tilt = jacobian.gradient + bent
        tilt_value = jacobian.value + (shift * (jacobian.gradient + 0.5 * bent)).sum(-1)
        gram = np.swapaxes(white, -1, -2) @ white
        return ThrustInformation(
            matrix=gram[..., :-1, :-1] - jacobian.hessian,
            vector=gram[..., :-1, -1] + tilt,
            constant=(
                -0.5 * gram[..., -1, -1] - log_det - 0.5 * rows * np.log(2.0 * np.pi) + tilt_value
            ),
        )

    @property
    def stretch(self) -> Array:
        """Effective over commanded on-time (n, E, K)."""
        return self.system.stretch

    def draw(self, thrust_n: Array, rng: np.random.Generator) -> TermDraws:
        """External torques given the thrusts: a prior draw corrected by the residual it leaves.

        And the constants of the on-board ΔV.
        """
        system, shared = self.system, self.points.shared
        residual = system.target - (system.design @ thrust_n[..., None])[..., 0]
        departure = shared.torque_sd_n_m * rng.standard_normal((*residual.shape[:-1], 3))
        noise = np.linalg.cholesky(system.covariance) @ rng.standard_normal((*residual.shape, 1))
        missing = residual - (system.torque_design @ departure[..., None] + noise)[..., 0]
        answer = np.linalg.solve(system.covariance + system.torque_covariance, missing[..., None])
        turned = (np.swapaxes(system.torque_design, -1, -2) @ answer)[..., 0]
        gain = shared.torque_sd_n_m**2 * turned
        draws = {TORQUE: np.asarray(shared.torque_mean_n_m + departure + gain)}
        if self.term.computed is not None:
            variance = delta_v_variance(self.points.parameters)
            software = draw_software(self.term.computed, variance, rng)
            draws |= dict(zip(SOFTWARE, software.T, strict=True))
        return draws

    def log_density(self, thrust_n: Array, draws: TermDraws) -> Array:
        """Log density (n, E) of each row's figures given all parameters, thrusts and torques."""
        factor = np.linalg.cholesky(self.system.covariance)
        residual = self.residual(thrust_n, draws)
        white = np.linalg.solve(factor, residual[..., None])[..., 0]
        log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
        rows = factor.shape[-1]
        jacobian = self.system.log_jacobian(thrust_n)
        density = -0.5 * (white**2).sum(-1) - log_det - 0.5 * rows * np.log(2.0 * np.pi) + jacobian
        if self.term.computed is not None:
            variance = delta_v_variance(self.points.parameters)
            density = density + event_channel_log_likelihood(
                self.term.computed, software_of(draws), variance
            )
        return np.asarray(density)

    def residual(self, thrust_n: Array, draws: TermDraws) -> Array:
        """Thruster impulse plus external torque minus the wheels' change, (n, E, R)."""
        departure = draws[TORQUE] - self.points.shared.torque_mean_n_m
        return self.system.residual(thrust_n, departure)

    def expected_information(self, first: int) -> Iterator[tuple[int, Array]]:
        """Of every row: its balance, whitened, against all its unknowns."""
        system, shared = self.system, self.points.shared
        prior = shared.thrust_prior
        at_common = system.target - prior.common_mean_n * system.design.sum(-1)
        walked = -slopes_of(at_common)
        factor = self.term.thrust_factor(self.points)
        for i in range(len(self.term.event_ids)):
            design = system.design[0, i]
            torque = system.torque_design[i] * shared.torque_sd_n_m
            levels = prior.scaled(None if factor is None else factor[0, i]).shared
            columns = np.concatenate(
                [walked[:, i].T, design @ levels, design @ prior.departures, torque], axis=1
            )
            white = np.linalg.solve(np.linalg.cholesky(system.covariance[0, i]), columns)
            yield first + i, white.T @ white

    def variables(self, _draws: TermDraws) -> Mapping[str, Variable]:
        """Wet masses, where a ΔV needs them."""
        if MASS not in self.term.parameters:
            return {}
        table = self.term.stack.mass_kg
        mass = self.points.parameters[MASS][:, None] * table
        return {"mass_kg": (("event",), mass, "kg", "wet mass: table mass times factor")}

    def replicates(
        self, thrust_n: Array, draws: TermDraws, rng: np.random.Generator
    ) -> Mapping[str, Variable]:
        """On-times of the same biases flown again, one replicate per draw; and what is left over.

        New hold rates and attitude errors give a new residual; the pair that does the work about
        each axis makes up the difference, all other on-times stay as they were
        (docs/topics/totals-likelihood.md §3). A slightly negative value means that the opposite
        pair would have fired.
        """
        residual = self.residual(thrust_n, draws)[..., :3]
        factor = np.linalg.cholesky(self.system.covariance[..., :3, :3])
        fresh = (factor @ rng.standard_normal((*factor.shape[:-1], 1)))[..., 0]
        matrix = self.system.response_matrix(thrust_n)
        answer = np.linalg.solve(matrix, (fresh - residual)[..., None])
        stack, each, along = self.term.stack, ("event", "thruster"), ("event", "axis")
        again = np.asarray(stack.on_time_s + (stack.response @ answer)[..., 0])
        left = "thruster impulse plus torque minus the wheels' momentum change, at the data"
        return {
            "on_time_s": (each, again, "s", "commanded on-time of the same bias flown again"),
            "balance_residual_n_m_s": (along, residual, "N m s", left),
        }

    def statistics(self, thrust_n: Array) -> Mapping[str, Variable]:
        """Exact minus expanded log response Jacobian of all rows, nats."""
        exact = self.system.log_jacobian(thrust_n)
        error = (exact - self.system.expanded_log_jacobian(thrust_n)).sum(-1)
        meaning = "exact minus expanded log response Jacobian"
        return {"jacobian_expansion_error": ((), np.asarray(error), "1", meaning)}


def software_of(draws: TermDraws) -> Array:
    """Constants (n, 2) of the on-board ΔV among a term's draws."""
    return np.stack([draws[name] for name in SOFTWARE], axis=-1)


def totals_parameters(priors: Priors, shared: Shared, *, has_delta_v: bool) -> tuple[str, ...]:
    """Names of the parameters that totals rows need, in the order in which they are walked.

    Every wheel of the priors file is among them, prime in these rows or not.
    """
    spacecraft = shared.spacecraft
    return (
        *PULSE_PARAMETERS,
        *CENTRE_OF_MASS,
        *spacecraft.geometry[shared.branch].parameters,
        *spacecraft.wheel_parameters(priors.wheels),
        *INERTIA_PARAMETERS,
        *NOISE,
        *((MASS, *DELTA_V_NOISE) if has_delta_v else ()),
        *shared.thrust_prior.walked,
    )


def totals_terms(
    events: Sequence[TotalsEvent],
    priors: Priors,
    shared: Shared,
    *,
    pulse_shape: str,
    delta_v: DeltaVUse,
) -> tuple[TotalsTerm, ...]:
    """All rows as one term; none without rows.

    Raises
    ------
    InputError
        Rows of another branch or wheel set, without pulse counts, or with a ΔV but no mass;
        parameters that are missing, or that leave nothing to estimate or no noise to weigh it by.
    """
    if not events:
        return ()
    rows, spacecraft = tuple(events), shared.spacecraft
    stack = stack_events(rows, spacecraft, priors.branch)
    _require_wheels(rows, priors)
    given, declared = stack.has_delta_v, stack.delta_v_measured
    measured = given & (declared | (delta_v == "as-measured")) & (delta_v != "ignore")
    computed = given & ~declared & (delta_v == "as-declared")
    _require_given(rows, measured | computed, "mass_kg")
    _require_given(rows, computed, "thrust_predicted_n")
    directions = thruster_directions(spacecraft, priors.branch)
    channel = None
    if computed.any():
        mean, sd = priors.normal(SOFTWARE)
        channel = computed_channel(stack, directions, computed, np.array(mean), np.array(sd))
    has_delta_v = bool((measured | computed).any())
    names = totals_parameters(priors, shared, has_delta_v=has_delta_v)
    priors.require(names, "the model of these events")
    _require_sense(priors, shared, (NOISE, DELTA_V_NOISE) if has_delta_v else (NOISE,))
    balance = TotalsBalance(stack, PULSE_SHAPES[pulse_shape], directions, measured)
    return (TotalsTerm(rows, balance, names, delta_v, channel),)


def _require_sense(priors: Priors, shared: Shared, noises: Sequence[tuple[str, ...]]) -> None:
    """Refuse priors without a thrust to estimate or a noise, and pairs that turn nothing."""
    prior, centre = shared.thrust_prior, priors.means()
    if not prior.common_mean_n > 0:
        raise InputError(
            f"{priors.path}: parameters.{THRUST_COMMON}",
            "a positive mean, in N",
            f"{prior.common_mean_n:g}",
            "thrust is counted along each thruster's direction; change loc",
        )
    if prior.shared.shape[1] + prior.departures.shape[1] == 0 and not prior.common_is_walked:
        raise InputError(
            f"{priors.path}: parameters.{THRUST_COMMON}",
            "a distribution for at least one of the thrust parameters",
            "all four fixed",
            "give thrust_common_n a distribution",
        )
    for names in noises:
        if not any(centre[name] > 0 for name in names):
            raise InputError(
                f"{priors.path}: parameters.{names[0]}",
                f"at least one of {', '.join(names)} above zero",
                "all of them 0",
                "say how well the figures and the dead-band are known",
            )
    check_axis_pairs(shared.spacecraft, shared.branch, centre)


def _require_wheels(rows: tuple[TotalsEvent, ...], priors: Priors) -> None:
    for event in rows:
        if not set(event.wheels) <= set(priors.wheels):
            raise InputError(
                f"event {event.id}: wheels",
                f"wheels out of {list(priors.wheels)} as in {priors.path}",
                str(list(event.wheels)),
                "list every wheel the events use under spacecraft.wheels, with its priors",
            )


def _require_given(rows: tuple[TotalsEvent, ...], used: Flags, name: str) -> None:
    """Refuse rows whose velocity change is used and that lack what it is made of."""
    for event, is_used in zip(rows, used, strict=True):
        if is_used and getattr(event, name) is None:
            raise InputError(
                f"event {event.id}: {name}",
                "a number, because the event has a velocity change",
                "an empty cell",
                'fill it in, or set delta_v = "ignore" in the run file\'s [model]',
            )
