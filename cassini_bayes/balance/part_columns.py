"""A matrix whose rows come in parts, of which each has few of the columns.

In the linear model of all events most columns belong to one event: its thrusts, what its counters
leave open, its torque noise. Written out, six events of a quarter of an hour are 0.7 GB, of which
nine tenths are zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np

from cassini_bayes.computing.arrays import Array, Places


@dataclass(frozen=True)
class PartColumns:
    """Columns ``values`` (n, k) that a part has, at ``places`` (k,) among all; ascending."""

    places: Places
    values: Array

    @classmethod
    def of(cls, columns: Array) -> PartColumns:
        """Those of all columns (n, p) that are not zero."""
        places = np.flatnonzero(np.any(columns, axis=0))
        return cls(places, columns[:, places])


@dataclass(frozen=True, eq=False)
class ColumnsByPart:
    """Matrix (m, width), part by part; the columns that a part has not are zero there."""

    parts: tuple[PartColumns, ...]
    width: int

    @classmethod
    def of(cls, columns: Array, counts: Sequence[int]) -> ColumnsByPart:
        """Of a matrix (m, p) that is written out, with so many rows in every part."""
        blocks = np.split(columns, np.cumsum(counts)[:-1])
        return cls(tuple(map(PartColumns.of, blocks)), columns.shape[1])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return sum(len(part.values) for part in self.parts), self.width

    @property
    def slices(self) -> tuple[slice, ...]:
        """Where every part's rows are among all."""
        ends = accumulate((len(part.values) for part in self.parts), initial=0)
        return tuple(slice(a, b) for a, b in pairwise(ends))

    def __matmul__(self, factors: Array) -> Array:
        """X times factors (p, …)."""
        each = [part.values @ factors[part.places] for part in self.parts]
        return np.concatenate(each) if each else np.zeros((0, *factors.shape[1:]))

    def along(self, values: Array) -> Array:
        """Xᵀ times values (m, …)."""
        result = np.zeros((self.width, *values.shape[1:]))
        for part, own in zip(self.parts, self.slices, strict=True):
            result[part.places] += part.values.T @ values[own]
        return result

    def gram(self) -> Array:
        """Xᵀ X (p, p)."""
        total = np.zeros((self.width, self.width))
        for part in self.parts:
            total[np.ix_(part.places, part.places)] += part.values.T @ part.values
        return total

    def chosen(self, columns: Places) -> ColumnsByPart:
        """Some columns, in ascending order, alone."""
        number = np.full(self.width, -1)
        number[columns] = np.arange(len(columns))
        parts = []
        for part in self.parts:
            kept = number[part.places] >= 0
            parts.append(PartColumns(number[part.places[kept]], part.values[:, kept]))
        return ColumnsByPart(tuple(parts), len(columns))

    def written_out(self) -> Array:
        """All of it (m, p), zeros included: of few columns."""
        return self @ np.eye(self.width)


def spread(values: Array, places: Places, width: int) -> Array:
    """Values (…, k) at their places among ``width``, zero elsewhere."""
    result = np.zeros((*values.shape[:-1], width))
    result[..., places] = values
    return result
