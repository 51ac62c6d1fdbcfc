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

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cassini_bayes.balance.statistics.counters import firings
from cassini_bayes.balance.statistics.long_levels import NO_LEVELS, LongLevels
from cassini_bayes.balance.statistics.pulse_columns import PULSE_COLUMNS, PulseBasis
from cassini_bayes.balance.statistics.rows import (
    SAME_S,
    Samples,
    quiet_rows,
    rows_at_readings,
)
from cassini_bayes.balance.statistics.turning import turned_into_body
from cassini_bayes.computing.arrays import Array, Flags, Places
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.spacecraft.pulses import STEADY_S, PulseShape

AXES = "xyz"
CUT_PARTS = 4  # of an event, whose cut tails are independent of each other
# Per couple: pairs that may be close, and of every part the nominal variance of its steps, over
# that of a pair: of cut tails and of unlike pulses.
CUT_COLUMNS = 1 + CUT_PARTS
# How often pulses are a control cycle apart is the controller's business (0.45 to 0 of the pairs
# within a second): a share that is inferred, and how it falls with the time between two counter
# readings (docs/topics/telemetry-likelihood.md §7).
ALIKE_S = 1.0  # pairs of pulses within it are as often close as any
ACROSS = 1.0 / 6.0  # of the chance within an interval of that length, for pairs about a reading
# Of the chance of two pulses within that time: three have 1.5 times the chance for each pair. With
# a share near 1 more of them lose than there are; the share is then smaller.
MOST_ALIKE = 5.0 / 3.0
MOST_ACROSS = 4.0  # pairs about a reading, of several pulses on either side
# The slowest cosines of torque noise are unknowns: rows and turns see them alike. How many matter
# grows with the duration (docs/topics/telemetry-likelihood.md §8).
COSINE_S = 300.0  # of the event, for each cosine
WALK_COSINES = 6, 16  # as few, as many: the slow band has twice as many modes
USUAL_SHARE = 0.3  # of close pairs
LEAST_PAIR_S2 = 1e-12  # (1 µs)²: where no tail is cut, unlike widths are all that scatters
LEAST_FALL_S = 1e-4  # a valve that closes at once: nothing of its thrust is left a cycle later
MOST_WAITING = 1_000_000  # rows of ceaseless firing that are kept waiting for it to end


@dataclass(frozen=True)
class RowContext:
    """What a column that an effect brings may depend on, at the n rows that enter the balance.

    ``counter_time_s``, ``on_time_s`` and ``pulses`` are the counter readings around these rows, to
    be looked up at other times as well; the columns of both are the thrusters.
    """

    time_s: Array  # (n,)
    rate_rad_s: Array  # (n, 3)
    wheel_rad_s: Array  # (n, W)
    counter_time_s: Array  # (m,)
    on_time_s: Array  # (m, K)
    pulses: Array  # (m, K)

    def on_time_at(self, time_s: Array) -> Array:
        """Commanded on-time (n, K) at the last reading before or at each time."""
        return self.on_time_s[self.reading(time_s)]

    def pulses_at(self, time_s: Array) -> Array:
        """Pulses (n, K) at the last reading before or at each time."""
        return self.pulses[self.reading(time_s)]

    def reading(self, time_s: Array) -> NDArray[np.intp]:
        """Place of the last reading before or at each time."""
        place = np.searchsorted(self.counter_time_s, time_s + SAME_S, side="right") - 1
        return np.maximum(place, 0)


@dataclass(frozen=True)
class ExtraColumn:
    """A scalar column of an effect: its name and its values (n,) at the rows.

    ``over_trapezoids`` is its integral over that by trapezoids, from row to row: of a swing of
    frequency f and rows Δ apart tan(π f Δ)/(π f Δ), of all that is slow one.
    """

    name: str
    values: Callable[[RowContext], Array]
    over_trapezoids: float = 1.0


