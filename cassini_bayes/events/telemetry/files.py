"""Telemetry files as blocks of numbers: CSV or Parquet, streamed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from cassini_bayes.events.telemetry.block import Block
from cassini_bayes.events.telemetry.csv_file import CsvTable
from cassini_bayes.events.telemetry.mends import Mends
from cassini_bayes.events.telemetry.parquet_file import open_parquet
from cassini_bayes.files.reading import open_file


class Table(Protocol):
    """An open telemetry file: names of its columns, where they stand, and what a row is called."""

    header: tuple[str, ...]
    header_place: str

    @property
    def unit(self) -> str:
        """``line`` or ``row``, whatever rows are counted in."""

    def blocks(self, rows: int, mends: Mends) -> Iterator[Block]:
        """Yield the rows in file order, at most ``rows`` at a time."""


@contextmanager
def open_table(path: Path) -> Iterator[Table]:
    """Open a telemetry file by its suffix.

    Raises
    ------
    InputError
        It cannot be read, or its header is no header.
    """
    if path.suffix == ".parquet":
        yield open_parquet(path)
        return
    with open_file(path, "telemetry") as stream:
        yield CsvTable(path, stream)
