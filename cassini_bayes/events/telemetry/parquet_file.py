"""A telemetry Parquet file as a stream of blocks. Needs the extra ``parquet`` (pyarrow)."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any, Final

import numpy as np

from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.block import EVERYTHING, Block, Selection, no_numbers
from cassini_bayes.events.telemetry.clocks import seconds_of
from cassini_bayes.events.telemetry.mends import Mends
from cassini_bayes.files.reading import open_file

# what pyarrow raises about bytes that are no Parquet: its own errors derive from these
_DAMAGE: Final = (OSError, ValueError, NotImplementedError, TypeError, KeyError, MemoryError)
_NUMBERS: Final = ("double", "float", "halffloat", "int", "uint", "null")
_DATES: Final = ("timestamp", "date", "string", "large_string")


class ParquetTable:
    """An open Parquet file with one column per telemetry column."""

    unit: Final = "row"

    def __init__(self, path: Path, file: Any) -> None:
        self._path = path
        self._file = file
        self.refused: dict[str, str] = {}
        self.header = tuple(str(name) for name in file.schema_arrow.names)
        self.header_place = f"{path}: columns"

    def first_row(self) -> dict[str, str]:
        """The first value of every column, as text; empty without a row."""
        for batch in self._batches(1, list(range(len(self.header)))):
            values = (column[0].as_py() for column in batch.columns)
            shown = (v.isoformat() if isinstance(v, date) else str(v) for v in values)
            return dict(zip(batch.schema.names, shown, strict=True))
        return {}

    def blocks(self, rows: int, mends: Mends, selection: Selection = EVERYTHING) -> Iterator[Block]:
        """Yield the rows in file order, at most ``rows`` at a time."""
        self._check_types(selection)
        first = 1
        read = [i for i in range(len(self.header)) if i not in selection.unread]
        for batch in self._batches(rows, read):
            cells = np.full((len(self.header), batch.num_rows), np.nan)
            for name, column in zip(batch.schema.names, batch.columns, strict=True):
                i = self.header.index(name)
                if i in selection.texts:
                    where = f"{self._path}: column {name}, rows from {first}"
                    dates = column.to_numpy(zero_copy_only=False)
                    cells[i] = seconds_of(dates, selection.texts[i], where)
                    continue
                cells[i] = column.cast("float64", safe=False).to_numpy(zero_copy_only=False)
                self._note_nans(i, cells[i], column.null_count, first, mends)
            lines = np.arange(first, first + batch.num_rows, dtype=np.int64)
            block = Block(str(self._path), self.header, "row", lines, cells)
            block.check_finite("leave it null where not sampled")
            first += batch.num_rows
            if batch.num_rows:
                yield block

    def _batches(self, rows: int, columns: list[int]) -> Iterator[Any]:
        names = [self.header[i] for i in columns]
        try:
            yield from self._file.iter_batches(batch_size=rows, columns=names)
        except _DAMAGE as error:
            raise _refusal(self._path, error) from None

    def _check_types(self, selection: Selection) -> None:
        for i, kind in enumerate(map(str, self._file.schema_arrow.types)):
            if i in selection.unread or i in selection.texts or kind.startswith(_NUMBERS):
                continue
            where = f"{self._path}: column {self.header[i]}"
            expected = "numbers (double, float or int)"
            fix = "store the column as double, null where it was not sampled"
            raise no_numbers(where, expected, kind.startswith(_DATES), kind, fix)

    def _note_nans(
        self, column: int, values: np.ndarray[Any, Any], nulls: int, first: int, mends: Mends
    ) -> None:
        empty = np.flatnonzero(np.isnan(values))
        if empty.size > nulls:
            lines, count = first + empty, int(empty.size) - nulls
            mends.add("nan", self.header[column], lines, "NaN was taken as not sampled", count)


def open_parquet(path: Path) -> ParquetTable:
    """Open a Parquet file.

    Raises
    ------
    InputError
        pyarrow is not installed, or the file cannot be read or is no Parquet file.
    """
    with open_file(path, "a Parquet file"):
        pass  # a regular file: the library opens it by name
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            str(path),
            "the library pyarrow, to read Parquet",
            "an environment without it",
            'install cassini-bayes[parquet] (pip install -e ".[parquet]" in the repository), or'
            " store the telemetry as telemetry.csv",
        ) from None
    try:
        return ParquetTable(path, pyarrow.parquet.ParquetFile(path))
    except _DAMAGE as error:
        raise _refusal(path, error) from None


def _refusal(path: Path, error: Exception) -> InputError:
    reason = str(error).partition("\n")[0] or type(error).__name__
    return InputError(
        str(path), "a Parquet file", reason, "write the file again, or use telemetry.csv"
    )
