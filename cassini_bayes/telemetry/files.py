"""Telemetry files as blocks of numbers: CSV or Parquet, streamed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import numpy as np
import pandas as pd

from cassini_bayes.telemetry.block import Block


class Table(Protocol):
    """An open telemetry file."""

    @property
    def header(self) -> tuple[str, ...]:
        """Names of the columns."""

    @property
    def header_place(self) -> str:
        """Where the names stand, for messages."""

    def blocks(self, rows: int) -> Iterator[Block]:
        """The rows in file order, at most ``rows`` at a time; lines count from the header's 1."""


class _Plain:
    def __init__(self, path: Path) -> None:
        self._path = path
        self.header = tuple(pd.read_csv(path, nrows=0, encoding="utf-8-sig").columns)
        self.header_place = f"{path}: line 1"

    def blocks(self, rows: int) -> Iterator[Block]:
        first = 2
        with pd.read_csv(self._path, chunksize=rows, dtype=np.float64) as chunks:
            for frame in chunks:
                lines = np.arange(first, first + len(frame), dtype=np.int64)
                first += len(frame)
                cells = np.ascontiguousarray(frame.to_numpy().T)
                yield Block(str(self._path), self.header, lines, cells)


@contextmanager
def open_table(path: Path) -> Iterator[Table]:
    """Open a telemetry file."""
    yield _Plain(path)
