"""From events and priors to a model: what is walked, what is linear, what they predict.

A :class:`TotalsTerm` is everything that stays constant during a fit. :func:`linear_system` turns a
batch of walked parameters into the linear-Gaussian system of the thrusts and torques, which
:mod:`cassini_bayes.model.thrusts` integrates out exactly. The same system serves the likelihood,
the posterior predictive and the residuals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.computed_delta_v import ComputedDeltaV, computed_channel
from cassini_bayes.balance.physics import (
    CENTRE_PARAMETERS,
    INERTIA_PARAMETERS,
    PULSE_PARAMETERS,
    Modifier,
    Parameters,
    Physics,
    physics_of,
)
from cassini_bayes.balance.totals_terms import (
    ResponseJacobian,
    TotalsStack,
    hold_attitude_covariance,
    hold_rate_covariance,
    on_time_rounding_covariance,
    response_jacobian,
    stack_events,
    thruster_columns,
    wheel_momentum,
    wheel_rounding_covariance,
)
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.priors.chaining import ChainedLevels
from cassini_bayes.priors.reader import ParameterSpace, Priors
from cassini_bayes.spacecraft import (
    Spacecraft,
    check_axis_pairs,
    thruster_directions,
)
from cassini_bayes.spacecraft.parameters import ParameterSpec
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES, PulseShape, effective_on_time

Array = NDArray[np.float64]
DeltaVUse = Literal["as-declared", "ignore", "as-measured"]

THRUST_COMMON: Final = "thrust_common_n"
THRUST_LEVELS: Final = ("thrust_individual_n", "thrust_event_n", "thrust_jitter_n")
TORQUES: Final = tuple(f"external_torque_{axis}_n_m" for axis in "xyz")
_NOISE: Final = (
    "hold_rate_rad_s",
    "hold_attitude_rad",
    "on_time_resolution_s",
    "wheel_resolution_rpm",
)
SOFTWARE: Final = ("fsw_acceleration_factor", "fsw_impulse_offset_s")
_DELTA_V_NOISE: Final = ("delta_v_noise_m_s", "delta_v_resolution_m_s")


@dataclass(frozen=True)
class ThrustPrior:
    """Prior of the parameters that enter linearly.

    thrust[e] = common mean + shared @ η + own @ ξ_e, with η shared by all events, ξ_e the event's
    own, all N(0, 1) before the data: shared @ sharedᵀ is the prior covariance of the thrusters'
    levels (common + individual), own @ ownᵀ that of an event's departures (event + jitter).
    """

    common_mean_n: float
    common_sd_n: float  # 0 where the common level is walked or fixed
    common_is_walked: bool
    individual_sd_n: float
    shared: Array  # (K, q)
    own: Array  # (K, p)
    torque_mean_n_m: Array  # (3,)
    torque_sd_n_m: Array  # (3,)
    # levels from an earlier fit: ``shared`` is then a factor of their covariance given the walked
    # parameters, and their mean takes the place of the common one
    chained: ChainedLevels | None = None


@dataclass(frozen=True)
class TotalsTerm:
    """Model of totals-only bias events: data, parameter space, linear block, pulse shape."""

    spacecraft: Spacecraft
    branch: str
    stack: TotalsStack
    space: ParameterSpace
    specs: Mapping[str, ParameterSpec]
    thrust_prior: ThrustPrior
    pulse_shape: PulseShape
    delta_v: DeltaVUse
    absent_wheel_parameters: Mapping[str, float]
    computed: ComputedDeltaV | None  # the channel of ΔV computed on board, where events have it
    modifiers: tuple[Modifier, ...] = ()  # effects beyond the standard physics

    @property
    def uses_measured_delta_v(self) -> NDArray[np.bool_]:
        """(E,) which events' ΔV enters as a measurement of thrust."""
        if self.delta_v == "ignore":
            return np.zeros_like(self.stack.has_delta_v)
        if self.delta_v == "as-measured":
            return self.stack.has_delta_v
        return self.stack.has_delta_v & self.stack.delta_v_measured

    @property
    def uses_computed_delta_v(self) -> NDArray[np.bool_]:
        """(E,) which events' ΔV enters as the output of the on-board computation."""
        if self.delta_v != "as-declared":
            return np.zeros_like(self.stack.has_delta_v)
        return self.stack.has_delta_v & ~self.stack.delta_v_measured