@dataclass(frozen=True)
class Sampling:
    """How telemetry is turned into columns.

    ``pulse_reference_s`` are the τ_delay, τ_rise, τ_fall at which pulses are exact;
    ``guard_s`` is how long after its end a pulse may still deliver momentum, ``duration_s`` the
    time of the last row. ``corner_rad`` is what a trapezoid of wheel rates may miss of a turn, in
    rad of the wheel, ``corner_rad_s`` the second difference of wheel rates that is no noise.
    ``reference_noise`` are noise levels, by name, of about the right size: all hypotheses of an
    event have the same measure of flat motion (:mod:`cassini_bayes.balance.flat_motion`). Those of
    ``noise_to_see`` are taken from the event where it shows them (:mod:`.channel_noise`).
    ``widths_s`` are what pulses of the event are like, all as likely, ``unsure_s`` how well the
    on-time of a firing is known (:class:`.PulseBasis`), and
    ``gaps_s`` the times after which close ones follow (without, a control cycle), ``paired_s`` the
    widths of pulses, means over firings, all as likely (without, pulses of steady thrust). With a
    ``block_s``, rows are means over blocks of that length of those at readings of the counters,
    ``block_rows`` of them usually, whatever is still being delivered then (:mod:`.late`).
    ``levels`` are roundings of counters that are unknowns.
    """

    pulse_shape: PulseShape
    pulse_reference_s: tuple[float, float, float]
    guard_s: float
    couples: tuple[tuple[int, ...], ...]  # thrusters (places) that only ever fire together
    duration_s: float
    extra: tuple[ExtraColumn, ...] = ()
    control_cycle_s: float = 0.0  # pulses start with control cycles
    corner_rad: float = np.inf
    corner_rad_s: float = np.inf
    reference_noise: tuple[tuple[str, float], ...] = ()
    noise_to_see: tuple[str, ...] = ()
    widths_s: tuple[float, ...] = ()
    unsure_s: float = 0.0
    gaps_s: tuple[float, ...] = ()
    paired_s: tuple[float, ...] = (STEADY_S,)
    block_s: float = 0.0
    block_rows: float = 0.0
    levels: LongLevels = field(default=NO_LEVELS, compare=False)

    @cached_property
    def pair_s2(self) -> float:
        """Variance of what a pair of pulses loses, at the reference and the usual share, s²."""
        gaps = np.array(self.gaps_s or (self.control_cycle_s,))
        cut, fall = self.cut_tail_s(self.pulse_reference_s), self.pulse_reference_s[2]
        given = (np.array([value]) for value in (cut, fall, USUAL_SHARE))
        lost = lost_tails(gaps, self.control_cycle_s, *given)
        return max(float(lost.variance_s2[0]), LEAST_PAIR_S2)

    def cut_tail_s(
        self, tau_s: tuple[ArrayLike, ArrayLike, ArrayLike], offset_s: ArrayLike = 0.0
    ) -> Array:
        """On-time (n,), or one of numbers, s, that a pulse loses whose successor begins as it ends.

        The tail of a long one, times the thrust that the first pulse has reached and the one that
        the second reaches: (τ_f − τ_r) (1 − exp(−Δ₁/τ_r)) (1 − exp(−Δ₂/τ_r)) of a first-order
        valve. Both are taken at their mean over the widths of pairs.

        Parameters
        ----------
        tau_s
            τ_delay, τ_rise, τ_fall, each (n,) or a number.
        offset_s
            (n,) or a number, by how much pulses last longer than commanded.
        """
        return np.asarray(self.pulse_shape.tail_s(*tau_s) * self._reached(tau_s, offset_s) ** 2)

    def cut_by_width(self, width_s: Array) -> Array:
        """What pairs of these widths (…) lose over those of the event's, at the reference: ρ²/ρ̄².

        ρ is the thrust that a pulse reaches, ρ̄ its mean over ``paired_s``.
        """
        own = self.pulse_shape.reached(width_s, *self.pulse_reference_s)
        mean = float(self._reached(self.pulse_reference_s)) ** 2
        return np.asarray(own**2 / mean) if mean > 0.0 else np.ones_like(own)

    def _reached(
        self, tau_s: tuple[ArrayLike, ArrayLike, ArrayLike], offset_s: ArrayLike = 0.0
    ) -> Array:
        """Mean thrust, over the steady one, that the event's pulses reach."""
        delay, rise, fall = (np.asarray(value)[..., None] for value in tau_s)
        lasts = np.maximum(np.asarray(self.paired_s) + np.asarray(offset_s)[..., None], 0.0)
        return np.asarray(self.pulse_shape.reached(lasts, delay, rise, fall).mean(axis=-1))

    @cached_property
    def pulses(self) -> PulseBasis:
        """Columns and weights of pulses."""
        reference = self.pulse_reference_s
        return PulseBasis(self.pulse_shape, reference, self.widths_s, self.unsure_s)


