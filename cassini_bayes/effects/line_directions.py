"""About which axis of the body a line swings: the evidence of a direction, and of all of them.

An appendage swings about one direction n of the body, be it a body axis or oblique: what the
balance lacks lies along n, and only the body's turning about n drives it. Of a line's five columns
(cosine, sine, and the driven rate about each axis) along each axis, with Gram matrix G (15, 15) and
Aᵀy (15,), a direction has

    W(n) = [n ⊗ e₁, n ⊗ e₂, −n ⊗ (0, 0, n)],   Wᵀ G W (3, 3),   Wᵀ Aᵀy (3,),

so that one pass over the rows shows all directions. A priori half of the appendages swing about a
body axis, and the others about any direction of a hemisphere, whose evidence is Laplace's:
Z(n̂) 2π/√det H over its area 2π, H the curvature (2, 2) of −log Z at the best n̂.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.effects.line_shapes import Direction, Posterior, posterior

BODY_AXES: Final[tuple[Direction, ...]] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ALONG_AXES: Final = 0.5  # prior probability of a body axis: judgement
COLUMNS: Final = 5  # of a line along each axis
LOOKED_AT: Final = 60
"""Directions of a hemisphere, some 0.3 rad apart: the evidence falls with the square of the cosine
to the best one, so that the search from the best of these ends there."""
STEP_RAD: Final = 0.03  # for slopes and curvature by direction
LONGEST_RAD: Final = 0.3  # of a step towards the best direction
MOST_STEPS: Final = 6
SETTLED_RAD: Final = 1e-3


def hemisphere(count: int) -> Array:
    """Unit vectors (count, 3) spread evenly over a hemisphere, by the golden angle."""
    height = (np.arange(count) + 0.5) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])


_TRIED: Final = np.concatenate([np.array(BODY_AXES), hemisphere(LOOKED_AT)])


class AllDirections(NamedTuple):
    """What rows show of a line of one frequency and damping, along all axes.

    ``gram`` (15, 15) and ``projection`` (15,) are those of its five columns along X, Y and Z, what
    the fit takes away taken off. ``moments`` (3,) are the body's, kg m², ``scales`` (2,) the
    priors' of the amplitude (rad/s) and the share of the inertia.
    """

    gram: Array
    projection: Array
    moments: Array
    scales: tuple[float, float]

    def posterior(self, directions: Array) -> Posterior:
        """Posterior of the sizes about every direction (m, 3)."""
        weights = _weights(directions)
        gram = np.swapaxes(weights, 1, 2) @ self.gram @ weights
        return posterior(gram, self.projection @ weights, self.size(directions))

    def size(self, directions: Array) -> Array:
        """Momentum (m, 3) of the priors' scales about every direction, N m s."""
        amplitude, share = self.scales
        moments = np.square(directions) @ self.moments
        return np.asarray(moments[:, None] * np.array([amplitude, amplitude, share]))

    def log_evidence(self, directions: Array) -> Array:
        """Log evidence (m,) about every direction, nats."""
        return self.posterior(directions).log_evidence


class OfDirections:
    """The evidence of a line over all directions, and the one it most likely swings about."""

    def __init__(self, seen: AllDirections) -> None:
        self._seen = seen
        self._tried = seen.log_evidence(_TRIED)
        self.about_axes_posterior = seen.posterior(_TRIED[: len(BODY_AXES)])

    @cached_property
    def _oblique(self) -> tuple[Array, float, float]:
        """The best direction (3,), its log evidence, and that of all oblique ones."""
        n, value = _TRIED[int(self._tried.argmax())], float(self._tried.max())
        curvature = np.eye(2)
        for _ in range(MOST_STEPS):
            slope, curvature, across = self._local(n)
            values, axes = np.linalg.eigh(curvature)
            step = axes @ ((axes.T @ slope) / np.maximum(np.abs(values), 1.0))
            length = float(np.hypot(*step))
            step *= min(1.0, LONGEST_RAD / max(length, SETTLED_RAD))
            moved = n + across @ step
            moved = moved / np.linalg.norm(moved)
            there = float(self._seen.log_evidence(moved[None])[0])
            if there <= value:
                break
            n, value = moved, there
            if length < SETTLED_RAD:
                break
        # a direction that is hardly known may be any: no more than the hemisphere
        bends = np.maximum(np.linalg.eigvalsh(curvature), 1.0)
        return n, value, value - 0.5 * float(np.log(bends).sum())

    def _local(self, n: Array) -> tuple[Array, Array, Array]:
        """Slope (2,) and curvature (2, 2) of the log evidence in two directions (3, 2) across n."""
        across = np.linalg.svd(n[None])[2][1:].T
        h = STEP_RAD
        moves = h * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)])
        near = n + moves @ across.T
        at = self._seen.log_evidence(near / np.linalg.norm(near, axis=1, keepdims=True))
        slope = np.array([at[1] - at[2], at[3] - at[4]]) / (2.0 * h)
        first, second = (at[1] + at[2] - 2.0 * at[0]) / h**2, (at[3] + at[4] - 2.0 * at[0]) / h**2
        both = (at[5] + at[6] - 2.0 * at[0]) / h**2
        mixed = 0.5 * (both - first - second)
        return slope, -np.array([[first, mixed], [mixed, second]]), across

    @property
    def about_axes(self) -> Array:
        """Log evidence (3,) about X, Y and Z."""
        return self._tried[: len(BODY_AXES)]

    @property
    def rough_evidence(self) -> float:
        """Over all directions by those looked at, nats: good to rank lines by, and quick."""
        oblique = np.logaddexp.reduce(self._tried[len(BODY_AXES) :]) - np.log(LOOKED_AT)
        return float(np.logaddexp(self._of_axes, oblique + np.log(1.0 - ALONG_AXES)))

    @property
    def log_evidence(self) -> float:
        """Over all directions, nats."""
        return float(np.logaddexp(self._of_axes, self._of_oblique))

    @property
    def _of_axes(self) -> float:
        return float(np.logaddexp.reduce(self.about_axes) + np.log(ALONG_AXES / len(BODY_AXES)))

    @property
    def _of_oblique(self) -> float:
        return float(self._oblique[2] + np.log(1.0 - ALONG_AXES))

    @property
    def best(self) -> Direction:
        """A body axis if those have more of the evidence, else the best oblique direction."""
        if self._of_axes > self._of_oblique:
            return BODY_AXES[int(self.about_axes.argmax())]
        x, y, z = (float(part) for part in self._oblique[0])
        return x, y, z


def _weights(directions: Array) -> Array:
    """W (m, 15, 3) of directions (m, 3), columns in order of axes."""
    weights = np.zeros((len(directions), 3, COLUMNS, 3))
    weights[:, :, 0, 0] = weights[:, :, 1, 1] = directions
    weights[:, :, 2:, 2] = -directions[:, :, None] * directions[:, None, :]
    return weights.reshape(len(directions), 3 * COLUMNS, 3)
