"""Any mix of telemetry events and totals rows in one model, and its collapsed posterior.

What all events share (pulse shape, centre of mass, geometry, wheels, inertia, noise) is walked;
thrusts, initial momenta, torques and cut tails are linear-Gaussian and integrated out, each
event's own first, then the shared thrust levels. The dimension that is walked does not grow with
events.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.computed_delta_v import channel_log_likelihood
from cassini_bayes.balance.kernel import without_own
from cassini_bayes.balance.measured_delta_v import (
    DELTA_V_PARAMETERS,
    DeltaVStatistics,
    delta_v_information,
)
from cassini_bayes.balance.physics import (
    CENTRE_PARAMETERS,
    INERTIA_PARAMETERS,
    PULSE_PARAMETERS,
    Modifier,
    Physics,
    physics_of,
)
from cassini_bayes.balance.statistics import EventStatistics, Sampling
from cassini_bayes.balance.telemetry_system import EventSystem, event_system
from cassini_bayes.balance.telemetry_terms import (
    TelemetryTerms,
    make_terms,
    merged_bands,
    without_idle_columns,
)
from cassini_bayes.errors import InputError
from cassini_bayes.model.thrusts import (
    CollapsedThrusts,
    ThrustDraws,
    ThrustInformation,
    combine,
    draw_thrusts,
    thrust_information,
)
from cassini_bayes.model.totals import (
    THRUST_COMMON,
    TORQUES,
    ThrustPrior,
    TotalsTerm,
    linear_system,
    normal_priors,
    thrust_prior_of,
)
from cassini_bayes.priors.reader import ParameterSpace, Priors
from cassini_bayes.spacecraft import Spacecraft, couples, thruster_directions
from cassini_bayes.spacecraft.parameters import ParameterSpec
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

Array = NDArray[np.float64]
_CHANNELS: Final = (
    "rate_noise_rad_s",
    "wheel_noise_rpm",
    "attitude_noise_rad",
    "torque_noise_n_m_s05",
)
_TAIL_SPAN: Final = 5.0
_PRIOR_SPAN: Final = 2.0
_POINTS: Final = 4
_BLOCK: Final = 400
_FAR: Final = 30.0


@dataclass(frozen=True)
class Model:
    """Everything that stays constant during a fit of telemetry events and totals rows.

    Thrusts are those of the events that fire, totals rows first, then telemetry in order.
    """

    spacecraft: Spacecraft
    branch: str
    space: ParameterSpace
    specs: Mapping[str, ParameterSpec]
    thrust_prior: ThrustPrior
    totals: TotalsTerm | None
    telemetry: tuple[TelemetryTerms, ...]
    absent_wheel_parameters: Mapping[str, float]
    torque_mean_n_m: Array
    torque_sd_n_m: Array
    modifiers: tuple[Modifier, ...] = ()  # effects beyond the standard physics
    delta_v: tuple[DeltaVStatistics, ...] = ()  # measured velocity changes of telemetry events

    @property
    def event_ids(self) -> tuple[str, ...]:
        """All events, totals rows first."""
        rows = self.totals.stack.event_ids if self.totals is not None else ()
        return (*rows, *(terms.id for terms in self.telemetry))

    @property
    def fired_ids(self) -> tuple[str, ...]:
        """Events with thrusts."""
        rows = self.totals.stack.event_ids if self.totals is not None else ()
        return (*rows, *(terms.id for terms in self.telemetry if terms.fires))


@dataclass(frozen=True)
class OwnFactors:
    """Conditional normal of a telemetry event's own unknowns given its thrusts.

    In standardised coordinates v = (u − mean)/sd: precision factorᵀ-wise lower ``factor``, mean
    factor⁻ᵀ (shift − coupling F).
    """

    factor: Array  # (n, U, U)
    shift: Array  # (n, U)
    coupling: Array  # (n, U, K)
    sd: Array  # (n, U)
    mean: Array  # (U,)


@dataclass(frozen=True)
class Collapsed:
    """The collapsed posterior at a batch of points, with all that drawing back needs."""

    log_likelihood: Array
    common_n: Array
    thrusts: CollapsedThrusts | None
    own: tuple[OwnFactors, ...]


def sampling_of(
    priors: Priors, thrusters: Sequence[str], duration_s: float, pulse_shape: str
) -> Sampling:
    """How an event's telemetry is reduced, from the priors of the pulse parameters.

    The guard time is the valve delay and five of the longest likely tail-off times: what a pulse
    delivers later is below a percent of its tail.
    """
    groups = couples(priors.spacecraft, priors.branch) if thrusters else ()
    reference, guard = (0.0, 0.0, 0.0), 0.0
    if thrusters:
        priors.require(PULSE_PARAMETERS, "telemetry with thrusters")
        moments = [_moments(priors, name) for name in PULSE_PARAMETERS]
        delay, rise, fall = (mean for mean, _ in moments)
        reference = (delay, rise, fall)
        guard = delay + _TAIL_SPAN * (fall + _PRIOR_SPAN * moments[2][1])
    return Sampling(
        PULSE_SHAPES[pulse_shape],
        reference,
        guard,
        tuple(tuple(list(thrusters).index(name) for name in group) for group in groups),
        duration_s,
    )


def _moments(priors: Priors, name: str) -> tuple[float, float]:
    prior = priors.parameters[name]
    if prior.distribution is None:
        assert prior.fixed is not None  # the reader guarantees dist or fixed
        return prior.fixed, 0.0
    return prior.distribution.mean(), prior.distribution.sd()


def build_model(
    statistics: Sequence[tuple[EventStatistics, Sampling]],
    priors: Priors,
    totals: TotalsTerm | None = None,
    *,
    delta_v: Sequence[DeltaVStatistics] = (),
    keep_idle: bool = False,
) -> Model:
    """Assemble the model of telemetry events, with totals rows if there are any.

    ``delta_v`` are measured velocity changes of some of the events.
    ``keep_idle`` keeps the columns that have no weight yet, for effects to be added;
    :func:`without_idle` drops them.

    Raises
    ------
    InputError
        No event; an id twice; wheels or parameters that the priors file lacks.
    """
    ids = list(totals.stack.event_ids) if totals is not None else []
    ids += [event.event_id for event, _ in statistics]
    if not ids:
        raise InputError("events", "at least one event", "none", "name an event folder or CSV")
    for name in ids:
        if ids.count(name) > 1:
            raise InputError(
                f"event {name}", "each event once in a fit", "the same id twice", "rename one"
            )
    spacecraft = priors.spacecraft
    n_thrusters = len(spacecraft.thruster_names(priors.branch))
    fired = totals is not None or any(event.layout.thrusters for event, _ in statistics)
    names = list(totals.space.names) + list(totals.space.fixed) if totals is not None else []
    if statistics:
        names += [*INERTIA_PARAMETERS, *_CHANNELS]
        names += _wheel_names(statistics, priors)
    if fired:
        position_names = spacecraft.geometry[priors.branch].parameters
        names += [*PULSE_PARAMETERS, *CENTRE_PARAMETERS, *position_names]
    linear = thrust_prior_of(priors, n_thrusters) if fired else _no_thrust(n_thrusters)
    if linear.common_is_walked:
        names.append(THRUST_COMMON)
    if delta_v:
        names += DELTA_V_PARAMETERS
    names = list(dict.fromkeys(names))
    priors.require(names, "the model of these events")
    space = priors.space(names)
    _refuse_free_delay(space, fired, priors.path)
    means, scales = normal_priors(priors, TORQUES)
    own_names = [name for wheel in spacecraft.wheels for name in wheel.parameters]
    nominal = {**dict.fromkeys(own_names, 0.0), **_centre(space)}
    model = Model(
        spacecraft=spacecraft,
        branch=priors.branch,
        space=space,
        specs={name: prior.spec for name, prior in priors.parameters.items()},
        thrust_prior=linear,
        totals=totals,
        telemetry=tuple(
            make_terms(event, sampling, spacecraft, nominal) for event, sampling in statistics
        ),
        absent_wheel_parameters={
            name: 0.0 for name in own_names if name not in (*space.names, *space.fixed)
        },
        torque_mean_n_m=np.array(means),
        torque_sd_n_m=np.array(scales),
        delta_v=tuple(delta_v),
    )
    return model if keep_idle else without_idle(model)


def without_idle(model: Model) -> Model:
    """The model without columns that no parameter point gives weight: call it after a change."""
    if not model.telemetry:
        return model
    points = model.space.sample(np.random.default_rng(0), _POINTS)
    physics = physics_at(model, full_parameters(model, points))
    thrust = model.thrust_prior.common_mean_n
    telemetry = tuple(without_idle_columns(t, physics, thrust) for t in model.telemetry)
    return replace(model, telemetry=telemetry)


def with_equal_bands_merged(model: Model) -> Model:
    """The model with a slew's bands as one where no torque noise tells them apart."""
    if model.space.fixed.get("torque_noise_n_m_s05") != 0.0:
        return model
    return replace(model, telemetry=tuple(merged_bands(terms) for terms in model.telemetry))


