"""The collapsed posterior: thrusts and torques integrated out exactly, drawn back afterwards.

Given the walked parameters θ the model is linear-Gaussian in the thrusts and torques, apart from
the response Jacobian, whose logarithm is expanded to second order about the reference thrust
(:func:`cassini_bayes.model.predictive.jacobian_expansion_error` measures what that leaves out).
Each event's own coordinates are eliminated first, then the shared ones, so the cost grows linearly
with events. ``docs/totals-likelihood.md`` derives the formulae.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.computed_delta_v import channel_log_likelihood, draw_software
from cassini_bayes.model.totals import LinearSystem, ThrustPrior, TotalsTerm, linear_system

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ThrustInformation:
    """What events say of their thrusts, everything else of their own integrated out.

    With d = F − common: log L_e(F) = constant + vectorᵀ d − ½ dᵀ matrix d. Totals and telemetry
    events alike come down to this.
    """

    common_n: Array  # (n,)
    matrix: Array  # (n, E, K, K)
    vector: Array  # (n, E, K)
    constant: Array  # (n, E)


@dataclass(frozen=True)
class CollapsedThrusts:
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
    software: Array  # (n, 2) factor and on-time per pulse of the on-board ΔV computation


def collapse_totals(model: TotalsTerm, system: LinearSystem) -> CollapsedThrusts:
    """Integrate the thrusts and torques out of the likelihood of totals events."""
    information = thrust_information(model, system)
    if system.offset_n is not None:
        information = about(information, system.offset_n)
    collapsed = combine(model.thrust_prior, information)
    if model.computed is None:
        return collapsed
    channel = channel_log_likelihood(model.computed, system.delta_v_variance)
    return replace(collapsed, log_likelihood=collapsed.log_likelihood + channel)


def thrust_information(model: TotalsTerm, system: LinearSystem) -> ThrustInformation:
    """What totals events say of their thrusts, the external torques integrated out.

    With A the whitened design, b the whitened misfit at the common level's mean, and g, H the
    gradient and Hessian of the response Jacobian there, an event's information on its thrusts is
    G = AᵀA − H with linear term ν = Aᵀb + g + H d0; d0 is the distance of a walked common level
    from the reference.
    """
    linear = model.thrust_prior
    misfit = system.target - system.common_n[..., None, None] * system.design.sum(-1)
    factor = _cholesky(system.covariance + system.torque_covariance)
    white = np.linalg.solve(factor, np.concatenate([system.design, misfit[..., None]], axis=-1))
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
    return ThrustInformation(
        common_n=system.common_n,
        matrix=gram[..., :-1, :-1] - jacobian.hessian,
        vector=gram[..., :-1, -1] + tilt,
        constant=(
            -0.5 * gram[..., -1, -1] - log_det - 0.5 * rows * np.log(2.0 * np.pi) + tilt_value
        ),
    )


def about(information: ThrustInformation, offset_n: Array) -> ThrustInformation:
    """The same information about other mean levels, common + offset (n, K).

    With d = d' + δ: c + νᵀd − ½ dᵀGd = (c + νᵀδ − ½ δᵀGδ) + (ν − Gδ)ᵀ d' − ½ d'ᵀ G d'.
    """
    moved = (information.matrix @ offset_n[:, None, :, None])[..., 0]
    along = offset_n[:, None, :] * (information.vector - 0.5 * moved)
    return replace(
        information,
        vector=information.vector - moved,
        constant=information.constant + along.sum(-1),
    )


def combine(linear: ThrustPrior, information: ThrustInformation) -> CollapsedThrusts:
    """Integrate the thrusts out of the information of all events.

    Thrust is S η + L ξ_e beyond the common level, so ξ_e is eliminated with the Cholesky factor of
    1 + LᵀGL and η with that of 1 + Sᵀ Σ_e [G − GL(1 + LᵀGL)⁻¹LᵀG] S (Rasmussen & Williams 2006,
    eqs. A.9-A.12).
    """
    own, shared = linear.own, linear.shared
    matrix, vector = information.matrix, information.vector
    by_shared = _times(matrix, shared)
    own_precision = _times(np.swapaxes(_times(matrix, own), -1, -2), own)
    own_factor = _cholesky(own_precision + np.eye(own.shape[1]))
    right = _times(
        np.concatenate([np.swapaxes(by_shared, -1, -2), vector[..., None, :]], axis=-2), own
    )
    solved: Array = np.asarray(np.linalg.solve(own_factor, np.swapaxes(right, -1, -2)), dtype=float)
    schur = np.swapaxes(solved, -1, -2) @ solved
    shared_precision = shared.T @ by_shared.sum(-3) - schur[..., :-1, :-1].sum(-3)
    shared_linear = vector.sum(-2) @ shared - schur[..., :-1, -1].sum(-2)
    shared_factor = _cholesky(shared_precision + np.eye(shared.shape[1]))
    shared_shift = np.linalg.solve(shared_factor, shared_linear[..., None])[..., 0]
    own_log_det = np.log(np.diagonal(own_factor, axis1=-2, axis2=-1)).sum(-1)
    shared_log_det = np.log(np.diagonal(shared_factor, axis1=-2, axis2=-1)).sum(-1)
    log_likelihood = (
        (information.constant + 0.5 * schur[..., -1, -1] - own_log_det).sum(-1)
        + 0.5 * (shared_shift**2).sum(-1)
        - shared_log_det
    )
    return CollapsedThrusts(
        log_likelihood=log_likelihood,
        own_factor=own_factor,
        own_coupling=solved[..., :-1],
        own_shift=solved[..., -1],
        shared_factor=shared_factor,
        shared_shift=shared_shift,
    )


def _cholesky(matrix: Array) -> Array:
    return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)


def _times(stack: Array, matrix: Array) -> Array:
    """stack (..., r, K) @ matrix (K, c) as one product: numpy would loop over the stack."""
    product = stack.reshape(-1, stack.shape[-1]) @ matrix
    return np.asarray(product.reshape(*stack.shape[:-1], matrix.shape[1]))


def totals_log_likelihood(model: TotalsTerm, z: Array) -> Array:
    """Collapsed log likelihood (n,) at walked coordinates z (n, d)."""
    return collapse_totals(model, linear_system(model, model.space.to_parameters(z))).log_likelihood


def totals_log_posterior(model: TotalsTerm, z: Array) -> Array:
    """Collapsed log likelihood plus log prior density in z, shape (n,); each prior counts once."""
    return np.asarray(totals_log_likelihood(model, z) + model.space.log_prior_terms(z).sum(-1))


@dataclass(frozen=True)
class ThrustDraws:
    """One draw of the thrusts per parameter point."""

    thrust_n: Array  # (n, E, K)
    common_n: Array  # (n,)
    level_n: Array  # (n, K)


def draw_thrusts(
    linear: ThrustPrior,
    collapsed: CollapsedThrusts,
    common_n: Array,
    rng: np.random.Generator,
    offset_n: Array | None = None,
) -> ThrustDraws:
    """One draw of all events' thrusts from their conditional normal at every parameter point."""
    n, n_events, n_own, n_shared = collapsed.own_coupling.shape
    shared = _solve_transposed(
        collapsed.shared_factor, collapsed.shared_shift + rng.standard_normal((n, n_shared))
    )
    pull = collapsed.own_shift - (collapsed.own_coupling @ shared[:, None, :, None])[..., 0]
    own = _solve_transposed(collapsed.own_factor, pull + rng.standard_normal((n, n_events, n_own)))
    level = common_n[:, None] + shared @ linear.shared.T
    if offset_n is not None:
        level = level + offset_n
    return ThrustDraws(
        thrust_n=level[:, None, :] + own @ linear.own.T,
        common_n=draw_common(linear, common_n, level, rng),
        level_n=level,
    )


