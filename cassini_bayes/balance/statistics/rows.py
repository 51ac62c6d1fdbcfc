"""Telemetry rows as arrays, and which of them the momentum balance may use.

A row enters when attitude, body rates and wheel rates were sampled together and no thrust was being
delivered: counters show a pulse when it starts, its momentum arrives over the next tenths of a
second. The row is kept if the last counters read at least ``guard_s`` before it and the first ones
read at or after it are the same (``docs/topics/telemetry-likelihood.md`` §4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array, Flags, Places, picked

SAME_S: Final = 1e-6  # times closer than this are the same


@dataclass(frozen=True)
class Samples:
    """N rows of telemetry in order of time; NaN where a channel was not sampled.

    ``attitude`` are Euler parameters, inertial to body, scalar last. Counters are cumulative and
    have K columns, none for an event without thrusters.
    """

    time_s: Array  # (N,)
    attitude: Array  # (N, 4)
    rate_rad_s: Array  # (N, 3)
    wheel_rad_s: Array  # (N, W)
    on_time_s: Array  # (N, K)
    pulses: Array  # (N, K)

    def __len__(self) -> int:
        return len(self.time_s)

    def part(self, start: int, stop: int | None = None) -> Samples:
        """Rows ``start`` to ``stop``."""
        return picked(self, slice(start, stop))

    @property
    def complete(self) -> Samples:
        """Rows with attitude, body rates and wheel rates."""
        return picked(self, self.has_state)

    @property
    def has_motion(self) -> bool:
        """Whether the event has attitudes, body rates and wheel rates at all."""
        return all(own.shape[1] > 0 for own in (self.attitude, self.rate_rad_s, self.wheel_rad_s))

    @property
    def has_counters(self) -> Flags:
        """(N,) rows with thruster counters: on-times and pulses, as neither tells alone."""
        return _are_sampled(self.on_time_s) & _are_sampled(self.pulses)

    @property
    def has_state(self) -> Flags:
        """(N,) rows with attitude, body rates and wheel rates."""
        return (
            _are_sampled(self.attitude)
            & _are_sampled(self.rate_rad_s)
            & _are_sampled(self.wheel_rad_s)
        )


def _are_sampled(channel: Array) -> Flags:
    """Rows (N,) in which a channel (N, C) was sampled; none of one that an event lacks."""
    return np.asarray(np.isfinite(channel).all(axis=1) & (channel.shape[1] > 0))


def quiet_rows(time_s: Array, counter_time_s: Array, counters: Array, guard_s: float) -> Flags:
    """Times at which no pulse is being delivered.

    Parameters
    ----------
    time_s
        (N,) times asked about.
    counter_time_s, counters
        (m,) increasing times of the counter readings, (m, C) their values.
    guard_s
        How long after its off command a pulse still delivers momentum.

    Returns
    -------
    (N,) true where the readings that bracket [t − guard, t] are equal. Before ``guard_s`` after the
    first reading, and after the last one, nothing is known: false.
    """
    if len(counter_time_s) == 0:
        return np.zeros(len(time_s), dtype=bool)
    before, after = bracketing_readings(time_s, counter_time_s, guard_s)
    changes = np.concatenate([[0], np.cumsum(np.any(np.diff(counters, axis=0) != 0, axis=1))])
    last = len(counter_time_s) - 1
    same = changes[np.minimum(after, last)] == changes[np.maximum(before, 0)]
    return np.asarray(same & (before >= 0) & (after <= last))


def rows_at_readings(time_s: Array, counter_time_s: Array, guard_s: float) -> Flags:
    """Times (N,) at which counters were read, and once before by ``guard_s`` at least."""
    if len(counter_time_s) == 0:
        return np.zeros(len(time_s), dtype=bool)
    before, after = bracketing_readings(time_s, counter_time_s, guard_s)
    read = counter_time_s[np.minimum(after, len(counter_time_s) - 1)]
    return np.asarray((np.abs(read - time_s) <= SAME_S) & (before >= 0))


def bracketing_readings(
    time_s: Array, counter_time_s: Array, guard_s: float
) -> tuple[Places, Places]:
    """Places of the last readings ``guard_s`` before times (N,), and of the first ones after."""
    before = np.searchsorted(counter_time_s, time_s - guard_s + SAME_S, side="right") - 1
    return before, np.searchsorted(counter_time_s, time_s - SAME_S, side="left")