def full_parameters(model: Model, z: Array) -> dict[str, Array]:
    """Every parameter the physics may ask for at walked coordinates z (n, d), as (n,) arrays."""
    values = {**model.absent_wheel_parameters, **model.space.to_parameters(z)}
    return {
        name: value if isinstance(value, np.ndarray) else np.full(len(z), value)
        for name, value in values.items()
    }


def physics_at(model: Model, full: Mapping[str, Array]) -> Physics:
    """Physics of the telemetry events at the parameters of :func:`full_parameters`."""
    fires = bool(model.fired_ids)
    return physics_of(model.spacecraft, model.branch, full, model.modifiers, fires=fires)


def system_of(
    model: Model, terms: TelemetryTerms, physics: Physics, full: Mapping[str, Array]
) -> EventSystem:
    """Normal equations of one telemetry event of the model at n points.

    ``physics`` and ``full`` are those of :func:`physics_at` and :func:`full_parameters`.
    """
    return event_system(
        terms,
        physics,
        full,
        model.thrust_prior.common_mean_n,
        model.torque_mean_n_m,
        model.torque_sd_n_m,
    )


def _centre(space: ParameterSpace) -> dict[str, float]:
    means = {n: d.mean() for n, d in zip(space.names, space.distributions, strict=True)}
    return {**space.fixed, **means}


