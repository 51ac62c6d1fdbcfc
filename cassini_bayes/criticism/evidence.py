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
from cassini_bayes.warmstart import Proposal, find_mode, importance, laplace, lower_factor, refined

Array = NDArray[np.float64]
LogDensity = Callable[[Array], Array]
STEP: Final = 0.05
CURVATURE_STEP: Final = 0.2
LEAST_CURVATURE: Final = 0.05
RIDGE_ROUNDS: Final = 2
FLATTEST: Final = 1e-4  # of the steepest curvature, in one round
LEAST_RIDGE: Final = 1e-6
FAR_MOVED: Final = 3.0  # baseline standard deviations along an axis
RENEWALS: Final = 4
OWN_START: Final = 0.1
STARTS: Final = (-2.0, -0.7, 0.0, 0.7, 2.0)
WORTH_A_SEARCH: Final = -1.0  # nats of log density against the baseline's mode
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


def curvature(log_density: LogDensity, point: Array, axes: Array) -> tuple[Array, Array]:
    """Gradient and negative Hessian in the coordinates u of z = point + axes u, in one batch."""
    d = axes.shape[1]
    h = CURVATURE_STEP
    unit = h * axes.T
    rows, columns = np.triu_indices(d, 1)
    plus, minus = unit[rows] + unit[columns], unit[rows] - unit[columns]
    offsets = np.vstack([np.zeros((1, len(point))), unit, -unit, plus, -plus, minus, -minus])
    values = log_density(point + offsets)
    centre, up, down = values[0], values[1 : d + 1], values[d + 1 : 2 * d + 1]
    same, opposite = values[2 * d + 1 :].reshape(2, 2, -1).sum(1)
    matrix = np.diag(2.0 * centre - up - down) / h**2
    matrix[rows, columns] = matrix[columns, rows] = -(same - opposite) / (4.0 * h**2)
    return (up - down) / (2.0 * h), matrix


def _inverse_factor(matrix: Array) -> Array:
    """Lower factor of the inverse of a symmetric matrix with its eigenvalues kept positive."""
    values, vectors = np.linalg.eigh(matrix)
    return lower_factor(vectors / np.sqrt(np.maximum(values, LEAST_CURVATURE)))


def climb(log_density: LogDensity, point: Array, axes: Array, steps: int = 60) -> Array:
    """Maximum from ``point`` by L-BFGS in whitened coordinates, gradients in batches."""
    d = axes.shape[1]
    moves = STEP * axes.T

    def objective(u: Array) -> tuple[float, Array]:
        centre = point + axes @ u
        values = log_density(np.vstack([centre, centre + moves, centre - moves]))
        gradient = (values[1 : d + 1] - values[d + 1 :]) / (2.0 * STEP)
        return -float(values[0]), -gradient

    found = minimize(
        objective,
        np.zeros(d),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": steps, "ftol": 1e-8},
    )
    return np.asarray(point + axes @ found.x)


def baseline_mode(log_density: LogDensity, d: int, start: Array | None = None) -> Mode:
    """Mode and Laplace factor from the centre of the prior."""
    point = find_mode(log_density, np.zeros(d) if start is None else start)
    factor = np.eye(d) * 0.05
    for _ in range(3):
        _, matrix = curvature(log_density, point, factor)
        factor = factor @ _inverse_factor(matrix)
    point = climb(log_density, point, factor)
    _, matrix = curvature(log_density, point, factor)
    return _mode(log_density, point, lower_factor(factor @ _inverse_factor(matrix)))


def _mode(log_density: LogDensity, point: Array, factor: Array) -> Mode:
    log_det = float(np.log(np.abs(np.diagonal(factor))).sum())
    value = float(log_density(point[None])[0])
    return Mode(point, factor, value + 0.5 * len(point) * np.log(2.0 * np.pi) + log_det)


def starts(extra: int) -> Array:
    """Starting values (s, extra) of an effect's coordinates: along each axis and at the middle."""
    points = [np.zeros(extra)]
    for axis in range(extra):
        points += [value * np.eye(extra)[axis] for value in STARTS if value != 0.0]
    return np.array(points)


