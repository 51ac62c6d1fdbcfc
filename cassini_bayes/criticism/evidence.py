"""Evidence of every cause: Laplace for all, importance sampling for those near the best.

Coordinates are whitened by the baseline's Laplace factor, so that a few steps of a quasi-Newton
search end at a cause's own mode, and finite differences have the right size along every axis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from cassini_bayes.criticism.extended import Hypothesis
from cassini_bayes.errors import CassiniBayesError
from cassini_bayes.warmstart import Proposal, importance, lower_factor, refined

Array = NDArray[np.float64]
LogDensity = Callable[[Array], Array]
STEP: Final = 0.05
CURVATURE_STEP: Final = 0.2
LEAST_CURVATURE: Final = 0.05
RIDGE_ROUNDS: Final = 2
FLATTEST: Final = 1e-4  # of the steepest curvature, in one round
LEAST_RIDGE: Final = 1e-6
FAR_MOVED: Final = 3.0  # baseline standard deviations along an axis
RENEWALS: Final = 6
OWN_START: Final = 0.1
STARTS: Final = (-2.0, -0.7, 0.0, 0.7, 2.0)
SCALES: Final = (0.3, 0.03, 0.003, 0.0003)  # prior standard deviations
FIRST_START: Final = 0.05
FIRST_STEPS: Final = 12
NEWTON_STEPS: Final = 6
GAIN_LEFT: Final = 0.01  # nats
WHITE: Final = (0.3, 3.0)  # curvature along axes that need no other look
CLEAR: Final = 0.3  # of its own curvature that an effect keeps along its ridge
NEAR_BEST: Final = 10.0  # nats
AGREE: Final = (0.3, 0.25)  # nats, and share of the foretold change
DRAWS: Final = 1_000
DOF: Final = 8.0


@dataclass(frozen=True)
class Mode:
    """A hypothesis's mode in z, lower factor of its Laplace covariance, log evidence by it."""

    point: Array
    factor: Array
    log_evidence: float


@dataclass(frozen=True)
class Weighed:
    """A hypothesis with its evidence, and posterior draws where it was sampled."""

    hypothesis: Hypothesis
    mode: Mode
    log_evidence: float
    log_evidence_se: float
    z: Array | None = None  # (n, d)
    log_weights: Array | None = None
    pareto_k: float = float("nan")

    @property
    def name(self) -> str:
        """Name of the cause."""
        return self.hypothesis.name


def curvature(log_density: LogDensity, point: Array, axes: Array) -> tuple[float, Array, Array]:
    """Value, gradient and negative Hessian in the u of z = point + axes u, in one batch.

    H_ij = (f(i + j) + f(−i − j) − f(i) − f(−i) − f(j) − f(−j) + 2 f(0)) / 2 h², exact for cubics.
    """
    d = axes.shape[1]
    h = CURVATURE_STEP
    unit = h * axes.T
    rows, columns = np.triu_indices(d, 1)
    both = unit[rows] + unit[columns]
    offsets = np.vstack([np.zeros((1, len(point))), unit, -unit, both, -both])
    values = log_density(point + offsets)
    up, down = values[1 : d + 1], values[d + 1 : 2 * d + 1]
    pairs = values[2 * d + 1 :].reshape(2, -1).sum(0)
    each = up + down - 2.0 * values[0]
    matrix = np.diag(-each) / h**2
    matrix[rows, columns] = -(pairs - 2.0 * values[0] - each[rows] - each[columns]) / (2.0 * h**2)
    matrix[columns, rows] = matrix[rows, columns]
    return float(values[0]), (up - down) / (2.0 * h), matrix


def _inverse_factor(matrix: Array, least: float = LEAST_CURVATURE) -> Array:
    """Lower factor of the inverse of a symmetric matrix with its eigenvalues kept positive."""
    values, vectors = np.linalg.eigh(matrix)
    return lower_factor(vectors / np.sqrt(np.maximum(values, least)))


