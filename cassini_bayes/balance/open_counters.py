"""What counters leave open, as steps and levels in time: which tails were cut, what was rounded.

Pairs of pulses that may be close are steps s_i H_i(t) of variance s (1 − s) m_i, s the share of
close pairs and m_i how many an interval has. The columns of cut tails take up the mean of a part of
the event, c_j = Σ m_i H_i / Σ m_i; s_i (H_i − c_j) stays. The rounding of a counter is one
independent level between two firings (docs/topics/telemetry-likelihood.md §7).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cassini_bayes.balance.statistics.columns import CUT_PARTS, quarter_of
from cassini_bayes.balance.statistics.reduction import CounterStatistics
from cassini_bayes.computing.arrays import Array


def cut_patterns(counters: CounterStatistics, couple: int, duration_s: float, step: Array) -> Array:
    """Patterns (n, s) of single cut tails, each of variance s (1 − s).

    ``step`` (n, R) is what a unit step at the end of every interval with firings leaves in n rows.
    """
    part, pairs = quarter_of(counters.end_s, duration_s), counters.weight[:, couple]
    found = [step[:, :0]]
    for j in range(CUT_PARTS):
        own = np.flatnonzero((part == j) & (pairs > 0.0))
        if len(own) > 0:
            mean = step[:, own] @ pairs[own] / pairs[own].sum()
            found.append((step[:, own] - mean[:, None]) * np.sqrt(pairs[own]))
    return np.concatenate(found, axis=1)


def level_patterns(counters: CounterStatistics, couple: int, step: Array, always: Array) -> Array:
    """Patterns (n, s), in s of on-time and of variance 1, of a couple's rounded counters.

    ``always`` (n, 1) is what a constant leaves in the rows.
    """
    ends = np.concatenate([always, step[:, counters.fired[:, couple]]], axis=1)
    return np.asarray(-np.diff(ends, axis=1, append=0.0) * np.sqrt(counters.open_s2[couple]))


def patterns_at(
    counters: CounterStatistics, duration_s: float, time_s: Array
) -> Iterator[tuple[Array, Array]]:
    """Cut tails and levels of every couple in rows at times (n,), each (n, s)."""
    step = (time_s[:, None] >= counters.end_s).astype(np.float64)
    for couple in range(counters.weight.shape[1]):
        levels = level_patterns(counters, couple, step, np.ones((len(time_s), 1)))
        yield (
            cut_patterns(counters, couple, duration_s, step),
            levels[:, levels.any(axis=0)],
        )
