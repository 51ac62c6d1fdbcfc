"""That the plain likelihood and the copies in JAX state the same posterior as ours."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import jax.scipy.special as jax_special
import numpy as np
import scipy.special

from cassini_bayes.model.posterior import log_posterior
from speed import plain
from speed.fast_jax import fast_log_posterior


def largest_difference(problem: plain.Problem, points: int = 5) -> dict[str, float]:
    """Largest relative differences to our log posterior over prior-like points.

    The plain density is Gaussian in everything we integrate out, so its integral is exact: the
    maximum and the determinant of its second derivatives, which are differences of slopes.
    """
    d, extra = len(problem.model.space.names), problem.linear_size
    z = 0.5 * np.random.default_rng(7).standard_normal((points, d))
    ours = log_posterior(problem.model, z)
    fast = jax.jit(fast_log_posterior(problem))
    by_jax = np.array([float(fast(point)) for point in z])

    def density(x: jax.Array) -> jax.Array:
        return plain.log_posterior(jnp, jax_special, problem, x)

    slopes = jax.jit(jax.vmap(jax.grad(density)))
    steps = np.concatenate([np.zeros((1, d + extra)), np.eye(d + extra)[d:]])
    integrals, copies = [], []
    for point in z:
        x = np.concatenate([point, np.zeros(extra)])
        slope = np.asarray(slopes(x + steps))[:, d:]
        curve = slope[0] - slope[1:]  # exact for a quadratic function, rounding apart
        for _ in range(2):  # the second step mends the first one's rounding
            x = np.concatenate([point, x[d:] + np.linalg.solve(curve, slope[0])])
            slope = np.asarray(slopes(x + steps))[:, d:]
        value = plain.log_posterior(np, scipy.special, problem, x)
        log_det = np.linalg.slogdet(curve)[1]
        integrals.append(value + 0.5 * extra * np.log(2.0 * np.pi) - 0.5 * log_det)
        copies.append(float(density(x)) - value)
    scale = np.abs(ours)
    return {
        "fast in JAX": float(np.max(np.abs(by_jax - ours) / scale)),
        "plain, integrated": float(np.max(np.abs(integrals - ours) / scale)),
        "plain in JAX against numpy": float(np.max(np.abs(copies) / scale)),
    }
