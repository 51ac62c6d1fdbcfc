"""A first look at an event's telemetry: least steps of its channels, on-times behind its counters.

Both need the whole event, so they come before the pass that reduces it. Only readings at which a
counter changes are kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass, replace
from typing import Final

import numpy as np

from cassini_bayes.balance.statistics.channel_noise import channel_noise
from cassini_bayes.balance.statistics.counters import (
    are_quantised,
    counter_step,
    delivered_pulses,
    firings,
    single_widths,
)
from cassini_bayes.balance.statistics.event_statistics import COARSE_STEP_S, ChannelSteps
from cassini_bayes.balance.statistics.first_look import LateRows, Preparation
from cassini_bayes.balance.statistics.rounded_counters import expected_on_times
from cassini_bayes.balance.statistics.rows import SAME_S, Samples, quiet_rows
from cassini_bayes.balance.statistics.thinned import Thinned
from cassini_bayes.computing.arrays import Array, joined
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

LOOKED_AT: Final = 4_096  # rows, for the steps of rates and wheel rates
LEAST_VALUES: Final = 20  # different ones: fewer look rounder than they are
LEAST_ALONE: Final = 20  # pulses: the widths of fewer are not those of all
LEAST_CUT: Final = 8  # pulses that readings cut, to tell whether they begin with cycles (judgement)
ALIKE: Final = 0.85  # of them, that begin the same time into a cycle where all pulses do
SLACK_S: Final = 1e-3  # of the times of readings
QUANTILES: Final = 12  # that stand for all gaps
WIDTHS: Final = 48  # that stand for all widths
# Rows between firings per row at a reading: with fewer, all that are at readings tell more.
LEAST_QUIET: Final = 0.1
# Thrusters answer what is late, in rows; in means over so long a block little of it is left beside
# the body's slow motion (docs/results/likelihood-experiments.md).
BLOCK_S: Final = 32.0
# Of pulses that may last longer than a control cycle, where readings shall say which have just
# begun: a twentieth (docs/results/likelihood-experiments.md). With an eighth they seldom do.
LONGER: Final = 0.05
_SAME: Final = 1e-3  # of a step, that a printed multiple may be off


@dataclass(frozen=True)
class Prepared:
    """What a first look found, and the telemetry with it; ``end_s`` is the time of its last row."""

    found: Preparation
    end_s: float

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        """The same telemetry with expected counters in the place of what was read."""
        found = self.found
        for chunk in chunks:
            if len(found.read_s) == 0 or chunk.on_time_s.shape[1] == 0:
                yield chunk
                continue
            place = np.searchsorted(found.read_s, chunk.time_s + SAME_S, side="right") - 1
            place, read = np.maximum(place, 0), chunk.has_counters[:, None]
            yield replace(
                chunk,
                on_time_s=np.where(read, found.on_time_s[place], chunk.on_time_s),
                pulses=np.where(read, found.pulses[place], chunk.pulses),
            )


def prepare(chunks: Iterable[Samples], control_cycle_s: float, guard_s: float) -> Prepared:
    """Look at an event's telemetry once, chunk by chunk.

    Parameters
    ----------
    chunks
        Rows in order of time.
    control_cycle_s
        What commands may be multiples of; whether they are is decided from the readings.
    guard_s
        How long after its end a pulse may still deliver momentum.
    """
    first: list[Samples] = []
    readings, looked, end_s = _Readings(), 0, 0.0
    complete, at_readings = Thinned(), Thinned()
    for chunk in chunks:
        readings.add(chunk)
        complete.add(chunk.time_s[chunk.has_state])
        at_readings.add(chunk.time_s[chunk.has_state & chunk.has_counters])
        end_s = float(chunk.time_s[-1])
        if looked < LOOKED_AT:
            first.append(chunk)
            looked += len(chunk)
    seen = joined(first)
    rows = seen.part(0, LOOKED_AT).complete
    steps = ChannelSteps(
        channel_step(seen.rate_rad_s),
        channel_step(seen.wheel_rad_s / RAD_S_PER_RPM) * RAD_S_PER_RPM,
    )
    time, on_time, pulses = readings.around_changes()
    if len(time) == 0:
        noise = channel_noise(rows, np.zeros(len(rows), dtype=np.intp), *astuple(steps))
        return Prepared(Preparation(steps, noise), end_s)
    step_s = counter_step(on_time, pulses)
    expected = expected_on_times(on_time, pulses, step_s, control_cycle_s)
    singles = single_widths(on_time, on_time, pulses)
    with_cycles = begin_with_cycles(time, on_time, pulses, step_s, control_cycle_s)
    gaps = close_gaps(singles, step_s, control_cycle_s, with_cycles=with_cycles)
    paired = paired_widths(expected.on_time_s, pulses)
    widths = _typical(single_widths(expected.on_time_s, on_time, pulses), WIDTHS, LEAST_ALONE)
    # from the last change to the last reading nothing fires
    counters = np.concatenate([on_time, pulses], axis=1)[[*range(len(time)), -1]]
    read = np.r_[time, readings.end_s]
    quiet = quiet_rows(complete.values, read, counters, guard_s).sum()
    of_rows = quiet_rows(rows.time_s, read, counters, guard_s)
    stretch = np.where(of_rows, np.searchsorted(read, rows.time_s), -1)
    noise = channel_noise(rows, stretch, *astuple(steps))
    late, begun = LateRows(), pulses[-1] - pulses[0]
    hardly_quiet = (
        quiet * complete.stride < LEAST_QUIET * len(at_readings.values) * at_readings.stride
    )
    if hardly_quiet and begun.any():
        gained = expected.on_time_s[-1] - expected.on_time_s[0]
        width, rates = float(gained.sum() / begun.sum()), begun / (time[-1] - time[0])
        are_cycles = are_quantised(on_time, pulses, step_s, control_cycle_s)
        are_told = are_cycles and width < (1.0 + LONGER) * control_cycle_s
        every = control_cycle_s if with_cycles else 0.0
        first_s = every if are_told else 0.0
        usual_s = float(np.median(np.diff(at_readings.values))) / at_readings.stride
        late = LateRows(BLOCK_S, BLOCK_S / usual_s, width, tuple(rates.tolist()), first_s, every)
        if are_told:
            pulses = delivered_pulses(expected.on_time_s, pulses, control_cycle_s)
    elif 0.0 < step_s <= COARSE_STEP_S:
        pulses = delivered_pulses(on_time, pulses, step_s)
    on_times = (time, expected.on_time_s, pulses)
    found = Preparation(steps, noise, *on_times, expected.rounding, gaps, paired, widths, late)
    return Prepared(found, end_s)


def paired_widths(on_time_s: Array, pulses: Array) -> tuple[float, ...]:
    """Widths of an event's pulses, each the mean of its firing, as quantiles, s; none without any.

    Parameters
    ----------
    on_time_s, pulses
        (m, K) readings of the counters around every change.
    """
    found = [np.zeros(0)]
    for gained, begun in zip(np.diff(on_time_s, axis=0).T, np.diff(pulses, axis=0).T, strict=True):
        own = firings(gained, begun)
        found.append(np.repeat(own.seconds / own.pulses, own.pulses.astype(np.int64)))
    return _typical(np.maximum(np.concatenate(found), 0.0), QUANTILES, 1)


def begin_with_cycles(
    time_s: Array, on_time_s: Array, pulses: Array, step_s: float, control_cycle_s: float
) -> bool:
    """Whether pulses may be taken to begin with control cycles, and not at any time.

    A reading that cuts a pulse tells when it began: on-time is gained after it without a pulse that
    begins, and before it as much as the pulse had lasted. Where pulses begin with cycles, all such
    readings are the same time into a cycle. Where less than :data:`LEAST_CUT` were cut nothing
    speaks against it.

    Parameters
    ----------
    time_s
        (m,) of the readings around every change.
    on_time_s, pulses
        (m, K) readings.
    step_s
        Of the on-times.
    """
    gained, begun = np.diff(on_time_s, axis=0), np.diff(pulses, axis=0)
    cut = (gained[1:] > 0.0) & (begun[1:] == 0.0) & (begun[:-1] == 1.0)
    lasted = gained[:-1][cut]
    read = np.broadcast_to(time_s[1:-1, None], cut.shape)[cut]
    if control_cycle_s == 0.0 or len(lasted) < LEAST_CUT:
        return True
    phase = np.exp(2j * np.pi * (read - lasted) / control_cycle_s)
    # alike but for a rounding at either end
    turn = np.angle(phase * np.conj(phase.mean())) * control_cycle_s / (2.0 * np.pi)
    return bool(np.mean(np.abs(turn) <= step_s + SLACK_S) > ALIKE)


def close_gaps(
    widths_s: Array, step_s: float, control_cycle_s: float, *, with_cycles: bool = True
) -> tuple[float, ...]:
    """Times, all as likely, from the end of a pulse to that of its control cycle.

    By then the next pulse may begin: after a pulse of 40 ms in a cycle of 125 ms within 85 ms.
    Pulses that fill their cycles are followed by a whole one, or are no pair. Of too few pulses
    nothing is said.

    Parameters
    ----------
    widths_s
        Of single pulses.
    step_s
        Of the on-times, which may hide that a pulse fills its cycle.
    with_cycles
        Else the next pulse begins at any time until then (:func:`begin_with_cycles`).
    """
    if control_cycle_s == 0.0 or len(widths_s) < LEAST_ALONE:
        return ()
    into = np.mod(widths_s, control_cycle_s)
    slack = max(step_s, _SAME * control_cycle_s)
    fills = (into < slack) | (into > control_cycle_s - slack)
    gaps = np.where(fills, control_cycle_s, control_cycle_s - into)
    share = (np.arange(QUANTILES) + 0.5) / QUANTILES  # of all, and of the rest of a cycle
    return tuple(np.quantile(gaps if with_cycles else np.outer(gaps, share), share).tolist())


def _typical(widths_s: Array, number: int, least: int) -> tuple[float, ...]:
    """A number of the widths that stand for all; none of fewer than the ``least``."""
    if len(widths_s) < least:
        return ()
    share = (np.arange(number) + 0.5) / number
    # widths that occur: between pulses of 63 and of 125 ms there may be none
    return tuple(np.quantile(widths_s, share, method="inverted_cdf").tolist())


def channel_step(values: Array) -> float:
    """Largest 1, 2 or 5 times a power of ten that all values are multiples of, to print; else 0."""
    every = np.unique(values[np.isfinite(values)])
    if len(every) < LEAST_VALUES:
        return _step_of_few(values, every)
    largest = float(np.abs(every).max())
    top = int(np.floor(np.log10(np.diff(every).max())))
    for exponent in range(top, int(np.floor(np.log10(largest))) - 9, -1):
        for digit in (5.0, 2.0, 1.0):
            step = digit * 10.0**exponent
            ratio = every / step
            if np.all(np.abs(ratio - np.round(ratio)) < _SAME):
                return step
    return 0.0


def _step_of_few(values: Array, every: Array) -> float:
    """Step of channels (n, c) that show few values, as those of wheels that rest between two.

    Their values differ by one step at least: the least difference within a channel is the step if
    it is 1, 2 or 5 times a power of ten and all values are multiples of it.
    """
    columns = values.reshape(len(values), -1).T
    gaps = [np.diff(np.unique(own[np.isfinite(own)])).min(initial=np.inf) for own in columns]
    least = float(min(gaps, default=np.inf))
    if not np.isfinite(least):
        return 0.0
    digit = least / 10.0 ** np.floor(np.log10(least) + _SAME)
    ratio = every / least
    is_printed = np.abs(digit - np.array([1.0, 2.0, 5.0])).min() < 10.0 * _SAME
    return least if is_printed and np.all(np.abs(ratio - np.round(ratio)) < _SAME) else 0.0


class _Readings:
    """Counter readings before and after every change, from rows that come in chunks."""

    def __init__(self) -> None:
        self._kept: list[tuple[Array, Array, Array]] = []
        self._last: tuple[Array, Array, Array] | None = None

    def add(self, chunk: Samples) -> None:
        """Take the readings of some more rows."""
        counted = chunk.has_counters
        if not counted.any():
            return
        own = (chunk.time_s[counted], chunk.on_time_s[counted], chunk.pulses[counted])
        if self._last is None:
            self._kept.append((own[0][:1], own[1][:1], own[2][:1]))
        else:
            one, two, three = self._last
            own = (
                np.concatenate([one, own[0]]),
                np.concatenate([two, own[1]]),
                np.concatenate([three, own[2]]),
            )
        time, on_time, pulses = own
        changed = np.any(np.diff(on_time, axis=0) != 0.0, axis=1)
        changed |= np.any(np.diff(pulses, axis=0) != 0.0, axis=1)
        used = np.zeros(len(time), dtype=bool)
        used[:-1] |= changed
        used[1:] |= changed
        self._kept.append((time[used], on_time[used], pulses[used]))
        self._last = (time[-1:], on_time[-1:], pulses[-1:])

    @property
    def end_s(self) -> float:
        """Time of the last reading, of which nothing is known before there is one."""
        return -np.inf if self._last is None else float(self._last[0][0])

    def around_changes(self) -> tuple[Array, Array, Array]:
        """Times (m,), on-times and pulses (m, K), each reading once."""
        if not self._kept:
            return np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))
        time, on_time, pulses = (np.concatenate(part) for part in zip(*self._kept, strict=True))
        time, first = np.unique(time, return_index=True)
        return time, on_time[first], pulses[first]
