"""What a first look at an event has found, for the pass that reduces it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from cassini_bayes.balance.statistics.channel_noise import NOT_SEEN, ChannelNoise
from cassini_bayes.balance.statistics.event_statistics import NO_STEPS, ChannelSteps
from cassini_bayes.balance.statistics.rounded_counters import Rounding
from cassini_bayes.computing.arrays import Array


@dataclass(frozen=True)
class LateRows:
    """Of rows that have late pulses: length of their blocks, mean width of pulses, and how often.

    ``block_s`` is 0 where rows are between firings, else ``block_rows`` are usual in one;
    ``rate_hz`` (K,) is of every thruster. Readings
    find a pulse ``first_s`` after it begins or any number of times ``every_s`` later, which is 0
    where they find it at any time.
    """

    block_s: float = 0.0
    block_rows: float = 0.0
    width_s: float = 0.0
    rate_hz: tuple[float, ...] = ()
    first_s: float = 0.0
    every_s: float = 0.0


@dataclass(frozen=True)
class Preparation:
    """What a first look at an event's telemetry found, for the pass that reduces it."""

    steps: ChannelSteps = NO_STEPS
    noise: ChannelNoise = NOT_SEEN
    read_s: Array = field(default_factory=lambda: np.zeros(0))  # (m,) readings around changes
    on_time_s: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (m, K) expected there
    # (m, K) pulses whose on-time is counted there
    pulses: Array = field(default_factory=lambda: np.zeros((0, 0)))
    rounding: tuple[Rounding, ...] = ()  # (K,) of the thrusters' counters, between these
    gaps_s: tuple[float, ...] = ()  # of close pulses; without, a control cycle
    paired_s: tuple[float, ...] = ()  # widths of pulses that may be close
    widths_s: tuple[float, ...] = ()  # of pulses; without, those of a firing are alike
    late: LateRows = LateRows()  # without rows between firings

    @property
    def unsure_s(self) -> float:
        """Standard deviation of a usual firing's on-time, s, of the least known counter."""
        return math.sqrt(max((one.unsure_s2 for one in self.rounding), default=0.0))