def climb(log_density: LogDensity, point: Array, axes: Array, steps: int = 60) -> Array:
    """Maximum from ``point`` in whitened coordinates, gradients in batches.

    Where the axes are white a gradient is a Newton step; L-BFGS goes on where that gains nothing.
    """
    d = axes.shape[1]
    moves = STEP * axes.T

    def look(centre: Array) -> tuple[float, Array]:
        values = log_density(np.vstack([centre, centre + moves, centre - moves]))
        return float(values[0]), (values[1 : d + 1] - values[d + 1 :]) / (2.0 * STEP)

    value, gradient = look(point)
    for _ in range(NEWTON_STEPS):
        following = point + axes @ gradient
        if 0.5 * gradient @ gradient < GAIN_LEFT:
            return np.asarray(following)
        higher, slope = look(following)
        if not higher > value:
            break
        point, value, gradient = following, higher, slope

    def objective(u: Array) -> tuple[float, Array]:
        value, gradient = look(point + axes @ u)
        return -value, -gradient

    options = {"maxiter": steps, "ftol": 1e-8}
    found = minimize(objective, np.zeros(d), jac=True, method="L-BFGS-B", options=options)
    return np.asarray(point + axes @ found.x)


def baseline_mode(log_density: LogDensity, d: int, start: Array | None = None) -> Mode:
    """Mode and Laplace factor from the centre of the prior or a start."""
    first = np.zeros(d) if start is None else start
    if not np.isfinite(log_density(first[None])).all():
        raise CassiniBayesError("the posterior is not finite at the centre of the prior")
    axes = FIRST_START * np.eye(d)
    return settled(log_density, climb(log_density, first, axes, FIRST_STEPS), axes)


def settled(log_density: LogDensity, point: Array, axes: Array) -> Mode:
    """Mode with its whole curvature, from a point and rough axes.

    Looks at the curvature and climbs along the axes that it whitens, until a look finds its axes
    white and nothing to gain. The last Newton step is taken without another look.
    """
    # at first axes may be short: prior curvature, one in z, shows as their length squared
    least = min(LEAST_CURVATURE, LEAST_CURVATURE * float((axes**2).sum(0).max()))
    for left in reversed(range(RENEWALS)):
        value, gradient, matrix = curvature(log_density, point, axes)
        bends = np.linalg.eigvalsh(matrix)
        inverse = _inverse_factor(matrix, least)
        step = inverse @ (inverse.T @ gradient)
        gain = 0.5 * float(gradient @ step)
        if gain < GAIN_LEFT and WHITE[0] < bends[0] and bends[-1] < WHITE[1]:
            factor = lower_factor(axes @ inverse)
            return _mode_of(value + gain, point + axes @ step, factor)
        axes = lower_factor(axes @ inverse)
        if left:
            point = climb(log_density, point, axes)
    return _mode(log_density, point, axes)


def _mode(log_density: LogDensity, point: Array, factor: Array) -> Mode:
    return _mode_of(float(log_density(point[None])[0]), point, factor)


def _mode_of(value: float, point: Array, factor: Array) -> Mode:
    """Mode of a value of the log density and a lower factor of the covariance."""
    log_det = float(np.log(np.abs(np.diagonal(factor))).sum())
    return Mode(point, factor, value + 0.5 * len(point) * float(np.log(2.0 * np.pi)) + log_det)


def starts(extra: int) -> Array:
    """Starting values (s, extra) of an effect's coordinates: along each axis and at the middle."""
    points = [np.zeros(extra)]
    for axis in range(extra):
        points += [value * np.eye(extra)[axis] for value in STARTS if value != 0.0]
    return np.array(points)


def extended_mode(hypothesis: Hypothesis, base: Mode, *, renew: bool = True) -> Mode:
    """Mode of a hypothesis with more coordinates than the baseline, from the baseline's mode.

    Newton steps from the baseline's mode where the density is a parabola along the effect's only
    coordinate: the baseline's curvature with the effect's own rows and columns renewed. Elsewhere
    a search from the best of some starting values of the effect.

    ``renew``: the whole curvature anew where the nuisances moved far.
    """
    density = hypothesis.log_density
    d, extra = len(base.point), hypothesis.dimension - len(base.point)
    mode = None
    if extra == 1:
        origin = _at_base(base, extra)[0]
        axes = _own_axes(density, origin, base, extra)
        rows = _own_rows(density, origin, axes, d)
        if _is_parabola(density, origin, rows, axes):
            mode = _by_newton(density, origin, axes, rows)
    if mode is None:
        point = _best_start(density, base, starts(extra))
        mode = _searched(density, point, _own_axes(density, point, base, extra), d)
    return renewed(hypothesis, mode, base) if renew and has_moved(mode, base) else mode


def has_moved(mode: Mode, base: Mode) -> bool:
    """Whether nuisances are so far from the baseline's mode that their curvature may differ."""
    d = len(base.point)
    moved = np.linalg.solve(base.factor, mode.point[:d] - base.point)
    return bool(np.abs(moved).max() > FAR_MOVED)


