"""A CSV as rows of named cells with their line and column, for messages."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known, nearest, parse_number
from cassini_bayes.files.reading import open_file, read_bytes, text_of

MOST_BYTES: Final = 64 << 20
MOST_AHEAD: Final = 64 << 10  # bytes in which comments and header have to be


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

    def choice(self, column: str, known: Collection[str], expected: str | None = None) -> str:
        """One of the known texts; ``expected`` says what they are."""
        text = self.text(column, f"one of {', '.join(known)}")
        check_known(self.where(column), text, known, expected)
        return text

    def number(self, column: str, unit: str) -> float:
        """A finite number in ``unit``."""
        number = parse_number(self.text(column, f"a number in {unit}"))
        if number is None:
            raise self.refuse(
                column, f"a finite number in {unit}", "write it like -1118 or 4.28, '.' as point"
            )
        return number

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


def read_rows(
    path: Path,
    columns: Sequence[str],
    needed: Collection[str],
    what: str = "a CSV file",
    comments: bool = False,
) -> tuple[Row, ...]:
    """Rows of a CSV file; ``comments``: lines that start with ``#`` are none.

    Raises
    ------
    InputError
        The file cannot be read, is larger than :data:`MOST_BYTES` or no UTF-8; or as
        :func:`rows_of`.
    """
    text = text_of(read_bytes(path, what, MOST_BYTES), str(path))
    if comments:  # blank lines keep the numbers of the others
        text = "\n".join("" if line.startswith("#") else line for line in text.split("\n"))
    return rows_of(str(path), text, columns, needed)


def first_line(path: Path, what: str, comment: str) -> str:
    """The header of a CSV file, the first line that is neither blank nor comment; not checked.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    with open_file(path, what) as stream:
        lines = stream.read(MOST_AHEAD).decode("utf-8-sig", "replace").splitlines()
    return next((line for line in lines if line.strip() and not line.startswith(comment)), "")


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
    lines = [(line, cells) for line, cells in cells_of(file, text) if any(cells)]
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


def cells_of(file: str, text: str) -> Iterator[tuple[int, list[str]]]:
    """Number and stripped cells of every line of CSV text.

    Raises
    ------
    InputError
        Broken quoting, or a cell longer than any of this package's.
    """
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        for cells in reader:
            yield reader.line_num, [cell.strip() for cell in cells]
    except csv.Error as error:
        raise InputError(
            f"{file}: line {reader.line_num}", "comma-separated values", str(error), "mend the line"
        ) from None


def refuse_comment(where: str, header: Sequence[str]) -> None:
    """Refuse a comment where the names of columns should stand.

    Raises
    ------
    InputError
        Quotes it.
    """
    if header and header[0].startswith("#"):
        text, fix = ",".join(header), "delete the lines above the names"
        raise InputError(where, "names of columns in the first line", f"the comment {text!r}", fix)


def check_once(where: str, header: Sequence[str]) -> None:
    """Refuse a header that names a column twice.

    Raises
    ------
    InputError
        Names the first such column.
    """
    for i, name in enumerate(header):
        if name in header[:i]:
            raise InputError(where, "each column once", f"{name!r} twice", "drop one of the two")


def _check_header(
    where: str, header: Sequence[str], columns: Sequence[str], needed: Collection[str]
) -> None:
    refuse_comment(where, header)
    mark = next((own for own in ";\t|" if own in header[0]), "") if len(header) == 1 else ""
    if mark and len(columns) > 1:
        fix = "save the table as CSV with commas"
        raise InputError(where, "names separated by commas", f"one with {mark!r} in it", fix)
    missing = [name for name in columns if name not in header]
    for name in header:
        if name not in columns:
            raise InputError(
                where,
                "a known column",
                f"the unknown column {name!r}",
                nearest(name, missing) if missing else "drop it: every known column is there",
            )
    check_once(where, header)
    lacking = [name for name in columns if name in needed and name not in header]
    if lacking:
        raise InputError(
            where,
            f"the column {lacking[0]!r}",
            "a header without it",
            "add the column; leave its cells empty where the value is not known",
        )
