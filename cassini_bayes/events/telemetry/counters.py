"""Checks of the thrusters' counters: growing, at a possible pace, in agreement; wraps undone."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array, Flags
from cassini_bayes.events.telemetry.block import Block
from cassini_bayes.events.telemetry.channel_map import ChannelMap
from cassini_bayes.events.telemetry.columns import Layout
from cassini_bayes.events.telemetry.mends import Mends
from cassini_bayes.events.totals import SHORTEST_PULSE_S

Rows = NDArray[np.int64]

SLACK_S: Final = 0.3
"""Two pulses and some rounding: by how much an on-time may outrun the time between its samples."""
ROUNDING: Final = 1e-6
STEEPER: Final = 3.0
"""A wrap may hide a growth up to so many times the largest one seen."""
WRAPPED: Final = 0.25
"""Or, where a channel map states the size of the counter, up to so much of that."""
FROZEN_PULSES: Final = 10
"""So many pulses without any on-time are no matter of rounding."""
_BITS: Final = (8, 10, 12, 15, 16, 24, 31, 32)
_STEPS_S: Final = (0.001, 0.005, 0.01, 0.1, 0.125, 1.0)
_DIGITS: Final = range(2, 8)
_GRIDS: Final = (0.5, 0.25, 0.2, 0.125, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
"""Steps, s, of which all that an on-time grows by may be multiples."""


def wrap_sizes(channel: str) -> tuple[float, ...]:
    """Ranges at which a counter may start again at 0: 2^n or 10^n least steps."""
    steps = _STEPS_S if channel == "on_time" else (1.0,)
    binary = (2.0**n * step for n in _BITS for step in steps)
    decimal = (10.0**n * step for n in _DIGITS for step in steps)
    return tuple(sorted({round(size, 6) for size in (*binary, *decimal) if size >= 10.0}))


class Counter:
    """One kind of counter, cumulative on-times or pulses, of all thrusters of the branch."""

    def __init__(
        self, channel: str, layout: Layout, mends: Mends, channel_map: ChannelMap | None
    ) -> None:
        self._channel = channel
        self._map = channel_map
        self._columns = list(layout.channels[channel])
        self._time = layout.channels["time"][0]
        self._mends = mends
        self._unit = "s" if channel == "on_time" else "pulses"
        size = len(self._columns)
        self._last: tuple[float, Array] | None = None
        self._wrapped = np.zeros(size)  # what wraps have taken away so far
        self._highest = np.full(size, -np.inf)  # raw
        self._steepest = np.zeros(size)  # largest growth from one sample to the next
        # steps of which all that was gained is a multiple; pulses are whole numbers anyway
        self._grids: tuple[float, ...] = _GRIDS if channel == "on_time" else ()
        self._names = layout.names(channel)
        # where each counter wraps: as the map says, else once one did (NaN until then)
        self._sizes = np.full(size, np.nan)
        self._stated = np.zeros(size, dtype=np.bool_)
        self._offsets = np.zeros(size)  # what is shown where a counter counts 0
        if channel_map is not None:
            sizes = [channel_map.wraps_at(channel, name) for name in self._names]
            self._sizes = np.array(sizes, dtype=np.float64)
            self._stated = ~np.isnan(self._sizes)
            self._offsets = np.array([channel_map.offset(channel, name) for name in self._names])

    def checked(self, block: Block) -> Array:
        """Counts (n, K) with wraps undone, NaN where not sampled."""
        raw = block.cells[self._columns]
        rows = np.flatnonzero(~np.isnan(raw[0])) if self._columns else np.zeros(0, np.int64)
        if rows.size == 0:
            return np.ascontiguousarray(raw.T)
        values = raw if rows.size == block.rows else raw[:, rows]
        self._check_values(block)
        time = block.cells[self._time][rows]
        start, first = self._last or (float(time[0]), values[:, 0])
        growth = np.diff(values, axis=1, prepend=first[:, None])
        step_s = np.diff(time, prepend=start)
        self._last = (float(time[-1]), values[:, -1].copy())
        if self._channel == "on_time":
            self._check_pace(block, rows, growth, step_s)
        self._look_at_grids(growth)
        if growth.min() < -ROUNDING:
            values = values + np.cumsum(self._unwrap(block, rows, growth, step_s), axis=1)
        counts = values + self._wrapped[:, None]
        self._wrapped = counts[:, -1] - self._last[1]
        self._highest = np.maximum(self._highest, raw[:, rows].max(axis=1))
        self._check_highest(block, int(rows[-1]))
        self._steepest = np.maximum(self._steepest, growth.max(axis=1))
        if rows.size == block.rows:
            return np.ascontiguousarray(counts.T)
        result = np.full((block.rows, len(self._columns)), np.nan)
        result[rows] = counts.T
        return result

    def _check_values(self, block: Block) -> None:
        fix = "check the columns: on-times are in on_time_…_s"
        for column, offset in zip(self._columns, self._offsets.tolist(), strict=True):
            own, least = block.cells[column], min(offset, 0.0)
            expected = f"{least:.10g} or more, in {self._unit}"
            block.check(own < least, column, expected, "check the column")
            if self._channel == "pulses":
                block.check(own % 1.0 > 0.0, column, "a whole number of pulses", fix)

    def _look_at_grids(self, growth: Array) -> None:
        if self._grids:
            grown = growth[growth > ROUNDING]
            self._grids = tuple(step for step in self._grids if are_multiples(grown, step))

    def _unwrap(self, block: Block, rows: Rows, growth: Array, step_s: Array) -> Array:
        """What wraps took away at each sample (K, m); ``growth`` is mended in place."""
        jumps = np.zeros_like(growth)
        for i, k in np.argwhere(growth.T < -ROUNDING).tolist():
            row, column = int(rows[i]), self._columns[k]
            now = float(block.cells[column, row])
            before = now - float(growth[k, i])
            seen = max(self._steepest[k], growth[k, :i].max(initial=0.0))
            size = self._wrap_size(k, before, now, seen, float(step_s[i]))
            if size is None:
                raise block.refuse(
                    row,
                    column,
                    f"a cumulative count of at least {before:.10g} {self._unit}",
                    f"it was reset or misread, or wraps at another size{self._as_stated(k)}: add"
                    " what was counted before, split the event there, or say wraps_at in a channel"
                    f" map; {self._other_kind(k)}",
                    f"{now:.10g}",
                )
            if np.isnan(self._sizes[k]):  # counters of which nothing is said are of one kind
                self._sizes[np.isnan(self._sizes)] = size
            jumps[k, i] = size
            growth[k, i] += size
            self._mends.add(
                *("counter_wrap", block.header[column], block.lines[[row]]),
                f"the counter went from {before - self._offsets[k]:.10g} to"
                f" {now - self._offsets[k]:.10g}: it wraps at {size:.10g} {self._unit}, which was"
                " added",
            )
        return jumps

    def _as_stated(self, k: int) -> str:
        """What a fall of a counter was compared with."""
        if np.isnan(self._sizes[k]):
            return " than a usual one, or several of these would do"
        return f" than {self._sizes[k]:.10g} {self._unit}"

    def _wrap_size(
        self, k: int, before: float, now: float, seen: float, step_s: float
    ) -> float | None:
        """The one size that explains a drop by a growth like those seen; None if none or two do.

        Where a map states the size, a growth need not be like others. One of more than a quarter of
        it is a reset, or a wrap at another size.
        """
        most = STEEPER * seen + (SLACK_S if self._channel == "on_time" else 2.0)
        if self._stated[k]:
            most = max(most, WRAPPED * self._sizes[k])
        if self._channel == "on_time":
            most = min(most, step_s + SLACK_S)
        known, counted = float(self._sizes[k]), before - float(self._offsets[k])
        sizes = wrap_sizes(self._channel) if np.isnan(known) else (known,)
        fits = [
            size
            for size in sizes
            if size + ROUNDING >= counted and -ROUNDING <= now + size - before <= most
        ]
        if len(fits) > 1 and self._grids:
            # pulses of whole cycles grow by whole cycles over a wrap as well
            step = self._grids[0]
            fits = [size for size in fits if are_multiples(now + size - before, step)]
        return fits[0] if len(fits) == 1 else None

    def _check_highest(self, block: Block, row: int) -> None:
        """A counter that wraps never shows more than its size."""
        most = self._sizes + self._offsets  # that are shown; NaN, which none exceeds, if not known
        for k in np.flatnonzero(self._highest > most + ROUNDING).tolist():
            raise block.refuse(
                row,
                self._columns[k],
                f"counts below {most[k]:.10g} {self._unit}, where the counters wrap",
                "a counter that fell near there was reset rather than wrapped: mend it",
                f"up to {self._highest[k]:.10g}",
            )

    def _check_pace(self, block: Block, rows: Rows, growth: Array, step_s: Array) -> None:
        for i, k in np.argwhere((growth > 1.01 * step_s + SLACK_S).T).tolist():
            raise block.refuse(
                int(rows[i]),
                self._columns[k],
                f"an on-time that grows by at most the {step_s[i]:.6g} s since its last sample",
                "check the unit (s, not ms) and that it belongs to one thruster only"
                if self._map is None
                else f"{self._other_kind(k)}; or correct unit or source there",
                f"a growth by {growth[k, i]:.6g} s",
            )

    def _other_kind(self, k: int) -> str:
        if self._map is None:
            return 'counts per interval need a channel map with kind = "per_interval"'
        return self._map.other_kind(self._channel, self._names[k])


def are_multiples(values: Array | float, step: float) -> bool:
    """Whether all values are multiples of a step, but for what printing rounds."""
    return bool(np.all(np.abs(values - step * np.round(values / step)) < ROUNDING))


class Agreement:
    """On-time and pulses of a thruster grow together; looked at where both were sampled."""

    def __init__(self, layout: Layout) -> None:
        self._on_time_columns = layout.channels["on_time"]
        self._pulse_columns = layout.channels["pulses"]
        self._last: tuple[Array, Array] | None = None  # at the last common sample
        size = len(self._pulse_columns)
        self._idle = np.zeros(size, dtype=np.bool_)  # neither grew from the sample before the last
        self._since = np.zeros(size)  # pulses when the on-time last grew
        self._uncounted = np.zeros(size)  # on-time that no pulse explains

    def check(self, block: Block, on_time: Array, pulses: Array) -> None:
        """Refuse pulses without on-time, and firings that no pulse began."""
        if not on_time.size or not pulses.size:
            return
        rows = np.flatnonzero(~np.isnan(on_time[:, 0]) & ~np.isnan(pulses[:, 0]))
        if rows.size == 0:
            return
        seconds, counts = on_time[rows], pulses[rows]
        first = self._last is None
        if self._last is None:
            self._last = seconds[0], counts[0]
            self._since = counts[0].copy()
        longer = np.diff(seconds, axis=0, prepend=self._last[0][None]) > ROUNDING
        more = np.diff(counts, axis=0, prepend=self._last[1][None]) > 0.0
        more[0] |= first  # what went before the first sample is not known to have been idle
        self._check_frozen(block, rows, counts, longer)
        self._check_uncounted(block, rows, seconds, longer, more)
        self._last = seconds[-1].copy(), counts[-1].copy()

    def _check_frozen(self, block: Block, rows: Rows, counts: Array, longer: Flags) -> None:
        marks = np.where(longer, counts, -np.inf)  # an offset may have counts below 0
        marks[0] = np.maximum(marks[0], self._since)
        since = np.maximum.accumulate(marks, axis=0)
        self._since = since[-1].copy()
        for i, k in np.argwhere(counts - since >= FROZEN_PULSES).tolist():
            raise block.refuse(
                int(rows[i]),
                self._on_time_columns[k],
                f"an on-time that grows by at least {SHORTEST_PULSE_S:g} s with every pulse",
                f"check this column and {block.header[self._pulse_columns[k]]}",
                f"no growth over {counts[i, k] - since[i, k]:.0f} pulses",
            )

    def _check_uncounted(
        self, block: Block, rows: Rows, seconds: Array, longer: Flags, more: Flags
    ) -> None:
        assert self._last is not None
        idle = ~longer & ~more
        idle_before = np.concatenate([self._idle[None], idle[:-1]])
        self._idle = idle[-1].copy()
        odd = idle_before & longer & ~more
        if not odd.any():
            return
        growth = np.diff(seconds, axis=0, prepend=self._last[0][None])
        total = self._uncounted + np.cumsum(np.where(odd, growth, 0.0), axis=0)
        self._uncounted = total[-1].copy()
        for i, k in np.argwhere(total > SLACK_S).tolist():
            raise block.refuse(
                int(rows[i]),
                self._pulse_columns[k],
                "a pulse for every firing that starts",
                f"check this column and {block.header[self._on_time_columns[k]]}; where counters"
                " are read more seldom than rows come, leave the cells between readings empty",
                f"{total[i, k]:.4g} s of firings that no pulse began",
            )
