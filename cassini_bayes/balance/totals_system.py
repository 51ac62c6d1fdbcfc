"""The balance of totals rows at a batch of parameter points: columns, target and noise.

The columns are those of :mod:`cassini_bayes.balance.totals_terms`. A ΔV that was measured adds
three rows, M ΔV = Σ_k d_k F_k s_k (paper 000 App. D; paper 001 eq. 22).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Physics, delta_v_variance, effective_on_times
from cassini_bayes.balance.totals_terms import (
    ResponseJacobian,
    TotalsStack,
    hold_attitude_covariance,
    hold_rate_covariance,
    on_time_rounding_covariance,
    response_jacobian,
    thruster_columns,
    wheel_momentum,
    wheel_rounding_covariance,
)
from cassini_bayes.computing.arrays import Array, Flags, Places
from cassini_bayes.spacecraft.pulses import PulseShape

NOISE: Final = (
    "hold_rate_rad_s",
    "hold_attitude_rad",
    "on_time_resolution_s",
    "wheel_resolution_rpm",
)
"""Parameters of the noise of a row's balance."""


@dataclass(frozen=True)
class TotalsBalance:
    """What stays constant in the balance of totals rows."""

    stack: TotalsStack
    pulse_shape: PulseShape
    directions: Array  # (3, K) of the thrusters' forces
    measures_delta_v: Flags  # (E,) whose ΔV is a measurement of thrust


@dataclass(frozen=True)
class TotalsSystem:
    """The balance at n points: target = design @ thrust + torque·D + noise.

    Rows R are the three momentum axes [N m s], followed by the three ΔV axes [m/s] where any event
    uses ΔV as a measurement.
    """

    design: Array  # (n, E, R, K)
    torque_design: Array  # (E, R, 3)
    target: Array  # (n, E, R), less the mean external torque's share
    covariance: Array  # (n, E, R, R) of the noise
    torque_covariance: Array  # (E, R, R) of the external torque's departure from its mean
    arms_m: Array  # (..., E, 3, K), or (..., 1, 3, K)
    stretch: Array  # (n, E, K) effective over commanded on-time; 1 where a thruster did not fire
    response: Array  # (E, K, 3)
    answered: Flags  # (E, 3), whether anything fired about an axis
    jacobian: ResponseJacobian  # at the reference thrust
    reference_n: Array  # (..., E, K), broadcastable

    @classmethod
    def of_rows(cls, systems: Sequence[TotalsSystem], which: Places) -> TotalsSystem:
        """Every row (E,) out of the system, by its number, whose effects act in it."""
        if len(systems) == 1:
            return systems[0]

        def rows(values: Sequence[Array], tail: int) -> Array:
            rest = (slice(None),) * tail
            shape = np.broadcast_shapes(*(v.shape for v in values), (len(which), *(1,) * tail))
            joined = np.empty(shape)
            for i, value in enumerate(values):
                joined[(..., which == i, *rest)] = np.broadcast_to(value, shape)[
                    (..., which == i, *rest)
                ]
            return joined

        return replace(
            systems[0],
            design=rows([s.design for s in systems], 2),
            target=rows([s.target for s in systems], 1),
            covariance=rows([s.covariance for s in systems], 2),
            arms_m=rows([s.arms_m for s in systems], 2),
            stretch=rows([s.stretch for s in systems], 1),
            jacobian=ResponseJacobian(
                rows([s.jacobian.value for s in systems], 0),
                rows([s.jacobian.gradient for s in systems], 1),
                rows([s.jacobian.hessian for s in systems], 2),
            ),
            reference_n=rows([s.reference_n for s in systems], 1),
        )

    def residual(self, thrust_n: Array, torque_departure_n_m: Array) -> Array:
        """Thruster impulse plus external torque minus the wheels' change, (n, E, R).

        thrust_n (n, E, K); torque_departure_n_m (n, E, 3) from the torque's prior mean.
        """
        impulse = (self.design @ thrust_n[..., None])[..., 0]
        torque = (self.torque_design @ torque_departure_n_m[..., None])[..., 0]
        return np.asarray(impulse + torque - self.target)

    def response_matrix(self, thrust_n: Array) -> Array:
        """M = ∂(momentum)/∂(responding on-times) at thrusts (n, E, K) → (n, E, 3, 3), N m."""
        rows = self.stretch[..., :, None] * self.response
        return np.asarray((self.arms_m * thrust_n[..., None, :]) @ rows)

    def log_jacobian(self, thrust_n: Array) -> Array:
        """Exact log |det M| (n, E) at thrusts (n, E, K)."""
        return response_jacobian(
            self.arms_m, self.stretch, self.response, thrust_n, self.answered
        ).value

    def expanded_log_jacobian(self, thrust_n: Array) -> Array:
        """What the expansion about the reference thrust makes of it, (n, E)."""
        expanded, step = self.jacobian, thrust_n - self.reference_n
        return np.asarray(
            expanded.value
            + (expanded.gradient * step).sum(-1)
            + 0.5 * (step[..., None, :] @ expanded.hessian @ step[..., :, None])[..., 0, 0]
        )


