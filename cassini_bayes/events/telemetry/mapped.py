"""A table of foreign columns as one of ours: the same rows, renamed and converted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array, Flags
from cassini_bayes.events.telemetry.block import Block, Selection
from cassini_bayes.events.telemetry.channel_map import Column
from cassini_bayes.events.telemetry.mends import Mends
from cassini_bayes.events.telemetry.table import ForeignTable

MOST_CELLS: Final = 1 << 24
"""Of a block, read or not: some 130 MB, however many columns a file has."""


class MappedTable:
    """An open table whose columns are made from those of another."""

    def __init__(self, table: ForeignTable, columns: Sequence[Column]) -> None:
        self._table, self._columns = table, tuple(columns)
        self.header = tuple(column.name for column in columns)
        self.header_place = table.header_place
        self.unit = table.unit

    def blocks(self, rows: int, mends: Mends) -> Iterator[Block]:
        """Yield the rows in file order, at most ``rows`` at a time."""
        foreign = self._table.header
        read = {column.place for column in self._columns}
        asked = Selection(
            {c.place: c.dates for c in self._columns if c.dates is not None},
            frozenset(range(len(foreign))) - read,
        )
        names = tuple(
            name if name == foreign[c.place] else f"{name} (from {foreign[c.place]!r})"
            for name, c in zip(self.header, self._columns, strict=True)
        )
        most = max(1, min(rows, MOST_CELLS // len(foreign)))
        counts = np.zeros(len(self._columns))
        before = np.full(len(foreign), np.nan)  # the row before the block
        for block in self._table.blocks(most, mends, asked):
            cells = np.empty((len(self._columns), block.rows))
            again = _repeated(block, before, read)
            before = block.cells[:, -1].copy()
            for i, column in enumerate(self._columns):
                values = block.cells[column.place]
                if column.per_interval:
                    values = self._counted(block, column, values, again, counts, i)
                cells[i] = column.line.of(values)
            made = Block(block.file, names, block.unit, block.lines, cells)
            made.check_finite("check scale, offset and unit")
            yield made

    def _counted(
        self, block: Block, column: Column, values: Array, again: Flags, counts: Array, i: int
    ) -> Array:
        """What had been counted up to each row, in the file's unit; kept for the next block."""
        if column.grows:
            expected, fix = "0 or more in each interval", "check kind and column"
            block.check(values < 0.0, column.place, expected, fix)
        sampled = ~np.isnan(values)
        # a row that repeats the one before it counts nothing anew: it is dropped as a repetition
        summed = counts[i] + np.cumsum(np.where(sampled & ~again, values, 0.0))
        counts[i] = summed[-1] if summed.size else counts[i]
        return np.where(sampled, summed, np.nan)


def _repeated(block: Block, before: Array, places: Iterable[int]) -> Flags:
    """Rows whose cells at some places are those of the row before; ``before`` is of the first."""
    same = np.ones(block.rows, dtype=np.bool_)
    for place in places:
        now = block.cells[place]
        last = np.concatenate([before[[place]], now[:-1]])
        same &= (now == last) | (np.isnan(now) & np.isnan(last))
    return same