@dataclass(frozen=True)
class LinearSystem:
    """The balance at a batch of parameter points: target = design @ thrust + torque·D + noise.

    Rows R are the three momentum axes [N m s], followed by the three ΔV axes [m/s] where any event
    uses ΔV as a measurement. Shapes carry the batch axis n.
    """

    design: Array  # (n, E, R, K)
    torque_design: Array  # (E, R, 3)
    target: Array  # (n, E, R), less the mean external torque's share
    covariance: Array  # (n, E, R, R) of the noise
    torque_covariance: Array  # (E, R, R) of the external torque's departure from its mean
    jacobian: ResponseJacobian  # at the reference thrust
    delta_v_variance: Array  # (n,) of a printed ΔV; 0 where no event uses it
    common_n: Array  # (n,)
    effective_on_time_s: Array  # (n, E, K)
    offset_n: Array | None = None  # (n, K) mean level less the common one, from an earlier fit


def build_totals(
    events: tuple[TotalsEvent, ...],
    priors: Priors,
    *,
    pulse_shape: str = "first_order",
    delta_v: DeltaVUse = "as-declared",
) -> TotalsTerm:
    """Assemble the model of totals-only bias events.

    Parameters
    ----------
    events
        Totals rows of one thruster branch.
    priors
        The priors file; every parameter the model needs must be in it.
    pulse_shape
        Key of :data:`cassini_bayes.spacecraft.pulses.PULSE_SHAPES`.
    delta_v
        ``as-declared``: each event's ``delta_v_source`` decides; ``ignore``: ΔV is left out;
        ``as-measured``: every ΔV is taken as a measurement of thrust (a what-if).

    Raises
    ------
    InputError
        Unknown pulse shape, events of another branch or wheel set, or a missing parameter.
    """
    if pulse_shape not in PULSE_SHAPES:
        raise InputError(
            "model.pulse_shape",
            f"one of {', '.join(PULSE_SHAPES)}",
            repr(pulse_shape),
            "choose one of these",
        )
    spacecraft = priors.spacecraft
    stack = stack_events(events, spacecraft, priors.branch)
    for event in events:
        if not set(event.wheels) <= set(priors.wheels):
            raise InputError(
                f"event {event.id}: wheels",
                f"wheels out of {list(priors.wheels)} as in {priors.path}",
                str(list(event.wheels)),
                "list every wheel the events use under spacecraft.wheels, with its priors",
            )
    wheel_names, idle_names = (
        [
            name
            for wheel in spacecraft.wheels
            if (wheel.number in priors.wheels) == prime
            for name in wheel.parameters
        ]
        for prime in (True, False)
    )
    draft = TotalsTerm(
        spacecraft=spacecraft,
        branch=priors.branch,
        stack=stack,
        space=priors.space(()),
        specs={name: prior.spec for name, prior in priors.parameters.items()},
        thrust_prior=thrust_prior_of(replace(priors, earlier=None), len(stack.thrusters)),
        pulse_shape=PULSE_SHAPES[pulse_shape],
        delta_v=delta_v,
        # a parameter that an idle wheel shares with a prime one keeps its prior
        absent_wheel_parameters={name: 0.0 for name in idle_names if name not in wheel_names},
        computed=None,
    )
    position_names = spacecraft.geometry[priors.branch].parameters
    names = [*PULSE_PARAMETERS, *CENTRE_PARAMETERS, *position_names, *wheel_names]
    names += [*INERTIA_PARAMETERS, *_NOISE]
    if draft.uses_measured_delta_v.any():
        names += ["mass_factor", *_DELTA_V_NOISE]
        _require_mass(draft)
    if draft.uses_computed_delta_v.any():
        names += ["mass_factor", *_DELTA_V_NOISE]
        _require_mass(draft)
        means, scales = normal_priors(priors, SOFTWARE)
        draft = replace(
            draft,
            computed=computed_channel(
                stack,
                thruster_directions(spacecraft, priors.branch),
                draft.uses_computed_delta_v,
                np.array(means),
                np.array(scales),
            ),
        )
    if draft.thrust_prior.common_is_walked:
        names.append(THRUST_COMMON)
    names = list(dict.fromkeys(names))
    priors.require(names, "the totals model")
    model = replace(draft, space=priors.space(names))
    if priors.earlier is not None:
        model = _chained(model, priors)
    _require_sense(model, priors.path)
    check_axis_pairs(spacecraft, priors.branch, prior_centre(model))
    return model


