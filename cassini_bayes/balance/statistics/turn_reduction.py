"""Inner products of quiet pieces, gathered from rows that come in stretches."""

from __future__ import annotations

import numpy as np

from cassini_bayes.balance.statistics.columns import Rows
from cassini_bayes.balance.statistics.event_statistics import TurnStatistics
from cassini_bayes.balance.statistics.inner_products import Inner, by_axes, mixed_by_axes
from cassini_bayes.balance.statistics.layout import Layout
from cassini_bayes.balance.statistics.sampling import Sampling
from cassini_bayes.balance.statistics.thinned import Thinned
from cassini_bayes.balance.statistics.turns import (
    LEAST_PIECE,
    SLOPE_WAVES,
    SWING_GROUPS,
    piece_breaks,
    piece_ends,
    turned,
)
from cassini_bayes.computing.arrays import joined


class GatheredTurns:
    """Gathers the inner products of quiet pieces from rows that come in stretches."""

    def __init__(self, layout: Layout, sampling: Sampling) -> None:
        size, waves = 3 * len(layout.vector) + len(layout.scalar), SLOPE_WAVES + 1
        self._layout, self._sampling = layout, sampling
        self._waiting: list[Rows] = []
        self._before = 0  # rows of the piece before, by which a corner at the first row shows
        self._places = Thinned()  # (p, …) times, cosines, noise and walk, lines of wheel rates
        self._pieces, self._contrasts = 0, np.zeros(SWING_GROUPS, dtype=np.int64)
        self._slopes = Inner(
            np.zeros((size, size)), np.zeros((waves, size)), np.zeros((waves, waves))
        )
        self._swings = np.zeros((SWING_GROUPS, size, size))
        self._squares = np.zeros((SWING_GROUPS, 2))

    def add(self, rows: Rows) -> None:
        """Take more rows; those of a piece that may go on wait."""
        rows = joined([*self._waiting, rows])
        self._waiting = [rows]
        if len(rows.time_s) > LEAST_PIECE:
            self._work_up(is_last=False)

    def _work_up(self, *, is_last: bool) -> None:
        """Gather the pieces that are over."""
        if not self._waiting or len(self._waiting[0].time_s) < LEAST_PIECE:
            return
        (rows,), first = self._waiting, self._before
        breaks = piece_breaks(rows, self._layout, self._sampling)
        ends = [first + end for end in piece_ends(rows.time_s[first:], breaks[first:])]
        if not is_last:
            ends = ends[:-1]
        found = turned(rows, self._layout, ends, self._sampling)
        slopes, waves = found.slopes, found.waves
        self._slopes.gather(Inner(slopes.T @ slopes, waves.T @ slopes, waves.T @ waves))
        times, squares = found.time_s[:, None], np.stack([found.summed_s2, found.beyond_s3], axis=1)
        self._places.add(np.concatenate([times, waves, squares, found.shown], axis=1))
        self._pieces += len(slopes)
        for own, swings in zip(self._swings, found.swings, strict=True):
            own += swings.T @ swings
        self._contrasts += found.counts
        self._squares += found.squares
        self._before = min(ends[-1], 1)
        self._waiting = [rows.part(slice(ends[-1] - self._before, None))]

    def statistics(self) -> TurnStatistics:
        """All of it, once the last rows have been added."""
        self._work_up(is_last=True)
        summed, walked = (self._squares / np.maximum(self._contrasts, 1)[:, None]).T.copy()
        width = SLOPE_WAVES + 6 + 2 * len(self._layout.wheels)
        places = np.concatenate([np.zeros((0, width)), *self._places.kept])
        return TurnStatistics(
            self._pieces,
            by_axes(self._slopes.columns, self._layout),
            mixed_by_axes(self._slopes.mixed, self._layout),
            self._slopes.modes,
            places[:, 0].copy(),
            places[:, 1 : SLOPE_WAVES + 2].copy(),
            places[:, SLOPE_WAVES + 2].copy(),
            places[:, SLOPE_WAVES + 3].copy(),
            places[:, SLOPE_WAVES + 4 :].copy(),
            self._places.stride,
            self._contrasts,
            by_axes(self._swings, self._layout),
            summed,
            walked,
        )
