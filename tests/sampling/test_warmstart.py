"""Mode, Laplace, importance draws and evidence against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import CassiniBayesError
from cassini_bayes.priors.starts import Starts
from cassini_bayes.sampling.warmstart import (
    LogDensity,
    Proposal,
    find_mode,
    hessian,
    highest_mode,
    importance,
    laplace,
    pareto_k,
    warm_start,
)


def linear_gaussian(seed: int, d: int, n: int) -> tuple[Array, Array, float]:
    """Posterior mean, covariance and exact log evidence of y = A z + N(0, 1), z ~ N(0, 1)."""
    rng = np.random.default_rng(seed)
    design, y = rng.normal(size=(n, d)), rng.normal(size=n)
    covariance = np.linalg.inv(design.T @ design + np.eye(d))
    evidence = multivariate_normal(np.zeros(n), design @ design.T + np.eye(n)).logpdf(y)
    mean = covariance @ design.T @ y
    return mean, covariance, float(evidence)


def target(mean: Array, covariance: Array, evidence: float) -> LogDensity:
    """The unnormalised log posterior whose integral is the evidence."""
    normal = multivariate_normal(mean, covariance)
    return lambda z: np.atleast_1d(normal.logpdf(z)) + evidence


@pytest.mark.parametrize("d", [2, 8, 25])
def test_log_evidence_is_exact_on_a_linear_gaussian_case(d: int) -> None:
    """Importance-sampled log evidence is within three stated standard errors; Laplace is exact."""
    mean, covariance, evidence = linear_gaussian(1, d, 40)
    warm = warm_start(target(mean, covariance, evidence), d, np.random.default_rng(2))
    assert abs(warm.draws.log_evidence - evidence) < 3 * warm.draws.log_evidence_se
    assert warm.draws.log_evidence_se < 0.03
    assert warm.laplace_log_evidence == pytest.approx(evidence, abs=1e-4)
    assert warm.draws.pareto_k < 0.5
    assert warm.mode == pytest.approx(mean, abs=1e-3)


def test_hessian_is_that_of_a_quadratic() -> None:
    """Central differences return a known Hessian to eight digits."""
    mean, covariance, evidence = linear_gaussian(3, 6, 12)
    precision = np.linalg.inv(covariance)
    gradient, found = hessian(target(mean, covariance, evidence), mean + 0.3)
    assert found == pytest.approx(-precision, rel=1e-7, abs=1e-7)
    assert gradient == pytest.approx(-precision @ np.full(6, 0.3), rel=1e-7, abs=1e-7)


def test_a_wall_beside_the_point_leaves_curvature_finite() -> None:
    """Where a step reaches points of no density the axes stay, and the others' curvature is told.

    It had been infinite, and its eigenvalues "did not converge".
    """

    def walled(z: Array) -> Array:
        inside = -0.5 * (z**2 @ np.array([1.0, 4.0, 9.0]))
        return np.where(z[:, 0] < 1e-4, inside, -np.inf)

    gradient, found = hessian(walled, np.zeros(3))
    assert found == pytest.approx(np.diag([-1.0, -4.0, -9.0]), abs=1e-6)
    assert gradient == pytest.approx(np.zeros(3), abs=1e-9)
    _, factor = laplace(walled, np.zeros(3))
    assert np.isfinite(factor).all()


def test_laplace_of_a_stiff_density() -> None:
    """Directions a thousand times stiffer than others, and curved, do not spoil the covariance."""
    scale = np.array([1.0, 1e-3, 0.3, 1e-3])
    turn = np.linalg.qr(np.random.default_rng(4).standard_normal((4, 4)))[0]

    def stiff(z: Array) -> Array:
        u = (z - 0.2) @ turn / scale
        return -0.5 * (u**2).sum(1) - 1e-3 * u[:, 1] ** 4

    mode, factor = laplace(stiff, np.full(4, 0.2) + turn @ (0.8 * scale))
    assert mode == pytest.approx(np.full(4, 0.2), abs=2e-4)
    covariance = turn @ np.diag(scale**2) @ turn.T
    assert factor @ factor.T == pytest.approx(covariance, abs=2e-3 * scale.max() ** 2)
    inner = turn.T @ factor @ factor.T @ turn
    assert np.diag(inner) == pytest.approx(scale**2, rel=0.05)


def test_mode_of_a_curved_density() -> None:
    """The mode of a banana is found from the origin."""

    def banana(z: Array) -> Array:
        return -0.5 * ((z[:, 0] - 1) ** 2 + 10 * (z[:, 1] - z[:, 0] ** 2) ** 2)

    assert find_mode(banana, np.zeros(2)) == pytest.approx([1, 1], abs=1e-3)


def test_density_that_is_not_finite_at_the_start_is_an_error() -> None:
    """A posterior of −inf at the prior's centre is said, not optimised."""
    with pytest.raises(CassiniBayesError, match="not finite"):
        find_mode(lambda z: np.full(len(z), -np.inf), np.zeros(2))