def renewed(hypothesis: Hypothesis, mode: Mode, base: Mode) -> Mode:
    """Mode and its whole curvature anew, where the nuisances went far from the baseline's mode.

    Their curvature there is not the baseline's: near a bound of its prior a parameter hardly moves.
    """
    d, size = len(base.point), len(mode.point)
    axes = OWN_START * np.eye(size)
    axes[:d, :d] = OWN_START * base.factor
    return settled(hypothesis.log_density, mode.point, axes)


@dataclass(frozen=True)
class _Rows:
    """Value, gradient and curvature at a point along axes, the baseline's block taken as one."""

    value: float
    gradient: Array
    inner: Array
    baseline: int  # its number of coordinates

    def step(self) -> tuple[Array, float]:
        """Newton step and what it gains."""
        inverse = _inverse_factor(self.inner)
        step = inverse @ (inverse.T @ self.gradient)
        return step, 0.5 * float(self.gradient @ step)

    def ridge(self) -> tuple[Array, Array]:
        """Curvature (e, e) of the effect alone and along its ridge."""
        d = self.baseline
        cross, own = self.inner[:d, d:], self.inner[d:, d:]
        return own, own - cross.T @ cross


def _is_parabola(density: LogDensity, origin: Array, rows: _Rows, axes: Array) -> bool:
    """Whether the curvature at the baseline's mode foretells the density at other sizes.

    Only where either of them comes near the best that is foretold.
    """
    d, size = rows.baseline, len(rows.inner)
    _, gain = rows.step()
    moves = []
    for place in range(d, size):
        for start in STARTS:
            if start != 0.0:
                move = np.zeros(size)
                move[place] = start / axes[place, place]
                move[:d] = rows.gradient[:d] - rows.inner[:d, place] * move[place]
                moves.append(move)
    u = np.array(moves)
    foretold = u @ rows.gradient - 0.5 * np.einsum("ni,ij,nj->n", u, rows.inner, u)
    found = density(origin + u @ axes.T) - rows.value
    matters = np.maximum(foretold, found) > gain - NEAR_BEST
    wrong = np.abs(found - foretold) > AGREE[0] + AGREE[1] * np.abs(foretold)
    return not bool(np.any(matters & wrong))


def _by_newton(density: LogDensity, point: Array, axes: Array, rows: _Rows) -> Mode | None:
    """Mode by Newton steps, the axes turned along the ridge on the way; None if they fail."""
    for _ in range(NEWTON_STEPS):
        step, gain = rows.step()
        own, ridge = rows.ridge()
        clear = np.linalg.eigvalsh(ridge)[0] > CLEAR * np.linalg.eigvalsh(own)[0]
        if gain < GAIN_LEFT and clear:
            factor = lower_factor(axes @ _inverse_factor(rows.inner))
            return _mode_of(rows.value + gain, point + axes @ step, factor)
        point, axes = point + axes @ step, _along_ridge(rows, axes)
        following = _own_rows(density, point, axes, rows.baseline)
        if not following.value > rows.value - GAIN_LEFT:
            return None
        rows = following
    return None


def _searched(density: LogDensity, point: Array, axes: Array, d: int) -> Mode:
    """Mode by a search along the ridges."""
    for _ in range(RIDGE_ROUNDS):
        axes = _along_ridge(_own_rows(density, point, axes, d), axes)
    point = climb(density, point, axes)
    for _ in range(RIDGE_ROUNDS):
        axes = _along_ridge(_own_rows(density, point, axes, d), axes)
    inner = _own_rows(density, point, axes, d).inner
    return _mode(density, point, lower_factor(axes @ _inverse_factor(inner)))


def _along_ridge(rows: _Rows, axes: Array) -> Array:
    """Axes whose last ones follow the ridges along which the effect trades with the nuisances.

    With the baseline's coordinates white and c, h the effect's rows of the curvature, the ridge is
    (−c, 1) and its curvature h − cᵀc. That difference of large numbers is good after a few rounds.
    """
    d, cross = rows.baseline, rows.inner[: rows.baseline, rows.baseline :]
    own, along = rows.ridge()
    values, vectors = np.linalg.eigh(along)
    least = max(FLATTEST * float(np.abs(np.diagonal(own)).max()), LEAST_RIDGE)
    turn = vectors / np.sqrt(np.maximum(values, least))
    ridge = axes @ np.concatenate([-cross @ turn, turn])
    length = np.abs(ridge[d:]).max(0)
    return np.concatenate([axes[:, :d], ridge / np.maximum(length, 1.0)], axis=1)


