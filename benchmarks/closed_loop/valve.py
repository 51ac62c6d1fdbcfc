"""Commands to valves, and what first-order valves deliver for them, in closed form.

A valve opens τ_d after its command and the thrust, in units of the steady one, rises as κ̇ = (1 −
κ)/τ_r; τ_d after the command ends it closes and κ̇ = −κ/τ_f. A valve that opens again rises from
what is left. Commands are in whole milliseconds; those that touch or overlap are one pulse.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from closed_loop.cassini import Array


class Firing(NamedTuple):
    """A command to one thruster: its index, start and width."""

    thruster: int
    start_ms: int
    width_ms: int


Pulses = tuple[tuple[int, int], ...]
"""Commanded pulses of one thruster: start and end in ms, apart from each other, in order."""


def merged(intervals: Iterable[tuple[int, int]]) -> Pulses:
    """Intervals that touch or overlap as one."""
    found: list[tuple[int, int]] = []
    for start, end in sorted(intervals):
        if found and start <= found[-1][1]:
            found[-1] = (found[-1][0], max(found[-1][1], end))
        else:
            found.append((start, end))
    return tuple(found)


def commanded(
    pulses: Pulses, time_ms: Sequence[int]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cumulative on-time in ms up to each time, and pulses that have started by then."""
    starts = np.array([start for start, _ in pulses], dtype=np.int64)
    ends = np.array([end for _, end in pulses], dtype=np.int64)
    times = np.asarray(time_ms, dtype=np.int64)[:, None]
    on_time = np.clip(times - starts, 0, ends - starts).sum(axis=1)
    return on_time, (times >= starts).sum(axis=1)


class Valve:
    """What one valve delivers for its pulses: ∫ κ dt, exactly, whatever is merged or cut.

    Parameters
    ----------
    pulses
        As commanded.
    delay_s, rise_s, fall_s
        τ_d, τ_r, τ_f.
    longer_s
        How much later than it should the valve closes.
    """

    def __init__(
        self, pulses: Pulses, delay_s: float, rise_s: float, fall_s: float, longer_s: float = 0.0
    ) -> None:
        self._rise, self._fall = rise_s, fall_s
        # edges, whether the valve is open after each, κ and ∫ κ dt there
        self._time, self._open, self._level, self._integral = [-np.inf], [False], [0.0], [0.0]
        for start, end in pulses:
            opens = 1e-3 * start + delay_s
            closes = max(opens, 1e-3 * end + delay_s + longer_s)
            if opens <= self._time[-1]:  # it has not closed since
                del self._time[-1], self._open[-1], self._level[-1], self._integral[-1]
            else:
                self._edge(opens, True)
            self._edge(closes, False)

    def _edge(self, time_s: float, is_open: bool) -> None:
        level, integral = self._after(len(self._time) - 1, time_s)
        self._time.append(time_s)
        self._open.append(is_open)
        self._level.append(level)
        self._integral.append(integral)

    def _after(self, edge: int, time_s: float) -> tuple[float, float]:
        """κ and ∫ κ dt at a time after an edge."""
        level, integral = self._level[edge], self._integral[edge]
        if edge == 0:
            return 0.0, 0.0
        span = time_s - self._time[edge]
        if self._open[edge]:
            left = (1.0 - level) * np.exp(-span / self._rise)
            return 1.0 - left, integral + span - self._rise * (1.0 - level - left)
        left = level * np.exp(-span / self._fall)
        return left, integral + self._fall * (level - left)

    def edges(self) -> list[tuple[float, bool]]:
        """When the valve moves, in s, and whether it is open from then on."""
        return list(zip(self._time[1:], self._open[1:], strict=True))

    def effective_s(self, time_s: Iterable[float]) -> Array:
        """∫ κ dt up to each time, s."""
        return np.array([self._after(bisect_right(self._time, t) - 1, t)[1] for t in time_s])
