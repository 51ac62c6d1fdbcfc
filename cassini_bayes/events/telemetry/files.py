"""Telemetry as blocks of numbers, wherever it is: CSV, Parquet, HDF5, MATLAB, or memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Final

import numpy as np

from cassini_bayes.events.telemetry.block import EVERYTHING, Block, Selection
from cassini_bayes.events.telemetry.channel_map import ChannelMap, columns_of
from cassini_bayes.events.telemetry.columns import all_columns, channel_columns
from cassini_bayes.events.telemetry.csv_file import COMMA, CsvTable
from cassini_bayes.events.telemetry.mapped import MappedTable
from cassini_bayes.events.telemetry.memory import MemoryTable
from cassini_bayes.events.telemetry.mends import Mends
from cassini_bayes.events.telemetry.parquet_file import open_parquet
from cassini_bayes.events.telemetry.table import ForeignTable, Table
from cassini_bayes.files.foreign import SUFFIXES, read_foreign
from cassini_bayes.files.reading import open_file
from cassini_bayes.spacecraft import Spacecraft

PARQUET: Final = (".parquet", ".pq")


@contextmanager
def open_table(
    telemetry: Path | MemoryTable,
    channels: ChannelMap | None,
    spacecraft: Spacecraft,
    wheels: Sequence[int],
    branch: str,
    epoch: datetime,
) -> Iterator[Table]:
    """Open telemetry with the columns of this package, made by a channel map if there is one.

    Raises
    ------
    InputError
        It cannot be read, its header is no header, or the map does not fit it.
    """
    with open_foreign(telemetry, COMMA if channels is None else channels.delimiter) as table:
        if channels is None:
            yield table
            return
        own = channel_columns(spacecraft, wheels, spacecraft.thruster_names(branch))
        columns = columns_of(channels, table, own, all_columns(spacecraft), epoch)
        yield MappedTable(table, columns)


@contextmanager
def open_foreign(telemetry: Path | MemoryTable, delimiter: str = COMMA) -> Iterator[ForeignTable]:
    """Open telemetry by its suffix, with the columns that it has; any other suffix is text.

    Raises
    ------
    InputError
        It cannot be read, or its header is no header.
    """
    if isinstance(telemetry, MemoryTable):
        yield telemetry
    elif telemetry.suffix.lower() in PARQUET:
        yield open_parquet(telemetry)
    elif telemetry.suffix.lower() in SUFFIXES:
        yield _WholeFile(telemetry)
    else:
        with open_file(telemetry, "telemetry") as stream:
            yield CsvTable(telemetry, stream, delimiter)


class _WholeFile:
    """An HDF5 or MATLAB file: its names first, its columns once they are asked for."""

    unit: Final = "row"

    def __init__(self, path: Path) -> None:
        result = read_foreign(path)
        self._path = path
        self.header, self.refused = result.names, result.refused
        self.header_place = f"{path}: columns"

    def blocks(self, rows: int, mends: Mends, selection: Selection = EVERYTHING) -> Iterator[Block]:
        """Yield the rows in order, at most ``rows`` at a time."""
        wanted = [name for i, name in enumerate(self.header) if i not in selection.unread]
        result = read_foreign(self._path, wanted)
        table = MemoryTable(str(self._path), result.columns)
        texts = {wanted.index(self.header[i]): read for i, read in selection.texts.items()}
        for block in table.blocks(rows, mends, Selection(texts)):
            cells = np.full((len(self.header), block.rows), np.nan)
            cells[[self.header.index(name) for name in wanted]] = block.cells
            yield Block(block.file, self.header, "row", block.lines, cells)
