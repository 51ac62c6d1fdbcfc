"""Cells of a telemetry file as numbers, before anything is checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.errors import InputError


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
        shown = "an empty cell" if np.isnan(value) else f"{value:.10g}"
        return InputError(self.where(row, column), expected, got or shown, fix)

    def without(self, drop: NDArray[np.bool_]) -> Block:
        """The same without some rows."""
        keep = ~drop
        return Block(self.file, self.header, self.unit, self.lines[keep], self.cells[:, keep])