def _no_thrust(thrusters: int) -> ThrustPrior:
    nothing = np.zeros((thrusters, 0))
    return ThrustPrior(0.0, 0.0, False, 0.0, nothing, nothing, np.zeros(3), np.zeros(3))


def _wheel_names(
    statistics: Sequence[tuple[EventStatistics, Sampling]], priors: Priors
) -> list[str]:
    used = {number for event, _ in statistics for number in event.layout.wheels}
    missing = sorted(used - set(priors.wheels))
    if missing:
        raise InputError(
            f"{priors.path}: spacecraft.wheels",
            f"every wheel the events use, {sorted(used)}",
            str(list(priors.wheels)),
            "list them, with their priors",
        )
    return [
        name
        for wheel in priors.spacecraft.wheels
        if wheel.number in used
        for name in wheel.parameters
    ]


def _refuse_free_delay(space: ParameterSpace, fired: bool, where: str) -> None:
    if fired and "tau_delay_s" in space.names:
        raise InputError(
            f"{where}: parameters.tau_delay_s",
            "a fixed value (telemetry sees pulses only after they are over)",
            "a distribution",
            "fix it; the delay cancels in first_order pulses",
        )


def collapse(model: Model, z: Array) -> Collapsed:
    """Everything linear integrated out at walked coordinates z (n, d)."""
    n = len(z)
    full = full_parameters(model, z)
    log_likelihood = np.zeros(n)
    common = np.full(n, model.thrust_prior.common_mean_n)
    if model.thrust_prior.common_is_walked:
        common = full[THRUST_COMMON]
    parts: list[ThrustInformation] = []
    if model.totals is not None:
        system = linear_system(model.totals, full)
        parts.append(thrust_information(model.totals, system))
        if model.totals.computed is not None:
            log_likelihood = log_likelihood + channel_log_likelihood(
                model.totals.computed, system.delta_v_variance
            )
    own = []
    physics = physics_at(model, full) if model.telemetry else None
    for terms in model.telemetry:
        assert physics is not None  # there is telemetry
        event = system_of(model, terms, physics, full)
        factors, information = eliminate_own(event, terms.pattern.thrusters, common)
        own.append(factors)
        if terms.fires:
            parts.append(_with_delta_v(model, terms, physics, full, information))
        else:
            log_likelihood = log_likelihood + information.constant[:, 0]
    if not parts:
        return Collapsed(log_likelihood, common, None, tuple(own))
    thrusts = combine(model.thrust_prior, _joined(parts))
    return Collapsed(log_likelihood + thrusts.log_likelihood, common, thrusts, tuple(own))


