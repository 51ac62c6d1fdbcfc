"""Our fast likelihood written again in JAX, for samplers that need gradients. One bias only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.special as special
import numpy as np
from jax.scipy.linalg import solve_triangular

from cassini_bayes.balance.statistics.columns import CUT_PARTS
from cassini_bayes.balance.telemetry_balance import CONTROL_CYCLE_S, cut_probability
from speed import plain
from speed.wheel_motion import fast_motion, mean_walk, slow_motion

jax.config.update("jax_enable_x64", True)
Values = Any


def fast_log_posterior(problem: plain.Problem) -> Callable[[Values], Values]:
    """z (d,) → collapsed log posterior, compiled by the caller."""
    terms, model = problem.terms, problem.model
    reduced, pattern = terms.reduced, terms.pattern
    owner = np.repeat(np.arange(len(reduced.start) - 1), np.diff(reduced.start))
    columns, width = reduced.slow.shape[1], len(reduced.start) - 1
    grams = [jnp.asarray(gram) for gram in reduced.grams]
    slow_modes = jnp.asarray(reduced.slow)
    rows, k = terms.statistics.rows, pattern.thrusters
    channels = 3 + len(terms.wheel_places)
    mean, sd = plain.slow_prior(problem)
    linear = model.thrust_prior

    def combined(own: Values, inertia: Values, wheels: Values) -> Values:
        """Columns to unknowns and measured momentum, (3, A', P)."""
        chosen = jnp.concatenate([own, _measured(inertia, wheels)])[reduced.entries]
        return jnp.zeros((3, columns, width)).at[:, reduced.row, owner].add(chosen.T)

    def log_posterior(z: Values) -> Values:
        parameters = plain.to_parameters(jnp, special, model, z)
        inertia, wheels, arms, taus = plain.physics(jnp, problem, parameters)
        noise = plain.noise_of(parameters, inertia, problem)
        scale = rows * (jnp.linalg.slogdet(inertia)[1] - 0.5 * channels * np.log(2.0 * np.pi))
        own = _weights(problem, arms, taus)
        kept, log_density = slow_motion(jnp, terms.slow, noise.wheel)
        axes, variance = plain.slow_noise(jnp, problem, noise, wheels, kept)
        combine = combined(own, inertia, wheels @ kept)
        seen = jnp.einsum("cam,cak->cmk", slow_modes, combine)
        turned = jnp.einsum("cmk,ce->mek", seen, axes)
        normal = jnp.einsum("mek,mel->kl", turned / variance[..., None], turned)
        scale = scale + log_density - 0.5 * jnp.sum(jnp.log(variance))
        placed = jnp.append(_placed(normal, mean, sd), -1.0)
        lacking = combined(own, inertia, jnp.zeros_like(wheels)) @ placed
        for band, gram in zip(terms.fast, grams, strict=True):
            moments = _moments(gram, lacking, reduced.wheels) / band.rows
            other = noise.white + noise.walk * mean_walk(band) * jnp.eye(3)
            kept, log_density = fast_motion(jnp, band, moments, other, wheels, noise.wheel)
            precision = jnp.linalg.inv(other + noise.wheel * wheels @ kept @ wheels.T)
            combine = combined(own, inertia, wheels @ kept)
            right = jnp.einsum("cd,cdab,dbl->cal", precision, gram, combine)
            normal = normal + jnp.einsum("cak,cal->kl", combine, right)
            scale = scale + log_density
        matrix, vector, constant = _without_own(normal, k, mean[k:], sd[k:])
        common = linear.common_mean_n
        by_common = matrix.sum(-1)
        constant = constant + scale + common * vector.sum() - 0.5 * common**2 * by_common.sum()
        prior = -0.5 * jnp.sum(z**2) - 0.5 * len(z) * np.log(2.0 * np.pi)
        return constant + _without_thrust(problem, matrix, vector - common * by_common) + prior

    return log_posterior


def _placed(normal: Values, mean: Values, sd: Values) -> Values:
    """The unknowns (P,) where the slow band and their priors have them."""
    to_all = normal[:-1, :-1]
    precision = sd[:, None] * to_all * sd + jnp.eye(len(mean))
    return mean + sd * jnp.linalg.solve(precision, sd * (normal[:-1, -1] - to_all @ mean))


def _moments(gram: Values, lacking: Values, wheels: Values) -> Values:
    """Inner products (3 + W, 3 + W) of the lacking momentum and the measured wheel rates."""
    momentum = jnp.einsum("ca,cdab,db->cd", lacking, gram, lacking)
    mixed = jnp.einsum("ca,caj->cj", lacking, gram[:, 0][..., wheels])
    return jnp.block([[momentum, mixed], [mixed.T, gram[0, 0][wheels[:, None], wheels]]])


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


def _weights(problem: plain.Problem, arms: Values, taus: tuple[Values, Values]) -> Values:
    """Weights (B, 3) of the unknowns' entries."""
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
        push = problem.model.thrust_prior.common_mean_n * lost * jnp.sum(arms[:, members], axis=1)
        parts.append(push[None])
    return jnp.concatenate(parts)


def _measured(inertia: Values, wheels: Values) -> Values:
    """Weights of the measured momentum's entries: rates, constant, wheels, torque."""
    return jnp.concatenate([inertia.T, jnp.zeros((1, 3)), wheels.T, jnp.zeros((3, 3))])
