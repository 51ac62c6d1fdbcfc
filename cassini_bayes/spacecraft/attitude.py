"""Attitudes as matrices."""

from __future__ import annotations

import numpy as np

from cassini_bayes.computing.arrays import Array


def direction_cosines(attitude: Array) -> Array:
    """Inertial-to-body matrices (N, 3, 3) of Euler parameters (N, 4), scalar last.

    C = (q4² − q·q) 1 + 2 q qᵀ − 2 q4 [q×].
    """
    vector, scalar = attitude[:, :3], attitude[:, 3]
    matrix = 2.0 * vector[:, :, None] * vector[:, None, :]
    diagonal = scalar**2 - (vector**2).sum(1)
    for axis in range(3):
        matrix[:, axis, axis] += diagonal
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[:, i, j] += 2.0 * scalar * vector[:, k]
        matrix[:, j, i] -= 2.0 * scalar * vector[:, k]
    return np.asarray(matrix)