def _chained(model: TotalsTerm, priors: Priors) -> TotalsTerm:
    """The model with thrust levels from an earlier fit, given the parameters that both walk."""
    earlier = priors.earlier
    assert earlier is not None  # asked for with an earlier fit only
    if model.computed is not None:
        raise InputError(
            f"{priors.path}: from_fit",
            "events without a computed velocity change",
            "one that the flight software computed, whose constants are not handed on",
            'set delta_v = "ignore" in the run file: it informs no thrust',
        )
    levels, factor = earlier.levels(model.space.names)
    factor.setflags(write=False)
    return replace(model, thrust_prior=replace(model.thrust_prior, shared=factor, chained=levels))


def _require_sense(model: TotalsTerm, where: str) -> None:
    """Refuse priors under which the model has nothing to estimate or no noise to weigh it by."""
    linear, centre = model.thrust_prior, prior_centre(model)
    if not linear.common_mean_n > 0:
        raise InputError(
            f"{where}: parameters.{THRUST_COMMON}",
            "a positive mean, in N",
            f"{linear.common_mean_n:g}",
            "thrust is counted along each thruster's direction; change loc",
        )
    if linear.shared.shape[1] + linear.own.shape[1] == 0 and not linear.common_is_walked:
        raise InputError(
            f"{where}: parameters.{THRUST_COMMON}",
            "a distribution for at least one of the thrust parameters",
            "all four fixed",
            "give thrust_common_n a distribution",
        )
    if not any(centre[name] > 0 for name in _NOISE):
        raise InputError(
            f"{where}: parameters.{_NOISE[0]}",
            f"at least one of {', '.join(_NOISE)} above zero",
            "all of them 0",
            "say how well the figures and the dead-band are known",
        )
    used = model.uses_measured_delta_v.any() or model.uses_computed_delta_v.any()
    if used and not any(centre[name] > 0 for name in _DELTA_V_NOISE):
        raise InputError(
            f"{where}: parameters.{_DELTA_V_NOISE[0]}",
            f"{' or '.join(_DELTA_V_NOISE)} above zero",
            "both 0",
            "a printed velocity change is good to its last digit at best",
        )


def prior_centre(model: TotalsTerm) -> dict[str, float]:
    """Prior mean of every walked parameter and value of every fixed one: what one would assume."""
    if model.space.joint is not None:
        centre = model.space.to_parameters(np.zeros(model.space.dimension))
        return {name: float(value) for name, value in centre.items()}
    means = {
        name: distribution.mean()
        for name, distribution in zip(model.space.names, model.space.distributions, strict=True)
    }
    return {**model.space.fixed, **means}


def _require_mass(model: TotalsTerm) -> None:
    stack = model.stack
    used = model.uses_measured_delta_v | model.uses_computed_delta_v
    for row, event_id in enumerate(stack.event_ids):
        if used[row] and not (
            np.isfinite(stack.mass_kg[row]) and np.isfinite(stack.thrust_predicted_n[row])
        ):
            raise InputError(
                f"event {event_id}: mass_kg, thrust_predicted_n",
                "both, because the event has a velocity change",
                "an empty cell",
                'fill them in, or set delta_v = "ignore" in the run file\'s [model]',
            )


def thrust_prior_of(priors: Priors, n_thrusters: int) -> ThrustPrior:
    """Read the linear parameters' priors; they must be normal (or fixed) to be integrated out."""
    if priors.earlier is not None:
        raise InputError(
            f"{priors.path}: from_fit",
            "totals rows alone, in the earlier fit and in this one",
            "telemetry with thrusters",
            "fit both sets of events together instead",
        )
    priors.require([THRUST_COMMON], "the totals model")
    levels = normal_priors(priors, THRUST_LEVELS)[1]
    torque_means, torque_scales = normal_priors(priors, TORQUES)
    common = priors.parameters[THRUST_COMMON]
    walked = common.distribution is not None and not common.distribution.is_normal
    common_sd = 0.0 if common.distribution is None or walked else common.distribution.sd()
    mean = common.fixed if common.distribution is None else common.distribution.mean()
    assert mean is not None  # the reader guarantees dist or fixed
    individual, event, jitter = levels
    return ThrustPrior(
        common_mean_n=float(mean),
        common_sd_n=common_sd,
        common_is_walked=walked,
        individual_sd_n=individual,
        shared=_level_factor(common_sd, individual, n_thrusters),
        own=_level_factor(event, jitter, n_thrusters),
        torque_mean_n_m=np.array(torque_means),
        torque_sd_n_m=np.array(torque_scales),
    )


