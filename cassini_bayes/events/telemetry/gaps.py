"""Rows that are missing among those of counts per interval: their counts are lost with them."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.telemetry.block import Block
from cassini_bayes.events.telemetry.channel_map import COUNTERS, ChannelMap
from cassini_bayes.events.telemetry.columns import Layout

LONGER: Final = 1.5  # times the usual step: a row is missing
AROUND: Final = 5
"""Steps on either side of one whose medians say what is usual there."""


def gaps_of(layout: Layout, channel_map: ChannelMap | None) -> tuple[Gaps, ...]:
    """One for every channel that a map counts anew in every row."""
    if channel_map is None:
        return ()
    return tuple(
        Gaps(layout.channels["time"][0], layout.channels[channel][0])
        for channel in COUNTERS
        if channel_map.is_per_interval(channel, layout.names(channel)) and layout.channels[channel]
    )


class Gaps:
    """The last rows of a channel, and the steps between them that wait for those that follow."""

    def __init__(self, time: int, column: int) -> None:
        self._places = [time, column]
        self._last: Block | None = None  # time and column of the last rows that were sampled

    def check(self, block: Block) -> None:
        """Refuse a step that is longer than those around it, once enough have followed it."""
        cells = block.cells[self._places]
        sampled = ~np.isnan(cells[1])
        lines, cells = block.lines[sampled], cells[:, sampled]
        first = 0
        if self._last is not None:
            first = max(self._last.rows - 1 - AROUND, 0)
            lines = np.concatenate([self._last.lines, lines])
            cells = np.concatenate([self._last.cells, cells], axis=1)
        names = tuple(block.header[i] for i in self._places)
        rows = Block(block.file, names, block.unit, lines, cells)
        _check_steps(rows, first, rows.rows - 1 - AROUND)
        # steps wait for AROUND others that follow, and are compared with as many before them
        kept = slice(max(rows.rows - 1 - 2 * AROUND, 0), None)
        self._last = Block(block.file, names, block.unit, lines[kept], cells[:, kept])

    def finish(self) -> None:
        """Look at the steps that end the file."""
        if self._last is not None:
            _check_steps(self._last, max(self._last.rows - 1 - AROUND, 0), self._last.rows - 1)


def _check_steps(rows: Block, first: int, end: int) -> None:
    """Refuse the first of some steps that is longer than those before and those after it.

    One that is like those on either side begins or ends another rate of samples.
    """
    time = rows.cells[0]
    step_s = np.diff(time)
    if end <= first or step_s.max() <= LONGER * step_s.min():
        return
    # of up to AROUND steps from each place on, NaN where there are none
    medians = _medians(np.pad(step_s, AROUND, constant_values=np.nan))
    usual = np.fmax(medians[: step_s.size], medians[AROUND + 1 :])
    for i in (first + np.flatnonzero(step_s[first:end] > LONGER * usual[first:end])).tolist():
        raise rows.refuse(
            i + 1,
            1,
            f"a row every {usual[i]:.6g} s, as counts per interval are lost with their rows",
            "fill in the rows that are missing (an empty cell is none), give cumulative counts, or"
            " split the event there",
            f"none from {time[i]:.10g} s to {time[i + 1]:.10g} s",
        )


def _medians(values: Array) -> Array:
    """Of AROUND values from each place on that are not NaN, the higher of two middle ones."""
    ordered = np.sort(np.lib.stride_tricks.sliding_window_view(values, AROUND), axis=1)
    middle = np.count_nonzero(~np.isnan(ordered), axis=1) // 2  # NaN are sorted to the end
    return np.asarray(ordered[np.arange(middle.size), middle])