def walk_cosines(duration_s: float) -> int:
    """How many of the slowest cosines of torque noise are unknowns of an event."""
    fewest, most = WALK_COSINES
    return min(max(fewest, math.ceil(duration_s / COSINE_S)), most)


class LostTails(NamedTuple):
    """On-time that a pair of pulses loses by a cut tail: mean (n,), s, and variance (n,), s²."""

    mean_s: Array
    variance_s2: Array


def lost_tails(
    gaps_s: Array,
    cycle_s: float,
    tail_s: Array,
    fall_s: Array,
    share: Array,
    offset_s: Array | float = 0.0,
) -> LostTails:
    """What a pair within a second loses, that is close with the probability s.

    A valve that opens again after a gap loses x = exp(−gap/τ_f) of what it loses without one
    (:meth:`.Sampling.cut_tail_s`). A close pair has one of the gaps (m,)
    seen, any other one that is half a control cycle or more longer, up to a second, all as likely.
    A pulse that goes on for longer, by an offset, shortens the gap, and what overlaps is lost as
    well, y = offset − gap. Means and variances are those over all gaps. Gaps, the cycle and time
    constants are in s; ``tail_s`` (what is lost without a gap), τ_f, s and the offset are (n,).
    """
    fall, usual = np.maximum(fall_s, LEAST_FALL_S)[:, None], gaps_s + 0.5 * cycle_s
    tail, offset = tail_s[:, None], np.reshape(offset_s, (-1, 1))
    left, overlap = np.maximum(gaps_s - offset, 0.0), np.maximum(offset - gaps_s, 0.0)
    lost = tail * np.exp(-left / fall) + overlap
    usual = usual[usual < ALIKE_S]
    first, last = np.maximum(usual - offset, 0.0), np.maximum(ALIKE_S - offset, 0.0)
    most, least = np.maximum(offset - usual, 0.0), np.maximum(offset - ALIKE_S, 0.0)

    def later(power: int) -> Array:
        """Mean (n,) over the other gaps of the power of what is lost: tail x, or tail + y."""
        tau, next_power = fall / power, power + 1
        cut = tail**power * tau * (np.exp(-first / tau) - np.exp(-last / tau))
        covered = ((tail + most) ** next_power - (tail + least) ** next_power) / next_power
        return np.asarray(((cut + covered) / (ALIKE_S - usual)).sum(axis=1) / len(gaps_s))

    mean = share * lost.mean(axis=1) + (1.0 - share) * later(1)
    square = share * (lost**2).mean(axis=1) + (1.0 - share) * later(2)
    return LostTails(mean, np.maximum(square - mean**2, 0.0))


