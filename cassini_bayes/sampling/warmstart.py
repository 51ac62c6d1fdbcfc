"""Mode, Laplace approximation and importance sampling: the warm start of the sampler.

All of it works on a vectorised log density of standard-normal prior coordinates z: a function of an
(n, d) array returning (n,). The Student-t proposal found here feeds the independence move of
:mod:`cassini_bayes.sampling.ensembles`; the same draws give the evidence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize
from scipy.special import gammaln, logsumexp

from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.computing.arviz_import import arviz
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.errors import CassiniBayesError
from cassini_bayes.priors.starts import Starts

LogDensity = Callable[[Array], Array]

TRUSTED_K: Final = 0.7
"""Pareto k̂ of importance weights up to which an estimate is relied upon: Vehtari et al. 2024."""
ALL_ALIKE: Final = 1e-10
"""Nats: weights that differ by rounding alone have no tail to fit."""
# Steps in prior standard deviations, then in the posterior's once its axes are known.
GRADIENT_STEP: Final = 1e-4
HESSIAN_STEP: Final = 2e-2
LEAST_CURVATURE: Final = 0.25  # of a direction: none is taken for more than twice its prior's width
WHITENED_STEP: Final = 0.25  # standard deviations
WHITENED_GRADIENT_STEP: Final = 0.01
WHITENED_PASSES: Final = 4  # at most: mode and curvature in turn, until they settle
WHITENED_LEAST_CURVATURE: Final = 1e-2  # a pass may widen a direction tenfold
PROPOSAL_DOF: Final = 15.0
SETTLED: Final = 0.1  # of a curvature: widths are then good to a twentieth
ROUGH, FINE = 2e-9, 1e-13  # L-BFGS, relative to the log density: before and with whitened axes


@dataclass(frozen=True)
class Proposal:
    """Multivariate Student-t in z: location (d,), lower scale factor (d, d), degrees of freedom."""

    location: Array
    factor: Array
    dof: float

    def sample(self, rng: np.random.Generator | np.random.RandomState, n: int) -> Array:
        """n draws, shape (n, d)."""
        normals = rng.standard_normal((n, len(self.location)))
        scale = np.sqrt(self.dof / rng.chisquare(self.dof, n))[:, None]
        return np.asarray(self.location + scale * (normals @ self.factor.T))

    def log_density(self, z: Array) -> Array:
        """Log density at z (n, d), shape (n,)."""
        d, nu = len(self.location), self.dof
        # once for all draws: solving for some 100,000 of them takes ten times as long
        white = (z - self.location) @ self._whitening
        log_det = np.log(np.diagonal(self.factor)).sum()
        constant = gammaln((nu + d) / 2) - gammaln(nu / 2) - 0.5 * d * np.log(nu * np.pi) - log_det
        return np.asarray(constant - 0.5 * (nu + d) * np.log1p((white**2).sum(1) / nu))

    @cached_property
    def _whitening(self) -> Array:
        """Transposed inverse of the factor (d, d)."""
        inverse = solve_triangular(self.factor, np.eye(len(self.factor)), lower=True)
        return np.asarray(inverse.T)


@dataclass(frozen=True)
class ImportanceDraws:
    """Weighted draws from the posterior, and the evidence from them.

    ``log_evidence`` is the log of the mean weight with its Monte Carlo standard error;
    ``pareto_k`` is the tail index of the weights (Vehtari et al. 2024): below 0.5 the estimates and
    their errors can be trusted, above 0.7 they cannot.
    """

    z: Array  # (n, d)
    log_weights: Array  # (n,) normalised
    log_evidence: float
    log_evidence_se: float
    pareto_k: float
    efficiency: float

    def places(self, rng: np.random.Generator, n: int) -> Places:
        """Which (n,) have equal weight (systematic resampling), in random order."""
        edges = np.cumsum(np.exp(self.log_weights))
        points = (np.arange(n) + rng.uniform()) / n * edges[-1]
        return rng.permutation(np.searchsorted(edges, points))

    def resample(self, rng: np.random.Generator, n: int) -> Array:
        """n draws with equal weight, shape (n, d), in random order."""
        return np.asarray(self.z[self.places(rng, n)])


@dataclass(frozen=True)
class WarmStart:
    """What the sampler starts from."""

    mode: Array
    proposal: Proposal
    laplace_log_evidence: float
    draws: ImportanceDraws


def find_mode(
    log_density: LogDensity,
    start: Array,
    axes: Array | None = None,
    step: float = GRADIENT_STEP,
    tolerance: float = ROUGH,
) -> Array:
    """Maximise the log density from ``start`` (d,) by L-BFGS with batched central differences.

    The search is in the coordinates u of z = start + axes u; ``axes`` (d, d) is the identity by
    default. Axes of about a standard deviation each make it short where scales differ. It ends when
    a step gains less than ``tolerance`` of the density's own size. Beside points of no density an
    axis has no slope.

    Raises
    ------
    CassiniBayesError
        When the density is not finite at the start.
    """
    d = len(start)
    turned = np.eye(d) if axes is None else axes
    steps = step * turned.T

    def objective(u: Array) -> tuple[float, Array]:
        z = start + turned @ u
        values = log_density(np.vstack([z, z + steps, z - steps]))
        with np.errstate(invalid="ignore"):
            gradient = (values[1 : d + 1] - values[d + 1 :]) / (2.0 * step)
        return -float(values[0]), -told(gradient, 0.0)

    if not np.isfinite(log_density(start[None])).all():
        raise CassiniBayesError("the posterior is not finite at the centre of the prior")
    options = {"maxiter": 500, "ftol": tolerance}
    result = minimize(objective, np.zeros(d), jac=True, method="L-BFGS-B", options=options)
    return np.asarray(start + turned @ result.x, dtype=np.float64)


def hessian(
    log_density: LogDensity, point: Array, axes: Array | None = None, step: float = HESSIAN_STEP
) -> tuple[Array, Array]:
    """Gradient (d,) and second derivatives (d, d) at a point by central differences in one batch.

    Both are in the coordinates u of z = point + axes u; ``axes`` (d, d) is the identity by default.
    What steps to points of no density would tell stays as the axes have it: a second derivative of
    minus one, no mixed ones, no slope.
    """
    d = len(point)
    h = step
    unit = h * (np.eye(d) if axes is None else axes.T)
    rows, columns = np.triu_indices(d, 1)
    both = unit[rows] + unit[columns]
    values = log_density(point + np.vstack([np.zeros((1, d)), unit, -unit, both, -both]))
    plus, minus = values[1 : d + 1], values[d + 1 : 2 * d + 1]
    with np.errstate(invalid="ignore"):
        pairs = values[2 * d + 1 :].reshape(2, -1).sum(0) - 2.0 * values[0]
        alone = plus + minus - 2.0 * values[0]
        mixed = (pairs - alone[rows] - alone[columns]) / (2.0 * h**2)
        slope = (plus - minus) / (2.0 * h)
    result = np.diag(told(alone / h**2, -1.0))
    result[rows, columns] = result[columns, rows] = told(mixed, 0.0)
    return told(slope, 0.0), result


def told(differences: Array, otherwise: Array | float) -> Array:
    """Differences of a log density, something else where a step came to a point of no density."""
    return np.where(np.isfinite(differences), differences, otherwise)


def laplace(log_density: LogDensity, start: Array) -> tuple[Array, Array]:
    """Mode and lower factor of the Laplace covariance, from a point near the mode.

    Stiff and soft directions may differ by a thousand in scale and lie along curved ridges, where a
    search in the plain coordinates stops early and no one step of finite differences is right for
    all. The curvature found with a common step whitens the coordinates for a second search and a
    second look, whose steps are a fraction of a standard deviation along every axis, and so on
    until two looks agree.
    """
    mode = start
    _, curvature = hessian(log_density, mode)
    factor = _covariance_factor(-curvature, LEAST_CURVATURE)
    for _ in range(WHITENED_PASSES):
        mode = find_mode(log_density, mode, factor, WHITENED_GRADIENT_STEP, FINE)
        _, curvature = hessian(log_density, mode, factor, WHITENED_STEP)
        factor = no_wider_than_prior(
            factor @ _covariance_factor(-curvature, WHITENED_LEAST_CURVATURE)
        )
        if np.abs(curvature + np.eye(len(mode))).max() < SETTLED:
            break
    return mode, factor


def no_wider_than_prior(factor: Array) -> Array:
    """Lower factor of a covariance no axis of which is wider than the prior's curvature allows."""
    values, vectors = np.linalg.eigh(factor @ factor.T)
    return lower_factor(vectors * np.sqrt(np.clip(values, 0.0, 1.0 / LEAST_CURVATURE)))