def test_the_higher_of_two_modes_is_found_from_beside_it() -> None:
    """Two narrow normals, the second one ten nats higher; a start without a density is left out."""
    means = np.array([[0.2, 0.0], [3.0, 0.0]])

    def two(z: Array) -> Array:
        of_each = [-50.0 * ((z - mean) ** 2).sum(-1) + 10.0 * i for i, mean in enumerate(means)]
        return np.where(z[:, 0] > -1.0, np.logaddexp(*of_each), -np.inf)

    starts = Starts.of(np.array([[0.0, 0.0], [2.9, 0.1], [-2.0, 0.0]]))
    assert find_mode(two, starts.points[0]) == pytest.approx(means[0], abs=1e-3)
    assert highest_mode(two, starts) == pytest.approx(means[1], abs=1e-3)
    rng = np.random.default_rng(3)
    assert warm_start(two, 2, rng, starts=starts, draws=500).mode == pytest.approx(
        means[1], abs=1e-3
    )


@pytest.mark.parametrize(("first", "spares"), [(0.2, 0), (5.0, 1)])
def test_spare_starts_are_for_modes_that_are_odd(first: float, spares: int) -> None:
    """From the spare one only where the first search ends five standard deviations out."""
    begun: list[float] = []

    def one(z: Array) -> Array:
        begun.extend(z[:, 1].tolist())
        return -50.0 * (z[:, 0] - first) ** 2 - 0.5 * z[:, 1] ** 2

    starts = Starts(np.array([[first, 0.0]]), np.array([[first, 30.0]]))
    assert highest_mode(one, starts) == pytest.approx([first, 0.0], abs=1e-3)
    assert (max(begun) > 20.0) == bool(spares)


def test_proposal_density_and_draws_are_student_t() -> None:
    """Log density equals scipy's; draws have its covariance within Monte Carlo error."""
    factor = np.array([[1.0, 0.0], [0.5, 0.3]])
    proposal = Proposal(np.array([1.0, -1.0]), factor, 15.0)
    oracle = multivariate_t(proposal.location, factor @ factor.T, df=15)
    z = proposal.sample(np.random.default_rng(4), 40_000)
    assert proposal.log_density(z[:50]) == pytest.approx(oracle.logpdf(z[:50]))
    expected = factor @ factor.T * 15 / 13
    assert np.cov(z.T) == pytest.approx(expected, abs=5 * 2 / np.sqrt(len(z)))


def test_pareto_k_flags_a_proposal_that_is_too_narrow() -> None:
    """Negative control: a proposal with a third of the target's width has k̂ above 0.7."""
    mean, covariance, evidence = linear_gaussian(5, 8, 4)
    narrow = Proposal(mean, np.linalg.cholesky(covariance) / 3, 15.0)
    draws = importance(target(mean, covariance, evidence), narrow, np.random.default_rng(6), 4_000)
    assert draws.pareto_k > 0.7


def test_resampled_draws_have_the_posterior_moments() -> None:
    """Systematic resampling returns the target's mean and covariance within Monte Carlo error."""
    mean, covariance, evidence = linear_gaussian(7, 3, 10)
    warm = warm_start(target(mean, covariance, evidence), 3, np.random.default_rng(8))
    z = warm.draws.resample(np.random.default_rng(9), 4_000)
    error = 4 * np.sqrt(np.diag(covariance) / (4_000 * warm.draws.efficiency))
    assert (np.abs(z.mean(0) - mean) < error).all()
    assert np.cov(z.T) == pytest.approx(covariance, abs=0.1 * covariance.max())


def test_equal_weights_have_no_tail() -> None:
    """Weights that differ by rounding alone have k 0, heavy ones are seen all the same."""
    rng = np.random.default_rng(5)
    assert pareto_k(np.full(500, -3.0) + 1e-13 * rng.normal(size=500)) == 0.0
    assert pareto_k(rng.exponential(size=4_000)) > 0.7
