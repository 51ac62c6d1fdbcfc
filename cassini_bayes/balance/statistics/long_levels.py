"""Roundings of counters that last long between two firings: unknowns of their own.

What a rounded counter leaves open is one independent level between two firings
(docs/topics/telemetry-likelihood.md §7). As noise of a band each of its modes is a draw of its own.
That is right for many short levels. One that lasts for a minute is a single number, and as noise it
would hide what many slow modes tell: of three biases with counters of 10 ms, all but a twentieth of
what they say of a steady torque. So the longest levels are columns, each with an unknown of its
own, and the bands have those that are left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded

from cassini_bayes.balance.statistics.rounded_counters import read_levels
from cassini_bayes.balance.statistics.rows import SAME_S
from cassini_bayes.computing.arrays import Array, Flags, Places

MOST: Final = 40  # in an event: a call of the likelihood takes twice as long
LONG: Final = 1.5  # times the usual root of what a level leaves, squared and summed over time
LEAST_RATIO: Final = 1e-6  # of widths all alike: what stays open is one constant


@dataclass(frozen=True, eq=False)
class Levels:
    """What counters leave open between firings.

    ``end_s`` (R,) are the ends of the intervals with firings, ``fired`` (R, G) tells which couples
    fired in them, ``slopes`` (R, G, C) what pulse columns gain per on-time. ``open_s2`` (G,) are σ²
    of :class:`.Rounding`, ``open_ratio`` (R, G) its Q, and about every ``open_every``-th (G,) level
    is read.
    """

    end_s: Array
    fired: Flags
    slopes: Array
    open_s2: Array
    open_ratio: Array
    open_every: Array


@dataclass(frozen=True, eq=False)
class LongLevels:
    """The longest levels of an event, as functions of time.

    ``couple`` (L,) is whose they are, ``begin_s`` (L,) when the firing ended that each follows, −∞
    for what was there before the first. ``value_s`` (R + 1, L) are they between the ends ``end_s``
    (R,) of all firings, s of on-time per unit of an unknown of variance 1.
    """

    couple: Places
    begin_s: Array
    end_s: Array
    value_s: Array

    @property
    def couples(self) -> tuple[int, ...]:
        """The couple of each."""
        return tuple(int(g) for g in self.couple)

    def at(self, time_s: Array) -> Array:
        """Their values (n, L) at times (n,)."""
        return self.value_s[np.searchsorted(self.end_s, time_s + SAME_S, side="right")]


NO_LEVELS: Final = LongLevels(
    np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros(0), np.zeros((1, 0))
)


def level_patterns(levels: Levels, couple: int, step: Array, always: Array) -> Array:
    """Patterns (n, C, s), in s of pulse columns and of variance 1, of a couple's rounded counters.

    Levels between two firings have the precision (1 + Dᵀ Q⁻¹ D)/σ² = Uᵀ U/σ² of
    :class:`.rounded_counters.Rounding`, and the patterns are B U⁻¹, B what
    a level leaves in the rows: its error is in the firing before it and, less, in the one after it,
    by what columns gain per on-time. ``step`` (n, R) is what a unit step at the end of every
    interval with firings leaves in n rows, ``always`` (n, 1) what a constant does.
    """
    own = levels.fired[:, couple]
    slopes = levels.slopes[own, couple]
    size = slopes.shape[1]
    first = always[:, None] * np.eye(size, 1)
    ends = np.concatenate([first, step[:, None, own] * slopes.T], axis=2)
    each = -np.diff(ends, axis=2, append=0.0) * np.sqrt(levels.open_s2[couple])
    bound = 1.0 / np.maximum(levels.open_ratio[own, couple], LEAST_RATIO)
    if not bound.any() or not each.any():
        return np.asarray(each)
    diagonal = np.r_[bound, 0.0] + np.r_[0.0, bound]
    diagonal[read_levels(len(diagonal), levels.open_every[couple])] += 1.0
    factor = cholesky_banded(np.stack([np.r_[0.0, -bound], diagonal]))
    lower = np.stack([factor[1], np.roll(factor[0], -1)])  # of U', by columns
    flat = each.reshape(-1, len(diagonal))
    return np.asarray(solve_banded((1, 0), lower, flat.T).T).reshape(each.shape)


def longest(levels: Levels, duration_s: float) -> LongLevels:
    """Those of all couples that leave most in an event of so many seconds.

    A couple that never fires has none: what its counter shows is a constant, and brings nothing.
    """
    ends, couples = levels.end_s, levels.fired.shape[1]
    step = np.tri(len(ends) + 1, len(ends), -1)  # in what lies between the firings
    length = np.diff(np.r_[0.0, np.clip(ends, 0.0, duration_s), duration_s])[:, None]
    found = [
        level_patterns(levels, g, step, np.ones((len(step), 1)))[:, 0] * levels.fired[:, g].any()
        for g in range(couples)
    ]
    size = [np.sqrt((length * own**2).sum(axis=0)) for own in found]
    every = np.concatenate(size) if size else np.zeros(0)
    if not every.any():
        return NO_LEVELS
    least = max(LONG * float(np.median(every[every > 0.0])), np.sort(every)[-MOST:][0])
    chosen = [np.flatnonzero(own >= least) for own in size]
    begins = [np.r_[-np.inf, ends[levels.fired[:, g]]][own] for g, own in enumerate(chosen)]
    return LongLevels(
        np.repeat(np.arange(couples), [len(own) for own in chosen]),
        np.concatenate(begins),
        ends,
        np.concatenate([own[:, c] for own, c in zip(found, chosen, strict=True)], axis=1),
    )


def places_of(begin_s: Array, end_s: Array) -> Places:
    """Which of a couple's levels, the first of which is before its first firing, begin then.

    ``begin_s`` (l,) as of :class:`LongLevels`, ``end_s`` (F,) the ends of the couple's firings.
    """
    return np.searchsorted(end_s, begin_s + SAME_S, side="right")
