"""A CSV as rows of named cells that know where they stand, so that every message can say it."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import nearest

_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True)
class Row:
    """Cells of one line by column, and where it stands for messages."""

    file: str
    line: int
    cells: Mapping[str, str]
    absent: frozenset[str]  # known columns that the file leaves out; their cells are empty

    def where(self, column: str) -> str:
        """File, line and column of a cell, for messages."""
        return f"{self.file}: line {self.line}, column {column}"

    def refuse(self, column: str, expected: str, fix: str, got: str | None = None) -> InputError:
        """The error to raise about a cell; ``got`` replaces what the cell holds."""
        cell = self.cells[column]
        empty = "no such column" if column in self.absent else "an empty cell"
        return InputError(self.where(column), expected, got or (repr(cell) if cell else empty), fix)

    def text(self, column: str, expected: str) -> str:
        """A cell that must not be empty."""
        if not self.cells[column]:
            raise self.refuse(column, expected, "fill in the cell")
        return self.cells[column]

    def number(self, column: str, unit: str) -> float:
        """A finite number in ``unit``."""
        cell = self.text(column, f"a number in {unit}")
        if not _NUMBER.fullmatch(cell) or not math.isfinite(float(cell)):
            raise self.refuse(
                column, f"a finite number in {unit}", "write it like -1118 or 4.28, '.' as point"
            )
        return float(cell)

    def non_negative(self, column: str, unit: str) -> float:
        """A finite number of 0 or more."""
        value = self.number(column, unit)
        if value < 0:
            raise self.refuse(column, f"0 or more, in {unit}", "check the sign and the column")
        return value

    def positive(self, column: str, unit: str) -> float:
        """A finite number above 0."""
        value = self.number(column, unit)
        if value <= 0:
            raise self.refuse(column, f"a number above 0 in {unit}", "check the value")
        return value


def read_bytes(path: Path) -> bytes:
    """Bytes of a file; an :class:`InputError` says why it cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        names = [entry.name for entry in path.parent.glob("*.csv")]
        raise InputError(
            str(path), "a CSV file", "no such file", nearest(path.name, names)
        ) from None
    except IsADirectoryError:
        raise InputError(
            str(path), "a CSV file", "a folder", "name the CSV file inside it"
        ) from None
    except OSError as error:
        raise InputError(
            str(path), "a CSV file", error.strerror or str(error), "name a readable file"
        ) from None


def read_text(path: Path) -> str:
    """UTF-8 text of a file, with or without a byte-order mark."""
    content = read_bytes(path)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise InputError(
            f"{path}: line {line}", "UTF-8 text", "other bytes", "save the file as CSV UTF-8"
        ) from None


def rows_of(
    file: str, text: str, columns: Sequence[str], needed: Collection[str]
) -> tuple[Row, ...]:
    """Rows of CSV text with a header row; blank lines are skipped, cells stripped.

    Parameters
    ----------
    file
        What to call the text in messages.
    columns, needed
        The columns that may be there, and those of them that must be.

    Raises
    ------
    InputError
        Broken quoting, no rows, an unknown, repeated or missing column, a row of another length.
    """
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        lines = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader]
    except csv.Error as error:
        raise InputError(
            f"{file}: line {reader.line_num}", "comma-separated values", str(error), "mend the line"
        ) from None
    lines = [(line, cells) for line, cells in lines if any(cells)]
    if not lines:
        raise InputError(file, "a header row and at least one row", "an empty file", "fill it in")
    first, header = lines[0]
    absent = frozenset(columns) - set(header)
    _check_header(f"{file}: line {first}", header, columns, needed)
    if len(lines) == 1:
        raise InputError(file, "at least one row", "only the header row", "add rows")
    for line, cells in lines[1:]:
        if len(cells) != len(header):
            raise InputError(
                f"{file}: line {line}",
                f"{len(header)} cells as in the header",
                f"{len(cells)}",
                "check the commas; an empty cell still needs its comma",
            )
    empty = dict.fromkeys(absent, "")
    return tuple(
        Row(file, line, {**empty, **dict(zip(header, cells, strict=True))}, absent)
        for line, cells in lines[1:]
    )


def _check_header(
    where: str, header: Sequence[str], columns: Sequence[str], needed: Collection[str]
) -> None:
    missing = [name for name in columns if name not in header]
    for name in header:
        if name not in columns:
            raise InputError(
                where,
                "a known column",
                f"the unknown column {name!r}",
                nearest(name, missing) if missing else "drop it: every known column is there",
            )
    for i, name in enumerate(header):
        if name in header[:i]:
            raise InputError(where, "each column once", f"{name!r} twice", "drop one of the two")
    lacking = [name for name in columns if name in needed and name not in header]
    if lacking:
        raise InputError(
            where,
            f"the column {lacking[0]!r}",
            "a header without it",
            "add the column; leave its cells empty where the value is not known",
        )