def extended_mode(hypothesis: Hypothesis, base: Mode) -> Mode:
    """Mode of a hypothesis with more coordinates than the baseline, from the baseline's mode.

    From every starting value of the effect one Newton step is made in the baseline's coordinates;
    the best goes on to a search of its own if it may matter. The determinant is the baseline's with
    the effect's own rows and columns renewed.
    """
    density = hypothesis.log_density
    d, extra = len(base.point), hypothesis.dimension - len(base.point)
    point = _best_start(density, base, starts(extra))
    axes = _along_ridges(density, point, _own_axes(density, point, base, extra), d)
    if float(density(point[None])[0]) > float(density(_at_base(base, extra))[0]) + WORTH_A_SEARCH:
        point = climb(density, point, axes)
        axes = _along_ridges(density, point, axes, d)
    inner = _own_rows(density, point, axes, d)
    mode = _mode(density, point, lower_factor(axes @ _inverse_factor(inner)))
    moved = np.abs(np.linalg.solve(base.factor, point[:d] - base.point)).max()
    return _renewed(density, mode, base) if moved > FAR_MOVED else mode


def _renewed(density: LogDensity, mode: Mode, base: Mode) -> Mode:
    """Mode and its whole curvature anew, where the nuisances went far from the baseline's mode.

    Their curvature there is not the baseline's: near a bound of its prior a parameter hardly moves.
    """
    d, size = len(base.point), len(mode.point)
    point, factor = mode.point, OWN_START * np.eye(size)
    factor[:d, :d] = OWN_START * base.factor
    for _ in range(RENEWALS):
        _, matrix = curvature(density, point, factor)
        factor = factor @ _inverse_factor(matrix)
    point = climb(density, point, factor)
    _, matrix = curvature(density, point, factor)
    return _mode(density, point, lower_factor(factor @ _inverse_factor(matrix)))


def _along_ridges(density: LogDensity, point: Array, axes: Array, d: int) -> Array:
    """Axes whose last ones follow the ridges along which the effect trades with the nuisances.

    With the baseline's coordinates white and c, h the effect's rows of the curvature, the ridge is
    (−c, 1) and its curvature h − cᵀc. That difference of large numbers is good after a few rounds.
    """
    for _ in range(RIDGE_ROUNDS):
        inner = _own_rows(density, point, axes, d)
        cross, own = inner[:d, d:], inner[d:, d:]
        values, vectors = np.linalg.eigh(own - cross.T @ cross)
        least = max(FLATTEST * float(np.abs(np.diagonal(own)).max()), LEAST_RIDGE)
        turn = vectors / np.sqrt(np.maximum(values, least))
        ridge = axes @ np.concatenate([-cross @ turn, turn])
        length = np.abs(ridge[d:]).max(0)
        axes = np.concatenate([axes[:, :d], ridge / np.maximum(length, 1.0)], axis=1)
    return axes


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
    for i in range(extra):
        scale = 0.3
        for _ in range(4):
            unit = np.zeros(d + extra)
            unit[d + i] = scale
            up, middle, down = density(point + np.stack([unit, 0.0 * unit, -unit]))
            bend = (2.0 * middle - up - down) / scale**2
            better = 0.3 / np.sqrt(max(bend, LEAST_CURVATURE))
            if 0.5 < better / scale < 2.0:
                break
            scale = better
        axes[d + i, d + i] = scale / 0.3
    return axes


def _own_rows(density: LogDensity, point: Array, axes: Array, d: int) -> Array:
    """Curvature in the coordinates of ``axes``: the unit matrix but for the effect's own rows."""
    size = axes.shape[1]
    h = CURVATURE_STEP
    inner = np.eye(size)
    unit = h * axes.T
    for i in range(d, size):
        others = unit[: i + 1]
        both = np.vstack(
            [
                unit[i] + others,
                -unit[i] - others,
                unit[i] - others,
                others - unit[i],
                unit[i][None],
                -unit[i][None],
                np.zeros((1, len(point))),
            ]
        )
        values = density(point + both)
        same = values[: i + 1] + values[i + 1 : 2 * i + 2]
        opposite = values[2 * i + 2 : 3 * i + 3] + values[3 * i + 3 : 4 * i + 4]
        row = -(same - opposite) / (4.0 * h**2)
        row[i] = (2.0 * values[-1] - values[-3] - values[-2]) / h**2
        inner[i, : i + 1] = inner[: i + 1, i] = row
    return inner


def refined_mode(hypothesis: Hypothesis, mode: Mode) -> Mode:
    """Mode with its whole curvature renewed: for causes that matter.

    By looks that go on until they agree: along the ridge on which all masses and thrusts scale
    together one look from the wrong axes is short by a factor of several.
    """
    return _mode(hypothesis.log_density, *laplace(hypothesis.log_density, mode.point))


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
