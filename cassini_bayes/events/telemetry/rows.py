"""Checks of rows: times that only grow, channels that are whole, values that can be."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array, Flags
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.block import Block
from cassini_bayes.events.telemetry.columns import Layout
from cassini_bayes.events.telemetry.mends import Mends
from cassini_bayes.spacecraft import Spacecraft

SAME_TIME_S: Final = 1e-6  # rounding of times that were written to a microsecond
HIGHEST_DELTA_V_M_S: Final = 2000.0
MOST_COUNTS: Final = 1_000_000


class Times:
    """Times strictly increase; a row that repeats the one before it, cell for cell, is dropped."""

    def __init__(self, layout: Layout, mends: Mends) -> None:
        self._column = layout.channels["time"][0]
        self._mends = mends
        self._last: Array | None = None  # cells of the row before this block

    def checked(self, block: Block) -> Block:
        """The block without repeated rows."""
        time = block.cells[self._column]
        fix = "give every row its time, or drop it"
        block.check(np.isnan(time), self._column, "a time in s", fix)
        if self._last is None and abs(time[0]) > SAME_TIME_S:
            said = f"starts at {time[0]:.10g} s, not at 0: is epoch the time of the first row?"
            self._mends.add("late_start", "time_s", block.lines[:1], said)
        first = -np.inf if self._last is None else self._last[self._column]
        late = time <= np.concatenate([[first], time[:-1]])
        repeated = self._repeated(block, late) if late.any() else late
        self._last = block.cells[:, -1].copy()
        return block.without(repeated) if repeated.any() else block

    def _repeated(self, block: Block, late: Flags) -> Flags:
        for row in np.flatnonzero(late).tolist():
            before = block.cells[:, row - 1] if row else self._last
            assert before is not None
            if not np.array_equal(block.cells[:, row], before, equal_nan=True):
                raise self._refusal(block, row, before)
        said = "a row that repeats the one before it was dropped"
        self._mends.add("duplicate_row", "time_s", block.lines[late], said)
        return late

    def _refusal(self, block: Block, row: int, before: Array) -> InputError:
        last = float(before[self._column])
        time = float(block.cells[self._column, row])
        expected = f"a time after {last:.10g} s, that of the row before"
        got = f"{time:.10g} s, going back"
        fix = "sort the rows by time; split the event where its clock was set back"
        if time == last:
            got = f"the same time again, {time:.10g} s, with other values"
            fix = "merge the two rows if they hold different channels; drop one if they disagree"
        return block.refuse(row, self._column, expected, fix, got)


def check_whole(block: Block, layout: Layout) -> None:
    """Refuse rows that sample only part of a channel."""
    for columns in layout.channels.values():
        if len(columns) < 2:
            continue
        empty = np.isnan(block.cells[list(columns)])
        partly = np.flatnonzero(empty.any(axis=0) & ~empty.all(axis=0))
        if partly.size:
            row = int(partly[0])
            column = columns[int(np.flatnonzero(empty[:, row])[0])]
            names = f"{block.header[columns[0]]} to {block.header[columns[-1]]}"
            raise block.refuse(
                row,
                column,
                f"a number, as {names} are sampled together",
                "fill in the cell, or empty the others of the channel in this row",
            )


def check_foreign(block: Block, layout: Layout) -> None:
    """Refuse values of idle wheels and of the other branch's thrusters; empty and 0 may stand."""
    expected = "an empty cell: it belongs to no prime wheel and to no thruster of the branch"
    fix = "correct wheels and branch in event.toml, or drop the column"
    for column in layout.foreign:
        values = block.cells[column]
        block.check(~np.isnan(values) & (values != 0.0), column, expected, fix)


def check_ranges(block: Block, layout: Layout, spacecraft: Spacecraft) -> None:
    """Refuse rates, wheel rates, velocities and pressures that only another unit explains.

    How fast body and wheels can turn the spacecraft file says.
    """
    for channel, limit, quantity, fix in (
        (
            "rate",
            spacecraft.highest_rate_rad_s,
            "a body rate within ±{:g} rad/s",
            "check the unit (rad/s, not deg/s or mrad/s) and the decimal point; a body that turns"
            " faster has highest_rate_rad_s in its spacecraft file",
        ),
        (
            "wheel",
            spacecraft.highest_wheel_rpm,
            "a wheel rate within ±{:g} rev/min",
            "check the unit (rev/min, not deg/s) and the decimal point; faster wheels have"
            " highest_wheel_rpm in their spacecraft file",
        ),
        (
            "delta_v",
            HIGHEST_DELTA_V_M_S,
            "a velocity change within ±{:g} m/s",
            "check the unit (m/s, not mm/s)",
        ),
    ):
        for column in layout.channels[channel]:
            beyond = np.abs(block.cells[column]) > limit
            block.check(beyond, column, quantity.format(limit), fix)
    expected = f"a whole number of counts within ±{MOST_COUNTS:,}"
    fix = "give the counts as telemetry has them, not a velocity"
    for column in layout.channels["accelerometer"]:
        values = block.cells[column]
        block.check((np.abs(values) > MOST_COUNTS) | (values % 1.0 > 0.0), column, expected, fix)
    for column in layout.channels["pressure"]:
        block.check(block.cells[column] <= 0.0, column, "a pressure above 0 kPa", "check the value")