def draw_linear(
    model: TotalsTerm, system: LinearSystem, collapsed: CollapsedThrusts, rng: np.random.Generator
) -> LinearDraws:
    """One draw of thrusts and torques from their conditional normal at every parameter point."""
    thrusts = draw_thrusts(model.thrust_prior, collapsed, system.common_n, rng, system.offset_n)
    return LinearDraws(
        thrust_n=thrusts.thrust_n,
        common_n=thrusts.common_n,
        level_n=thrusts.level_n,
        external_torque_n_m=draw_torque(model, system, thrusts.thrust_n, rng),
        software=(
            np.zeros((len(thrusts.common_n), 2))
            if model.computed is None
            else draw_software(model.computed, system.delta_v_variance, rng)
        ),
    )


def draw_common(
    linear: ThrustPrior, common_n: Array, level_n: Array, rng: np.random.Generator
) -> Array:
    """The common level given every thruster's level = common + individual; the data add nothing.

    A thruster's own departure of width zero makes the common level that of every thruster.
    """
    normals = rng.standard_normal(len(level_n))
    if linear.common_sd_n == 0.0:
        return common_n
    if linear.individual_sd_n == 0.0:
        return level_n[:, 0]
    weight = linear.common_sd_n**-2 + level_n.shape[1] * linear.individual_sd_n**-2
    mean = (
        common_n * linear.common_sd_n**-2 + level_n.sum(-1) * linear.individual_sd_n**-2
    ) / weight
    return np.asarray(mean + normals / np.sqrt(weight))


