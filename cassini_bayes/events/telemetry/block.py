"""Cells of a telemetry file as numbers, before anything is checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.errors import InputError

TextReader = Callable[[str, str], float]
"""A number from a cell's text, and where the cell stands for the refusal of one that is none."""


@dataclass(frozen=True)
class Selection:
    """What to make of a file's columns, by their places: numbers, but for these.

    ``texts`` are columns of text and their readers; ``unread`` columns are not checked, and
    their cells are NaN.
    """

    texts: Mapping[int, TextReader] = field(default_factory=dict)
    unread: frozenset[int] = frozenset()


EVERYTHING: Final = Selection()


def no_numbers(where: str, expected: str, dates: bool, kind: object, fix: str) -> InputError:
    """The error to raise about a column of another kind than numbers: of dates or text, or not."""
    got, with_map = "other things", 'map the column with time_system = "iso8601"'
    if dates:
        got, fix = "dates or text", with_map
    return InputError(where, expected, f"{got} ({kind})", fix)


@dataclass(frozen=True, eq=False)
class Block:
    """Some rows of a file: ``cells`` (columns, n), NaN where empty, and where each row stands.

    ``lines`` (n,) counts lines of a CSV with the header as 1, rows of a Parquet file from 1;
    ``unit`` is the word for it.
    """

    file: str
    header: tuple[str, ...]
    unit: str
    lines: NDArray[np.int64]
    cells: NDArray[np.float64]

    @property
    def rows(self) -> int:
        """Number of rows n."""
        return int(self.lines.size)

    def where(self, row: int, column: int) -> str:
        """File, line and column of a cell, for messages."""
        return f"{self.file}: {self.unit} {self.lines[row]}, column {self.header[column]}"

    def refuse(
        self, row: int, column: int, expected: str, fix: str, got: str | None = None
    ) -> InputError:
        """The error to raise about a cell; ``got`` replaces what the cell holds."""
        value = self.cells[column, row]
        shown = "an empty cell or NaN" if np.isnan(value) else f"{value:.10g}"
        return InputError(self.where(row, column), expected, got or shown, fix)

    def check(self, wrong: NDArray[np.bool_], column: int, expected: str, fix: str) -> None:
        """Refuse a column's cell of the first row that is ``wrong``, if one is."""
        rows = np.flatnonzero(wrong)
        if rows.size:
            raise self.refuse(int(rows[0]), column, expected, fix)

    def check_finite(self, fix: str) -> None:
        """Refuse infinite cells."""
        for column, row in np.argwhere(np.isinf(self.cells)).tolist():
            raise self.refuse(row, column, "a finite number", fix)

    def without(self, drop: NDArray[np.bool_]) -> Block:
        """The same without some rows."""
        keep = ~drop
        return Block(self.file, self.header, self.unit, self.lines[keep], self.cells[:, keep])
