"""About which axis of the body a line swings: the evidence of a direction, and of all of them.

An appendage swings about one direction n of the body, be it a body axis or oblique: what the
balance lacks lies along n, and only the body's turning about n drives it. Of a line's c = 2 P + 3
columns (cosines and sines of P free oscillations, and the driven rate about each axis) along each
axis, with Gram matrix G (3 c, 3 c) and Aᵀy (3 c,), a direction has

    W(n) = n ⊗ C(n),   Wᵀ G W (q, q),   Wᵀ Aᵀy (q,),   q = 2 P + 1,

with C(n) (c, q) what makes cosines, sines and the answer to the turning about n of the c columns,
so that one pass over the rows shows all directions. A priori half of the appendages swing about a
body axis, and the others about any direction of a hemisphere, whose evidence is Laplace's:
Z(n̂) 2π/√det H over its area 2π, H the curvature (2, 2) of −log Z at the best n̂.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.effects.line_shapes import Direction, Posterior, posterior

BODY_AXES: Final[tuple[Direction, ...]] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ALONG_AXES: Final = 0.5  # prior probability of a body axis: judgement
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


def of_turning(directions: Array, swings: int) -> Array:
    """C (m, 2 P + 3, 2 P + 1) of directions (m, 3) and P free oscillations.

    Cosines and sines as they are, and less the driven rate about each.
    """
    free = 2 * swings
    columns = np.zeros((len(directions), free + 3, free + 1))
    columns[:, :free, :free] = np.eye(free)
    columns[:, free:, free] = -directions
    return columns


def sizes_about(directions: Array, moments: Array, scales: Array) -> Array:
    """Momentum (K, m, q) of K scales (K, q) of the sizes about directions (m, 3), N m s.

    ``moments`` (3,) are the body's about its axes, kg m².
    """
    return np.asarray((np.square(directions) @ moments)[:, None] * scales[:, None])


@dataclass(frozen=True, eq=False)
class AllDirections:
    """What rows show of a line of one frequency and damping, along all axes.

    ``gram`` (3 c, 3 c) and ``projection`` (3 c,) are those of its c columns along X, Y and Z, what
    the fit takes away taken off. ``moments`` (3,) are the body's, kg m², ``scales`` (K, q) those
    of cosines and sines (rad/s) and of the share of the inertia that are believed in.
    """

    gram: Array
    projection: Array
    moments: Array
    scales: Array

    def posterior_about(self, directions: Array) -> Posterior:
        """Posterior (K, m) of the sizes about every direction (m, 3)."""
        turning = of_turning(directions, self.scales.shape[1] // 2)
        weights = directions[:, :, None, None] * turning[:, None]
        weights = weights.reshape(len(directions), len(self.projection), -1)
        gram = np.swapaxes(weights, 1, 2) @ self.gram @ weights
        size = sizes_about(directions, self.moments, self.scales)
        return posterior(gram, self.projection @ weights, size)

    def evidence_about(self, directions: Array) -> Array:
        """Log evidence (m,) about every direction, nats."""
        return self.posterior_about(directions).of_all_sizes

    @cached_property
    def _tried(self) -> Posterior:
        return self.posterior_about(_TRIED)

    @property
    def about_axes(self) -> Posterior:
        """Posterior (K, 3) of the sizes about X, Y and Z."""
        return Posterior(*(values[:, : len(BODY_AXES)] for values in self._tried))

    @cached_property
    def _evidence_tried(self) -> Array:
        return self._tried.of_all_sizes

    @cached_property
    def _oblique(self) -> tuple[Array, Array, float]:
        """The best direction (3,), curvatures (2,) of its log evidence, that of all oblique."""
        tried = self._evidence_tried
        n, value = _TRIED[int(tried.argmax())], float(tried.max())
        curvature = np.eye(2)
        for _ in range(MOST_STEPS):
            slope, curvature, across = self._local(n)
            values, axes = np.linalg.eigh(curvature)
            step = axes @ ((axes.T @ slope) / np.maximum(np.abs(values), 1.0))
            length = float(np.hypot(*step))
            step *= min(1.0, LONGEST_RAD / max(length, SETTLED_RAD))
            moved = n + across @ step
            moved = moved / np.linalg.norm(moved)
            there = float(self.evidence_about(moved[None])[0])
            if there <= value:
                break
            n, value = moved, there
            if length < SETTLED_RAD:
                break
        # a direction that is hardly known may be any: no more than the hemisphere
        bends = np.maximum(np.linalg.eigvalsh(curvature), 1.0)
        return n, bends, value - 0.5 * float(np.log(bends).sum())

    @property
    def oblique_sd_rad(self) -> float:
        """Standard deviation of the best direction along an arc across it, both arcs' mean."""
        return float(np.sqrt(np.mean(1.0 / self._oblique[1])))

    def _local(self, n: Array) -> tuple[Array, Array, Array]:
        """Slope (2,) and curvature (2, 2) of the log evidence in two directions (3, 2) across n."""
        across = np.linalg.svd(n[None])[2][1:].T
        h = STEP_RAD
        moves = h * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)])
        near = n + moves @ across.T
        at = self.evidence_about(near / np.linalg.norm(near, axis=1, keepdims=True))
        slope = np.array([at[1] - at[2], at[3] - at[4]]) / (2.0 * h)
        first, second = (at[1] + at[2] - 2.0 * at[0]) / h**2, (at[3] + at[4] - 2.0 * at[0]) / h**2
        both = (at[5] + at[6] - 2.0 * at[0]) / h**2
        mixed = 0.5 * (both - first - second)
        return slope, -np.array([[first, mixed], [mixed, second]]), across

    @property
    def rough_evidence(self) -> float:
        """Over all directions by those looked at, nats: good to rank lines by, and quick."""
        oblique = np.logaddexp.reduce(self._evidence_tried[len(BODY_AXES) :]) - np.log(LOOKED_AT)
        return float(np.logaddexp(self._of_axes, oblique + np.log(1.0 - ALONG_AXES)))

    @property
    def log_evidence(self) -> float:
        """Over all directions, nats."""
        return float(np.logaddexp(self._of_axes, self._of_oblique))

    @property
    def _of_axes(self) -> float:
        about = np.logaddexp.reduce(self._evidence_tried[: len(BODY_AXES)])
        return float(about + np.log(ALONG_AXES / len(BODY_AXES)))

    @property
    def _of_oblique(self) -> float:
        return float(self._oblique[2] + np.log(1.0 - ALONG_AXES))

    @property
    def best(self) -> Direction:
        """A body axis if those have more of the evidence, else the best oblique direction."""
        if self._of_axes > self._of_oblique:
            return BODY_AXES[int(self._evidence_tried[: len(BODY_AXES)].argmax())]
        x, y, z = (float(part) for part in self._oblique[0])
        return x, y, z