def normal_priors(priors: Priors, names: tuple[str, ...]) -> tuple[list[float], list[float]]:
    """Means and standard deviations of parameters that are integrated out: normal or fixed."""
    priors.require(names, "the totals model")
    means, scales = [], []
    for name in names:
        prior = priors.parameters[name]
        if prior.distribution is None:
            assert prior.fixed is not None  # the reader guarantees one of the two
            means.append(prior.fixed)
            scales.append(0.0)
        elif prior.distribution.is_normal:
            means.append(prior.distribution.mean())
            scales.append(prior.distribution.sd())
        else:
            raise InputError(
                f"{priors.path}: parameters.{name}.dist",
                "norm without bounds, or fixed (the parameter is integrated out exactly)",
                f"{prior.distribution.name} (or bounds)",
                "use a normal prior; its width can be as large as you believe",
            )
    return means, scales


def _level_factor(common_sd: float, individual_sd: float, size: int) -> Array:
    """Factor B (K, rank) with B Bᵀ = common_sd² 1 1ᵀ + individual_sd² 1."""
    if individual_sd > 0:
        covariance = np.full((size, size), common_sd**2) + individual_sd**2 * np.eye(size)
        factor = np.linalg.cholesky(covariance)
    else:
        factor = np.full((size, int(common_sd > 0)), common_sd)
    factor.setflags(write=False)
    return np.asarray(factor, dtype=np.float64)


def linear_system(model: TotalsTerm, parameters: Parameters) -> LinearSystem:
    """Everything the collapsed likelihood needs, at a batch of walked parameters.

    Parameters
    ----------
    parameters
        name → (n,) array or float, as from ``model.space.to_parameters(z)``.
    """
    stack, spacecraft = model.stack, model.spacecraft
    full = _as_arrays({**parameters, **model.absent_wheel_parameters})
    physics = physics_of(spacecraft, model.branch, full, model.modifiers)
    axes, inertias, arms = physics.wheel_axes, physics.wheel_inertia_kg_m2, physics.arms_m
    effective = _effective_on_time(model, physics)
    start = wheel_momentum(axes, inertias, stack.wheel_start_rad_s)
    end = wheel_momentum(axes, inertias, stack.wheel_end_rad_s)
    covariance = (
        hold_rate_covariance(physics.inertia_kg_m2, full["hold_rate_rad_s"])[..., None, :, :]
        + hold_attitude_covariance(start, end, full["hold_attitude_rad"])
        + wheel_rounding_covariance(
            axes, inertias, stack.wheel_is_prime, full["wheel_resolution_rpm"]
        )
        + on_time_rounding_covariance(
            arms, model.thrust_prior.common_mean_n, stack.couples, full["on_time_resolution_s"]
        )
    )
    design = thruster_columns(arms, effective)
    target = end - start - _steady_impulse(stack, physics)
    batch = np.broadcast_shapes(
        design.shape[:-3], target.shape[:-2], covariance.shape[:-3], _batch_shape(full)
    )
    n_events, n_thrusters = stack.on_time_s.shape
    design = np.broadcast_to(design, (*batch, n_events, 3, n_thrusters))
    target = np.broadcast_to(target, (*batch, n_events, 3))
    covariance = np.broadcast_to(covariance, (*batch, n_events, 3, 3))
    torque_design = stack.duration_s[:, None, None] * np.eye(3)
    if model.uses_measured_delta_v.any():
        design, target, covariance, torque_design = _with_delta_v_rows(
            model, full, effective, design, target, covariance, torque_design
        )
    fired = stack.on_time_s > 0
    stretch = np.where(fired, effective / np.where(fired, stack.on_time_s, 1.0), 1.0)
    reference = np.full((n_events, n_thrusters), model.thrust_prior.common_mean_n)
    common = (
        full[THRUST_COMMON]
        if model.thrust_prior.common_is_walked
        else model.thrust_prior.common_mean_n
    )
    return LinearSystem(
        design=design,
        torque_design=torque_design,
        target=target - torque_design @ model.thrust_prior.torque_mean_n_m,
        covariance=covariance,
        torque_covariance=_outer(torque_design * model.thrust_prior.torque_sd_n_m),
        jacobian=response_jacobian(arms, stretch, stack.response, reference),
        delta_v_variance=np.broadcast_to(_delta_v_variance(full), batch),
        common_n=np.broadcast_to(np.asarray(common, dtype=np.float64), batch),
        effective_on_time_s=np.broadcast_to(effective, (*batch, n_events, n_thrusters)),
        offset_n=_offset(model.thrust_prior, full, batch, n_thrusters),
    )


