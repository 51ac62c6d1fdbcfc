"""Evidence of every cause: Laplace for all, importance sampling for those near the best.

Coordinates are whitened by the baseline's Laplace factor, so that a few steps of a quasi-Newton
search end at a cause's own mode, and finite differences have the right size along every axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from cassini_bayes.criticism.extended import Hypothesis
from cassini_bayes.errors import CassiniBayesError
from cassini_bayes.warmstart import (
    ImportanceDraws,
    Proposal,
    hessian,
    importance,
    lower_factor,
    no_wider_than_prior,
    refined,
)

Array = NDArray[np.float64]
LogDensity = Callable[[Array], Array]
LOG_2_PI: Final = float(np.log(2.0 * np.pi))
STEP: Final = 0.02  # standard deviations, for slopes
CURVATURE_STEP: Final = 0.2
LEAST_CURVATURE: Final = 0.05
FIRST_AXES: Final = 0.05  # prior standard deviations
FIRST_STEPS: Final = 15
LOOKS: Final = 6
WHITE: Final = (0.8, 1.25)  # curvature along axes that need no other look
NEWTON_STEPS: Final = 8
GAIN_LEFT: Final = 1e-3  # nats
LEAST_SHARE: Final = 0.2  # of the gain that a Newton step foretells
RIDGE_ROUNDS: Final = 2
NEAR_ROUNDS: Final = 9
NEAR_TURNS: Final = 3
NEAR_LEFT: Final = 0.02  # nats that a last step foretells
SLOPE_LEFT: Final = 0.1
NEAR_GAIN: Final = 5.0  # nats
NEAR_FAR: Final = 20.0  # nats that a step foretells
ROUNDING: Final = 1e-6  # nats by which the same point may differ between batches
SHORTER: Final = 0.3
FEW_STEPS: Final = 6
LACKING_NATS: Final = 30.0
LACKING_SHARE: Final = 2.0  # of the gain so far
LEAST_CROSS: Final = 0.1
FLATTEST: Final = 1e-4  # of the steepest curvature, in one round
LEAST_RIDGE: Final = 1e-6
FAR_MOVED: Final = 3.0  # baseline standard deviations along an axis
OWN_SCALES: Final = (0.3, 0.03, 0.003, 0.0003)  # prior standard deviations
STARTS: Final = (-2.0, -0.7, 0.0, 0.7, 2.0)
NEAR_STARTS: Final = (-3.5, -2.5, -1.8, -1.2, -0.7, -0.3, 0.0, 0.4, 1.0, 2.0)
LEAST_EFFICIENCY: Final = 0.1
TRUSTED_K: Final = 0.7
FEW_DRAWS: Final = 300
DRAWS: Final = 2_000
DOF: Final = 8.0


@dataclass(frozen=True)
class Mode:
    """A hypothesis's mode in z, lower factor of its Laplace covariance, log evidence by it."""

    point: Array
    factor: Array
    log_evidence: float
    is_whole: bool = False  # the curvature is that at this point, in all coordinates

    @property
    def value(self) -> float:
        """Log density at the mode."""
        return self.log_evidence - _volume(self.factor)

    @property
    def fit(self) -> float:
        """Log likelihood at the mode, without the prior's log N(z; 0, 1)."""
        prior = -0.5 * float(self.point @ self.point) - 0.5 * len(self.point) * LOG_2_PI
        return self.value - prior


@dataclass(frozen=True)
class Sought:
    """How far the search for a hypothesis's mode has come, and what it may still gain (nats)."""

    mode: Mode
    reach: float = 0.0


class _Rows(NamedTuple):
    """Value, slope and curvature along axes of which the first are white."""

    value: float
    slope: Array  # (D,)
    inner: Array  # (D, D)


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
    proposal: Proposal | None = None  # that the draws came from
    unsure: float = 0.0  # nats by which Laplace's evidence may be short

    @property
    def name(self) -> str:
        """Name of the cause."""
        return self.hypothesis.name

    @property
    def net_evidence(self) -> float:
        """Log evidence less what a search before the fit cost (nats)."""
        return self.log_evidence - self.hypothesis.log_penalty


def look(log_density: LogDensity, point: Array, axes: Array) -> tuple[float, Array]:
    """Value and gradient in the coordinates u of z = point + axes u, from one-sided differences.

    Along white axes the curvature is one: g_j = (f(h e_j) − f(0)) / h + h / 2. Where it is not, the
    mode found with such gradients is off by less than h / 2.
    """
    values = log_density(np.vstack([point, point + STEP * axes.T]))
    return float(values[0]), (values[1:] - values[0]) / STEP + 0.5 * STEP


