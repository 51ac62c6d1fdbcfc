"""What counters leave open of an event: intervals with firings, long roundings, late pulses."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Final

import numpy as np

from cassini_bayes.balance.statistics.event_statistics import COARSE_STEP_S, CounterStatistics
from cassini_bayes.balance.statistics.first_look import Preparation
from cassini_bayes.balance.statistics.layout import Layout
from cassini_bayes.balance.statistics.long_levels import (
    NO_LEVELS,
    Levels,
    LongLevels,
    longest,
)
from cassini_bayes.balance.statistics.pairs import Counted, Pairs, pairs_of, quarter_of
from cassini_bayes.balance.statistics.rounded_counters import KNOWN, Rounding
from cassini_bayes.balance.statistics.rows import SAME_S
from cassini_bayes.balance.statistics.sampling import Sampling
from cassini_bayes.balance.statistics.thinned import Thinned
from cassini_bayes.computing.arrays import Array

MOST_STEPS: Final = 384  # intervals with firings of a couple that are told apart
STEPS_BY_ROW: Final = 4  # at most: where rows are means over blocks more of them tell nothing


def long_levels_of(prepared: Preparation, layout: Layout, sampling: Sampling) -> LongLevels:
    """Roundings that are unknowns, of counters in coarse steps, from a first look at them."""
    coarse = any(one.step_s > COARSE_STEP_S for one in prepared.rounding)
    if not coarse or sampling.block_s > 0.0 or len(prepared.on_time_s) == 0:
        return NO_LEVELS
    counted = Counted(prepared.read_s, prepared.on_time_s, prepared.pulses, -np.inf)
    pairs, _ = pairs_of(counted, layout, sampling)
    return longest(_levels(pairs, prepared, layout), sampling.duration_s)


def _levels(pairs: Pairs, prepared: Preparation, layout: Layout) -> Levels:
    """What a first look says of the levels between some intervals with firings."""
    by_couple = _by_couple(prepared.rounding, layout)
    return Levels(
        pairs.end_s,
        pairs.fired,
        pairs.slopes,
        np.array([one.variance_s2 for one in by_couple]),
        _open_ratios(by_couple, prepared.read_s, pairs.end_s),
        np.array([one.every for one in by_couple]),
    )


def counter_statistics(
    pairs: Pairs,
    times: Thinned,
    sampling: Sampling,
    prepared: Preparation,
    layout: Layout,
    averaged: float,
) -> CounterStatistics:
    """Intervals with firings, neighbours joined where there are very many."""
    late, levels = prepared.late, _levels(pairs, prepared, layout)
    steps = pairs.steps(sampling.pair_s2)
    rows = max(len(times.values) * times.stride, 1)
    most = min(MOST_STEPS, STEPS_BY_ROW * rows)
    whole = frozenset(sampling.levels.couples)
    pairs, steps, levels = _joined(pairs, steps, levels, sampling.duration_s, most, whole)
    return CounterStatistics(
        times.values,
        times.stride,
        pairs.end_s,
        pairs.fired,
        pairs.square,
        pairs.unlike,
        steps,
        pairs.slopes,
        levels.open_s2,
        levels.open_ratio,
        levels.open_every,
        np.array(sampling.gaps_s),
        np.array(sampling.paired_s),
        np.array(sampling.widths_s),
        sampling.unsure_s,
        sampling.block_s,
        sampling.block_rows,
        averaged,
        late.width_s,
        np.array([max((late.rate_hz[k] for k in own), default=0.0) for own in layout.couples])
        if late.rate_hz
        else np.zeros(len(layout.couples)),
        late.first_s,
        late.every_s,
        max((one.step_s for one in _by_couple(prepared.rounding, layout)), default=0.0),
        sampling.levels.couple,
        sampling.levels.begin_s,
        sampling.levels.end_s,
        sampling.levels.value_s,
    )


def _joined(
    pairs: Pairs,
    steps: Array,
    levels: Levels,
    duration_s: float,
    most: int,
    whole: Container[int] = (),
) -> tuple[Pairs, Array, Levels]:
    """Intervals with their steps (m, G) and levels, a couple's neighbours joined beyond so many.

    What joined ones have together is in the first of them: each couple has its own, as a level in a
    wrong place shows. None is joined over a quarter's end, as a column of cut tails stands for what
    is in its own quarter. Couples that are to stay ``whole`` keep theirs. A level of k that are
    joined is the mean of k roundings that each last a k-th of its time: σ²/k.
    """
    quarter = quarter_of(pairs.end_s, duration_s)
    fired, steps, ratio = pairs.fired.copy(), steps.copy(), levels.open_ratio.copy()
    open_s2, open_every = levels.open_s2.copy(), levels.open_every.copy()
    square, unlike, slopes = pairs.square.copy(), pairs.unlike.copy(), pairs.slopes.copy()
    for g in range(fired.shape[1]):
        own = np.flatnonzero(fired[:, g] | (steps[:, g] > 0.0))
        every = -(-len(own) // most)
        if every < 2 or g in whole:
            continue
        number = np.arange(len(own)) - np.searchsorted(quarter[own], quarter[own])
        starts = np.flatnonzero(number % every == 0)
        first, firings = own[starts], np.add.reduceat(fired[own, g].astype(np.float64), starts)
        for each in (square, unlike, steps, ratio, slopes):
            together = np.add.reduceat(each[own, g], starts, axis=0)
            each[own, g] = 0.0
            each[first, g] = together
        slopes[first, g] /= np.maximum(firings, 1.0)[:, None]
        readings = max(every / open_every[g], 1.0)  # that are used, of each level
        ratio[first, g] *= readings
        open_s2[g] /= readings
        open_every[g] = -(-open_every[g] // every)
        fired[own, g] = False
        fired[first, g] = firings > 0.0
    kept = np.flatnonzero(fired.any(axis=1) | (steps > 0.0).any(axis=1))
    end_s, fired = pairs.end_s[kept], fired[kept]
    joined = Pairs(end_s, fired, square[kept], unlike[kept], slopes[kept])
    of_joined = Levels(end_s, fired, slopes[kept], open_s2, ratio[kept], open_every)
    return joined, steps[kept], of_joined


def _open_ratios(by_couple: Sequence[Rounding], read_s: Array, end_s: Array) -> Array:
    """Of every couple's :class:`Rounding`, at the ends (R,) of intervals with firings, (R, G)."""
    result = np.full((len(end_s), len(by_couple)), np.inf)
    place = np.searchsorted(read_s[1:], end_s - SAME_S)
    for g, one in enumerate(by_couple):
        if len(one.ratio) > 0:
            result[:, g] = one.ratio[place]
    return result


def _by_couple(rounding: Sequence[Rounding], layout: Layout) -> list[Rounding]:
    """What stays open of every couple's counters, from those of its thrusters."""
    by_thruster = rounding or (KNOWN,) * len(layout.thrusters)
    return [
        max((by_thruster[k] for k in own), key=lambda one: one.variance_s2)
        for own in layout.couples
    ]