def _offset(
    linear: ThrustPrior, parameters: Parameters, batch: tuple[int, ...], n_thrusters: int
) -> Array | None:
    """Mean levels less the common one (..., K); None without an earlier fit."""
    if linear.chained is None:
        return None
    common = parameters[THRUST_COMMON] if linear.common_is_walked else linear.common_mean_n
    levels = linear.chained.levels_n(parameters) - np.asarray(common)[..., None]
    return np.broadcast_to(levels, (*batch, n_thrusters))


def _effective_on_time(model: TotalsTerm, physics: Physics) -> Array:
    """Effective on-time of every thruster and event, (..., E, K) s."""
    stack = model.stack
    effective = effective_on_time(
        model.pulse_shape,
        stack.on_time_s,
        stack.pulses,
        *(np.asarray(tau)[..., None, None] for tau in physics.tau_s),
    )
    if np.ndim(physics.thrust_factor):
        effective = np.asarray(physics.thrust_factor)[..., None, :] * effective
    if np.ndim(physics.impulse_offset_s):
        effective = effective + np.asarray(physics.impulse_offset_s)[..., None, :] * stack.pulses
    return effective


def _steady_impulse(stack: TotalsStack, physics: Physics) -> Array | float:
    """Angular impulse (..., E, 3) of a steady torque beyond the collapsed one, N m s."""
    if not np.ndim(physics.steady_torque_n_m):
        return 0.0
    return np.asarray(physics.steady_torque_n_m)[..., None, :] * stack.duration_s[:, None]


def _outer(columns: Array) -> Array:
    return np.asarray(columns @ np.swapaxes(columns, -1, -2))


def _as_arrays(values: Parameters) -> dict[str, Array]:
    return {name: np.asarray(value, dtype=np.float64) for name, value in values.items()}


def _batch_shape(parameters: Parameters) -> tuple[int, ...]:
    return np.broadcast_shapes(*(np.shape(value) for value in parameters.values()))


def _with_delta_v_rows(
    model: TotalsTerm,
    parameters: Parameters,
    effective: Array,
    design: Array,
    target: Array,
    covariance: Array,
    torque_design: Array,
) -> tuple[Array, Array, Array, Array]:
    """Append ΔV = Σ_k d_k F_k s_k / M as three more rows (paper 000 App. D; paper 001 eq. 22).

    An event without a measured ΔV gets rows that are satisfied with density one.
    """
    stack, used = model.stack, model.uses_measured_delta_v
    batch = target.shape[:-2]
    mass = np.asarray(parameters["mass_factor"])[..., None] * np.where(used, stack.mass_kg, 1.0)
    directions = thruster_directions(model.spacecraft, model.branch)
    rows = directions * (effective / mass[..., None])[..., None, :]
    rows = np.where(used[:, None, None], rows, 0.0)
    values = np.where(used[:, None], stack.delta_v_m_s, 0.0)
    variance = np.where(used, _delta_v_variance(parameters)[..., None], 1.0 / (2.0 * np.pi))
    blocks = np.zeros((*batch, len(used), 6, 6))
    blocks[..., :3, :3] = covariance
    blocks[..., 3:, 3:] = variance[..., None, None] * np.eye(3)
    return (
        np.concatenate([design, np.broadcast_to(rows, design.shape)], axis=-2),
        np.concatenate([target, np.broadcast_to(values, target.shape)], axis=-1),
        blocks,
        np.concatenate([torque_design, np.zeros_like(torque_design)], axis=-2),
    )


def _delta_v_variance(parameters: Parameters) -> Array:
    if _DELTA_V_NOISE[0] not in parameters:
        return np.zeros(())
    noise = np.asarray(parameters["delta_v_noise_m_s"])
    step = np.asarray(parameters["delta_v_resolution_m_s"])
    return np.asarray(noise**2 + step**2 / 12.0)
