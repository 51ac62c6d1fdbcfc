"""What the model says of the measured figures: residuals, replicated on-times, densities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.computed_delta_v import event_channel_log_likelihood
from cassini_bayes.balance.physics import Parameters
from cassini_bayes.balance.totals_terms import response_jacobian
from cassini_bayes.model.thrusts import LinearDraws
from cassini_bayes.model.totals import LinearSystem, TotalsTerm, linear_system
from cassini_bayes.spacecraft import lever_arms

Array = NDArray[np.float64]


def balance_residual(model: TotalsTerm, system: LinearSystem, draws: LinearDraws) -> Array:
    """Thruster impulse plus external torque minus the wheels' change, (n, E, R).

    The first three rows are the body axes in N m s; any further three are ΔV in m/s.
    """
    impulse = (system.design @ draws.thrust_n[..., None])[..., 0]
    departure = draws.external_torque_n_m - model.thrust_prior.torque_mean_n_m
    torque = (system.torque_design @ departure[..., None])[..., 0]
    return np.asarray(impulse + torque - system.target)


def response_matrix(
    model: TotalsTerm, system: LinearSystem, parameters: Parameters, thrust_n: Array
) -> Array:
    """M = ∂(momentum)/∂(responding on-times) at given thrusts (n, E, K) → (n, E, 3, 3), N m."""
    stretch = on_time_stretch(model, system)
    arms = lever_arms(model.spacecraft, model.branch, parameters)
    rows = stretch[..., :, None] * model.stack.response
    return np.asarray((arms[..., None, :, :] * thrust_n[..., None, :]) @ rows)


def on_time_stretch(model: TotalsTerm, system: LinearSystem) -> Array:
    """Effective over commanded on-time s/u (n, E, K); 1 where a thruster did not fire."""
    on_time = model.stack.on_time_s
    fired = on_time > 0
    return np.where(fired, system.effective_on_time_s / np.where(fired, on_time, 1.0), 1.0)


def replicate_on_times(
    model: TotalsTerm, parameters: Parameters, draws: LinearDraws, rng: np.random.Generator
) -> Array:
    """Commanded on-times (n, E, K) of the same biases flown again, one replicate per draw.

    New hold rates and attitude errors give a new residual; the pair that does the work about each
    axis makes up the difference, all other on-times stay as they were (docs/totals-likelihood.md
    §3). A slightly negative value means that the opposite pair would have fired.
    """
    system = linear_system(model, parameters)
    factor = np.linalg.cholesky(system.covariance[..., :3, :3])
    fresh = (factor @ rng.standard_normal((*factor.shape[:-1], 1)))[..., 0]
    change = fresh - balance_residual(model, system, draws)[..., :3]
    matrix = response_matrix(model, system, parameters, draws.thrust_n)
    answer = np.linalg.solve(matrix, change[..., None])
    return np.asarray(model.stack.on_time_s + (model.stack.response @ answer)[..., 0])


def event_log_likelihood(model: TotalsTerm, parameters: Parameters, draws: LinearDraws) -> Array:
    """Log density (n, E) of each event's figures given all parameters, thrusts and torques."""
    system = linear_system(model, parameters)
    factor = np.linalg.cholesky(system.covariance)
    white = np.linalg.solve(factor, balance_residual(model, system, draws)[..., None])[..., 0]
    log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
    arms = lever_arms(model.spacecraft, model.branch, parameters)
    jacobian = response_jacobian(
        arms, on_time_stretch(model, system), model.stack.response, draws.thrust_n
    ).value
    rows = factor.shape[-1]
    density = -0.5 * (white**2).sum(-1) - log_det - 0.5 * rows * np.log(2.0 * np.pi) + jacobian
    if model.computed is not None:
        density = density + event_channel_log_likelihood(
            model.computed, draws.software, system.delta_v_variance
        )
    return np.asarray(density)


def jacobian_expansion_error(model: TotalsTerm, parameters: Parameters, thrust_n: Array) -> Array:
    """Exact minus expanded log Jacobian, summed over events, at thrusts (n, E, K) → (n,) nats.

    The collapsed likelihood uses the expansion; this measures what it leaves out.
    """
    system = linear_system(model, parameters)
    expanded = system.jacobian
    arms = lever_arms(model.spacecraft, model.branch, parameters)
    exact = response_jacobian(
        arms, on_time_stretch(model, system), model.stack.response, thrust_n
    ).value
    step = thrust_n - model.thrust_prior.common_mean_n
    quadratic = (
        expanded.value
        + (expanded.gradient * step).sum(-1)
        + 0.5 * (step[..., None, :] @ expanded.hessian @ step[..., :, None])[..., 0, 0]
    )
    return np.asarray((exact - quadratic).sum(-1))
