"""Rows of telemetry as arrays, one array per channel."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array


@dataclass(frozen=True, eq=False)
class Chunk:
    """n rows of telemetry in file order, checked and mended; arrays are read-only.

    NaN means "not sampled at this time"; a channel is sampled as a whole or not at all in a row. A
    channel that the file does not have is 0 wide, the tank pressure then all NaN. Attitudes are
    unit quaternions J2000 → body, scalar last, with the sign that continues the one before.
    Counters only grow: a wrap has been undone. ``first_row`` is the line of the file (for Parquet
    the row, counted from 1) that the first row came from.
    """

    first_row: int
    time_s: Array  # (n,) since the event's epoch, strictly increasing
    attitude: Array  # (n, 4)
    rate_rad_s: Array  # (n, 3) body axes
    wheel_rpm: Array  # (n, W) in the order of the event's wheels
    on_time_s: Array  # (n, K) cumulative, as commanded, in the order of the event's thrusters
    pulses: Array  # (n, K) cumulative
    delta_v_m_s: Array  # (n, 3) cumulative, body axes
    tank_pressure_kpa: Array  # (n,)

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            getattr(self, name).setflags(write=False)

    @property
    def rows(self) -> int:
        """Number of rows n."""
        return int(self.time_s.size)


_ARRAYS: Final = tuple(field.name for field in fields(Chunk) if field.name != "first_row")


def join(chunks: list[Chunk]) -> Chunk:
    """Chunks that follow each other as one; at least one."""
    arrays = {name: np.concatenate([getattr(c, name) for c in chunks]) for name in _ARRAYS}
    return Chunk(first_row=chunks[0].first_row, **arrays)