def climb(log_density: LogDensity, point: Array, axes: Array, steps: int = 60) -> Array:
    """Maximum from ``point`` in whitened coordinates.

    Where the axes are white a gradient is a Newton step; L-BFGS goes on where that does not gain
    what it foretells.
    """
    value, slope = look(log_density, point, axes)
    for _ in range(NEWTON_STEPS):
        foretold = 0.5 * float(slope @ slope)
        if foretold < GAIN_LEFT:
            return point
        ahead = point + axes @ slope
        higher, following = look(log_density, ahead, axes)
        if not higher - value > LEAST_SHARE * foretold:
            break
        point, value, slope = ahead, higher, following

    def objective(u: Array) -> tuple[float, Array]:
        value, slope = look(log_density, point + axes @ u, axes)
        return -value, -slope

    options = {"maxiter": steps, "ftol": 1e-8}
    start = np.zeros(axes.shape[1])
    found = minimize(objective, start, jac=True, method="L-BFGS-B", options=options)
    return np.asarray(point + axes @ found.x)


def settled(log_density: LogDensity, point: Array, axes: Array) -> Mode:
    """Mode with its whole curvature, from a point and rough axes.

    Looks at the curvature and climbs along the axes that it whitens, until a look finds its own
    axes white: along the ridge on which all masses and thrusts scale together one look from the
    wrong axes is short by a factor of several.
    """
    for left in reversed(range(LOOKS)):
        slope, bend = hessian(log_density, point, axes, CURVATURE_STEP)
        values, vectors = np.linalg.eigh(-bend)
        turned = vectors / np.sqrt(np.maximum(values, LEAST_CURVATURE))
        is_white = WHITE[0] < values[0] and values[-1] < WHITE[1]
        axes = no_wider_than_prior(axes @ turned)
        if left == 0 or (is_white and 0.5 * float(((slope @ turned) ** 2).sum()) < GAIN_LEFT):
            break
        point = climb(log_density, point, axes)
    return replace(_mode(log_density, point, axes), is_whole=True)


def baseline_mode(log_density: LogDensity, d: int, start: Array | None = None) -> Mode:
    """Mode and Laplace factor from the centre of the prior or a start.

    Raises
    ------
    CassiniBayesError
        When the density is not finite at the start.
    """
    first = np.zeros(d) if start is None else start
    if not np.isfinite(log_density(first[None])).all():
        raise CassiniBayesError("the posterior is not finite at the centre of the prior")
    axes = FIRST_AXES * np.eye(d)
    return settled(log_density, climb(log_density, first, axes, FIRST_STEPS), axes)


def _mode(log_density: LogDensity, point: Array, factor: Array) -> Mode:
    return Mode(point, factor, float(log_density(point[None])[0]) + _volume(factor))


def _volume(factor: Array) -> float:
    """Log of what the peak of a normal density with this triangular factor is to be times."""
    log_det = float(np.log(np.abs(np.diagonal(factor))).sum())
    return 0.5 * len(factor) * LOG_2_PI + log_det


def starts(extra: int, values: Sequence[float] = STARTS) -> Array:
    """Starting values (s, extra) of an effect's coordinates: along each axis and at the middle."""
    points = [np.zeros(extra)]
    for axis in range(extra):
        points += [value * np.eye(extra)[axis] for value in values if value != 0.0]
    return np.array(points)


def near_mode(hypothesis: Hypothesis, base: Mode) -> Sought:
    """Mode of a cause that the data hardly speak of, by Newton steps from the baseline's mode.

    The nuisances keep the baseline's curvature; that of the effect, across and along, is looked at
    before every step. The search has not ended where it comes to no rest, nor where the cause gains
    more than a few nats: there may be another mode.
    """
    density = hypothesis.log_density
    d, extra = len(base.point), hypothesis.dimension - len(base.point)
    tried = starts(extra, NEAR_STARTS)
    tried = np.concatenate([np.tile(base.point, (len(tried), 1)), tried], axis=1)
    seen = density(tried)
    point, value = tried[int(np.nanargmax(seen))], float(np.nanmax(seen))
    axes = _own_axes(density, point, base, extra)
    step, foretold, turns = np.zeros(d + extra), 0.0, 0
    for _ in range(NEAR_ROUNDS):
        rows = _own_rows(density, point + step, axes, d)
        if not rows.value - value >= LEAST_SHARE * foretold - ROUNDING:
            step, foretold = SHORTER * step, SHORTER * foretold
            continue
        point, value, step, foretold = point + step, rows.value, np.zeros(d + extra), 0.0
        ridge, is_white = _ridge(axes, rows.inner, d)
        if not is_white:
            turns += 1
            if turns > NEAR_TURNS:
                break
            axes = np.concatenate([axes[:, :d], ridge], axis=1)
            continue
        turns = 0
        values, vectors = np.linalg.eigh(rows.inner)
        turned = axes @ vectors / np.sqrt(values)
        slope = vectors.T @ rows.slope / np.sqrt(values)
        foretold = 0.5 * float(slope @ slope)
        if foretold > NEAR_FAR:
            break
        if foretold < NEAR_LEFT:
            mode = _mode(density, point, lower_factor(turned))
            gain = value + 0.5 * extra * LOG_2_PI - base.value
            return Sought(mode, 0.0 if gain < NEAR_GAIN else _lacking(mode, base))
        step = turned @ slope
    return Sought(_mode(density, point, lower_factor(axes)), np.inf)


