"""Columns of the angular-momentum balance of telemetry: known vectors times unknown weights.

In body axes at time t, with R(t, t') the rotation from body axes at t' to those at t,

    I ω + H_w = R(t, 0) h0 + Σ_k F_k Σ_j q_kj ∫ R(t, t') e_j ds_k + Σ_j τ_j ∫ R(t, t') e_j dt'

(paper 000 eqs. 4-7 and 15-17 in inertial form). Scalar columns stand for one column per axis:
ω_x, ω_y, ω_z, 1, ρ_1 … ρ_W, and the turns of the attitude, which only the balance integrated over
quiet pieces has (:mod:`.turns`; zero in rows).
Vector columns have three components at each time: R e_j for the initial momentum, ∫R e_j dt for a
steady torque, R e_j [cos(mπt/T) − 1] for the slowest cosines of torque noise, ∫R e_j ds_k for
thruster k. The effective on-time s depends on the pulse parameters, by the columns of
:mod:`.pulse_columns`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cassini_bayes.balance.statistics.counters import firings
from cassini_bayes.balance.statistics.layout import CUT_COLUMNS, Layout
from cassini_bayes.balance.statistics.pairs import Counted, Pairs, cut_columns, pairs_of
from cassini_bayes.balance.statistics.pulse_columns import PULSE_COLUMNS
from cassini_bayes.balance.statistics.rows import (
    SAME_S,
    Samples,
    quiet_rows,
    rows_at_readings,
)
from cassini_bayes.balance.statistics.sampling import RowContext, Sampling
from cassini_bayes.balance.statistics.turning import turned_into_body
from cassini_bayes.balance.statistics.walk import walk_columns
from cassini_bayes.computing.arrays import Array, Flags, Places, joined, picked
from cassini_bayes.spacecraft.attitude import direction_cosines

MOST_WAITING = 1_000_000  # rows of ceaseless firing that are kept waiting for it to end


@dataclass(frozen=True)
class Carry:
    """What integrals have gathered up to a time; the state between two chunks.

    Integrals are in inertial axes: ``torque`` (3, 3) = ∫ Pᵀ dt, ``fired`` (K, C, 3, 3) = Σ Pᵀ Δs
    per thruster and pulse column, last two axes (inertial, j), ``cuts`` the tails that may have
    been cut and ``pairs`` the intervals in which, a part for every stretch. ``waiting`` are rows
    read already: those after ``done_until_s``, and before it as many as are needed to tell which of
    them are quiet.
    """

    done_until_s: float
    first_attitude: Array | None  # (3, 3) inertial to body at the first row
    last_time_s: float
    last_attitude: Array | None
    torque: Array
    fired: Array
    cuts: Array
    pairs: tuple[Pairs, ...]
    waiting: Samples | None
    block: Rows | None = None  # rows of a block that may go on

    @staticmethod
    def start(layout: Layout) -> Carry:
        """Nothing read yet."""
        fired = np.zeros((len(layout.thrusters), len(PULSE_COLUMNS), 3, 3))
        cuts = np.zeros(CUT_COLUMNS * len(layout.couples))
        none = np.zeros((0, len(layout.couples)))
        slopes = np.zeros((*none.shape, len(PULSE_COLUMNS)))
        unlike = np.zeros((*slopes.shape, len(PULSE_COLUMNS)))
        pairs = Pairs(np.zeros(0), none > 0.0, none, unlike, slopes)
        return Carry(-np.inf, None, 0.0, None, np.zeros((3, 3)), fired, cuts, (pairs,), None)


@dataclass(frozen=True)
class Rows:
    """Columns at the rows that enter the balance, and the pulses so far."""

    time_s: Array  # (n,)
    vector: Array  # (n, 3, V) component, column
    scalar: Array  # (n, S)
    pulses: Array  # (n, K)
    cosines: Array  # (n, 3, 3) inertial to body

    def part(self, places: slice) -> Rows:
        """Some of the rows."""
        return picked(self, places)

    def averaged(self, block: Array, usual: float) -> Rows:
        """Means over the blocks that rows (n,) are numbered by; time and attitude of the middle.

        Blocks with less than half the ``usual`` number of rows are left out: their noise is
        another.
        """
        first = np.flatnonzero(np.diff(block, prepend=-1.0))
        if len(first) == 0:
            return self
        count = np.diff(first, append=len(block))
        vector = np.add.reduceat(self.vector, first, axis=0) / count[:, None, None]
        scalar = np.add.reduceat(self.scalar, first, axis=0) / count[:, None]
        pulses = np.add.reduceat(self.pulses, first, axis=0) / count[:, None]
        full = 2.0 * count >= usual
        middle = (first + count // 2)[full]
        return Rows(
            self.time_s[middle], vector[full], scalar[full], pulses[full], self.cosines[middle]
        )


def settle(
    samples: Samples, carry: Carry, layout: Layout, sampling: Sampling, final: bool
) -> tuple[Rows, Carry]:
    """Columns of one chunk, and what the next needs.

    Rows after the last reading of unchanged counters wait for the next chunk unless this is the
    final one, and so does a reading until there is an attitude after it: the result does not depend
    on where chunks end.
    """
    if carry.waiting is not None:
        samples = joined([carry.waiting, samples])
    complete = np.flatnonzero(samples.has_state)
    end = len(samples) - 1 if final else _settled(samples, complete)
    if len(samples) == 0 or samples.time_s[end] <= carry.done_until_s:
        return _no_rows(layout), replace(carry, waiting=samples)
    now = samples.part(0, end + 1)
    until = float(now.time_s[-1])
    waiting = samples.part(_context(now, sampling.guard_s))
    after = complete[complete > end][:1]
    following = samples.time_s[after], direction_cosines(samples.attitude[after])
    rows, carry = _columns(now, following, carry, layout, sampling)
    carry = replace(carry, done_until_s=until, waiting=waiting)
    if sampling.block_s == 0.0:
        return rows, carry
    if carry.block is not None:
        rows = joined([carry.block, rows])
    of_block = np.floor((rows.time_s + SAME_S) / sampling.block_s)
    over = np.ones(len(of_block), dtype=bool) if final else of_block < of_block[-1:]
    rows, block = rows.part(slice(0, over.sum())), rows.part(slice(over.sum(), None))
    return rows.averaged(of_block[over], sampling.block_rows), replace(carry, block=block)


def _no_rows(layout: Layout) -> Rows:
    vectors, scalars = np.empty((0, 3, len(layout.vector))), np.empty((0, len(layout.scalar)))
    pulses = np.empty((0, len(layout.thrusters)))
    return Rows(np.empty(0), vectors, scalars, pulses, np.empty((0, 3, 3)))


def _columns(
    now: Samples,
    following: tuple[Array, Array],
    carry: Carry,
    layout: Layout,
    sampling: Sampling,
) -> tuple[Rows, Carry]:
    """Columns of the rows after ``carry.done_until_s``, and the integrals up to the last row.

    ``following`` are the time (1,) and the attitude (1, 3, 3) of the next row that has one, if any.
    """
    state = np.flatnonzero(now.has_state)
    time, attitude = now.time_s[state], direction_cosines(now.attitude[state])
    known = _attitudes(time, attitude, following, carry)
    if len(known[0]) == 0:  # what is fired before the first attitude is in the initial momentum
        return _no_rows(layout), carry
    read = now.has_counters
    readings = now.time_s[read], now.on_time_s[read], now.pulses[read]
    counted = Counted(*readings, carry.done_until_s)
    fired = _impulses(counted, *known, carry, sampling)
    pairs, weight = pairs_of(counted, layout, sampling)
    added = cut_columns(pairs, weight, layout, sampling)
    cuts = carry.cuts + np.concatenate([np.zeros((1, len(carry.cuts))), np.cumsum(added, axis=0)])
    gathered = replace(carry, fired=fired[-1], cuts=cuts[-1], pairs=(*carry.pairs, pairs))
    new = time > carry.done_until_s
    if not new.any():
        return _no_rows(layout), gathered
    first = carry.first_attitude if carry.first_attitude is not None else attitude[0]
    torque = _torque_integral(time[new], attitude[new], carry)
    keep = _usable(now, time, sampling) & new
    rows, body, n = state[keep], attitude[keep], int(keep.sum())
    index = counted.events_before(time[keep])
    vector = np.empty((n, 3, len(layout.vector)))
    vector[:, :, layout.initial] = since_start = body @ first.T
    vector[:, :, layout.torque] = body @ torque[keep[new]]
    vector[:, :, layout.walk] = walk_columns(
        time[keep], since_start, sampling.duration_s, layout.cosines
    )
    # (1 + m, K, pulse column, inertial, j) -> inertial, (K, j, pulse column)
    inertial = fired.transpose(0, 3, 1, 4, 2).reshape(len(fired), 3, -1)
    turned_into_body(body, np.ascontiguousarray(inertial), index, vector[:, :, layout.fired])
    context = RowContext(
        time[keep],
        now.rate_rad_s[rows],
        now.wheel_rad_s[rows],
        counted.time_s,
        counted.total_on_time,
        counted.total_pulses,
    )
    scalar = np.concatenate(
        [
            context.rate_rad_s,
            np.ones((n, 1)),
            context.wheel_rad_s,
            np.zeros((n, 3)),
            cuts[index],
            sampling.levels.at(time[keep]),
            *(extra.values(context)[:, None] for extra in sampling.extra),
        ],
        axis=1,
    )
    after = replace(
        gathered,
        first_attitude=first,
        last_time_s=float(time[-1]),
        last_attitude=attitude[-1],
        torque=torque[-1],
    )
    pulses = context.pulses_at(context.time_s) if layout.thrusters else np.empty((n, 0))
    return Rows(time[keep], vector, scalar, pulses, body), after


def _attitudes(
    time: Array, attitude: Array, following: tuple[Array, Array], carry: Carry
) -> tuple[Array, Array]:
    """Times (n,) and attitudes (n, 3, 3) of a stretch, with one before and one after it."""
    times, attitudes = np.r_[time, following[0]], np.concatenate([attitude, following[1]])
    if carry.last_attitude is None or np.any(times[:1] <= carry.last_time_s):
        return times, attitudes
    return np.r_[carry.last_time_s, times], np.concatenate([carry.last_attitude[None], attitudes])


def _settled(samples: Samples, complete: Places) -> int:
    """Last row that may be worked up.

    It is the last reading after which the counters did not change, and which a complete row
    follows, or is.
    """
    if samples.on_time_s.shape[1] == 0:
        return len(samples) - 1
    waits = len(samples) < MOST_WAITING
    last = complete.max(initial=-1) if waits else len(samples)
    counted = np.flatnonzero(samples.has_counters)
    values = np.concatenate([samples.on_time_s[counted], samples.pulses[counted]], axis=1)
    same = np.flatnonzero(~np.any(np.diff(values, axis=0) != 0, axis=1))
    same = same[counted[same] <= last]
    if len(same) == 0:
        return 0 if waits else len(samples) - 1
    return int(counted[same[-1]])


def _context(now: Samples, guard_s: float) -> int:
    """First row that the next chunk needs: the last reading ``guard_s`` before the end of this."""
    counted = np.flatnonzero(now.has_counters)
    before = now.time_s[counted] <= now.time_s[-1] - guard_s
    return int(counted[before][-1]) if before.any() else len(now) - 1


def _usable(samples: Samples, time: Array, sampling: Sampling) -> Flags:
    if samples.on_time_s.shape[1] == 0:
        return np.ones(len(time), dtype=bool)
    counted = samples.has_counters
    if sampling.block_s > 0.0:
        return rows_at_readings(time, samples.time_s[counted], sampling.guard_s)
    values = np.concatenate([samples.on_time_s[counted], samples.pulses[counted]], axis=1)
    return quiet_rows(time, samples.time_s[counted], values, sampling.guard_s)


def _torque_integral(time: Array, attitude: Array, carry: Carry) -> Array:
    """∫ Pᵀ dt' up to every row by the trapezoidal rule, (n, 3, 3)."""
    before = attitude[0] if carry.last_attitude is None else carry.last_attitude
    start = time[0] if carry.last_attitude is None else carry.last_time_s
    matrices = np.concatenate([before[None], attitude])
    steps = np.diff(time, prepend=start)[:, None, None]
    mean = 0.5 * (matrices[1:] + matrices[:-1])
    return np.asarray(carry.torque + np.cumsum(steps * np.swapaxes(mean, 1, 2), axis=0))