@dataclass(frozen=True)
class Layout:
    """Names and places of the columns: vector columns first, scalar columns after them."""

    wheels: tuple[int, ...]
    thrusters: tuple[str, ...]
    couples: tuple[tuple[int, ...], ...]
    cosines: int  # of torque noise that are unknowns
    levels: tuple[int, ...] = ()  # couples of roundings that are unknowns
    extra: tuple[str, ...] = ()

    @cached_property
    def vector(self) -> tuple[str, ...]:
        """Names of the vector columns."""
        walks = (f"walk:{order}" for order in range(1, 1 + self.cosines))
        steady = [f"{what}:{axis}" for what in ("initial", "torque", *walks) for axis in AXES]
        fired = [
            f"thrust:{name}:{axis}:{column}"
            for name in self.thrusters
            for axis in AXES
            for column in PULSE_COLUMNS
        ]
        return (*steady, *fired)

    @cached_property
    def scalar(self) -> tuple[str, ...]:
        """Names of the scalar columns."""
        return (
            *(f"rate:{axis}" for axis in AXES),
            "one",
            *(f"wheel:{number}" for number in self.wheels),
            *(f"turn:{axis}" for axis in AXES),
            *(
                f"cut:{self.thrusters[couple[0]]}:{part}"
                for couple in self.couples
                for part in ("mean", *range(CUT_PARTS))
            ),
            *(
                f"level:{self.thrusters[self.couples[couple][0]]}:{place}"
                for place, couple in enumerate(self.levels)
            ),
            *self.extra,
        )

    @property
    def size(self) -> int:
        """Number of columns A per axis."""
        return len(self.vector) + len(self.scalar)

    @property
    def initial(self) -> slice:
        """The three columns of the initial momentum."""
        return slice(0, 3)

    @property
    def torque(self) -> slice:
        """The three columns of a steady torque."""
        return slice(3, 6)

    @property
    def walk(self) -> slice:
        """What the slowest cosines of a random walk gained, (D, 3 axes) in this order."""
        return slice(self.torque.stop, self.torque.stop + 3 * self.cosines)

    @property
    def fired(self) -> slice:
        """Columns of the thrusters, (K, 3 axes, C pulse columns) in this order."""
        return slice(self.walk.stop, len(self.vector))

    @property
    def rate(self) -> slice:
        """The three body rates."""
        return slice(len(self.vector), len(self.vector) + 3)

    @property
    def one(self) -> int:
        """The constant."""
        return len(self.vector) + 3

    @property
    def wheel(self) -> slice:
        """The wheel rates."""
        return slice(len(self.vector) + 4, len(self.vector) + 4 + len(self.wheels))

    @property
    def turn(self) -> slice:
        """The turns of the attitude, in integrated columns alone."""
        return slice(self.wheel.stop, self.wheel.stop + 3)

    @property
    def cut(self) -> slice:
        """Cut tails and unlike pulses, :data:`CUT_COLUMNS` per couple."""
        return slice(self.turn.stop, self.turn.stop + CUT_COLUMNS * len(self.couples))

    @property
    def level(self) -> slice:
        """Roundings of counters that are unknowns."""
        return slice(self.cut.stop, self.cut.stop + len(self.levels))

    @property
    def extra_place(self) -> slice:
        """Columns that effects brought."""
        return slice(self.level.stop, self.size)


def layout_of(wheels: Sequence[int], thrusters: Sequence[str], sampling: Sampling) -> Layout:
    """The columns of an event with these wheels and thrusters."""
    count = walk_cosines(sampling.duration_s)
    return Layout(tuple(wheels), tuple(thrusters), sampling.couples, count)


@dataclass(frozen=True)
class Pairs:
    """Pairs of pulses that may be close together, by counter interval (m,) and couple (G,).

    Of every pair the tail of the first pulse may have been cut: ``square`` (m, G) counts pairs for
    variances, each by how often it is close against one of two pulses within a second, and by the
    square of what it loses against one of the event's mean widths. ``fired`` (m, G) tells which
    couples fired at all. ``unlike`` (m, G, C, C) are the covariances of what the pulse
    columns gain beyond what is expected (:meth:`.PulseBasis.scatter`), s², and ``slopes``
    (m, G, C) what they gain per on-time (:meth:`.PulseBasis.slopes`).
    """

    end_s: Array
    fired: NDArray[np.bool_]
    square: Array
    unlike: Array
    slopes: Array

    def steps(self, pair_s2: float) -> Array:
        """Variance (m, G) of what intervals gain beyond what is expected, over that of a pair."""
        return np.asarray(self.square + self.unlike[..., 0, 0] / pair_s2)

    @staticmethod
    def joined(parts: Sequence[Pairs]) -> Pairs:
        """Several stretches, one after the other."""
        return Pairs(
            *(
                np.concatenate([getattr(part, field.name) for part in parts])
                for field in fields(Pairs)
            )
        )


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
        return Rows(*(getattr(self, field.name)[places] for field in fields(self)))

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

    @staticmethod
    def joined(parts: Sequence[Rows]) -> Rows:
        """Several stretches of rows, one after the other."""
        return Rows(
            *(
                np.concatenate([getattr(part, field.name) for part in parts])
                for field in fields(Rows)
            )
        )


def direction_cosines(attitude: Array) -> Array:
    """Inertial-to-body matrices (N, 3, 3) of Euler parameters (N, 4), scalar last.

    C = (q4² − q·q) 1 + 2 q qᵀ − 2 q4 [q×].
    """
    vector, scalar = attitude[:, :3], attitude[:, 3]
    matrix = 2.0 * vector[:, :, None] * vector[:, None, :]
    diagonal = scalar**2 - (vector**2).sum(1)
    for axis in range(3):
        matrix[:, axis, axis] += diagonal
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[:, i, j] += 2.0 * scalar * vector[:, k]
        matrix[:, j, i] -= 2.0 * scalar * vector[:, k]
    return np.asarray(matrix)