def _with_delta_v(
    model: Model,
    terms: TelemetryTerms,
    physics: Physics,
    parameters: Mapping[str, Array],
    information: ThrustInformation,
) -> ThrustInformation:
    """An event's information on its thrusts with that of its measured velocity change, if any."""
    own = next((part for part in model.delta_v if part.event_id == terms.id), None)
    if own is None:
        return information
    directions = thruster_directions(model.spacecraft, model.branch)
    matrix, vector, constant = delta_v_information(
        own, physics, directions, parameters, information.common_n
    )
    return ThrustInformation(
        information.common_n,
        information.matrix + matrix[:, None],
        information.vector + vector[:, None],
        information.constant + constant[:, None],
    )


def _joined(parts: Sequence[ThrustInformation]) -> ThrustInformation:
    if len(parts) == 1:
        return parts[0]
    return ThrustInformation(
        parts[0].common_n,
        np.concatenate([part.matrix for part in parts], axis=1),
        np.concatenate([part.vector for part in parts], axis=1),
        np.concatenate([part.constant for part in parts], axis=1),
    )


def eliminate_own(
    event: EventSystem, thrusters: int, common_n: Array
) -> tuple[OwnFactors, ThrustInformation]:
    """Integrate an event's initial momentum, torque and cut tails out of its normal equations.

    With M the normal equations and v the standardised own unknowns, their precision is
    1 + s M_vv s; what is left is the information on the thrusts (docs/telemetry-likelihood.md §5).
    """
    factor, shift, coupling, matrix, vector, constant = without_own(
        event.normal,
        thrusters,
        event.own_mean,
        event.own_sd,
        np.ascontiguousarray(common_n),
    )
    information = ThrustInformation(
        common_n, matrix[:, None], vector[:, None], (event.log_scale + constant)[:, None]
    )
    return OwnFactors(factor, shift, coupling, event.own_sd, event.own_mean), information


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


@dataclass(frozen=True)
class JointDraws:
    """One draw of everything integrated out per parameter point.

    ``own`` has per telemetry event the initial momentum (3), the steady torque (3) and the
    standardised cut tails.
    """

    thrusts: ThrustDraws | None
    own: tuple[Array, ...]


def draw(model: Model, collapsed: Collapsed, rng: np.random.Generator) -> JointDraws:
    """Draw thrusts, then every telemetry event's own unknowns given its thrusts."""
    thrusts = (
        None
        if collapsed.thrusts is None
        else draw_thrusts(model.thrust_prior, collapsed.thrusts, collapsed.common_n, rng)
    )
    place = 0 if model.totals is None else len(model.totals.stack.event_ids)
    own = []
    for terms, factors in zip(model.telemetry, collapsed.own, strict=True):
        pull = factors.shift
        if terms.fires:
            assert thrusts is not None  # an event that fires has thrusts
            pull = pull - (factors.coupling @ thrusts.thrust_n[:, place, :, None])[..., 0]
            place += 1
        white = pull + rng.standard_normal(pull.shape)
        v = np.linalg.solve(np.swapaxes(factors.factor, -1, -2), white[..., None])[..., 0]
        own.append(factors.mean + factors.sd * v)
    return JointDraws(thrusts, tuple(own))
