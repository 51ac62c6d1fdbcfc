"""Rows of telemetry that the checks look at, evenly thinned in constant memory."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Final, Self

import numpy as np

from cassini_bayes.computing.arrays import Array, Flags
from cassini_bayes.events.telemetry import Chunk

MOST_MOTION_ROWS: Final = 4096
MOST_BALANCE_ROWS: Final = 1024
"""Evenly thinned where there are more: a check then takes as long for a day as for an hour
(judgement)."""
LEAST_ROWS: Final = 12  # judgement: fewer are not checked


@dataclass(frozen=True, eq=False)
class Motion:
    """Rows at which attitude and body rates were both sampled."""

    time_s: Array  # (n,)
    attitude: Array  # (n, 4)
    rate_rad_s: Array  # (n, 3)

    def only(self, chosen: Flags) -> Self:
        """Some of the rows."""
        return replace(self, **{own.name: getattr(self, own.name)[chosen] for own in fields(self)})


@dataclass(frozen=True, eq=False)
class Rows(Motion):
    """Rows at which every channel was sampled; counters are 0 wide without thrusters."""

    wheel_rpm: Array  # (n, W)
    on_time_s: Array  # (n, K)
    pulses: Array  # (n, K)


def at_times(at_s: Array, time_s: Array, values: Array) -> Array:
    """Values (n, c) of rows at other times (m,), linear between rows: (m, c)."""
    return np.stack([np.interp(at_s, time_s, column) for column in values.T], axis=1)


class Thinned:
    """At most so many rows of a table, evenly spaced, however long it gets and however it comes."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._stride = 1
        self._seen = 0
        self._kept: list[Array] = []

    def add(self, table: Array) -> None:
        """Take rows; those with a cell that was not sampled are no rows."""
        table = table[~np.isnan(table).any(axis=1)]
        number = np.arange(self._seen, self._seen + len(table))
        self._seen += len(table)
        self._kept.append(table[number % self._stride == 0])
        while sum(map(len, self._kept)) > self._most:
            self._kept = [np.concatenate(self._kept)[::2]]
            self._stride *= 2

    def table(self) -> Array:
        """The rows kept."""
        return np.concatenate(self._kept)


class RowCollector:
    """Feed it an event's chunks; it keeps what the checks of motion and of momentum need.

    Between two equal readings of counters nothing has fired: rows between them have these counters.
    """

    def __init__(self) -> None:
        self._motion = Thinned(MOST_MOTION_ROWS)
        self._rows = Thinned(MOST_BALANCE_ROWS)
        self._waiting: Array | None = None  # rows after the last reading of counters
        self._wheels, self._counters = 0, 0
        self._complete = False

    def add(self, chunk: Chunk) -> None:
        """Take a chunk."""
        has_pulses = chunk.pulses.shape == chunk.on_time_s.shape
        pulses = chunk.pulses if has_pulses else np.zeros_like(chunk.on_time_s)
        self._wheels, self._counters = chunk.wheel_rpm.shape[1], chunk.on_time_s.shape[1]
        self._complete = chunk.attitude.shape[1] + chunk.rate_rad_s.shape[1] == 7
        motion = (chunk.time_s[:, None], chunk.attitude, chunk.rate_rad_s)
        self._motion.add(np.concatenate(motion, axis=1))
        channels = (*motion, chunk.wheel_rpm, chunk.on_time_s, pulses)
        table = np.concatenate(channels, axis=1)
        if self._counters:
            table = self._with_counters(table)
        self._rows.add(table)

    def _with_counters(self, table: Array) -> Array:
        """Rows up to the last reading of counters, those between equal readings filled in."""
        if self._waiting is not None:
            table = np.concatenate([self._waiting, table])
        counters = table[:, -2 * self._counters :]
        read = np.flatnonzero(~np.isnan(counters).any(axis=1))
        if not len(read):
            self._waiting = table[-MOST_BALANCE_ROWS:]
            return table[:0]
        after = np.minimum(np.searchsorted(read, np.arange(len(table))), len(read) - 1)
        before = np.maximum(after - 1, 0)
        same = (counters[read[after]] == counters[read[before]]).all(axis=1)
        between = same & (np.arange(len(table)) > read[0])
        filled = table.copy()
        filled[between, -2 * self._counters :] = counters[read[after]][between]
        # the last reading waits too: it may be the first of two that are equal
        self._waiting = table[read[-1] :][:MOST_BALANCE_ROWS]
        return filled[: read[-1]]

    def motion(self) -> Motion | None:
        """Rows with attitude and rates; None if too few."""
        table = self._motion.table() if self._complete else np.zeros((0, 8))
        if len(table) < LEAST_ROWS:
            return None
        return Motion(table[:, 0], table[:, 1:5], table[:, 5:8])

    def rows(self) -> Rows | None:
        """Rows with every channel; None if there are no wheels or too few rows."""
        if self._waiting is not None:
            self._rows.add(self._waiting)
            self._waiting = None
        table = self._rows.table() if self._complete and self._wheels else np.zeros((0, 8))
        if len(table) < LEAST_ROWS:
            return None
        ends = np.cumsum([8, self._wheels, self._counters])
        wheels, on_time, pulses = np.split(table[:, 8:], ends[1:] - 8, axis=1)
        return Rows(table[:, 0], table[:, 1:5], table[:, 5:8], wheels, on_time, pulses)