def settle(
    samples: Samples, carry: Carry, layout: Layout, sampling: Sampling, final: bool
) -> tuple[Rows, Carry]:
    """Columns of one chunk, and what the next needs.

    Rows after the last reading of unchanged counters wait for the next chunk unless this is the
    final one, and so does a reading until there is an attitude after it: the result does not depend
    on where chunks end.
    """
    if carry.waiting is not None:
        samples = Samples.joined([carry.waiting, samples])
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
        rows = Rows.joined([carry.block, rows])
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
    counted = Counted(now, carry.done_until_s)
    fired = _impulses(counted, *known, carry, sampling)
    pairs, weight = pairs_of(counted, layout, sampling)
    added = _cut_columns(pairs, weight, layout, sampling)
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


def cosines(time_s: Array, duration_s: float, count: int) -> Array:
    """The cosines cos(m π t/T), m = 0 … M − 1, at times (n,): (n, M)."""
    return np.asarray(np.cos(np.pi / duration_s * time_s[:, None] * np.arange(count)))


def walk_scales(duration_s: float, cosines: int) -> Array:
    """Standard deviations (1 + cosines,) of the mean and the cosines of a unit random walk, s^½.

    Momentum gained from white torque noise of density a² has a mean of variance a² T/3 and cosine
    coefficients of variance 2 a² T/(m π)² (Karhunen-Loève expansion of a random walk about its
    mean).
    """
    order = np.arange(1, 1 + cosines)
    return np.asarray(np.sqrt(duration_s) * np.r_[1.0 / np.sqrt(3.0), np.sqrt(2.0) / order / np.pi])


def walk_columns(time_s: Array, since_start: Array, duration_s: float, count: int) -> Array:
    """R e_j [cos(mπt/T) − 1] (n, 3, 3 M), M cosines; ``since_start`` (n, 3, 3) are the R e_j."""
    gained = cosines(time_s, duration_s, 1 + count)[:, 1:] - 1.0
    columns = gained[:, None, :, None] * since_start[:, :, None, :]
    return np.asarray(columns.reshape(len(time_s), 3, 3 * count))


class Counted:
    """Counter intervals of a stretch of telemetry in which something fired, after a time."""

    def __init__(self, samples: Samples, after_s: float) -> None:
        counted = samples.has_counters
        self.time_s = samples.time_s[counted]
        self.total_on_time = samples.on_time_s[counted]
        self.total_pulses = samples.pulses[counted]
        self.on_time = np.diff(self.total_on_time, axis=0)
        self.pulses = np.diff(self.total_pulses, axis=0)
        changed = np.any((self.on_time != 0) | (self.pulses != 0), axis=1)
        self.active = np.flatnonzero(changed & (self.time_s[1:] > after_s))

    def events_before(self, time: Array) -> NDArray[np.intp]:
        """How many of the active intervals have ended by each time."""
        ends = self.time_s[self.active + 1] if len(self.active) else np.empty(0)
        return np.searchsorted(ends, time + SAME_S, side="right")


def _attitudes(
    time: Array, attitude: Array, following: tuple[Array, Array], carry: Carry
) -> tuple[Array, Array]:
    """Times (n,) and attitudes (n, 3, 3) of a stretch, with one before and one after it."""
    times, attitudes = [time, following[0]], [attitude, following[1]]
    begins = np.concatenate(times)[:1]
    if carry.last_attitude is not None and not (begins <= carry.last_time_s).any():
        times.insert(0, np.array([carry.last_time_s]))
        attitudes.insert(0, carry.last_attitude[None])
    return np.concatenate(times), np.concatenate(attitudes)


def _settled(samples: Samples, complete: Places) -> int:
    """Last row that may be worked up.

    It is the last reading after which the counters did not change, and which a complete row
    follows, or is.
    """
    if samples.on_time_s.shape[1] == 0:
        return len(samples) - 1
    if len(samples) >= MOST_WAITING:
        complete = np.array([len(samples)])
    counted = np.flatnonzero(samples.has_counters)
    values = np.concatenate([samples.on_time_s[counted], samples.pulses[counted]], axis=1)
    same = np.flatnonzero(~np.any(np.diff(values, axis=0) != 0, axis=1))
    same = same[counted[same] <= complete.max(initial=-1)]
    if len(same) == 0:
        return 0 if len(samples) < MOST_WAITING else len(samples) - 1
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


