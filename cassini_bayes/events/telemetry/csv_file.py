"""A telemetry CSV as a stream of blocks: constant memory, exact line numbers, correct rounding."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.block import EVERYTHING, Block, Selection
from cassini_bayes.events.telemetry.digits import (
    BAD_LENGTH,
    NUMBERS,
    TEXT,
    UNREAD,
    powers_of_ten,
    read_cells,
)
from cassini_bayes.events.telemetry.mends import Mends
from cassini_bayes.files.checks import parse_number

LONGEST_LINE: Final = 1 << 20
BUFFER: Final = 4 << 20
_AHEAD: Final = 8  # bytes that the compiled reader may look beyond the last newline
_ODD: Final = 4096
COMMA: Final = ","
_DELIMITERS: Final = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}


class CsvTable:
    """An open CSV file with a header row."""

    unit: Final = "line"

    def __init__(self, path: Path, stream: BufferedReader, delimiter: str = COMMA) -> None:
        self._path = path
        self._stream = stream
        self._delimiter = delimiter
        self.refused: dict[str, str] = {}
        self._line, self.header = self._read_header()
        self.header_place = f"{path}: line {self._line - 1}"

    def _read_header(self) -> tuple[int, tuple[str, ...]]:
        """Number of the line behind the header, and the names."""
        line, content = 0, b"\n"
        blank = b"\xef\xbb\xbf\r\n " + self._delimiter.encode()
        while content and not content.strip(blank):
            content = self._stream.readline(LONGEST_LINE)
            line += 1
        if not content:
            expected = "a header row and rows below it"
            raise InputError(str(self._path), expected, "an empty file", "fill it in")
        return line + 1, header_of(f"{self._path}: line {line}", content, self._delimiter)

    def blocks(self, rows: int, mends: Mends, selection: Selection = EVERYTHING) -> Iterator[Block]:
        """Yield the rows in file order, ``rows`` at a time."""
        filling = _Filling(
            *(str(self._path), self.header, rows, self._line, mends, selection, self._delimiter)
        )
        store = bytearray(BUFFER + LONGEST_LINE + _AHEAD)
        buffer = np.frombuffer(store, dtype=np.uint8)
        kept, last = 0, False
        while not last:
            count = self._stream.readinto(memoryview(store)[kept : kept + BUFFER])
            end, last = kept + count, count == 0
            if last and kept:
                buffer[end] = 10  # the last line may lack its newline
                end += 1
            stop = store.rfind(b"\n", 0, end) + 1
            yield from filling.take(buffer, stop, last)
            if end - stop >= LONGEST_LINE:
                raise filling.too_long()
            kept = end - stop
            buffer[:kept] = buffer[stop:end].copy()
        yield from filling.rest()


@dataclass(eq=False)
class _Filling:
    """The block that is being filled, and the line that comes next."""

    _file: str
    _header: tuple[str, ...]
    _rows: int
    _line: int
    _mends: Mends
    _selection: Selection
    _delimiter: str

    def __post_init__(self) -> None:
        self._kinds = np.full(len(self._header), NUMBERS, dtype=np.int64)
        self._kinds[list(self._selection.texts)] = TEXT
        self._kinds[list(self._selection.unread)] = UNREAD
        self._powers = powers_of_ten()
        self._odd = np.zeros((_ODD + 2 * len(self._header), 5), dtype=np.int64)
        self._new()

    def _new(self) -> None:
        self._row = 0
        self._cells = np.empty((len(self._header), self._rows))
        self._lines = np.empty(self._rows, dtype=np.int64)

    def take(self, text: NDArray[np.uint8], stop: int, last: bool) -> Iterator[Block]:
        """Read whole lines of the text; yield every block that gets full."""
        place = 0
        nans = np.zeros((len(self._header), 3), dtype=np.int64)
        while place < stop:
            place, self._line, self._row, result = read_cells(
                *(text, place, stop, self._line, self._row),
                *(self._cells, self._lines, nans, self._odd, self._powers),
                *(self._kinds, ord(self._delimiter)),
            )
            entries = self._odd[:result]
            if result and entries[-1, 1] == BAD_LENGTH:  # says more than the cells of that line
                entries = entries[(entries[:, 4] != entries[-1, 4]) | (entries[:, 1] == BAD_LENGTH)]
            for entry in entries.tolist():
                self._settle(text, entry, last and place >= stop)
            if self._row == self._rows:
                yield self._block()
                self._new()
        self._note_nans(nans)

    def rest(self) -> Iterator[Block]:
        """Yield the last block, if it has rows."""
        if self._row:
            yield self._block()

    def too_long(self) -> InputError:
        """The error about a line without an end."""
        return InputError(
            f"{self._file}: line {self._line}",
            f"a line of at most {LONGEST_LINE} bytes",
            "a longer one",
            "check that this is a CSV file with one row per line",
        )

    def _block(self) -> Block:
        row = self._row
        return Block(self._file, self._header, "line", self._lines[:row], self._cells[:, :row])

    def _note_nans(self, nans: NDArray[np.int64]) -> None:
        for column in np.flatnonzero(nans[:, 0]).tolist():
            count, *lines = nans[column].tolist()
            name = self._header[column]
            self._mends.add("nan", name, lines, "NaN was taken as not sampled", count)

    def _settle(self, text: NDArray[np.uint8], entry: list[int], last: bool) -> None:
        """Read a cell that is no plain number, or say what is wrong with it."""
        row, column, first, behind, line = entry
        content = bytes(text[first:behind])
        if column == BAD_LENGTH:
            self._refuse_length(line, row, content, last)
        cell = content.decode("utf-8", errors="replace").strip()
        if len(cell) > 1 and cell[0] == cell[-1] == '"':
            cell = cell[1:-1].strip()
        where = f"{self._file}: line {line}, column {self._header[column]}"
        if not cell:
            self._cells[column, row] = math.nan
        elif column in self._selection.texts:
            self._cells[column, row] = self._selection.texts[column](cell, where)
        elif (number := parse_number(cell)) is not None:
            self._cells[column, row] = number
        else:
            short = cell if len(cell) <= 40 else cell[:37] + "…"
            raise InputError(
                where,
                "a finite number, or an empty cell where the channel was not sampled",
                ascii(short),
                "write it like -1118 or 4.28e-5, '.' as point, or empty the cell",
            )

    def _refuse_length(self, line: int, count: int, content: bytes, last: bool) -> None:
        columns = len(self._header)
        fix = "check the commas; an empty cell still needs its comma"
        if last and count < columns:
            fix = f"{fix}; if the file was cut short, delete its last line"
        elif b";" in content and self._delimiter == COMMA:
            fix = "separate cells by commas, not semicolons"
        elif self._delimiter != COMMA:
            fix = f"check the cells between {self._delimiter!r}, the delimiter of the channel map"
        raise InputError(
            f"{self._file}: line {line}", f"{columns} cells as in the header", f"{count}", fix
        )


def header_of(where: str, content: bytes, delimiter: str = COMMA) -> tuple[str, ...]:
    """Names of the columns from the bytes of a header row.

    Raises
    ------
    InputError
        Not text, another delimiter, or numbers instead of names.
    """
    expected = "a header row of column names"
    fix = "save the telemetry as CSV UTF-8 (unpacked), or name a Parquet file telemetry.parquet"
    refusal = InputError(where, expected, "bytes that are no text", fix)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise refusal from None
    if "\0" in text or any(ord(c) < 32 and c not in "\t\r\n" for c in text):
        raise refusal
    for mark, name in _DELIMITERS.items():
        if mark in text and delimiter not in text:
            raise InputError(
                where,
                f"names separated by {_DELIMITERS.get(delimiter, repr(delimiter))}",
                name,
                f"save it with {delimiter!r} between the cells, or write delimiter = {mark!r} in"
                " a channel map",
            )
    try:
        names = next(csv.reader([text.strip("\r\n ")], strict=True, delimiter=delimiter))
    except csv.Error as error:
        raise InputError(where, "names of columns", str(error), "mend the line") from None
    names = [name.strip() for name in names]
    if parse_number(names[0]) is not None:
        fix = "add a first line time_s,q1,… that names the columns"
        raise InputError(where, expected, f"the number {names[0]}", fix)
    return tuple(names)
