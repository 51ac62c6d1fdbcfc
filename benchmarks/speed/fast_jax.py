"""Our fast likelihood written again in JAX, for samplers that need gradients. One bias only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.special as special
import numpy as np
from jax.scipy.linalg import solve_triangular

from cassini_bayes.statistics.columns import CUT_PARTS
from cassini_bayes.telemetry_terms import CONTROL_CYCLE_S, INITIAL_SD_N_M_S, cut_probability
from cassini_bayes.terms import RAD_S_PER_RPM
from speed import plain

jax.config.update("jax_enable_x64", True)
Values = Any


def fast_log_posterior(problem: plain.Problem) -> Callable[[Values], Values]:
    """z (d,) → collapsed log posterior, compiled by the caller."""
    terms, model = problem.terms, problem.model
    reduced, pattern = terms.reduced, terms.pattern
    owner = np.repeat(np.arange(len(reduced.start) - 1), np.diff(reduced.start))
    columns, width = reduced.slow.shape[1], len(reduced.start) - 1
    grams = [jnp.asarray(gram) for gram in reduced.grams]
    slow = jnp.asarray(reduced.slow)
    rows, k = terms.statistics.rows, pattern.thrusters
    channels = 3 + len(terms.wheel_places)
    mean = np.concatenate(
        [terms.initial_mean_n_m_s, model.torque_mean_n_m, np.zeros(len(pattern.cuts))]
    )
    linear = model.linear

    def log_posterior(z: Values) -> Values:
        parameters = plain.to_parameters(jnp, special, model, z)
        inertia, wheels, arms, taus = plain.physics(jnp, problem, parameters)
        kept, log_density = plain.latent_wheels(jnp, problem, parameters)
        white = (
            parameters["rate_noise_rad_s"] ** 2 * inertia @ inertia.T
            + parameters["attitude_noise_rad"] ** 2 * terms.spin
        )
        wheel = (parameters["wheel_noise_rpm"] * RAD_S_PER_RPM) ** 2
        walk = parameters["torque_noise_n_m_s05"] ** 2
        scale = log_density + rows * (
            jnp.linalg.slogdet(inertia)[1] - 0.5 * channels * np.log(2.0 * np.pi)
        )
        normal = jnp.zeros((width, width))
        own, own_sd = _weights(problem, arms, taus)
        for i, (band, share) in enumerate(zip(problem.bands, kept, strict=True)):
            weights = jnp.concatenate([own, _measured(inertia, wheels @ share)])
            chosen = weights[reduced.entries]
            combine = jnp.zeros((3, columns, width)).at[:, reduced.row, owner].add(chosen.T)
            values, vectors = jnp.linalg.eigh(white + wheel * wheels @ share @ wheels.T)
            if i == 0:
                variance = values[:, None] + walk * band.walk
                seen = jnp.einsum("cam,cak->cmk", slow, combine)
                turned = jnp.einsum("cmk,ce->emk", seen, vectors)
                normal = normal + jnp.einsum("emk,eml->kl", turned / variance[..., None], turned)
                scale = scale - 0.5 * jnp.sum(jnp.log(variance))
                continue
            variance = values + walk * jnp.mean(band.walk)
            precision = (vectors / variance) @ vectors.T
            right = jnp.einsum("cd,cdab,dbl->cal", precision, grams[i - 1], combine)
            normal = normal + jnp.einsum("cak,cal->kl", combine, right)
            scale = scale - 0.5 * band.rows * jnp.sum(jnp.log(variance))
        sd = jnp.concatenate([jnp.full(3, INITIAL_SD_N_M_S), model.torque_sd_n_m, own_sd])
        matrix, vector, constant = _without_own(normal, k, mean, sd)
        common = linear.common_mean_n
        by_common = matrix.sum(-1)
        constant = constant + scale + common * vector.sum() - 0.5 * common**2 * by_common.sum()
        prior = -0.5 * jnp.sum(z**2) - 0.5 * len(z) * np.log(2.0 * np.pi)
        return constant + _without_thrust(problem, matrix, vector - common * by_common) + prior

    return log_posterior


def _without_own(normal: Values, k: int, mean: Values, sd: Values) -> tuple[Values, Values, Values]:
    """Information on the thrusts, the event's own unknowns integrated out."""
    own = slice(k, k + len(mean))
    target_own = normal[own, -1] - normal[own, own] @ mean
    target_thrust = normal[:k, -1] - normal[:k, own] @ mean
    square = normal[-1, -1] - 2.0 * normal[-1, own] @ mean + mean @ normal[own, own] @ mean
    factor = jnp.linalg.cholesky(sd[:, None] * normal[own, own] * sd + jnp.eye(len(mean)))
    coupling = solve_triangular(factor, sd[:, None] * normal[own, :k], lower=True)
    shift = solve_triangular(factor, sd * target_own, lower=True)
    constant = -0.5 * square + 0.5 * shift @ shift - jnp.sum(jnp.log(jnp.diag(factor)))
    return normal[:k, :k] - coupling.T @ coupling, target_thrust - coupling.T @ shift, constant


def _without_thrust(problem: plain.Problem, matrix: Values, vector: Values) -> Values:
    factor = problem.thrust_factor
    lower = jnp.linalg.cholesky(factor.T @ matrix @ factor + jnp.eye(len(factor)))
    shift = solve_triangular(lower, factor.T @ vector, lower=True)
    return 0.5 * shift @ shift - jnp.sum(jnp.log(jnp.diag(lower)))


def _weights(
    problem: plain.Problem, arms: Values, taus: tuple[Values, Values]
) -> tuple[Values, Values]:
    """Weights (B, 3) of the unknowns' entries, and the prior sd of the cut tails."""
    terms, layout = problem.terms, problem.terms.statistics.layout
    rise, fall = taus
    _, reference_rise, reference_fall = terms.sampling.pulse_reference_s
    pulse = jnp.stack([jnp.ones(()), rise - reference_rise, fall - reference_fall])
    lost = (fall - rise) * jnp.exp(-CONTROL_CYCLE_S / fall)
    chance = cut_probability(terms.statistics.counter_interval_s)
    pattern, parts = terms.pattern, []
    for thruster in range(pattern.thrusters):
        arm = arms[:, thruster]
        strength = (arm[:, None] * pulse).reshape(9, 1)
        cuts = pattern.start[thruster + 1] - pattern.start[thruster] - 10
        parts += [jnp.broadcast_to(strength, (9, 3)), jnp.zeros((1, 3))]
        parts.append(jnp.broadcast_to(-chance * lost * arm, (cuts, 3)))
    parts.append(jnp.ones((6, 3)))
    for place in pattern.cuts:
        members = list(layout.couples[place // CUT_PARTS])
        push = problem.model.linear.common_mean_n * lost * jnp.sum(arms[:, members], axis=1)
        parts.append(push[None])
    pairs = np.array([terms.statistics.close_pairs[place] for place in pattern.cuts])
    return jnp.concatenate(parts), jnp.asarray(np.sqrt(chance * (1.0 - chance) / pairs))


def _measured(inertia: Values, wheels: Values) -> Values:
    """Weights of the measured momentum's entries: rates, constant, wheels, torque."""
    return jnp.concatenate([inertia.T, jnp.zeros((1, 3)), wheels.T, jnp.zeros((3, 3))])
