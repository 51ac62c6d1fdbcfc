"""Pulses of counter intervals: pairs that may be close, what they lose, how unlike ones scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics.counters import firings
from cassini_bayes.balance.statistics.layout import CUT_COLUMNS, CUT_PARTS, Layout
from cassini_bayes.balance.statistics.pulse_columns import PULSE_COLUMNS
from cassini_bayes.balance.statistics.rows import SAME_S
from cassini_bayes.balance.statistics.sampling import ALIKE_S, Sampling
from cassini_bayes.computing.arrays import Array

MOST_APART = 0.5  # of an interval, between the beginnings of close pulses: at most every other one
# Of the chance of two pulses within that time: three have 1.5 times the chance for each pair. With
# a share near 1 more of them lose than there are; the share is then smaller.
MOST_ALIKE = 5.0 / 3.0
MOST_ACROSS = 4.0  # pairs about a reading, of several pulses on either side


@dataclass(frozen=True)
class Pairs:
    """Pairs of pulses that may be close together, by counter interval (m,) and couple (G,).

    Of every pair the tail of the first pulse may have been cut: ``square`` (m, G) counts pairs for
    variances, each by how often it is close against one of two pulses within a second, and by the
    square of what it loses against one of the event's mean widths. ``fired`` (m, G) tells which
    couples fired at all. ``unlike`` (m, G, C, C) are the covariances of what the pulse
    columns gain beyond what is expected (:meth:`.PulseBasis.scatter`), s², and ``slopes``
    (m, G, C) what they gain per on-time (:meth:`.PulseBasis.slopes`).
    """

    end_s: Array
    fired: NDArray[np.bool_]
    square: Array
    unlike: Array
    slopes: Array

    def steps(self, pair_s2: float) -> Array:
        """Variance (m, G) of what intervals gain beyond what is expected, over that of a pair."""
        return np.asarray(self.square + self.unlike[..., 0, 0] / pair_s2)


class Counted:
    """Counter intervals between readings (m,) and (m, K) in which something fired, after a time."""

    def __init__(self, time_s: Array, on_time_s: Array, pulses: Array, after_s: float) -> None:
        self.time_s, self.total_on_time, self.total_pulses = time_s, on_time_s, pulses
        self.on_time = np.diff(self.total_on_time, axis=0)
        self.pulses = np.diff(self.total_pulses, axis=0)
        changed = np.any((self.on_time != 0) | (self.pulses != 0), axis=1)
        self.active = np.flatnonzero(changed & (self.time_s[1:] > after_s))

    def events_before(self, time: Array) -> NDArray[np.intp]:
        """How many of the active intervals have ended by each time."""
        ends = self.time_s[self.active + 1] if len(self.active) else np.empty(0)
        return np.searchsorted(ends, time + SAME_S, side="right")


def close_pairs(length_s: Array, pulses: Array, before: Array, apart_s: Array) -> Array:
    """Pairs (m, G) within each of some counter intervals, and across the reading before it.

    Counters show neither which pairs were a control cycle apart nor what share. The share depends
    on the controller and is inferred (docs/topics/telemetry-likelihood.md §7). The more pulses an
    interval has, the closer they are. Of close pairs that begin a part s of an interval apart the
    share s is about a reading, the others within an interval: of all pairs of pulses that the
    counters allow the chances are as s/2(1 − s) to 1.

    Parameters
    ----------
    length_s
        (m,) of the intervals.
    pulses
        (m, G) that every couple began in them.
    before
        (m, G) that it fired in the intervals before them, one at least where it fired.
    apart_s
        (m, G) between the beginnings of two close pulses.
    """
    alike = np.minimum(1.0, ALIKE_S / length_s)[:, None]
    within = np.minimum(alike * np.maximum(0.5 * pulses, 1.0), MOST_ALIKE)
    apart = np.minimum(apart_s / length_s[:, None], MOST_APART)
    across = np.minimum(pulses * before, MOST_ACROSS) * apart / (2.0 * (1.0 - apart))
    return np.asarray(within * np.maximum(pulses - 1.0, 0.0) + alike * across)


def pairs_of(counted: Counted, layout: Layout, sampling: Sampling) -> tuple[Pairs, Array]:
    """Pairs of the active intervals of a stretch of telemetry, which begins with an idle one.

    Returns also how many there are (m, G), each by what it loses.
    """
    active = counted.active
    groups = [list(couple) for couple in layout.couples]
    pulses = np.zeros((len(counted.pulses), len(groups)))
    fired = np.zeros((len(counted.pulses), len(groups)), dtype=bool)
    for g, members in enumerate(groups):
        pulses[:, g] = counted.pulses[:, members].max(axis=1, initial=0.0)
        on_time = counted.on_time[:, members].max(axis=1, initial=0.0)
        fired[:, g] = (pulses[:, g] > 0.0) | (on_time > 0.0)
    fired_of = np.maximum(pulses, fired)
    before = np.concatenate([np.zeros_like(fired_of[:1]), fired_of[:-1]])
    scatter, slopes, width = (of_all[active] for of_all in _of_firings(counted, layout, sampling))
    apart_s = width + np.mean(sampling.close_gaps_s)
    pairs = close_pairs(np.diff(counted.time_s)[active], pulses[active], before[active], apart_s)
    lose = sampling.cut_by_width(width)
    end_s, own = counted.time_s[active + 1], fired[active]
    return Pairs(end_s, own, pairs * lose**2, scatter, slopes), pairs * lose


def _of_firings(counted: Counted, layout: Layout, sampling: Sampling) -> tuple[Array, Array, Array]:
    """What unlike pulses of a firing scatter (m, G, C, C), where it ends, slopes (m, G, C), widths.

    Widths (m, G), s, are means over the pulses of a firing, 0 without one.
    """
    slopes = np.zeros((len(counted.pulses), len(layout.couples), len(PULSE_COLUMNS)))
    scatter, width = np.zeros((*slopes.shape, len(PULSE_COLUMNS))), np.zeros(slopes.shape[:2])
    for g, members in enumerate(map(list, layout.couples)):
        gained, begun = (
            of_all[:, members].max(axis=1) for of_all in (counted.on_time, counted.pulses)
        )
        own = firings(gained, begun)
        ends = own.active[np.diff(own.number, append=len(own.pulses)) > 0]
        mean = own.seconds / own.pulses
        scatter[ends, g] = sampling.pulses.scatter(mean, own.pulses)
        slopes[own.active, g] = sampling.pulses.slopes(mean, own.pulses)[own.number]
        width[own.active, g] = np.maximum(mean, 0.0)[own.number]
    return scatter, slopes, width


def cut_columns(pairs: Pairs, weight: Array, layout: Layout, sampling: Sampling) -> Array:
    """What every active interval adds to the columns of cut tails, (m, S)."""
    m, part = len(pairs.end_s), quarter_of(pairs.end_s, sampling.duration_s)
    table = np.zeros((m, len(layout.couples), CUT_COLUMNS))
    table[:, :, 0] = weight
    table[np.arange(m), :, 1 + part] = pairs.steps(sampling.pair_s2)
    return table.reshape(m, CUT_COLUMNS * len(layout.couples))


def quarter_of(time_s: Array, duration_s: float) -> NDArray[np.intp]:
    """Part of the event (m,) that times lie in."""
    return np.clip((CUT_PARTS * time_s / duration_s).astype(np.intp), 0, CUT_PARTS - 1)