def draw_torque(
    model: TotalsTerm, system: LinearSystem, thrust_n: Array, rng: np.random.Generator
) -> Array:
    """External torques given the thrusts: a prior draw corrected by the residual it leaves."""
    linear = model.thrust_prior
    residual = system.target - (system.design @ thrust_n[..., None])[..., 0]
    departure = linear.torque_sd_n_m * rng.standard_normal((*residual.shape[:-1], 3))
    noise = np.linalg.cholesky(system.covariance) @ rng.standard_normal((*residual.shape, 1))
    missing = residual - (system.torque_design @ departure[..., None] + noise)[..., 0]
    answer = np.linalg.solve(system.covariance + system.torque_covariance, missing[..., None])
    gain = linear.torque_sd_n_m**2 * (np.swapaxes(system.torque_design, -1, -2) @ answer)[..., 0]
    return np.asarray(linear.torque_mean_n_m + departure + gain)


def _solve_transposed(factor: Array, right: Array) -> Array:
    """Solve factorᵀ x = right for stacked lower factors and vectors."""
    solution = np.linalg.solve(np.swapaxes(factor, -1, -2), right[..., None])
    return np.asarray(solution[..., 0])


def thrust_moments(model: TotalsTerm, z: Array) -> tuple[Array, Array]:
    """Conditional mean and variance (n, E, K) of every event's thrusts given the nuisances z.

    This is the estimate, and the noise-only variance, that a fit with all nuisances held at z would
    report; its change with z is the consider-style contribution of each nuisance.
    """
    system = linear_system(model, model.space.to_parameters(z))
    mean, variance = moments_of(model.thrust_prior, collapse_totals(model, system), system.common_n)
    if system.offset_n is not None:
        mean = mean + system.offset_n[:, None, :]
    return mean, variance


def moments_of(
    linear: ThrustPrior, collapsed: CollapsedThrusts, common_n: Array
) -> tuple[Array, Array]:
    """Mean and variance (n, E, K) of the thrusts that :func:`draw_thrusts` draws."""
    own, shared = linear.own, linear.shared
    shared_inverse = np.linalg.inv(collapsed.shared_factor)
    shared_mean = (np.swapaxes(shared_inverse, -1, -2) @ collapsed.shared_shift[..., None])[..., 0]
    own_inverse_t = np.swapaxes(np.linalg.inv(collapsed.own_factor), -1, -2)
    pull = collapsed.own_shift - (collapsed.own_coupling @ shared_mean[:, None, :, None])[..., 0]
    own_mean = (own_inverse_t @ pull[..., None])[..., 0]
    # thrust = … + [S − L gain] (η − η̂) + L (own noise)
    gain = own_inverse_t @ collapsed.own_coupling
    response = (shared - own @ gain) @ np.swapaxes(shared_inverse, -1, -2)[:, None]
    spread = own @ own_inverse_t
    mean = common_n[:, None, None] + own_mean @ own.T + (shared_mean @ shared.T)[:, None, :]
    return mean, (spread**2).sum(-1) + (response**2).sum(-1)
