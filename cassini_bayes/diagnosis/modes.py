"""Modes of hypotheses with their curvature, and Laplace's evidence.

Coordinates are whitened, so that a slope is a Newton step and finite differences have the right
size along every axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from scipy.optimize import minimize

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import CassiniBayesError
from cassini_bayes.priors.starts import Starts
from cassini_bayes.sampling.warmstart import hessian, no_wider_than_prior

LogDensity = Callable[[Array], Array]
LOG_2_PI: Final = float(np.log(2.0 * np.pi))
STEP: Final = 0.02
"""Of one-sided slopes, in standard deviations. Judgement: a mode is off by half of it, 5e-5 nats,
and rounding of 1e-6 nats (``search.ROUNDING``) is a slope of 5e-5."""
CURVATURE_STEP: Final = 0.2
"""In standard deviations. Judgement: rounding of 1e-6 nats is 2.5e-5 of a curvature; third
derivatives cancel in central differences."""
LEAST_CURVATURE: Final = 0.05
"""Of a direction in white coordinates: no look makes one more than 4.5 times as wide (judgement;
what is a saddle or noise would run away, and the next look widens again)."""
LEAST_TOLD: Final = 5e-5
"""Curvature that differences tell beside directions of one: twice what rounding may leave
(``CURVATURE_STEP``). Beside steeper ones higher orders of their differences are larger than it."""
FIRST_AXES: Final = 0.05
"""Prior standard deviations, before any curvature is known: judgement, between what telemetry tells
well (a thousandth) and what it does not."""
FIRST_STEPS: Final = 15
"""Of L-BFGS before the first curvature, and while axes are far from white: judgement, a rough point
is enough for the next curvature, and sixty steps cost what four curvatures do."""
FULL_LOOKS: Final = 2
"""Curvatures that are left when L-BFGS begins to go on for as long as it gains (judgement)."""
MOST_CURVATURES: Final = 6
"""Curvatures taken until axes are white (docs/topics/criticism.md §1). Judgement: each takes d²
points; what has not ended by then goes on by importance draws."""
WHITE: Final = (0.8, 1.25)
"""Curvature along axes that follow a ridge: Laplace's evidence is then good to 0.1 nats."""
NEARLY_WHITE: Final = (0.4, 2.5)
"""Curvature along axes whose differences tell it right (docs/topics/criticism.md §1): the step is
then 0.13 to 0.32 of the standard deviation there."""
SLOPE_LEFT: Final = 0.01
"""Nats that a last Newton step may still predict (docs/topics/criticism.md §1)."""
NEWTON_STEPS: Final = 8  # before L-BFGS: in white axes three or four are enough (judgement)
GAIN_LEFT: Final = 1e-3  # nats: a tenth of SLOPE_LEFT
MOST_STEPS: Final = 60
"""Of L-BFGS: judgement, it goes on only where Newton steps failed, and mostly ends by itself."""
LBFGS_LEFT: Final = 1e-8
"""Relative to the log density, of its gain in a step: 1e-3 nats of the 1e5 of a long event."""
LEAST_SHARE: Final = 0.2
"""Of the gain that a Newton step predicts; less, and the density is not quadratic there (judgement,
the sufficient decrease of line searches)."""


@dataclass(frozen=True)
class Mode:
    """A hypothesis's mode in z, lower factor of its Laplace covariance, log evidence by it."""

    point: Array  # (d,)
    factor: Array  # (d, d)
    log_evidence: float  # nats
    is_whole: bool = False  # the search has ended here with the curvature of all coordinates

    @property
    def value(self) -> float:
        """Log density at the mode."""
        return self.log_evidence - volume(self.factor)

    @property
    def fit(self) -> float:
        """Log likelihood at the mode, without the prior's log N(z; 0, 1)."""
        prior = -0.5 * float(self.point @ self.point) - 0.5 * len(self.point) * LOG_2_PI
        return self.value - prior


def value_and_gradient(log_density: LogDensity, point: Array, axes: Array) -> tuple[float, Array]:
    """Value and gradient (k,) in the coordinates u of z = point (d,) + axes (d, k) u, one-sided.

    Along white axes the curvature is one: g_j = (f(h e_j) − f(0)) / h + h / 2. Where it is not, the
    mode found with such gradients is off by less than h / 2.
    """
    values = log_density(np.vstack([point, point + STEP * axes.T]))
    return float(values[0]), (values[1:] - values[0]) / STEP + 0.5 * STEP


