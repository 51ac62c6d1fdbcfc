"""Evidence of a nearly linear model with normal noise: y_e = f_e(z) + ε_e, z ~ N(0, 1).

z are standard-normal prior coordinates of all parameters, ε_e ~ N(0, R_e) is one event's own. With
slopes J at the mode ẑ the data are N(f(ẑ) − J ẑ, J Jᵀ + R), and that density of y is the evidence:
exact where f is linear and R constant. R may depend on z; it is taken at the mode. An event that
was left out has, by the same linearisation, a normal prediction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from cassini_bayes.computing.arrays import Array
from cassini_bayes.sampling.warmstart import ImportanceDraws, Proposal, importance

Forward = Callable[[Array], Array]  # z (n, d) → predicted (n, E, U)
Noise = Callable[[Array], Array]  # z (d,) → covariance (E, U, U)

STEP: Final = 0.02
"""Standard normals, for slopes: judgement, long enough to see over the kinks where another thruster
needs least."""
MOST_STEPS: Final = 40  # judgement: a few are enough but on kinks
SETTLED: Final = 1e-4  # standard normals that a last step moves
SHORTER: Final = 0.5 ** np.arange(8)  # shares of a step that are tried
DEGREES: Final = 8.0  # of the Student-t proposal, as in evidence
BATCH: Final = 250
"""Points predicted at once: judgement, arrays of a lot stay within some tens of megabytes."""
LOG_2PI: Final = float(np.log(2.0 * np.pi))


@dataclass(frozen=True)
class Model:
    """What a hypothesis predicts of E events with U figures each, at d standard coordinates."""

    forward: Forward
    noise: Noise
    dimension: int


@dataclass(frozen=True)
class Fit:
    """A model linearised at its mode, with its evidence.

    ``mean`` (E, U) is the prediction at the mode, ``slope`` (E, U, d) its derivative, ``noise``
    (E, U, U), ``covariance`` (d, d) that of the posterior of z.
    """

    mode: Array
    covariance: Array
    mean: Array
    slope: Array
    noise: Array
    log_evidence: float
    chi_square: float  # of the prior's prediction, linearised at the mode


def fit(y: Array, model: Model, start: Array | None = None) -> Fit:
    """Mode by Gauss–Newton steps that are shortened until they help, and the evidence there.

    y (E, U). ``start`` (d,) is the prior's centre by default.
    """
    z = np.zeros(model.dimension) if start is None else start.copy()
    for _ in range(MOST_STEPS):
        mean, slope = _linearise(model.forward, z)
        noise = model.noise(z)
        _, gain = _posterior(slope, noise)
        step = gain @ (y - mean + slope @ z).ravel() - z
        trial = np.vstack([z, z + SHORTER[:, None] * step])
        losses = _losses(y, model.forward(trial), noise, trial)
        best = int(np.argmin(losses))
        z = trial[best]
        if best == 0 or np.abs(SHORTER[best - 1] * step).max() < SETTLED:
            break
    return linearised(y, model, z)


def linearised(y: Array, model: Model, z: Array) -> Fit:
    """The model linearised at z (d,), with the evidence of its linear form."""
    mean, slope = _linearise(model.forward, z)
    noise = model.noise(z)
    covariance, _ = _posterior(slope, noise)
    centre = mean - slope @ z
    evidence, chi_square = normal_log_density(
        y.ravel(), centre.ravel(), _flat(slope) @ _flat(slope).T + block_diag(*noise)
    )
    return Fit(z, covariance, mean, slope, noise, evidence, chi_square)


def normal_log_density(y: Array, mean: Array, covariance: Array) -> tuple[float, float]:
    """log N(y; mean, covariance) and (y − mean)ᵀ covariance⁻¹ (y − mean)."""
    factor = np.linalg.cholesky(covariance)
    white = solve_triangular(factor, y - mean, lower=True)
    square = float(white @ white)
    log_det = 2.0 * float(np.log(np.diagonal(factor)).sum())
    return -0.5 * (square + log_det + len(y) * LOG_2PI), square


def evidence_with_noise(y: Array, fitted: Fit, sizes: Array) -> Array:
    """Log evidence (n,) with independent noise of the given sizes (n,) added to every figure.

    The linearisation stays as it is.
    """
    flat = _flat(fitted.slope)
    values, vectors = np.linalg.eigh(flat @ flat.T + block_diag(*fitted.noise))
    turned = vectors.T @ (y - fitted.mean + fitted.slope @ fitted.mode).ravel()
    variance = np.maximum(values, 0.0) + sizes[:, None] ** 2
    return np.asarray(-0.5 * (turned**2 / variance + np.log(variance) + LOG_2PI).sum(-1))


def predict_left_out(
    y: Array, model: Model, event: int, start: Array
) -> tuple[Array, Array, float]:
    """Mean (U,) and covariance (U, U) of one event, from a fit of the others, linearised afresh.

    And the log evidence of the others.
    """
    others = np.delete(np.arange(len(y)), event)
    taught = Model(
        lambda z: model.forward(z)[:, others], lambda z: model.noise(z)[others], model.dimension
    )
    fitted = fit(y[others], taught, start)
    mean, slope = _linearise(model.forward, fitted.mode)
    gradient = slope[event]
    covariance = gradient @ fitted.covariance @ gradient.T + model.noise(fitted.mode)[event]
    return mean[event], covariance, fitted.log_evidence


def importance_draws(
    y: Array, model: Model, fitted: Fit, rng: np.random.Generator, n: int, batch: int = BATCH
) -> ImportanceDraws:
    """Importance draws from the posterior with the noise as at the mode: they check the evidence.

    Proposals are Student-t with the mode's covariance.
    """
    factor = np.asarray(np.linalg.cholesky(fitted.covariance), dtype=np.float64)
    proposal = Proposal(fitted.mode, factor, DEGREES)
    factors = np.linalg.cholesky(fitted.noise)
    log_det = 2.0 * float(np.log(np.diagonal(factors, axis1=1, axis2=2)).sum())
    constant = -0.5 * (log_det + (y.size + model.dimension) * LOG_2PI)

    def log_density(z: Array) -> Array:
        parts = [
            _losses(y, model.forward(part), fitted.noise, part)
            for part in np.array_split(z, max(len(z) // batch, 1))
        ]
        return np.asarray(constant - np.concatenate(parts))

    return importance(log_density, proposal, rng, n)


def _flat(slope: Array) -> Array:
    return slope.reshape(-1, slope.shape[-1])


def _linearise(forward: Forward, z: Array) -> tuple[Array, Array]:
    """Prediction (E, U) and its slopes (E, U, d) at z, by central differences in one batch."""
    steps = STEP * np.eye(len(z))
    values = forward(np.vstack([z, z + steps, z - steps]))
    d = len(z)
    slope = (values[1 : d + 1] - values[d + 1 :]) / (2.0 * STEP)
    return values[0], np.moveaxis(slope, 0, -1)


def _posterior(slope: Array, noise: Array) -> tuple[Array, Array]:
    """Covariance (d, d) of z and the gain (d, E U) that turns residuals into z."""
    weighted = np.asarray(np.linalg.solve(noise, slope), dtype=np.float64)
    d = slope.shape[-1]
    precision = np.eye(d) + np.einsum("eud,euf->df", slope, weighted)
    inverse = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    covariance = np.asarray(0.5 * (inverse + inverse.T))
    return covariance, covariance @ _flat(weighted).T


def _losses(y: Array, predicted: Array, noise: Array, z: Array) -> Array:
    """½ χ² of the data and of the prior, (n,)."""
    residual = y - predicted
    white = np.einsum("euv,nev->neu", np.linalg.inv(noise), residual)
    return np.asarray(0.5 * (residual * white).sum((1, 2)) + 0.5 * (z**2).sum(-1))