def close_pairs(length_s: Array, pulses: Array, before: Array) -> Array:
    """Pairs (m, G) within each of some counter intervals, and across the reading before it.

    Counters show neither which pairs were a control cycle apart nor what share. The share depends
    on the controller and is inferred (docs/topics/telemetry-likelihood.md §7). The more pulses an
    interval has, the closer they are.

    Parameters
    ----------
    length_s
        (m,) of the intervals.
    pulses
        (m, G) that every couple began in them.
    before
        (m, G) that it fired in the intervals before them, one at least where it fired.
    """
    alike = np.minimum(1.0, ALIKE_S / length_s)[:, None]
    within = np.minimum(alike * np.maximum(0.5 * pulses, 1.0), MOST_ALIKE)
    across = np.minimum(pulses * before, MOST_ACROSS)
    return np.asarray(within * np.maximum(pulses - 1.0, 0.0) + alike * ACROSS * across)


def pairs_of(counted: Counted, layout: Layout, sampling: Sampling) -> tuple[Pairs, Array]:
    """Pairs of the active intervals of a stretch of telemetry, which begins with an idle one.

    Returns also how many there are (m, G), each by what it loses.
    """
    active = counted.active
    groups = [list(couple) for couple in layout.couples]
    pulses = np.zeros((len(counted.pulses), len(groups)))
    fired = np.zeros((len(counted.pulses), len(groups)), dtype=bool)
    for g, members in enumerate(groups):
        pulses[:, g] = counted.pulses[:, members].max(axis=1, initial=0.0)
        on_time = counted.on_time[:, members].max(axis=1, initial=0.0)
        fired[:, g] = (pulses[:, g] > 0.0) | (on_time > 0.0)
    fired_of = np.maximum(pulses, fired)
    before = np.concatenate([np.zeros_like(fired_of[:1]), fired_of[:-1]])
    scatter, slopes, width = (of_all[active] for of_all in _of_firings(counted, layout, sampling))
    pairs = close_pairs(np.diff(counted.time_s)[active], pulses[active], before[active])
    lose = sampling.cut_by_width(width)
    end_s, own = counted.time_s[active + 1], fired[active]
    return Pairs(end_s, own, pairs * lose**2, scatter, slopes), pairs * lose


def _of_firings(counted: Counted, layout: Layout, sampling: Sampling) -> tuple[Array, Array, Array]:
    """What unlike pulses of a firing scatter (m, G, C, C), where it ends, slopes (m, G, C), widths.

    Widths (m, G), s, are means over the pulses of a firing, 0 without one.
    """
    slopes = np.zeros((len(counted.pulses), len(layout.couples), len(PULSE_COLUMNS)))
    scatter, width = np.zeros((*slopes.shape, len(PULSE_COLUMNS))), np.zeros(slopes.shape[:2])
    for g, members in enumerate(map(list, layout.couples)):
        gained, begun = (
            of_all[:, members].max(axis=1) for of_all in (counted.on_time, counted.pulses)
        )
        own = firings(gained, begun)
        ends = own.active[np.diff(own.number, append=len(own.pulses)) > 0]
        mean = own.seconds / own.pulses
        scatter[ends, g] = sampling.pulses.scatter(mean, own.pulses)
        slopes[own.active, g] = sampling.pulses.slopes(mean, own.pulses)[own.number]
        width[own.active, g] = np.maximum(mean, 0.0)[own.number]
    return scatter, slopes, width


def _cut_columns(pairs: Pairs, weight: Array, layout: Layout, sampling: Sampling) -> Array:
    """What every active interval adds to the columns of cut tails, (m, S)."""
    m, part = len(pairs.end_s), quarter_of(pairs.end_s, sampling.duration_s)
    table = np.zeros((m, len(layout.couples), CUT_COLUMNS))
    table[:, :, 0] = weight
    table[np.arange(m), :, 1 + part] = pairs.steps(sampling.pair_s2)
    return table.reshape(m, CUT_COLUMNS * len(layout.couples))


def quarter_of(time_s: Array, duration_s: float) -> NDArray[np.intp]:
    """Part of the event (m,) that times lie in."""
    return np.clip((CUT_PARTS * time_s / duration_s).astype(np.intp), 0, CUT_PARTS - 1)


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