def _covariance_factor(curvature: Array, least: float) -> Array:
    """Lower factor of the inverse of a curvature whose eigenvalues are raised to ``least``.

    The prior alone has curvature one in z; far less is finite-difference noise or a saddle.
    """
    values, vectors = np.linalg.eigh(curvature)
    return lower_factor(vectors / np.sqrt(np.maximum(values, least)))


def lower_factor(root: Array) -> Array:
    """Lower factor of root rootᵀ (d, d), whose squared scales may differ by more than 1e16."""
    upper = np.linalg.qr(root.T, mode="r")
    signs = np.where(np.diagonal(upper) < 0.0, -1.0, 1.0)
    factor = np.tril((signs[:, None] * upper).T)
    smallest = 1e-12 * float(np.abs(np.diagonal(factor)).max())
    np.fill_diagonal(factor, np.maximum(np.diagonal(factor), smallest))
    return np.asarray(factor, dtype=np.float64)


def importance(
    log_density: LogDensity, proposal: Proposal, rng: np.random.Generator, n: int
) -> ImportanceDraws:
    """Importance draws from the proposal, with log evidence, its standard error and Pareto k̂."""
    z = proposal.sample(rng, n)
    return weighted(z, log_density(z) - proposal.log_density(z))


def weighted(z: Array, log_ratio: Array) -> ImportanceDraws:
    """Draws z (n, d) with log ratios (n,) of the target's density to the one they come from."""
    n = len(z)
    log_total = float(logsumexp(log_ratio))
    weights = np.exp(log_ratio - log_total)
    efficiency = 1.0 / (n * float((weights**2).sum()))
    return ImportanceDraws(
        z=z,
        log_weights=log_ratio - log_total,
        log_evidence=log_total - float(np.log(n)),
        log_evidence_se=float(np.sqrt(max(1.0 / efficiency - 1.0, 0.0) / n)),
        pareto_k=pareto_k(log_ratio),
        efficiency=efficiency,
    )


