"""Rows of telemetry at which every channel was sampled, evenly thinned in constant memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.telemetry import Chunk

MOST_ROWS: Final = 4096
LEAST_ROWS: Final = 12


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows at which every channel was sampled; counters are 0 wide without thrusters."""

    time_s: Array
    attitude: Array
    rate_rad_s: Array
    wheel_rpm: Array
    effective_s: Array


class MomentumRows:
    """Collects, in constant memory, evenly spaced rows at which every channel was sampled.

    Feed it the chunks of one event while they are read for something else.
    """

    def __init__(self, tau_difference_s: float) -> None:
        self._tau_s = tau_difference_s
        self._stride = 1
        self._seen = 0
        self._kept: list[Array] = []
        self._shape: tuple[int, int] | None = None

    def add(self, chunk: Chunk) -> None:
        """Take what a chunk has of such rows."""
        effective = chunk.on_time_s
        if chunk.pulses.shape == effective.shape:
            effective = effective + self._tau_s * chunk.pulses
        parts = (
            chunk.time_s[:, None],
            chunk.attitude,
            chunk.rate_rad_s,
            chunk.wheel_rpm,
            effective,
        )
        self._shape = (
            chunk.attitude.shape[1] + chunk.rate_rad_s.shape[1],
            chunk.wheel_rpm.shape[1],
        )
        table = np.concatenate(parts, axis=1)
        table = table[~np.isnan(table).any(axis=1)]
        number = np.arange(self._seen, self._seen + len(table))
        self._seen += len(table)
        self._kept.append(table[number % self._stride == 0])
        while sum(map(len, self._kept)) > MOST_ROWS:
            self._kept = [np.concatenate(self._kept)[::2]]
            self._stride *= 2

    def rows(self) -> Rows | None:
        """What was collected; None if a channel is lacking or rows are too few."""
        if self._shape is None or self._shape[0] != 7 or self._shape[1] == 0:
            return None
        table = np.concatenate(self._kept)
        if len(table) < LEAST_ROWS:
            return None
        wheels = self._shape[1]
        return Rows(
            table[:, 0],
            table[:, 1:5],
            table[:, 5:8],
            table[:, 8 : 8 + wheels],
            table[:, 8 + wheels :],
        )


def conventions(attitude: Array) -> Iterator[tuple[str, Array]]:
    """Yield other ways of writing an attitude, turned into ours."""
    inverse = attitude * np.array([-1.0, -1.0, -1.0, 1.0])
    first = np.roll(attitude, -1, axis=1)
    yield "quaternions that look like body → J2000", inverse
    yield "quaternions that look scalar-first", first
    yield (
        "quaternions that look scalar-first and body → J2000",
        first * np.array([-1.0, -1.0, -1.0, 1.0]),
    )
