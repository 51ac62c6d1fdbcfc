"""The collapsed posterior: thrusts and torques integrated out exactly, drawn back afterwards.

Given the walked parameters θ the model is linear-Gaussian in the thrusts and torques, apart from
the response Jacobian, whose logarithm is expanded to second order about the reference thrust (the
error of that expansion is measured by :func:`cassini_bayes.predictive.jacobian_expansion_error`). Each event's own
coordinates are eliminated first, then the shared ones, so the cost grows linearly with events.
``docs/totals-likelihood.md`` derives the formulae.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.model import LinearSystem, TotalsModel, linear_system

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Collapsed:
    """Factors of the conditional normal of the linear coordinates at a batch of points.

    Coordinates are the events' own ξ_e (p of them) and the shared η (q); all have N(0, 1) priors.
    """

    log_likelihood: Array  # (n,)
    own_factor: Array  # (n, E, p, p) lower Cholesky factor of an event's own precision
    own_coupling: Array  # (n, E, p, q) own_factor⁻¹ Λ_ξη
    own_shift: Array  # (n, E, p) own_factor⁻¹ ν_ξ
    shared_factor: Array  # (n, q, q) lower Cholesky factor of the shared precision
    shared_shift: Array  # (n, q) shared_factor⁻¹ ν_η


@dataclass(frozen=True)
class LinearDraws:
    """One draw of the linear parameters per parameter point."""

    thrust_n: Array  # (n, E, K)
    common_n: Array  # (n,) the common level
    level_n: Array  # (n, K) common + individual: a thruster's level over all events
    external_torque_n_m: Array  # (n, E, 3)


def _own_map(model: TotalsModel) -> tuple[Array, Array, Array]:
    """Maps from [ξ_e, ξ'_e | η] to thrust (K, p+q), and the torque columns' scales (3,)."""
    linear = model.linear
    used = linear.torque_sd_n_m > 0
    n_thrusters = linear.own.shape[0]
    to_thrust = np.hstack([linear.own, np.zeros((n_thrusters, int(used.sum()))), linear.shared])
    scales = np.diag(linear.torque_sd_n_m)[:, used]
    return to_thrust, scales, used


def collapse(model: TotalsModel, system: LinearSystem) -> Collapsed:
    """Integrate the thrusts and torques out of the likelihood.

    With r = W x − b the whitened residual (x the linear coordinates) and the Jacobian tilt
    g, H about the reference thrust, an event's precision is WᵀW − UᵀHU, its linear term
    Wᵀb + Uᵀ(g + H d0); U maps x to thrust and d0 is the offset of the walked common level from the
    reference. Block elimination as in Rasmussen & Williams (2006) eq. A.11-A.12.
    """
    linear = model.linear
    to_thrust, torque_scales, _ = _own_map(model)
    n_own = to_thrust.shape[1] - linear.shared.shape[1]
    columns = system.design @ to_thrust
    first_torque = linear.own.shape[1]
    columns[..., first_torque:n_own] += system.torque_design @ torque_scales
    offset = system.common_n[..., None, None] * system.design.sum(-1)
    offset = offset + system.torque_design @ linear.torque_mean_n_m
    misfit = system.target - offset
    factor = np.linalg.cholesky(system.covariance)
    white = np.linalg.solve(factor, np.concatenate([columns, misfit[..., None]], axis=-1))
    log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
    rows = factor.shape[-1]

    jacobian = system.jacobian
    shift = (system.common_n - linear.common_mean_n)[..., None, None]
    tilt = jacobian.gradient + shift * jacobian.hessian.sum(-1)
    tilt_value = (
        jacobian.value
        + shift[..., 0] * jacobian.gradient.sum(-1)
        + 0.5 * shift[..., 0] ** 2 * jacobian.hessian.sum((-2, -1))
    )
    gram = np.swapaxes(white, -1, -2) @ white
    precision = gram[..., :-1, :-1] - to_thrust.T @ jacobian.hessian @ to_thrust
    linear_term = gram[..., :-1, -1] + tilt @ to_thrust
    constant = -0.5 * gram[..., -1, -1] - log_det - 0.5 * rows * np.log(2.0 * np.pi) + tilt_value

    own_precision = precision[..., :n_own, :n_own] + np.eye(n_own)
    own_factor = np.linalg.cholesky(own_precision)
    right = np.concatenate(
        [precision[..., :n_own, n_own:], linear_term[..., :n_own, None]], axis=-1
    )
    solved = np.linalg.solve(own_factor, right)
    schur = np.swapaxes(solved, -1, -2) @ solved
    n_shared = precision.shape[-1] - n_own
    shared_precision = (precision[..., n_own:, n_own:] - schur[..., :-1, :-1]).sum(-3)
    shared_linear = (linear_term[..., n_own:] - schur[..., :-1, -1]).sum(-2)
    shared_factor = np.linalg.cholesky(shared_precision + np.eye(n_shared))
    shared_shift = np.linalg.solve(shared_factor, shared_linear[..., None])[..., 0]
    own_log_det = np.log(np.diagonal(own_factor, axis1=-2, axis2=-1)).sum(-1)
    shared_log_det = np.log(np.diagonal(shared_factor, axis1=-2, axis2=-1)).sum(-1)
    log_likelihood = (
        (constant + 0.5 * schur[..., -1, -1] - own_log_det + system.delta_v_log_likelihood).sum(-1)
        + 0.5 * (shared_shift**2).sum(-1)
        - shared_log_det
    )
    return Collapsed(
        log_likelihood=log_likelihood,
        own_factor=own_factor,
        own_coupling=solved[..., :-1],
        own_shift=solved[..., -1],
        shared_factor=shared_factor,
        shared_shift=shared_shift,
    )


def log_likelihood(model: TotalsModel, z: Array) -> Array:
    """Collapsed log likelihood (n,) at walked coordinates z (n, d)."""
    return collapse(model, linear_system(model, model.space.to_parameters(z))).log_likelihood


def log_posterior(model: TotalsModel, z: Array) -> Array:
    """Collapsed log likelihood plus log prior density in z, shape (n,); each prior counts once."""
    return log_likelihood(model, z) + model.space.log_prior_terms(z).sum(-1)


def draw_linear(
    model: TotalsModel, collapsed: Collapsed, common_n: Array, rng: np.random.Generator
) -> LinearDraws:
    """One draw of thrusts and torques from their conditional normal at every parameter point."""
    n, n_events, n_own, n_shared = collapsed.own_coupling.shape
    shared = _solve_transposed(
        collapsed.shared_factor, collapsed.shared_shift + rng.standard_normal((n, n_shared))
    )
    pull = collapsed.own_shift - (collapsed.own_coupling @ shared[:, None, :, None])[..., 0]
    own = _solve_transposed(
        collapsed.own_factor, pull + rng.standard_normal((n, n_events, n_own))
    )
    linear = model.linear
    _, scales, _ = _own_map(model)
    n_thrust = linear.own.shape[1]
    level = common_n[:, None] + shared @ linear.shared.T
    return LinearDraws(
        thrust_n=level[:, None, :] + own[..., :n_thrust] @ linear.own.T,
        common_n=common_n + (linear.common_sd_n * shared[:, 0] if linear.common_sd_n else 0.0),
        level_n=level,
        external_torque_n_m=linear.torque_mean_n_m + own[..., n_thrust:] @ scales.T,
    )


def _solve_transposed(factor: Array, right: Array) -> Array:
    """Solve factorᵀ x = right for stacked lower factors and vectors."""
    solution = np.linalg.solve(np.swapaxes(factor, -1, -2), right[..., None])
    return np.asarray(solution[..., 0])


def thrust_moments(model: TotalsModel, z: Array) -> tuple[Array, Array]:
    """Conditional mean and variance (n, E, K) of every event's thrusts given the nuisances z.

    This is the estimate, and the noise-only variance, that a fit with all nuisances held at z would
    report; its change with z is the consider-style contribution of each nuisance.
    """
    system = linear_system(model, model.space.to_parameters(z))
    collapsed = collapse(model, system)
    to_thrust, _, _ = _own_map(model)
    n_own = collapsed.own_factor.shape[-1]
    identity = np.eye(n_own)
    shared_inverse = np.linalg.inv(collapsed.shared_factor)
    shared_mean = (np.swapaxes(shared_inverse, -1, -2) @ collapsed.shared_shift[..., None])[..., 0]
    shared_cov = np.swapaxes(shared_inverse, -1, -2) @ shared_inverse
    own_inverse_t = np.swapaxes(np.linalg.solve(collapsed.own_factor, identity), -1, -2)
    gain = own_inverse_t @ collapsed.own_coupling  # ξ_e = mean − gain (η − η̂) + own noise
    pull = collapsed.own_shift - (collapsed.own_coupling @ shared_mean[:, None, :, None])[..., 0]
    own_mean = (own_inverse_t @ pull[..., None])[..., 0]
    response = to_thrust[:, n_own:] - to_thrust[:, :n_own] @ gain
    spread = to_thrust[:, :n_own] @ own_inverse_t
    mean = (
        system.common_n[:, None, None]
        + own_mean @ to_thrust[:, :n_own].T
        + (shared_mean @ to_thrust[:, n_own:].T)[:, None, :]
    )
    variance = (spread**2).sum(-1) + ((response @ shared_cov[:, None]) * response).sum(-1)
    return mean, variance
