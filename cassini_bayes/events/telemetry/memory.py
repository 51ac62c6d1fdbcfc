"""Columns that are in memory, of a data frame or of a file that is read as a whole."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.block import EVERYTHING, Block, Selection, no_numbers
from cassini_bayes.events.telemetry.clocks import seconds_of
from cassini_bayes.events.telemetry.mends import Mends


@dataclass(frozen=True, eq=False)
class MemoryTable:
    """Named columns of one length each, in an open table's manner.

    ``refused`` are columns that hold neither numbers nor dates, and why.
    """

    name: str
    columns: Mapping[str, NDArray[Any]]
    refused: Mapping[str, str] = field(default_factory=dict)
    unit: ClassVar[str] = "row"

    def __str__(self) -> str:
        return self.name

    @property
    def header(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.columns)

    @property
    def header_place(self) -> str:
        """What to call the header in messages."""
        return f"{self.name}: columns"

    @cached_property
    def digest(self) -> str:
        """SHA-256 of names, kinds and values."""
        total = hashlib.sha256()
        for name, values in self.columns.items():
            total.update(f"{name}\0{values.dtype.str}{values.shape}".encode())
            plain = np.array(list(map(str, values))) if values.dtype.hasobject else values
            total.update(np.ascontiguousarray(plain).tobytes())
        return total.hexdigest()

    def blocks(
        self,
        rows: int,
        mends: Mends,  # noqa: ARG002 - NaN is all that memory has for "not sampled"
        selection: Selection = EVERYTHING,
    ) -> Iterator[Block]:
        """Yield the rows in order, at most ``rows`` at a time."""
        read = [i for i in range(len(self.header)) if i not in selection.unread]
        numbers = {i: self._numbers(i, selection) for i in read}
        self._check_lengths(read)
        length = len(numbers[read[0]]) if read else 0
        for first in range(0, length, rows):
            count = min(rows, length - first)
            cells = np.full((len(self.header), count), np.nan)
            for i, values in numbers.items():
                cells[i] = values[first : first + count]
            lines = np.arange(first + 1, first + count + 1, dtype=np.int64)
            block = Block(self.name, self.header, "row", lines, cells)
            block.check_finite("NaN means not sampled")
            yield block

    def _numbers(self, place: int, selection: Selection) -> Array:
        name = self.header[place]
        values, where = self.columns[name], f"{self.name}: column {name}"
        if place in selection.texts:
            return seconds_of(values, selection.texts[place], where)
        if values.dtype.kind not in "fiub":
            _check_cells(values, self.name, name)
            dates = values.dtype.kind in "MU"
            raise no_numbers(where, "numbers", dates, values.dtype, "store it as numbers")
        return np.asarray(values, dtype=np.float64)

    def _check_lengths(self, read: list[int]) -> None:
        names = [self.header[i] for i in read]
        for name in names[1:]:
            if len(self.columns[name]) != len(self.columns[names[0]]):
                raise InputError(
                    f"{self.name}: column {name}",
                    f"{len(self.columns[names[0]]):,} values, as many as {names[0]} has",
                    f"{len(self.columns[name]):,}",
                    "put all on the rows of one time column, NaN where not sampled",
                )


def _check_cells(values: NDArray[Any], table: str, column: str) -> None:
    """Refuse text in a column of objects with its row: one such cell makes a column one of them."""
    texts = (i for i, value in enumerate(values.tolist()) if isinstance(value, str))
    row = next(texts, None) if values.dtype.kind == "O" else None
    if row is not None:
        raise InputError(
            f"{table}: row {row + 1}, column {column}",
            "a number, or NaN where nothing was sampled",
            repr(values[row])[:60],
            "correct it, then store the column as numbers: pandas.to_numeric",
        )