def _impulses(
    counted: Counted, time: Array, attitude: Array, carry: Carry, sampling: Sampling
) -> Array:
    """Σ Pᵀ Δs per thruster and pulse column after each active interval, (1 + m, K, C, 3, 3)."""
    active = counted.active
    if len(active) == 0:
        return carry.fired[None]
    of_pulse = sampling.pulses.expected_columns
    increments = effective_increments(counted.on_time, counted.pulses, of_pulse)[active]
    nearest = np.searchsorted(0.5 * (time[1:] + time[:-1]), counted.time_s)
    mean = 0.5 * (attitude[nearest[active]] + attitude[nearest[active + 1]])
    steps = increments[..., None, None] * np.swapaxes(mean, 1, 2)[:, None, None]
    return np.concatenate([carry.fired[None], carry.fired + np.cumsum(steps, axis=0)])


def effective_increments(
    on_time: Array, pulses: Array, of_pulse: Callable[[Array, Array], Array]
) -> Array:
    """What pulses of every counter interval add to the pulse columns, (m, K, C).

    Intervals of one firing share the mean width of their pulses. What a firing gains beyond its
    on-time is of its pulses, each where it began.
    on_time, pulses (m, K) are the increments of the counters; ``of_pulse`` gives the columns
    (…, C) of a pulse from the mean width (…) of so many (…), s.
    """
    result = np.zeros((*on_time.shape, of_pulse(np.zeros(1), np.ones(1)).shape[-1]))
    for k in range(on_time.shape[1]):
        rows, run, seconds, count = firings(on_time[:, k], pulses[:, k])
        effective = count[:, None] * of_pulse(seconds / count, count)
        begun = np.bincount(run, pulses[rows, k])
        by_time = on_time[rows, k] / np.where(seconds > 0, seconds, 1.0)[run]
        by_pulse = pulses[rows, k] / np.maximum(begun[run], 1.0)
        share = np.where(begun[run] > 0, by_pulse, by_time)
        commanded = seconds[:, None] * np.eye(1, effective.shape[1])
        beyond = share[:, None] * (effective - commanded)[run]
        result[rows, k] = by_time[:, None] * commanded[run] + beyond
    return result
