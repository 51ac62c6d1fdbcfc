"""Sufficient statistics of one telemetry event: what a model needs of its rows, and no more."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics.channel_noise import ChannelNoise
from cassini_bayes.balance.statistics.layout import Layout
from cassini_bayes.balance.statistics.long_levels import Levels, LongLevels
from cassini_bayes.balance.statistics.sampling import Sampling
from cassini_bayes.computing.arrays import Array, Places

# Steps of counters below which bands and single columns of what is open agree: with 1 ms the truth
# of a flight is 13 nats below the highest density by either
# (docs/results/likelihood-experiments.md).
COARSE_STEP_S: Final = 3e-3


@dataclass(frozen=True)
class ChannelSteps:
    """Least steps of measured rates and wheel rates, 0 where they have none to be seen."""

    rate_rad_s: float = 0.0
    wheel_rad_s: float = 0.0


NO_STEPS: Final = ChannelSteps()
"""Of channels that are not rounded."""


@dataclass(frozen=True, eq=False)
class TurnStatistics:
    """Inner products of integrated, centred columns of quiet pieces, and their noise.

    Of the ``pieces`` slopes: ``slope_gram`` (3, 3, A, A), and with the cosines m = 0 … M of the
    momentum ``slope_projection`` (1 + M, 3, A) and ``slope_mode_gram`` (1 + M, 1 + M);
    ``slope_time_s`` (r,) and ``slope_waves`` (r, 1 + M) are evenly thinned times of the pieces and
    the cosines there, the first of them |t − t̄|, ``slope_summed_s2`` (r,) the variances of summed
    white noise, ``slope_beyond_s3`` (r,) those of what a unit random walk has beside these cosines,
    and ``slope_shown`` (r, 2 + 2 W) the lines through their wheel rates; each stands
    for ``slope_stride`` pieces. Of the ``contrasts`` (G,) that are left, in groups: ``gram``
    (G, 3, 3, A, A), ``summed_s2`` (G,) and ``walked_s3`` (G,), mean squares per contrast
    (:class:`cassini_bayes.balance.statistics.turns.Turned`).
    """

    pieces: int
    slope_gram: Array
    slope_projection: Array
    slope_mode_gram: Array
    slope_time_s: Array
    slope_waves: Array
    slope_summed_s2: Array
    slope_beyond_s3: Array
    slope_shown: Array
    slope_stride: int
    contrasts: Places
    gram: Array
    summed_s2: Array
    walked_s3: Array


@dataclass(frozen=True, eq=False)
class CounterStatistics:
    """What counters leave open, by the times of the intervals in which something fired.

    ``row_time_s`` (r,) are evenly thinned times of the rows, each for ``stride`` of them;
    ``end_s`` (R,) are the intervals, ``fired`` (R, G) which couples did in them, ``square``
    (R, G) the pairs in them that may be close, by what they scatter, ``unlike`` (R, G, C, C) what
    unlike pulses scatter, ``steps`` (R, G) the nominal variances of both and ``slopes`` (R, G, C)
    what columns gain per on-time (:class:`Pairs`); ``open_s2`` (G,), ``open_ratio`` (R, G)
    and ``open_every`` (G,) say what rounded counters leave open of a couple's levels
    (:class:`.rounded_counters.Rounding`). ``gaps_s`` (m,) are the times,
    all as likely, from the end of a pulse to the next one of a pair that is close, ``paired_s``
    (m,) widths of pulses in pairs; ``widths_s``
    (m,) are widths of pulses, all as likely, none if they are not known, ``unsure_s`` how well the
    on-time of a firing is known. Where rows have pulses
    that are late, they are means over ``averaged`` rows in blocks of ``block_s`` (``block_rows``
    usually), ``late_width_s``
    is the mean width of pulses, ``late_rate_hz`` (G,) how often couples fire, ``late_first_s`` and
    ``late_every_s`` the ages at which readings find a pulse (:class:`LateRows`). ``step_s`` is the
    step of counters whose on-times are not known exactly, else 0. ``level_…`` are roundings that
    are unknowns (:class:`.LongLevels`).
    """

    row_time_s: Array
    stride: int
    end_s: Array
    fired: NDArray[np.bool_]
    square: Array
    unlike: Array
    steps: Array
    slopes: Array
    open_s2: Array
    open_ratio: Array
    open_every: Array
    gaps_s: Array
    paired_s: Array
    widths_s: Array
    unsure_s: float
    block_s: float
    block_rows: float
    averaged: float
    late_width_s: float
    late_rate_hz: Array
    late_first_s: float
    late_every_s: float
    step_s: float
    level_couple: Places
    level_begin_s: Array
    level_end_s: Array
    level_value_s: Array

    @property
    def has_late_pulses(self) -> bool:
        """Whether rows have pulses that are late: hardly one is without firing."""
        return self.block_s > 0.0

    @property
    def are_coarse(self) -> bool:
        """Whether what counters leave open is so much that its size matters."""
        return self.step_s > COARSE_STEP_S

    @property
    def levels(self) -> Levels:
        """What counters leave open between firings, long or short."""
        return Levels(
            self.end_s, self.fired, self.slopes, self.open_s2, self.open_ratio, self.open_every
        )

    @property
    def long_levels(self) -> LongLevels:
        """Roundings that are unknowns."""
        return LongLevels(
            self.level_couple, self.level_begin_s, self.level_end_s, self.level_value_s
        )

    def seen_by(self, sampling: Sampling) -> Sampling:
        """A sampling with what the event's counters say of its pulses."""
        return replace(
            sampling,
            widths_s=tuple(self.widths_s.tolist()),
            unsure_s=self.unsure_s,
            gaps_s=tuple(self.gaps_s.tolist()),
            paired_s=tuple(self.paired_s.tolist()),
            block_s=self.block_s,
            block_rows=self.block_rows,
            levels=self.long_levels,
        )


@dataclass(frozen=True, eq=False)
class ShownWheels:
    """Measured wheel rates ``rate_rad_s`` (r, W) at the thinned rows of :class:`CounterStatistics`.

    Their rounding is the same in all rows in which a wheel rests.
    """

    rate_rad_s: Array


@dataclass(frozen=True, eq=False)
class EventStatistics:
    """Sufficient statistics of one telemetry event; equal to nothing but itself.

    ``gram[c, d]`` (3, 3, A, A) holds Σ_t a_c(t) b_d(t) for all pairs of columns and axes;
    ``projection`` (M, 3, A) = Σ_t φ_m(t) a_c(t) and ``mode_gram`` (M, M) = Σ_t φ_m φ_l belong to
    the cosines φ_m(t) = cos(m π t / T), m = 1 … M, of the torque noise. ``turns`` are those of the
    integrated columns of quiet pieces, ``counters`` what counters leave open, ``extra_end`` (X,)
    what the layout's extra columns have come to in the last row.
    """

    event_id: str
    kind: str
    layout: Layout
    duration_s: float
    rows: int
    gram: Array
    projection: Array
    mode_gram: Array
    cuts: Array  # (S,) of every cut column at the end: pairs, or their like in variance
    counter_interval_s: float  # usual time between two readings of the counters, 0 without
    turns: TurnStatistics
    counters: CounterStatistics
    steps: ChannelSteps
    noise: ChannelNoise
    shown: ShownWheels
    extra_end: Array

    def seen_by(self, sampling: Sampling) -> Sampling:
        """A sampling with what the event says of its pulses and of the noise of its channels."""
        return self.noise.seen_by(self.counters.seen_by(sampling))
