"""Inner products of columns and cosines over rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics.columns import Rows
from cassini_bayes.balance.statistics.layout import Layout
from cassini_bayes.balance.statistics.pulse_columns import PULSE_COLUMNS
from cassini_bayes.computing.arrays import Array

MODES: Final = 512  # at 1 Hz the remainder is faster than 6 s in a bias of 1,500 s


@dataclass(frozen=True)
class Inner:
    """Inner products over rows of vector columns (their axis first), scalar columns and cosines."""

    columns: Array  # (3 V + S, 3 V + S)
    mixed: Array  # (M, 3 V + S)
    modes: Array  # (M, M)

    def gather(self, other: Inner) -> None:
        """Add those of other rows in place."""
        for own, more in zip(
            (self.columns, self.mixed, self.modes),
            (other.columns, other.mixed, other.modes),
            strict=True,
        ):
            own += more


def inner_products(rows: Rows, layout: Layout, duration_s: float) -> Inner:
    """Inner products over some rows, by symmetric products: scalars and twins only once."""
    n, scalars = len(rows.time_s), rows.scalar.shape[1]
    source = _twins(rows.vector, layout)
    own = np.flatnonzero(source == np.arange(len(source)))
    vector = rows.vector if len(own) == len(source) else rows.vector[:, :, own]
    vector = vector.reshape(n, -1)
    waves, to_modes = local_waves(rows.time_s / duration_s)
    rest = np.concatenate([rows.scalar, waves], axis=1)
    mixed, inner = vector.T @ rest, rest.T @ rest
    on_waves = np.concatenate([mixed[:, scalars:], inner[:scalars, scalars:]]).T
    mixed, scalar = mixed[:, :scalars], inner[:scalars, :scalars]
    every = np.r_[
        (np.arange(3)[:, None] * len(own) + np.searchsorted(own, source)).reshape(-1),
        3 * len(own) + np.arange(scalars),
    ]
    columns = np.block([[vector.T @ vector, mixed], [mixed.T, scalar]])
    modes = inner[scalars:, scalars:]
    if to_modes is not None:
        on_waves, modes = to_modes @ on_waves, to_modes @ modes @ to_modes.T
    return Inner(columns[every[:, None], every], on_waves[:, every], modes)


def by_axes(columns: Array, layout: Layout) -> Array:
    """Gram matrices (..., 3, 3, A, A), one per pair of axes, of those (..., 3 V + S, 3 V + S)."""
    vectors = len(layout.vector)
    own = [slice(c * vectors, (c + 1) * vectors) for c in range(3)]
    first, scalar, scalars = slice(vectors), slice(vectors, None), slice(3 * vectors, None)
    gram = np.empty((*columns.shape[:-2], 3, 3, layout.size, layout.size))
    for c, row in enumerate(own):
        for d, column in enumerate(own):
            block = gram[..., c, d, :, :]
            block[..., first, first] = columns[..., row, column]
            block[..., first, scalar] = columns[..., row, scalars]
            block[..., scalar, first] = columns[..., scalars, column]
            block[..., scalar, scalar] = columns[..., scalars, scalars]
    return gram


def mixed_by_axes(mixed: Array, layout: Layout) -> Array:
    """Inner products (M, 3, A) with the columns of every axis, of those (M, 3 V + S)."""
    vectors = len(layout.vector)
    own, scalar = np.split(mixed, [3 * vectors], axis=1)
    by_axis = own.reshape(len(mixed), 3, vectors)
    along = np.broadcast_to(scalar[:, None], (len(mixed), 3, scalar.shape[1]))
    return np.concatenate([by_axis, along], axis=2)


def _twins(vector: Array, layout: Layout) -> NDArray[np.intp]:
    """For every vector column (V,) the first that is the same: thrusters of a couple often are."""
    source = np.arange(len(layout.vector))
    fired = source[layout.fired].reshape(-1, 3 * len(PULSE_COLUMNS))
    for couple in layout.couples:
        first = fired[couple[0]]
        for other in (fired[k] for k in couple[1:]):
            if np.array_equal(vector[..., first], vector[..., other]):
                source[other] = first
    return source


def local_waves(turn: Array) -> tuple[Array, Array | None]:
    """Functions (n, D) of places x = t/T (n,) that the cosines cos(m π x) are made of, and how.

    Returns also the (M, D) matrix that makes the cosines of them, None if they are the cosines.
    Where many rows span a small part of the event, all cosines are sums of few Chebyshev
    polynomials, to rounding: with phases of up to ±φ about the middle, polynomial d has a weight of
    the size of the Bessel function J_d(φ).
    """
    middle, half = 0.5 * (turn.min() + turn.max()), 0.5 * (turn.max() - turn.min())
    phase = np.pi * MODES * half
    count = int(phase + 9.0 * np.cbrt(phase) + 16.0)
    order = np.arange(1, MODES + 1)
    if count >= min(MODES, len(turn)):
        return np.cos(np.pi * turn[:, None] * order), None
    node = np.pi * (np.arange(count) + 0.5) / count
    at_nodes = np.cos(np.pi * order[:, None] * (middle + half * np.cos(node)))
    weights = 2.0 / count * at_nodes @ np.cos(node[:, None] * np.arange(count))
    weights[:, 0] *= 0.5
    x = (turn - middle) / max(half, np.finfo(float).tiny)
    waves = np.empty((count, len(turn)))
    waves[0], waves[1] = 1.0, x
    for d in range(2, count):
        waves[d] = 2.0 * x * waves[d - 1] - waves[d - 2]
    return waves.T, weights
