"""From inertial into body axes: rotation matrices, and columns turned row by row, compiled."""

from __future__ import annotations

import numpy as np

from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.computing.compilation import compiled_sums


@compiled_sums
def turned_into_body(
    body: Array, inertial: Array, index: Places, out: Array
) -> None:  # pragma: no cover - compiled
    """Inertial columns in body axes: out[t] = body[t] @ inertial[index[t]].

    Parameters
    ----------
    body
        (n, 3, 3) inertial to body at every row.
    inertial
        (m, 3, C) columns after each change.
    index
        (n,) how many changes are over by every row.
    out
        (n, 3, C) result.
    """
    for t in range(body.shape[0]):
        held = inertial[index[t]]
        for c in range(3):
            x, y, z = body[t, c, 0], body[t, c, 1], body[t, c, 2]
            for a in range(held.shape[1]):
                out[t, c, a] = x * held[0, a] + y * held[1, a] + z * held[2, a]


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