def totals_system(
    balance: TotalsBalance,
    physics: Physics,
    parameters: Mapping[str, Array],
    thrust_n: float,
    torque_mean: Array,
    torque_sd: Array,
) -> TotalsSystem:
    """Columns, target and noise of every totals row at n points.

    Parameters
    ----------
    physics
        The physics at n points.
    parameters
        Noise levels, and with ΔV the mass factor: name → (n,) array.
    thrust_n
        Mean thrust without effects: the response Jacobian is expanded about what the physics makes
        of it, and it scales rounded on-times.
    torque_mean, torque_sd
        (3,) prior of a row's steady torque, N m.
    """
    stack = balance.stack
    axes, inertias, arms = physics.wheel_axes, physics.wheel_inertia_kg_m2, physics.arms_m
    effective = effective_on_times(balance.pulse_shape, physics, stack.on_time_s, stack.pulses)
    start = wheel_momentum(axes, inertias, stack.wheel_start_rad_s)
    end = wheel_momentum(axes, inertias, stack.wheel_end_rad_s)
    covariance = (
        hold_rate_covariance(physics.inertia_kg_m2, parameters["hold_rate_rad_s"])[..., None, :, :]
        + hold_attitude_covariance(start, end, parameters["hold_attitude_rad"])
        + wheel_rounding_covariance(
            axes, inertias, stack.wheel_is_prime, parameters["wheel_resolution_rpm"]
        )
        + on_time_rounding_covariance(
            arms, thrust_n, stack.couples, parameters["on_time_resolution_s"]
        )
    )
    design = thruster_columns(arms, effective)
    target = end - start - steady_impulse(physics, stack.duration_s)
    batch = np.broadcast_shapes(
        design.shape[:-3],
        target.shape[:-2],
        covariance.shape[:-3],
        *(np.shape(value) for value in parameters.values()),
    )
    n_events, n_thrusters = stack.on_time_s.shape
    design = np.broadcast_to(design, (*batch, n_events, 3, n_thrusters))
    target = np.broadcast_to(target, (*batch, n_events, 3))
    covariance = np.broadcast_to(covariance, (*batch, n_events, 3, 3))
    torque_design = stack.duration_s[:, None, None] * np.eye(3)
    if balance.measures_delta_v.any():
        design, target, covariance, torque_design = _with_delta_v_rows(
            balance, parameters, effective, design, target, covariance, torque_design
        )
    fired = stack.on_time_s > 0
    stretch = np.where(fired, effective / np.where(fired, stack.on_time_s, 1.0), 1.0)
    factor = np.broadcast_to(
        physics.thrust_factor, (*np.shape(physics.thrust_factor)[:-1], n_thrusters)
    )
    reference = thrust_n * factor[..., None, :]
    torque = torque_design * torque_sd
    return TotalsSystem(
        design=design,
        torque_design=torque_design,
        target=target - torque_design @ torque_mean,
        covariance=covariance,
        torque_covariance=np.asarray(torque @ np.swapaxes(torque, -1, -2)),
        arms_m=arms[..., None, :, :],
        stretch=np.broadcast_to(stretch, (*batch, n_events, n_thrusters)),
        response=stack.response,
        answered=stack.answered,
        jacobian=response_jacobian(
            arms[..., None, :, :], stretch, stack.response, reference, stack.answered
        ),
        reference_n=reference,
    )


def steady_impulse(physics: Physics, duration_s: Array) -> Array | float:
    """Angular impulse (..., E, 3) of a steady torque beyond the collapsed one, N m s.

    duration_s (..., E) of the events; 0 without such a torque.
    """
    if not np.ndim(physics.steady_torque_n_m):
        return 0.0
    return np.asarray(physics.steady_torque_n_m)[..., None, :] * duration_s[..., None]


def _with_delta_v_rows(
    balance: TotalsBalance,
    parameters: Mapping[str, Array],
    effective: Array,
    design: Array,
    target: Array,
    covariance: Array,
    torque_design: Array,
) -> tuple[Array, Array, Array, Array]:
    """Append ΔV = Σ_k d_k F_k s_k / M as three more rows.

    An event without a measured ΔV gets rows that are satisfied with density one.
    """
    stack, used = balance.stack, balance.measures_delta_v
    batch = target.shape[:-2]
    mass = np.asarray(parameters["mass_factor"])[..., None] * np.where(used, stack.mass_kg, 1.0)
    rows = balance.directions * (effective / mass[..., None])[..., None, :]
    rows = np.where(used[:, None, None], rows, 0.0)
    values = np.where(used[:, None], stack.delta_v_m_s, 0.0)
    variance = np.where(used, delta_v_variance(parameters)[..., None], 1.0 / (2.0 * np.pi))
    blocks = np.zeros((*batch, len(used), 6, 6))
    blocks[..., :3, :3] = covariance
    blocks[..., 3:, 3:] = variance[..., None, None] * np.eye(3)
    return (
        np.concatenate([design, np.broadcast_to(rows, design.shape)], axis=-2),
        np.concatenate([target, np.broadcast_to(values, target.shape)], axis=-1),
        blocks,
        np.concatenate([torque_design, np.zeros_like(torque_design)], axis=-2),
    )
