"""Telemetry as a stream of checked chunks, in constant memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from cassini_bayes.errors import InputError
from cassini_bayes.spacecraft import Spacecraft
from cassini_bayes.telemetry.block import Block
from cassini_bayes.telemetry.chunk import Array, Chunk, join
from cassini_bayes.telemetry.columns import Layout, make_layout
from cassini_bayes.telemetry.event import TelemetryEvent
from cassini_bayes.telemetry.files import open_table
from cassini_bayes.telemetry.mends import Mends

MOST_ROWS: Final = 2_000_000
"""Rows that :func:`load_event` takes: some 500 MB."""


def read_chunks(
    event: TelemetryEvent,
    spacecraft: Spacecraft,
    rows: int = 100_000,
    mends: Mends | None = None,
) -> Iterator[Chunk]:
    """Stream an event's telemetry, every row checked and mended, in constant memory.

    Parameters
    ----------
    event, spacecraft
        From :func:`read_event`, with the same spacecraft.
    rows
        The most rows of a chunk.
    mends
        Collects what was mended; complete once the last chunk has been taken.

    Raises
    ------
    InputError
        Names file, line and column, what was expected, what was found and the fix.
    """
    with open_table(event.telemetry) as table:
        layout = make_layout(
            table.header_place, table.header, spacecraft, event.kind, event.wheels, event.branch
        )
        for block in table.blocks(rows):
            yield _chunk(block, layout)


def load_event(event: TelemetryEvent, spacecraft: Spacecraft, mends: Mends | None = None) -> Chunk:
    """All rows of an event at once, for figures and tests.

    Raises
    ------
    InputError
        As :func:`read_chunks`, or more than ``MOST_ROWS`` rows.
    """
    chunks: list[Chunk] = []
    total = 0
    for chunk in read_chunks(event, spacecraft, mends=mends):
        chunks.append(chunk)
        total += chunk.rows
        if total > MOST_ROWS:
            raise InputError(
                str(event.telemetry),
                f"at most {MOST_ROWS:,} rows to hold at once",
                "more",
                "stream it with read_chunks",
            )
    return join(chunks)


def _chunk(block: Block, layout: Layout) -> Chunk:
    def channel(name: str) -> Array:
        return np.ascontiguousarray(block.cells[list(layout.channels[name])].T)

    pressure = channel("pressure")
    empty = np.full(block.lines.size, np.nan)
    return Chunk(
        first_row=int(block.lines[0]),
        time_s=channel("time")[:, 0],
        attitude=channel("attitude"),
        rate_rad_s=channel("rate"),
        wheel_rpm=channel("wheel"),
        on_time_s=channel("on_time"),
        pulses=channel("pulses"),
        delta_v_m_s=channel("delta_v"),
        tank_pressure_kpa=pressure[:, 0].copy() if pressure.shape[1] else empty,
    )