def maximise(log_density: LogDensity, point: Array, axes: Array, steps: int = MOST_STEPS) -> Array:
    """Maximum (d,) from ``point`` (d,) in the coordinates that ``axes`` (d, k) make white.

    Where the axes are white a gradient is a Newton step; L-BFGS goes on, for ``steps`` at most,
    where that does not gain what it predicts.
    """
    value, gradient = value_and_gradient(log_density, point, axes)
    for _ in range(NEWTON_STEPS):
        predicted = 0.5 * float(gradient @ gradient)
        if predicted < GAIN_LEFT:
            return point
        ahead = point + axes @ gradient
        next_value, next_gradient = value_and_gradient(log_density, ahead, axes)
        if not next_value - value > LEAST_SHARE * predicted:
            break
        point, value, gradient = ahead, next_value, next_gradient

    def objective(u: Array) -> tuple[float, Array]:
        value, gradient = value_and_gradient(log_density, point + axes @ u, axes)
        return -value, -gradient

    options = {"maxiter": steps, "ftol": LBFGS_LEFT}
    start = np.zeros(axes.shape[1])
    result = minimize(objective, start, jac=True, method="L-BFGS-B", options=options)
    return np.asarray(point + axes @ result.x)


def mode_near(log_density: LogDensity, point: Array, axes: Array) -> Mode:
    """Mode with its whole curvature, from a point (d,) and rough axes (d, d).

    Takes the curvature and maximises along the axes that it whitens, until a curvature finds its
    own axes nearly white: along the ridge on which all masses and thrusts scale together one from
    the wrong axes is short by a factor of several.
    """
    for left in reversed(range(MOST_CURVATURES)):
        gradient, bend = hessian(log_density, point, axes, CURVATURE_STEP)
        values, vectors = np.linalg.eigh(-bend)
        turned = vectors / np.sqrt(_curvature_used(values))
        is_right = NEARLY_WHITE[0] < values[0] and values[-1] < NEARLY_WHITE[1]
        axes = no_wider_than_prior(axes @ turned)
        has_ended = is_right and 0.5 * float(((gradient @ turned) ** 2).sum()) < SLOPE_LEFT
        if left == 0 or has_ended:
            break
        is_last = is_right or left <= FULL_LOOKS
        point = maximise(log_density, point, axes, MOST_STEPS if is_last else FIRST_STEPS)
    return replace(mode_at(log_density, point, axes), is_whole=has_ended)


def _curvature_used(values: Array) -> Array:
    """Curvatures (d,) by which axes are made as wide as the density: those that a look tells."""
    least = LEAST_TOLD if values[-1] < NEARLY_WHITE[1] else LEAST_CURVATURE
    return np.where(values < least, LEAST_CURVATURE, values)


def mode_from(log_density: LogDensity, start: Mode) -> Mode:
    """Mode with its whole curvature, from that of another density with the same coordinates."""
    point = maximise(log_density, start.point, start.factor, FIRST_STEPS)
    return mode_near(log_density, point, start.factor)


def find_mode(log_density: LogDensity, d: int, start: Array | None = None) -> Mode:
    """Mode with its whole curvature from the centre of the prior or a start (d,).

    Raises
    ------
    CassiniBayesError
        When the density is not finite at the start.
    """
    first = np.zeros(d) if start is None else start
    if not np.isfinite(log_density(first[None])).all():
        raise CassiniBayesError("the posterior is not finite at the centre of the prior")
    axes = FIRST_AXES * np.eye(d)
    return mode_near(log_density, maximise(log_density, first, axes, FIRST_STEPS), axes)


def highest_mode(log_density: LogDensity, starts: Starts) -> Mode:
    """The mode of most evidence of those that searches find."""
    find = partial(find_mode, log_density, starts.dimension)
    best = highest([find(start) for start in starts.points])
    return highest([best, *(find(start) for start in starts.beside(best.point))])


def highest(modes: Sequence[Mode]) -> Mode:
    """The mode of most evidence."""
    return max(modes, key=lambda own: own.log_evidence)


def mode_at(log_density: LogDensity, point: Array, factor: Array) -> Mode:
    """A point (d,) with its Laplace factor (d, d) as a mode."""
    return mode_of(point, factor, float(log_density(point[None])[0]))


def mode_of(point: Array, factor: Array, value: float) -> Mode:
    """The same where the log density at the point is known."""
    return Mode(point, factor, value + volume(factor))


def volume(factor: Array) -> float:
    """Log of what the peak of a normal density with this triangular factor is to be times."""
    log_det = float(np.log(np.abs(np.diagonal(factor))).sum())
    return 0.5 * len(factor) * LOG_2_PI + log_det
