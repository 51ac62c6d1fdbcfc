"""Rows that come in stretches, evenly thinned."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array

MOST_TIMES: Final = 4_096  # of rows, for what counters leave open: some percent of a small noise


class Thinned:
    """Rows of arrays (n, …) that come in stretches, evenly thinned in constant memory.

    ``kept`` are those that stay, each for ``stride`` rows.
    """

    def __init__(self) -> None:
        self.stride = 1
        self._seen = 0
        self.kept: list[Array] = []

    def add(self, values: Array) -> None:
        """Take some more rows."""
        number = np.arange(self._seen, self._seen + len(values))
        self._seen += len(values)
        self.kept.append(values[number % self.stride == 0])
        while sum(map(len, self.kept)) > MOST_TIMES:
            self.kept = [self.values[::2]]
            self.stride *= 2

    @property
    def values(self) -> Array:
        """Those that stay, in one array."""
        return np.concatenate(self.kept)
