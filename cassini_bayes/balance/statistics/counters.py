"""What cumulative counters of thrusters say: firings, their least step, multiples of a quantum."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cassini_bayes.computing.arrays import Array, Places

LEAST_VALUES: Final = 5  # different readings that show a step
LEAST_RUNS: Final = 3  # firings: two have one difference, which tells no spread
MOST_PULSES: Final = 32.0  # of a firing: by 1/32 of a pulse each is its mean width off at most
RARELY_CUT: Final = 0.04  # of pulses, by a reading: so few are no kind of their own (judgement)
MOST_WHOLE: Final = 0.5  # of readings, that cut no pulse: a controller with two widths has fewer
_SLACK: Final = 1e-6  # s, of floating-point numbers that are multiples of a step


class Firings(NamedTuple):
    """Firings of a thruster: which of its counter intervals are one, and what they sum up to."""

    active: Places  # (a,) intervals in which it fired
    number: Places  # (a,) the firing that each belongs to
    seconds: Array  # (R,) on-time of each firing
    pulses: Array  # (R,) how many began, one at least: the first may go on from before


def firings(gained_s: Array, begun: Array, most_pulses: float = MOST_PULSES) -> Firings:
    """Intervals in a row with firing belong together: a pulse may run from one into the next.

    A thruster that never pauses has a new firing after every ``most_pulses``: what one pulse has on
    either side of a reading is little beside so many.

    Parameters
    ----------
    gained_s, begun
        (m,) increments of a thruster's on-time, s, and of its pulses.
    """
    active = np.flatnonzero((gained_s > 0.0) | (begun > 0.0))
    starts = np.diff(active, prepend=active[:1]) > 1
    before = np.cumsum(begun[active]) - begun[active]
    first = np.maximum.accumulate(np.where(starts, np.arange(len(active)), 0))
    since = (before - before[first]) // most_pulses
    starts |= np.diff(since, prepend=since[:1]) > 0
    number = np.cumsum(starts, dtype=np.int64)
    seconds = np.bincount(number, gained_s[active]).astype(np.float64)
    return Firings(active, number, seconds, np.maximum(np.bincount(number, begun[active]), 1.0))


def single_widths(expected_s: Array, on_time_s: Array, pulses: Array) -> Array:
    """Widths of single pulses, of all thrusters, s.

    A pulse is single if it is the only one of its interval, and nothing fires in the intervals
    before and after: a reading may have cut it. Where readings rarely do (:func:`are_rarely_cut`),
    as those ten seconds apart, every pulse is that is the only one of its interval. A thruster that
    fires in nearly all intervals would have none otherwise, and the widths of others would stand
    for its own.

    What is expected of rounded counters may be some milliseconds below zero: then it is zero.

    Parameters
    ----------
    expected_s
        (m, K) on-times that the widths are taken from.
    on_time_s, pulses
        (m, K) readings of the counters around every change, by which a pulse is single.
    """
    gained, begun = np.diff(on_time_s, axis=0), np.diff(pulses, axis=0)
    fired = (gained > 0.0) | (begun > 0.0)
    alone = ~fired[:-2] & ~fired[2:]
    if are_rarely_cut(on_time_s, pulses):
        # without on-time it has just begun, and the next interval has it
        alone |= gained[1:-1] > 0.0
    alone &= begun[1:-1] == 1.0
    return np.asarray(np.maximum(np.diff(expected_s, axis=0)[1:-1][alone], 0.0))


def are_rarely_cut(on_time_s: Array, pulses: Array) -> bool:
    """Whether readings hardly ever cut a pulse, or find it as it begins (:data:`RARELY_CUT`).

    Where no pulse begins in an interval, what it has is the rest of one from before.

    Parameters
    ----------
    on_time_s, pulses
        (m, K) readings of the counters around every change.
    """
    gained, begun = np.diff(on_time_s, axis=0), np.diff(pulses, axis=0)
    told = (begun[:-1] > 0.0) & (begun[1:] == 0.0)
    cut = told & (gained[1:] > 0.0)
    return bool(cut.sum() + 0.5 < RARELY_CUT * (told.sum() + 1.0))


def counter_step(on_time_s: Array, pulses: Array) -> float:
    """Largest of the usual steps (1 ms to 1 s, 1-2-5) that all readings are multiples of; else 0.

    A counter with few distinct values looks rounder than it is: five are asked for. So does one
    whose pulses have all one width, as its readings are multiples of that: it is not rounded.

    Parameters
    ----------
    on_time_s, pulses
        (m, K) readings of the cumulative counters, in order.
    """
    values = np.unique(on_time_s[np.isfinite(on_time_s)])
    if len(values) < LEAST_VALUES or _have_one_width(on_time_s, pulses):
        return 0.0
    for step in (1.0, 0.5, 0.25, 0.2, 0.125, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001):
        if np.all(np.abs(values - step * np.round(values / step)) < _SLACK):
            return step
    return 0.0


def _have_one_width(on_time_s: Array, pulses: Array) -> bool:
    """Whether some thruster's readings are one width times its pulses, and no other's are not.

    One pulse may have been counted at a reading and not yet fired, or at the first one; by the next
    reading it has been. Pulses of less than a step that a rounding hides lack it for longer.
    """
    said = set()
    for gained, begun in zip((on_time_s - on_time_s[0]).T, (pulses - pulses[0]).T, strict=True):
        begins = begun > 0.0
        if len(np.unique(gained)) < LEAST_VALUES or not begins.any():
            continue  # too few readings, or one pulse that goes on
        width = float(np.median(gained[begins] / begun[begins]))
        fired = np.round(gained / max(width, _SLACK))
        whole = np.abs(gained - fired * width) < _SLACK
        have_been = fired[1:] >= begun[:-1]
        said.add(bool(np.all(whole & (np.abs(fired - begun) <= 1.0)) and np.all(have_been)))
    return said == {True}


def are_quantised(on_time_s: Array, pulses: Array, step_s: float, quantum_s: float) -> bool:
    """Whether readings (m, K) of some thruster say :func:`is_quantised`, and of none that not."""
    phase_s = cut_phase(on_time_s, step_s, quantum_s)
    each = zip(on_time_s.T, pulses.T, strict=True)
    said = {is_quantised(*own, step_s, quantum_s, phase_s) for own in each}
    return True in said and False not in said


def cut_phase(on_time_s: Array, step_s: float, quantum_s: float) -> float:
    """How far into a cycle readings (m, K) cut the pulses that they cut, s; 0 of none.

    Rows that come some time after a control cycle has begun find pulses being fired at that time of
    their cycle: all of them, where rows are whole cycles apart.
    """
    if quantum_s <= 0.0:
        return 0.0
    gained = on_time_s - on_time_s[0]
    cut = np.unique(gained[_off(gained, quantum_s) > step_s + _SLACK])
    if len(cut) == 0:
        return 0.0
    turns = np.exp(2j * np.pi * cut / quantum_s)
    return float(np.angle(turns.mean()) * quantum_s / (2.0 * np.pi) % quantum_s)


def whole_cycles(gained_s: Array, quantum_s: float, phase_s: float) -> Array:
    """On-times (...) of whole cycles, or such to which what a reading has cut is added, s."""
    whole = _multiple(gained_s, quantum_s)
    cut = phase_s + _multiple(gained_s - phase_s, quantum_s)
    return np.where(np.abs(gained_s - cut) < np.abs(gained_s - whole), cut, whole)


def _multiple(gained_s: Array, quantum_s: float) -> Array:
    return np.asarray(quantum_s * np.round(gained_s / quantum_s))


def _off(gained_s: Array, quantum_s: float) -> Array:
    return np.asarray(np.abs(gained_s - _multiple(gained_s, quantum_s)))


def is_quantised(
    on_time_s: Array, pulses: Array, step_s: float, quantum_s: float, phase_s: float = 0.0
) -> bool | None:
    """Whether every reading (m,) is within its rounding of a multiple of the quantum.

    Or it is that much after one as readings cut pulses (:func:`cut_phase`), which most do not; by
    the next one such a pulse has gone on.
    None where a thruster fired too rarely to decide. The quantum is a property of the controller,
    so that one thruster is enough to decide for all.

    By chance a reading is so with probability 2 step/quantum; with five different ones, of a step
    of a quarter of the quantum or less, that is not chance. With a step that is the quantum
    itself all readings are multiples; shorter pulses are seen by firings that gain less than one
    for each (but for the last, which may have been counted and not yet fired). Firings with long
    pulses must not make up for them, nor is one endless firing enough.
    """
    gained = on_time_s - on_time_s[0]
    if quantum_s <= 0.0:
        return False
    if len(np.unique(gained)) < LEAST_RUNS:
        return None
    if abs(step_s - quantum_s) < _SLACK:
        fired = firings(np.diff(on_time_s), np.diff(pulses), np.inf)
        full = np.all(gained >= quantum_s * (pulses - pulses[0] - 1.0) - _SLACK)
        return bool(full and np.all(fired.seconds[:-1] >= quantum_s * fired.pulses[:-1] - _SLACK))
    # the first reading is rounded, too
    bound = step_s + _SLACK
    off = np.abs(gained - whole_cycles(gained, quantum_s, phase_s))
    are_whole = np.mean(_off(np.unique(gained), quantum_s) <= bound) > MOST_WHOLE
    goes_on = np.diff(gained)[_off(gained[:-1], quantum_s) > bound] > 0.0
    fits = np.all(off <= bound) and are_whole and np.all(goes_on)
    return bool(4.0 * step_s <= quantum_s and fits)


def delivered_pulses(on_time_s: Array, pulses: Array, least_s: float) -> Array:
    """Pulses (m, K) whose on-time is counted: without those that have just begun at a reading.

    A pulse is counted when it begins. A thruster that gained more of them than its on-time has room
    for, each of ``least_s`` or more, has just begun one, and its on-time comes with the next
    reading. Where pulses last that or a little more, whatever else it gains beyond its on-time
    comes then, too. Taken as it is read, a pulse that begins with a reading would be one of no
    width, and a longer one that follows.

    Parameters
    ----------
    on_time_s, pulses
        (m, K) readings of the cumulative counters, in order.
    least_s
        What a pulse lasts at least.
    """
    gained, begun = np.diff(on_time_s, axis=0), np.diff(pulses, axis=0)
    surplus = begun - np.floor(gained / least_s + _SLACK)
    # as many as there is room for: whatever was so at the reading before, but where nothing fires
    is_told = (surplus != 0.0) | ((gained <= 0.0) & (begun <= 0.0))
    told = np.where(is_told, np.arange(len(surplus))[:, None], -1)
    last = np.maximum.accumulate(told, axis=0)
    begins = (last >= 0) & (np.take_along_axis(surplus, np.maximum(last, 0), axis=0) > 0.0)
    begins[:-1] &= gained[1:] > 0.0
    begins[-1:] = False
    return np.asarray(pulses - np.concatenate([np.zeros_like(pulses[:1]), begins]))
