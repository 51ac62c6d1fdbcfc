"""Gram matrices contracted with the weights of a batch of parameter points, compiled.

Columns combine into P new ones per axis, y_c,k(t) = Σ_a w[a, k, c] C_c,a(t); what the likelihood
needs are the inner products of these under a noise precision W, and their projections on the
cosines. The weights are sparse: entry b says that column ``row[b]`` enters new column ``owner[b]``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Places = NDArray[np.int64]
Function = TypeVar("Function", bound=Callable[..., Any])

# nogil: other threads may evaluate other points meanwhile
OPTIONS: Final[dict[str, Any]] = {
    "error_model": "numpy",
    "fastmath": {"reassoc", "contract"},
    "nogil": True,
}


def _compiled(function: Function) -> Function:
    try:
        return cast(Function, njit(cache=True, **OPTIONS)(function))
    except RuntimeError:  # the package's folder cannot be written: compile in every process
        return cast(Function, njit(**OPTIONS)(function))


@_compiled
def contract(
    gram: Array, row: Places, start: Places, weights: Array, precision: Array
) -> Array:  # pragma: no cover - compiled
    """Inner products of the new columns, M_kl = Σ_t y_k(t)ᵀ W y_l(t), (n, P, P).

    Parameters
    ----------
    gram
        (3, 3, A, A) from :class:`EventStatistics`.
    row, start
        (B,) column of every entry, in order of its owner; entries of new column k are
        ``start[k]`` to ``start[k + 1]``.
    weights
        (n, B, 3) weight of every entry per axis.
    precision
        (n, 3, 3) symmetric W.
    """
    n, size, width = weights.shape[0], gram.shape[2], start.size - 1
    result = np.empty((n, width, width))
    gathered = np.empty((3, size))
    for i in range(n):
        for k in range(width):
            gathered[:] = 0.0
            for b in range(start[k], start[k + 1]):
                u, v, w = weights[i, b, 0], weights[i, b, 1], weights[i, b, 2]
                for c in range(3):
                    by_x, by_y, by_z = (
                        precision[i, c, 0] * u,
                        precision[i, c, 1] * v,
                        precision[i, c, 2] * w,
                    )
                    x, y, z = gram[0, c, row[b]], gram[1, c, row[b]], gram[2, c, row[b]]
                    for a in range(size):
                        gathered[c, a] += by_x * x[a] + by_y * y[a] + by_z * z[a]
            for other in range(k + 1):
                value = 0.0
                for b in range(start[other], start[other + 1]):
                    for c in range(3):
                        value += weights[i, b, c] * gathered[c, row[b]]
                result[i, k, other] = value
                result[i, other, k] = value
    return result


@_compiled
def moments(gram: Array, places: Places, weights: Array) -> Array:  # pragma: no cover - compiled
    """Inner products of one new vector column and some scalar ones, (n, 3 + W, 3 + W).

    Parameters
    ----------
    gram
        (3, 3, A, A) from :class:`EventStatistics`.
    places
        (W,) columns that are scalars.
    weights
        (n, 3, A) of the new column y_c(t) = Σ_a w[c, a] C_c,a(t).
    """
    n, size, scalars = weights.shape[0], gram.shape[2], places.size
    result = np.empty((n, 3 + scalars, 3 + scalars))
    gathered = np.empty(size)
    for i in range(n):
        for c in range(3):
            for d in range(c + 1):
                gathered[:] = 0.0
                for b in range(size):
                    weight = weights[i, c, b]
                    if weight == 0.0:
                        continue
                    line = gram[c, d, b]
                    for a in range(size):
                        gathered[a] += weight * line[a]
                value = 0.0
                for a in range(size):
                    value += weights[i, d, a] * gathered[a]
                result[i, c, d] = value
                result[i, d, c] = value
                if d == 0:
                    for j in range(scalars):
                        result[i, c, 3 + j] = gathered[places[j]]
                        result[i, 3 + j, c] = gathered[places[j]]
        for j in range(scalars):
            for k in range(scalars):
                result[i, 3 + j, 3 + k] = gram[0, 0, places[j], places[k]]
    return result


@_compiled
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


@_compiled
def explained_by_modes(
    projection: Array, row: Places, start: Places, weights: Array, axes: Array, gain: Array
) -> Array:  # pragma: no cover - compiled
    """What the cosines of the torque noise take off the inner products, (n, P, P).

    Σ_m,e gain_m,e Y_m,e,k Y_m,e,l with Y_m,e,k = Σ_c axes_c,e Σ_t φ_m(t) y_c,k(t).

    Parameters
    ----------
    projection
        (3, A, M) of the columns on the cosines.
    row, start, weights
        As in :func:`contract`.
    axes
        (n, 3, 3) principal axes of the noise as columns.
    gain
        (n, 3, M) weight of every cosine per principal axis.
    """
    n, modes, width = weights.shape[0], projection.shape[2], start.size - 1
    result = np.zeros((n, width, width))
    body = np.empty((3, modes))
    seen = np.empty((width, 3 * modes))
    scaled = np.empty(3 * modes)
    for i in range(n):
        for k in range(width):
            body[:] = 0.0
            for b in range(start[k], start[k + 1]):
                for c in range(3):
                    weight = weights[i, b, c]
                    if weight == 0.0:
                        continue
                    line = projection[c, row[b]]
                    for m in range(modes):
                        body[c, m] += weight * line[m]
            for e in range(3):
                for m in range(modes):
                    seen[k, e * modes + m] = (
                        axes[i, 0, e] * body[0, m]
                        + axes[i, 1, e] * body[1, m]
                        + axes[i, 2, e] * body[2, m]
                    )
            for e in range(3):
                for m in range(modes):
                    scaled[e * modes + m] = gain[i, e, m] * seen[k, e * modes + m]
            for other in range(k + 1):
                value = 0.0
                for j in range(3 * modes):
                    value += scaled[j] * seen[other, j]
                result[i, k, other] = value
                result[i, other, k] = value
    return result
