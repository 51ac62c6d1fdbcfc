"""The terms of the angular-momentum balance of a totals-only bias event.

Between the start and the end of a bias the wheels take up momentum and the thrusters remove it
(paper 001 eqs. 12-17; paper 003 eqs. 1-4). Per event, in body axes [N m s],

    Σ_k q_k F_k s_k + τ D − (h1 − h0) = I (ω1 − ω0) + θ1×h1 − θ0×h0 + rounding

with q_k the lever arm (torque per newton, m), F_k the thrust (N), s_k the effective on-time (s),
τ the external torque (N m), D the duration (s), h the wheel momentum at either end, ω and θ the
body rate and attitude error left in the dead-band. The left-hand side is a sum of known columns
times parameters; the right-hand side is noise whose covariance depends on parameters. Every
function here is one such piece, vectorised over a batch of parameter points (leading axis ``n``,
absent where a parameter is fixed) and over events (axis ``E``).
``docs/topics/totals-likelihood.md`` has the derivation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cassini_bayes.computing.arrays import Array, Flags
from cassini_bayes.errors import InputError
from cassini_bayes.events.branches import require_branch
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.spacecraft import Spacecraft, couples, pair_indicator
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM


@dataclass(frozen=True)
class TotalsStack:
    """Totals-only events of one thruster branch as arrays (read-only), thrusters in file order.

    Shapes: E events, K thrusters, W wheels of the spacecraft (zero speed where not prime),
    G couples (thrusters that only ever fire together).
    """

    event_ids: tuple[str, ...]
    thrusters: tuple[str, ...]
    on_time_s: Array  # (E, K) commanded
    pulses: Array  # (E, K)
    wheel_start_rad_s: Array  # (E, W)
    wheel_end_rad_s: Array  # (E, W)
    wheel_is_prime: Flags  # (E, W)
    duration_s: Array  # (E,)
    response: Array  # (E, K, 3) thrusters that answer a momentum demand about each axis
    answered: Flags  # (E, 3) whether any of them fired
    couples: Array  # (G, K) indicator
    delta_v_m_s: Array  # (E, 3), NaN where not given
    has_delta_v: Flags  # (E,)
    delta_v_measured: Flags  # (E,)
    mass_kg: Array  # (E,) table mass, NaN where not given
    thrust_predicted_n: Array  # (E,) NaN where not given


def _frozen(values: object) -> Array:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def stack_events(
    events: tuple[TotalsEvent, ...], spacecraft: Spacecraft, branch: str
) -> TotalsStack:
    """Stack totals events of one branch into arrays.

    Raises
    ------
    InputError
        When there are no events, two carry the same id, one flew on another branch, one gives
        no pulse counts (the tail-off acts once per pulse, so on-times alone do not fix thrust), or
        nothing fired in one.
    """
    if not events:
        raise InputError("events", "at least one event", "none", "name an event folder or CSV")
    seen: set[str] = set()
    for event in events:
        if event.id in seen:
            raise InputError(
                f"event {event.id}", "unique ids", "the same id twice", "drop or rename one of them"
            )
        seen.add(event.id)
        require_branch(f"event {event.id}", event.branch, branch)
        if event.pulses is None:
            raise InputError(
                f"event {event.id}: pulses",
                "the number of pulses of every thruster",
                f"none in the rows of source {event.source!r}",
                "choose a source that has pulse counts (the tail-off acts once per pulse)",
            )
        if not any(event.on_time_s):
            raise InputError(
                f"event {event.id}: on-times",
                "at least one thruster that fired",
                "0 s of all of them",
                "leave the row out: it tells nothing of thrust",
            )
    names = tuple(t.name for t in spacecraft.thrusters_of(branch))
    on_time = np.array([event.on_time_s for event in events], dtype=np.float64)
    numbers = [wheel.number for wheel in spacecraft.wheels]
    shape = (len(events), len(numbers))
    start, end, prime = np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=bool)
    for row, event in enumerate(events):
        columns = [numbers.index(number) for number in event.wheels]
        start[row, columns] = np.asarray(event.rwa_start_rpm) * RAD_S_PER_RPM
        end[row, columns] = np.asarray(event.rwa_end_rpm) * RAD_S_PER_RPM
        prime[row, columns] = True
    prime.setflags(write=False)
    given = np.array([event.delta_v_m_s is not None for event in events])
    given.setflags(write=False)
    measured = np.array([event.delta_v_source == "measured" for event in events])
    measured.setflags(write=False)
    no_vector = np.full(3, np.nan)
    groups = couples(spacecraft, branch)
    response = response_directions(on_time, pair_indicator(spacecraft, branch))
    answered = answered_axes(on_time, response)
    answered.setflags(write=False)
    return TotalsStack(
        event_ids=tuple(event.id for event in events),
        thrusters=names,
        on_time_s=_frozen(on_time),
        pulses=_frozen([event.pulses for event in events]),
        wheel_start_rad_s=_frozen(start),
        wheel_end_rad_s=_frozen(end),
        wheel_is_prime=prime,
        duration_s=_frozen([event.duration_s for event in events]),
        response=_frozen(response),
        answered=answered,
        couples=_frozen([[name in group for name in names] for group in groups]),
        delta_v_m_s=_frozen(
            [no_vector if event.delta_v_m_s is None else event.delta_v_m_s for event in events]
        ),
        has_delta_v=given,
        delta_v_measured=measured,
        mass_kg=_frozen([np.nan if event.mass_kg is None else event.mass_kg for event in events]),
        thrust_predicted_n=_frozen(
            [np.nan if e.thrust_predicted_n is None else e.thrust_predicted_n for e in events]
        ),
    )


def response_directions(on_time_s: Array, pairs: Array) -> Array:
    """Which thrusters answer a momentum demand about each axis.

    The controller fires the pair of thrusters assigned to an axis and a sign. Both signs occur in
    every event (limit-cycle pulses), but a change of the net demand is met by the pair that does
    the work, i.e. the one with the larger total on-time.

    Parameters
    ----------
    on_time_s
        (E, K) commanded on-times.
    pairs
        (6, K) indicator of the thrusters fired for +x, −x, +y, −y, +z, −z.

    Returns
    -------
    (E, K, 3): column c is the indicator of the busier pair of axis c, negative for the minus pair.
    """
    busy = on_time_s @ pairs.T
    plus_wins = busy[:, 0::2] >= busy[:, 1::2]
    signed = np.where(plus_wins[:, :, None], pairs[None, 0::2], -pairs[None, 1::2])
    return np.asarray(np.swapaxes(signed, 1, 2), dtype=np.float64)


def wheel_momentum(axes: Array, inertias: Array, speed_rad_s: Array) -> Array:
    """Momentum of the wheels relative to the body, h = T diag(I_w) ρ, in N m s (paper 000 eq. 2).

    axes (..., 3, W), inertias (..., W) kg m², speeds (E, W) → (..., E, 3).
    """
    weights = axes * inertias[..., None, :]
    return np.asarray(np.swapaxes(weights @ speed_rad_s.T, -1, -2))


def thruster_columns(lever_arms: Array, effective_on_time: Array) -> Array:
    """Angular impulse per newton of every thruster, q_k s_k (N m s per N), in body axes.

    lever_arms (..., 3, K) m, effective_on_time (..., E, K) s → (..., E, 3, K).
    """
    return np.asarray(lever_arms[..., None, :, :] * effective_on_time[..., None, :])


def hold_rate_covariance(inertia: Array, hold_rate: Array) -> Array:
    """Covariance of I (ω1 − ω0) with both body rates drawn from N(0, hold_rate²) per axis.

    inertia (..., 3, 3) kg m², hold_rate (...) rad/s → (..., 3, 3) in (N m s)².
    """
    return np.asarray(
        2.0 * np.asarray(hold_rate)[..., None, None] ** 2 * (inertia @ np.swapaxes(inertia, -1, -2))
    )


def hold_attitude_covariance(start: Array, end: Array, hold_attitude: Array) -> Array:
    """Covariance of θ1×h1 − θ0×h0 with both attitude errors drawn from N(0, hold_attitude²).

    Uses [h×][h×]ᵀ = |h|² 1 − h hᵀ. start, end (..., E, 3) N m s; hold_attitude (...) rad →
    (..., E, 3, 3) in (N m s)².
    """
    square = (start * start + end * end).sum(-1)[..., None, None] * np.eye(3)
    outer = start[..., :, None] * start[..., None, :] + end[..., :, None] * end[..., None, :]
    return np.asarray(np.asarray(hold_attitude)[..., None, None, None] ** 2 * (square - outer))


def wheel_rounding_covariance(
    axes: Array, inertias: Array, is_prime: Flags, step_rpm: Array
) -> Array:
    """Covariance of the wheel momentum change due to the printed step of both wheel rates.

    A figure printed to a step s is uniform within ±s/2, variance s²/12. axes (..., 3, W),
    inertias (..., W), is_prime (E, W), step_rpm (...) → (..., E, 3, 3).
    """
    weights = (axes * inertias[..., None, :])[..., None, :, :] * is_prime[:, None, :]
    variance = 2.0 * (np.asarray(step_rpm) * RAD_S_PER_RPM) ** 2 / 12.0
    return np.asarray(variance[..., None, None, None] * (weights @ np.swapaxes(weights, -1, -2)))


def on_time_rounding_covariance(
    lever_arms: Array, thrust_n: float, couple_indicator: Array, step_s: Array
) -> Array:
    """Covariance of the thrusters' angular impulse due to the printed step of the on-times.

    One printed figure serves all thrusters of a couple. The thrust that scales it is the reference
    thrust: the term is some thousandths of an N m s, so its own uncertainty does not matter.
    lever_arms (..., 3, K), couple_indicator (G, K), step_s (...) → (..., 1, 3, 3).
    """
    per_couple = thrust_n * (lever_arms @ couple_indicator.T)
    variance = np.asarray(step_s) ** 2 / 12.0
    product = per_couple @ np.swapaxes(per_couple, -1, -2)
    return np.asarray((variance[..., None, None] * product)[..., None, :, :])


@dataclass(frozen=True)
class ResponseJacobian:
    """log |det ∂(momentum)/∂(on-times that respond)| and its expansion in the thrusts.

    Shapes: value (..., E), gradient (..., E, K) per N, hessian (..., E, K, K) per N².
    """

    value: Array
    gradient: Array
    hessian: Array


def answered_axes(on_time_s: Array, response: Array) -> Flags:
    """Whether any thruster answered about each axis (E, 3).

    on_time_s (E, K); response (E, K, 3) of :func:`response_directions`.
    """
    return np.asarray(np.einsum("ek,ekc->ec", on_time_s, np.abs(response)) > 0.0)


def response_jacobian(
    lever_arms: Array, stretch: Array, response: Array, thrust_n: Array, answered: Flags
) -> ResponseJacobian:
    """Jacobian between the momentum residual and the on-times that respond to it.

    The wheels are commanded and the on-times follow, so the density of the measured on-times is
    that of the residual times J = |det M|, M = Q diag(F) diag(stretch) R, with Q the lever arms,
    R the response directions and stretch = ∂s/∂u = s/u at fixed mean pulse width. With
    P = diag(stretch) R M⁻¹ Q: ∂logJ/∂F_k = P_kk and ∂²logJ/∂F_k∂F_l = −P_kl P_lk.

    Where nothing fired about an axis its on-time has a probability at 0 and no density: its column
    of M is a unit vector (of equal thrusts), whatever the thrusts are.

    lever_arms (..., E, 3, K), stretch (..., E, K), response (E, K, 3), thrust_n (..., E, K),
    answered (E, 3), or broadcastable. Derivation: docs/topics/totals-likelihood.md.
    """
    rows = stretch[..., :, None] * response
    matrix = (lever_arms * thrust_n[..., None, :]) @ rows
    if not answered.all():  # hardly ever
        answers, about = answered[..., None, :], lever_arms @ response
        unit = about / np.linalg.norm(about, axis=-2, keepdims=True)
        rows, matrix = np.where(answers, rows, 0.0), np.where(answers, matrix, unit)
    _, value = np.linalg.slogdet(matrix)
    spread = np.broadcast_to(lever_arms, (*matrix.shape[:-1], lever_arms.shape[-1]))
    projector = rows @ np.linalg.solve(matrix, spread)
    gradient = np.diagonal(projector, axis1=-2, axis2=-1)
    return ResponseJacobian(value, gradient, -projector * np.swapaxes(projector, -1, -2))