def _at_base(base: Mode, extra: int) -> Array:
    return np.concatenate([base.point, np.zeros(extra)])[None]


def _best_start(density: LogDensity, base: Mode, tried: Array) -> Array:
    d = len(base.point)
    moves = STEP * base.factor.T
    offsets = np.vstack([np.zeros((1, d)), moves, -moves])
    batch = np.concatenate(
        [
            np.broadcast_to(base.point + offsets, (len(tried), 2 * d + 1, d)),
            np.broadcast_to(tried[:, None], (len(tried), 2 * d + 1, tried.shape[1])),
        ],
        axis=2,
    )
    values = density(batch.reshape(-1, d + tried.shape[1])).reshape(len(tried), -1)
    gradient = (values[:, 1 : d + 1] - values[:, d + 1 :]) / (2.0 * STEP)
    candidates = [np.concatenate([np.tile(base.point, (len(tried), 1)), tried], axis=1)]
    for share in (1.0, 0.3):
        stepped = base.point + share * gradient @ base.factor.T
        candidates.append(np.concatenate([stepped, tried], axis=1))
    everything = np.concatenate(candidates)
    found = density(everything)
    return np.asarray(everything[int(np.nanargmax(found))])


def _own_axes(density: LogDensity, point: Array, base: Mode, extra: int) -> Array:
    """Whitening axes (d + extra, d + extra): the baseline's; the effect's by curvature."""
    d = len(base.point)
    axes = np.zeros((d + extra, d + extra))
    axes[:d, :d] = base.factor
    scales = np.array(SCALES)
    offsets = np.zeros((extra, len(scales), d + extra))
    for i in range(extra):
        offsets[i, :, d + i] = scales
    moves = offsets.reshape(-1, d + extra)
    values = density(point + np.concatenate([np.zeros((1, d + extra)), moves, -moves]))
    bends = 2.0 * values[0] - values[1:].reshape(2, extra, -1).sum(0)
    sizes = np.sqrt(1.0 / np.maximum(bends / scales**2, LEAST_CURVATURE))
    # the scale that finds the curvature nearest to its own size sees the peak, not its foot
    best = np.abs(np.log(CURVATURE_STEP * sizes / scales)).argmin(1)
    axes[range(d, d + extra), range(d, d + extra)] = sizes[range(extra), best]
    return axes


def _own_rows(density: LogDensity, point: Array, axes: Array, d: int) -> _Rows:
    """Gradient, and curvature along the axes: the unit matrix but for the effect's own rows."""
    size, h = axes.shape[1], CURVATURE_STEP
    unit = h * axes.T
    own = [(i, place) for place in range(d, size) for i in range(place)]
    rows, columns = np.array(own).T
    both = unit[rows] + unit[columns]
    offsets = np.vstack([np.zeros((1, len(point))), unit, -unit, both, -both])
    values = density(point + offsets)
    up, down = values[1 : size + 1], values[size + 1 : 2 * size + 1]
    pairs = values[2 * size + 1 :].reshape(2, -1).sum(0)
    each = up + down - 2.0 * values[0]
    inner = np.eye(size)
    inner[range(d, size), range(d, size)] = -each[d:] / h**2
    inner[rows, columns] = -(pairs - 2.0 * values[0] - each[rows] - each[columns]) / (2.0 * h**2)
    inner[columns, rows] = inner[rows, columns]
    return _Rows(float(values[0]), (up - down) / (2.0 * h), inner, d)


def refined_mode(hypothesis: Hypothesis, mode: Mode) -> Mode:
    """Mode with its whole curvature renewed: for causes that matter."""
    return settled(hypothesis.log_density, mode.point, mode.factor)


def sampled(weighed: Weighed, rng: np.random.Generator, draws: int = DRAWS) -> Weighed:
    """The evidence by importance sampling from the Laplace approximation, refined once."""
    hypothesis, density = weighed.hypothesis, weighed.hypothesis.log_density
    mode = refined_mode(hypothesis, weighed.mode)
    proposal = Proposal(mode.point, mode.factor, DOF)
    first = importance(density, proposal, rng, draws)
    best = first
    if first.efficiency < 0.3:
        proposal = refined(proposal, first)
        best = importance(density, proposal, rng, 2 * draws)
    return replace(
        weighed,
        mode=mode,
        log_evidence=best.log_evidence,
        log_evidence_se=best.log_evidence_se,
        z=best.z,
        log_weights=best.log_weights,
        pareto_k=best.pareto_k,
    )
