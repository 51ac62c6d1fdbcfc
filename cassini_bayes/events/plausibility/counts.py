"""Counters that cannot be: pulses counted more than once, on-times longer than time."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.telemetry import Chunk

LEAST_STEPS: Final = 24
"""Rows with new pulses: were even counts chance, thrusters would throw so many heads in a row
(a chance of 6e-8)."""


class PulseSteps:
    """The greatest common divisor of all increments of pulse counts."""

    def __init__(self) -> None:
        self._last: np.ndarray[tuple[int], np.dtype[np.int64]] | None = None
        self._divisor = 0
        self._steps = 0

    def add(self, chunk: Chunk) -> None:
        """Take a chunk."""
        if not chunk.pulses.shape[1]:
            return
        counts = chunk.pulses[~np.isnan(chunk.pulses).any(axis=1)].astype(np.int64)
        if not len(counts):
            return
        if self._last is not None:
            counts = np.concatenate([self._last[None], counts])
        self._last = counts[-1]
        steps = np.diff(counts, axis=0)
        self._steps += int(np.count_nonzero(steps.any(axis=1)))
        self._divisor = int(np.gcd.reduce(np.append(steps.ravel(), self._divisor)))

    @property
    def counted(self) -> int:
        """How often every pulse seems to be counted; 1 if nothing speaks against once."""
        return self._divisor if self._steps >= LEAST_STEPS and self._divisor > 1 else 1


class OnTimeSteps:
    """By how much counters gain more than the time that passes, at most."""

    def __init__(self, thrusters: int) -> None:
        self._last: Array | None = None
        self.excess_s: Array = np.full(thrusters, -np.inf)

    def add(self, chunk: Chunk) -> None:
        """Take a chunk."""
        table = np.concatenate([chunk.time_s[:, None], chunk.on_time_s], axis=1)
        table = table[~np.isnan(table).any(axis=1)]
        if self._last is not None:
            table = np.concatenate([self._last, table])
        if len(table) and table.shape[1] > 1:
            self._last = table[-1:]
            steps = np.diff(table, axis=0)
            most = np.max(steps[:, 1:] - steps[:, :1], axis=0, initial=-np.inf)
            self.excess_s = np.maximum(self.excess_s, most)