def pareto_k(log_weights: Array) -> float:
    """Tail index of importance weights, by Pareto-smoothed importance sampling; 0 of equal ones."""
    if np.ptp(log_weights) < ALL_ALIKE:
        return 0.0
    # Candidate tails far from the data have likelihoods below the smallest float: weight zero.
    with np.errstate(over="ignore"):
        _, shape = arviz().psislw(log_weights)
    return float(shape)


def highest_mode(log_density: LogDensity, starts: Starts) -> Array:
    """The highest of the maxima (d,) that searches find.

    Only the first point must have a density.
    """
    best = find_mode(log_density, starts.points[0])
    best = _higher(log_density, best, starts.points[1:])
    return _higher(log_density, best, starts.beside(best))


def _higher(log_density: LogDensity, best: Array, points: Array) -> Array:
    """The highest of a maximum (d,) and of those found from points (r, d) that have a density."""
    usable = (point for point in points if np.isfinite(log_density(point[None])).all())
    modes = np.stack([best, *(find_mode(log_density, point) for point in usable)])
    return np.asarray(modes[int(log_density(modes).argmax())])


def warm_start(
    log_density: LogDensity,
    d: int,
    rng: np.random.Generator,
    *,
    starts: Starts | None = None,
    dof: float = PROPOSAL_DOF,
    pilots: int = 2,
    draws: int = 4_000,
) -> WarmStart:
    """Mode → Laplace → refinement of the proposal by its own importance draws → evidence.

    The mode is the highest that is found from ``starts``, by default from zero.
    """
    first = Starts.of(np.zeros((1, d))) if starts is None else starts
    mode, factor = laplace(log_density, highest_mode(log_density, first))
    log_det = 2.0 * np.log(np.diagonal(factor)).sum()
    laplace_log_evidence = float(
        log_density(mode[None])[0] + 0.5 * d * np.log(2.0 * np.pi) + 0.5 * log_det
    )
    proposal = Proposal(mode, factor, dof)
    for _ in range(pilots):
        proposal = refined(proposal, importance(log_density, proposal, rng, draws))
    final = importance(log_density, proposal, rng, draws)
    return WarmStart(mode, proposal, laplace_log_evidence, final)


def refined(proposal: Proposal, draws: ImportanceDraws) -> Proposal:
    """Proposal with the weighted moments of its own importance draws.

    Moments from few effective draws are noisy: they are mixed with the old location and scale in
    proportion to how many effective draws there are per dimension.
    """
    weights = np.exp(draws.log_weights)
    location = weights @ draws.z
    deviation = draws.z - location
    moments = (weights[:, None] * deviation).T @ deviation
    n, d = draws.z.shape
    trust = draws.efficiency * n / (draws.efficiency * n + 5.0 * d)
    scale = trust * moments + (1.0 - trust) * proposal.factor @ proposal.factor.T
    return Proposal(
        trust * location + (1.0 - trust) * proposal.location,
        np.linalg.cholesky(scale),
        proposal.dof,
    )