def extended_mode(hypothesis: Hypothesis, base: Mode) -> Sought:
    """Mode of a hypothesis with more coordinates than the baseline, from the baseline's mode.

    From every starting value of the effect one Newton step is made in the baseline's coordinates;
    the best goes on to a climb. The determinant is the baseline's with the effect's own rows and
    columns renewed, right as long as the nuisances are not moved far (:func:`has_moved`). Where
    these rows are not white after the climb, or still slope, the search has not ended; a cause that
    could win has the better part of its gain by then.
    """
    density = hypothesis.log_density
    d, extra = len(base.point), hypothesis.dimension - len(base.point)
    point = _best_start(density, base, starts(extra))
    axes, _, _ = _along_ridges(density, point, _own_axes(density, point, base, extra), d)
    point = climb(density, point, axes, FEW_STEPS)
    turned, rows, is_white = _along_ridges(density, point, axes, d)
    if not is_white or 0.5 * float(rows.slope @ rows.slope) > SLOPE_LEFT:
        mode = _mode(density, point, lower_factor(axes))
        return Sought(mode, _lacking(mode, base))
    values, vectors = np.linalg.eigh(rows.inner)
    turned = turned @ vectors / np.sqrt(np.maximum(values, LEAST_CURVATURE))
    return Sought(_mode(density, point, lower_factor(turned)))


def _lacking(mode: Mode, base: Mode) -> float:
    """Nats that a search which has not ended may lack: thirty, and twice what it gained."""
    return LACKING_NATS + LACKING_SHARE * max(mode.log_evidence - base.log_evidence, 0.0)


def higher(new: Sought, old: Sought, base: Mode) -> Sought:
    """The search that came higher; the older one has not ended where that is the one."""
    if new.mode.log_evidence >= old.mode.log_evidence:
        return new
    return Sought(old.mode, _lacking(old.mode, base))


def has_moved(mode: Mode, base: Mode) -> bool:
    """Whether nuisances are so far from the baseline's mode that their curvature may differ."""
    d = len(base.point)
    moved = np.linalg.solve(base.factor, mode.point[:d] - base.point)
    return bool(np.abs(moved).max() > FAR_MOVED)


def renewed(hypothesis: Hypothesis, mode: Mode) -> Mode:
    """Mode and its whole curvature anew.

    Needed where the nuisances went far from the baseline's mode, as their curvature there is not
    the baseline's: near a bound of its prior a parameter hardly moves.
    """
    return settled(hypothesis.log_density, mode.point, mode.factor)


def _ridge(axes: Array, inner: Array, d: int) -> tuple[Array, bool]:
    """The last axes turned along the ridges on which the effect trades with the nuisances.

    With them whether those there are followed the ridges already. With the baseline's coordinates
    white and c, h the effect's rows of the curvature, the ridge is (−c, 1) and its curvature
    h − cᵀc. That difference of large numbers is good after a few rounds.
    """
    cross, own = inner[:d, d:], inner[d:, d:]
    values, vectors = np.linalg.eigh(own - cross.T @ cross)
    is_white = (cross**2).sum() < LEAST_CROSS and WHITE[0] < values[0] and values[-1] < WHITE[1]
    least = max(FLATTEST * float(np.abs(np.diagonal(own)).max()), LEAST_RIDGE)
    turn = vectors / np.sqrt(np.maximum(values, least))
    ridge = axes @ np.concatenate([-cross @ turn, turn])
    length = np.abs(ridge[d:]).max(0)
    return ridge / np.maximum(length, 1.0), bool(is_white)


def _along_ridges(
    density: LogDensity, point: Array, axes: Array, d: int
) -> tuple[Array, _Rows, bool]:
    """Axes whose last ones follow the ridges, the rows along them, whether these are white."""
    for left in reversed(range(RIDGE_ROUNDS + 1)):
        rows = _own_rows(density, point, axes, d)
        ridge, is_white = _ridge(axes, rows.inner, d)
        if is_white or left == 0:
            break
        axes = np.concatenate([axes[:, :d], ridge], axis=1)
    return axes, rows, is_white


