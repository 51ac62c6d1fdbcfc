"""What counters leave open, as steps and levels in time: which tails were cut, what was rounded.

Pairs of pulses that may be close are steps of a variance each at the end of a counter interval, and
so are firings of pulses of unlike widths. The columns of cut tails take up the mean of a part of
the event, c_j = Σ a_i H_i / Σ a_i, with H_i unit steps and a_i nominal variances; what stays are
steps times H_i − c_j. The rounding of a counter is one
independent level between two firings (docs/topics/telemetry-likelihood.md §7); those that last
longest are unknowns of the event (:mod:`.statistics.long_levels`), the others are here.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from cassini_bayes.balance.statistics.event_statistics import CounterStatistics
from cassini_bayes.balance.statistics.layout import CUT_PARTS
from cassini_bayes.balance.statistics.long_levels import level_patterns, places_of
from cassini_bayes.balance.statistics.pairs import quarter_of
from cassini_bayes.balance.statistics.sampling import LostTails
from cassini_bayes.computing.arrays import Array, Places


def step_patterns(
    counters: CounterStatistics, couple: int, duration_s: float, step: Array
) -> tuple[Array, Places]:
    """Patterns (n, s) of single steps of a couple, each less its quarter's mean; intervals (s,).

    ``step`` (n, R) is what a unit step at the end of every interval with firings leaves in n rows.
    """
    part, size = quarter_of(counters.end_s, duration_s), counters.steps[:, couple]
    patterns, intervals = [step[:, :0]], [np.zeros(0, dtype=np.int64)]
    for j in range(CUT_PARTS):
        own = np.flatnonzero((part == j) & (size > 0.0))
        if len(own) > 0:
            mean = step[:, own] @ size[own] / size[own].sum()
            patterns.append(step[:, own] - mean[:, None])
            intervals.append(own)
    return np.concatenate(patterns, axis=1), np.concatenate(intervals)


class OpenScales(NamedTuple):
    """What makes momentum of these patterns, at n points."""

    torque_n_m: Array  # (n, 3, G) of every couple
    lost: LostTails  # by a pair that may be close
    # (n, C) of the pulse columns, times the root of the factor on what is left open of them
    pulse_weights: Array

    def variance_s2(self, pairs: Array, columns: Array) -> Array:
        """Variances (n, …) of so many ``pairs`` (…), and of columns that scatter (…, C, C)."""
        of_pairs = np.multiply.outer(self.lost.variance_s2, pairs)
        if not columns.any():
            return np.asarray(of_pairs)
        by_column = np.tensordot(self.pulse_weights, columns, (1, columns.ndim - 2))
        weights = self.pulse_weights.reshape(len(of_pairs), *[1] * pairs.ndim, -1)
        # thinned rows, and rounding where all widths deliver alike, leave some below nothing
        return np.asarray(of_pairs + np.maximum((by_column * weights).sum(axis=-1), 0.0))


def step_variances(counters: CounterStatistics, couple: int, scales: OpenScales) -> Array:
    """Variances (n, R), s², of a couple's steps at the ends of all intervals, at n points."""
    return scales.variance_s2(counters.square[:, couple], counters.unlike[:, couple])


def short_levels(counters: CounterStatistics, couple: int, step: Array, always: Array) -> Array:
    """Patterns of a couple's rounded counters but the long ones, which are unknowns; as above.

    Arguments and result as of :func:`.long_levels.level_patterns`.
    """
    patterns = level_patterns(counters.levels, couple, step, always)
    own = counters.level_couple == couple
    ends = counters.end_s[counters.fired[:, couple]]
    patterns[:, :, places_of(counters.level_begin_s[own], ends)] = 0.0
    return patterns


def patterns_at(
    counters: CounterStatistics, duration_s: float, time_s: Array
) -> Iterator[tuple[Array, Places, Array]]:
    """Steps (n, s) of every couple with their intervals (s,), and levels (n, C, l), at n times."""
    step = (time_s[:, None] >= counters.end_s).astype(np.float64)
    for couple in range(counters.square.shape[1]):
        levels = short_levels(counters, couple, step, np.ones((len(time_s), 1)))
        patterns, intervals = step_patterns(counters, couple, duration_s, step)
        yield patterns, intervals, levels[..., levels.any(axis=(0, 1))]
