"""When a telemetry file ends, from its last bytes, before it is read."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.event import TelemetryEvent
from cassini_bayes.events.telemetry.files import PARQUET
from cassini_bayes.files.cells import cells_of
from cassini_bayes.files.foreign import SUFFIXES

_TAIL_BYTES: Final = 65_536  # of a file's end, for the time of its last row


def last_time(event: TelemetryEvent) -> float:
    """Time of the last row of an event as its file's tail has it, s; 1 where it does not tell.

    Only a guess that spares a pass over the file: a wrong one is noticed and put right. Of columns
    that are not ours, or in memory, none is made.
    """
    telemetry = event.telemetry
    if event.channels is not None or not isinstance(telemetry, Path):
        return 1.0
    suffix = telemetry.suffix.lower()
    if suffix in SUFFIXES:
        return 1.0
    try:
        if suffix in PARQUET:
            return _last_time_of_parquet(telemetry)
        with telemetry.open("rb") as stream:
            header = stream.readline().decode("utf-8-sig")
            place = next(cells_of("", header))[1].index("time_s")
            stream.seek(0, 2)
            stream.seek(max(stream.tell() - _TAIL_BYTES, 0))
            lines = stream.read().decode("utf-8", "replace").splitlines()
        for line in reversed(lines):
            if line.strip():
                value = float(next(cells_of("", line))[1][place])
                return value if np.isfinite(value) and value > 0 else 1.0
    except (OSError, ValueError, IndexError, StopIteration, InputError):
        return 1.0
    return 1.0


def _last_time_of_parquet(telemetry: Path) -> float:
    import pyarrow.parquet as parquet  # an extra, only there with Parquet files

    file = parquet.ParquetFile(telemetry)
    if file.metadata.num_row_groups == 0:
        return 1.0
    column = file.read_row_group(file.metadata.num_row_groups - 1, columns=["time_s"])
    value = float(column.column("time_s")[-1].as_py() or 1.0)
    return value if value > 0 else 1.0
