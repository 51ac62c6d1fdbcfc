"""Telemetry as a stream of checked chunks, in constant memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.attitude import Attitudes
from cassini_bayes.events.telemetry.block import Block
from cassini_bayes.events.telemetry.chunk import Chunk, join
from cassini_bayes.events.telemetry.columns import NEEDED, VELOCITY, Layout, make_layout
from cassini_bayes.events.telemetry.counters import Agreement, Counter
from cassini_bayes.events.telemetry.event import TelemetryEvent
from cassini_bayes.events.telemetry.files import open_table
from cassini_bayes.events.telemetry.gaps import gaps_of
from cassini_bayes.events.telemetry.mends import Mends
from cassini_bayes.events.telemetry.rows import Times, check_foreign, check_ranges, check_whole
from cassini_bayes.spacecraft import Spacecraft

MOST_ROWS: Final = 2_000_000
"""Rows that :func:`load_event` takes: some 500 MB."""
LEAST_SAMPLES: Final = 2
"""A balance needs a beginning and an end."""


def read_chunks(
    event: TelemetryEvent,
    spacecraft: Spacecraft,
    rows: int = 100_000,
    mends: Mends | None = None,
) -> Iterator[Chunk]:
    """Stream an event's telemetry, every row checked and mended, in constant memory.

    What a check of a row needs of the rows before is carried across chunks of any size.

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
        Names file, line and column, what was expected, what was found and the fix. Raised while
        chunks are taken: what came before the bad row has been yielded already, and of a row that
        is missing so may the few that show it.
    """
    if rows < 1:
        raise InputError("rows", "at least one row per chunk", str(rows), "ask for more")
    collected = Mends() if mends is None else mends
    with open_table(
        event.telemetry, event.channels, spacecraft, event.wheels, event.branch, event.epoch
    ) as table:
        layout = make_layout(
            table.header_place, table.header, spacecraft, event.kind, event.wheels, event.branch
        )
        checks = _Checks(event, spacecraft, layout, collected)
        for block in table.blocks(rows, collected):
            chunk = checks.chunk(block)
            if chunk.rows:
                yield chunk
        checks.finish()


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


class _Checks:
    """Everything that is known of the rows read so far."""

    def __init__(
        self, event: TelemetryEvent, spacecraft: Spacecraft, layout: Layout, mends: Mends
    ) -> None:
        self._event = event
        self._spacecraft = spacecraft
        self._layout = layout
        self._times = Times(layout, mends)
        self._gaps = gaps_of(layout, event.channels)
        self._attitudes = Attitudes(layout, mends, spacecraft.highest_rate_rad_s)
        self._on_times = Counter("on_time", layout, mends, event.channels)
        self._pulses = Counter("pulses", layout, mends, event.channels)
        self._agreement = Agreement(layout)
        self._samples = dict.fromkeys(layout.channels, 0)

    def chunk(self, block: Block) -> Chunk:
        """Check and mend a block."""
        block = self._times.checked(block)
        check_whole(block, self._layout)
        check_foreign(block, self._layout)
        check_ranges(block, self._layout, self._spacecraft)
        for gaps in self._gaps:
            gaps.check(block)
        for channel, columns in self._layout.channels.items():
            if columns:
                self._samples[channel] += int(np.count_nonzero(~np.isnan(block.cells[columns[0]])))
        on_time = self._on_times.checked(block)
        pulses = self._pulses.checked(block)
        self._agreement.check(block, on_time, pulses)
        return Chunk(
            first_row=int(block.lines[0]) if block.rows else 0,
            time_s=self._channel(block, "time")[:, 0].copy(),
            attitude=self._attitudes.checked(block),
            rate_rad_s=self._channel(block, "rate"),
            wheel_rpm=self._channel(block, "wheel"),
            on_time_s=on_time,
            pulses=pulses,
            delta_v_m_s=self._channel(block, "delta_v"),
            accelerometer_counts=self._single(block, "accelerometer"),
            tank_pressure_kpa=self._single(block, "pressure"),
        )

    def finish(self) -> None:
        """Refuse a file that lacks rows at its end or in all, or never samples what it needs."""
        for gaps in self._gaps:
            gaps.finish()
        file = str(self._event.telemetry)
        rows = self._samples["time"]
        if rows < LEAST_SAMPLES:
            raise InputError(
                file,
                f"at least {LEAST_SAMPLES} rows at different times",
                "only the header row" if rows == 0 else "one row",
                "an event needs its beginning and its end; add the rows",
            )
        velocity = max(VELOCITY, key=lambda channel: self._samples[channel])
        also = (velocity,) if self._event.kind == "delta_v" else ()
        for channel in (*NEEDED[self._event.kind], *also):
            if self._samples[channel] < LEAST_SAMPLES:
                raise InputError(
                    f"{file}: column {self._layout.names(channel)[0]}",
                    f"at least {LEAST_SAMPLES} samples, as the event is of kind {self._event.kind}",
                    f"{self._samples[channel] or 'no'} sample in {rows} rows",
                    "fill in the channel, or correct kind in event.toml",
                )

    def _channel(self, block: Block, name: str) -> Array:
        return np.ascontiguousarray(block.cells[list(self._layout.channels[name])].T)

    def _single(self, block: Block, channel: str) -> Array:
        values = self._channel(block, channel)
        return values[:, 0].copy() if values.shape[1] else np.full(block.rows, np.nan)