def _best_start(density: LogDensity, base: Mode, tried: Array) -> Array:
    d = len(base.point)
    offsets = np.vstack([np.zeros((1, d)), STEP * base.factor.T])
    batch = np.concatenate(
        [
            np.broadcast_to(base.point + offsets, (len(tried), d + 1, d)),
            np.broadcast_to(tried[:, None], (len(tried), d + 1, tried.shape[1])),
        ],
        axis=2,
    )
    values = density(batch.reshape(-1, d + tried.shape[1])).reshape(len(tried), -1)
    gradient = (values[:, 1:] - values[:, :1]) / STEP + 0.5 * STEP
    candidates = [np.concatenate([np.tile(base.point, (len(tried), 1)), tried], axis=1)]
    for share in (1.0, 0.3):
        stepped = base.point + share * gradient @ base.factor.T
        candidates.append(np.concatenate([stepped, tried], axis=1))
    everything = np.concatenate(candidates)
    found = density(everything)
    return np.asarray(everything[int(np.nanargmax(found))])


def _own_axes(density: LogDensity, point: Array, base: Mode, extra: int) -> Array:
    """Whitening axes (d + extra, d + extra): the baseline's; the effect's by curvature.

    Of several lengths of a step, the curvature is taken from the one nearest to a third of the
    standard deviation that it tells.
    """
    d = len(base.point)
    axes = np.zeros((d + extra, d + extra))
    axes[:d, :d] = base.factor
    scales = np.array(OWN_SCALES)
    for i in range(extra):
        unit = np.eye(d + extra)[d + i]
        moves = scales[:, None] * unit
        values = density(point + np.vstack([0.0 * unit[None], moves, -moves]))
        bend = (2.0 * values[0] - values[1:].reshape(2, -1).sum(0)) / scales**2
        told = 1.0 / np.sqrt(np.maximum(bend, LEAST_CURVATURE))
        axes[d + i, d + i] = told[int(np.argmin(np.abs(np.log(0.3 * told / scales))))]
    return axes


def _own_rows(density: LogDensity, point: Array, axes: Array, d: int) -> _Rows:
    """Value, slope and curvature along ``axes``: the unit matrix but for the effect's own rows."""
    size = axes.shape[1]
    inner, slope = np.eye(size), np.zeros(size)
    h, unit = CURVATURE_STEP, axes.T
    for i in range(d, size):
        away = np.stack([h * unit[i], -h * unit[i]])
        beside = (away[:, None] + STEP * unit[:i]).reshape(-1, len(point))
        values = density(point + np.vstack([0.0 * away[:1], away, beside]))
        slopes = (values[3:].reshape(2, i) - values[1:3, None]) / STEP
        inner[i, :i] = inner[:i, i] = -(slopes[0] - slopes[1]) / (2.0 * h)
        inner[i, i] = (2.0 * values[0] - values[1] - values[2]) / h**2
        slope[i] = (values[1] - values[2]) / (2.0 * h)
    slope[:d] = slopes.mean(0)[:d] + 0.5 * STEP
    return _Rows(float(values[0]), slope, inner)


def sampled(weighed: Weighed, rng: np.random.Generator, draws: int = FEW_DRAWS) -> Weighed:
    """The evidence by importance sampling from the Laplace approximation.

    Where that was poor the curvature is taken anew, and refined by the draws themselves if that
    helps. What was sampled before is sampled again from the proposal found then.
    """
    density = weighed.hypothesis.log_density
    if weighed.proposal is not None:
        again = importance(density, weighed.proposal, rng, draws)
        return _with_draws(weighed, weighed.proposal, again)
    proposal = Proposal(weighed.mode.point, weighed.mode.factor, DOF)
    found = importance(density, proposal, rng, draws)
    if _is_poor(found) and not weighed.mode.is_whole:
        weighed = replace(weighed, mode=renewed(weighed.hypothesis, weighed.mode))
        proposal = Proposal(weighed.mode.point, weighed.mode.factor, DOF)
        found = importance(density, proposal, rng, draws)
    if _is_poor(found):
        turned = refined(proposal, found)
        again = importance(density, turned, rng, 2 * draws)
        if again.efficiency > found.efficiency:
            proposal, found = turned, again
    return _with_draws(weighed, proposal, found)


def _is_poor(draws: ImportanceDraws) -> bool:
    """Few effective draws, or weights of a tail that leaves out some of the evidence."""
    return draws.efficiency < LEAST_EFFICIENCY or draws.pareto_k > TRUSTED_K


def _with_draws(weighed: Weighed, proposal: Proposal, draws: ImportanceDraws) -> Weighed:
    return replace(
        weighed,
        proposal=proposal,
        unsure=0.0,
        log_evidence=draws.log_evidence,
        log_evidence_se=draws.log_evidence_se,
        z=draws.z,
        log_weights=draws.log_weights,
        pareto_k=draws.pareto_k,
    )
