"""One streaming pass over an event's telemetry to its Gram matrices.

For white channel noise the telemetry enters the likelihood only through inner products of its
columns. They add over chunks, files and machines; after the pass the cost of a likelihood call does
not depend on the number of samples (``docs/topics/telemetry-likelihood.md`` §6).
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics.channel_noise import NOT_SEEN, ChannelNoise
from cassini_bayes.balance.statistics.columns import Carry, Rows, settle
from cassini_bayes.balance.statistics.layout import Layout
from cassini_bayes.balance.statistics.long_levels import (
    NO_LEVELS,
    KnownLevels,
    LongLevels,
    longest,
)
from cassini_bayes.balance.statistics.pairs import Counted, Pairs, pairs_of, quarter_of
from cassini_bayes.balance.statistics.pulse_columns import PULSE_COLUMNS
from cassini_bayes.balance.statistics.rounded_counters import KNOWN, Rounding
from cassini_bayes.balance.statistics.rows import SAME_S, Samples
from cassini_bayes.balance.statistics.sampling import Sampling
from cassini_bayes.balance.statistics.turns import (
    LEAST_PIECE,
    SLOPE_WAVES,
    SWING_GROUPS,
    piece_breaks,
    piece_ends,
    turned,
)
from cassini_bayes.balance.statistics.walk import walk_cosines
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.errors import InputError
from cassini_bayes.files.arrays import read_arrays, write_arrays

MODES: Final = 512  # at 1 Hz the remainder is faster than 6 s in a bias of 1,500 s
_FORMAT: Final = 23  # raised with every change of what is stored
BLOCK_ROWS: Final = 4_096  # some 10 MB of columns at a time
MOST_TIMES: Final = 4_096  # of rows, for what counters leave open: some percent of a small noise
MOST_STEPS: Final = 384  # intervals with firings of a couple that are told apart
STEPS_BY_ROW: Final = 4  # at most: where rows are means over blocks more of them tell nothing
# Steps of counters below which bands and single columns of what is open agree: with 1 ms the truth
# of a flight is 13 nats below the highest density by either
# (docs/results/likelihood-experiments.md).
COARSE_STEP_S: Final = 3e-3


@dataclass(frozen=True, eq=False)
class EventStatistics:
    """Sufficient statistics of one telemetry event; equal to nothing but itself.

    ``gram[c, d]`` (3, 3, A, A) holds Σ_t a_c(t) b_d(t) for all pairs of columns and axes;
    ``projection`` (M, 3, A) = Σ_t φ_m(t) a_c(t) and ``mode_gram`` (M, M) = Σ_t φ_m φ_l belong to
    the cosines φ_m(t) = cos(m π t / T), m = 1 … M, of the torque noise. ``turns`` are those of the
    integrated columns of quiet pieces, ``counters`` what counters leave open, ``extra_end`` (X,)
    what the layout's extra columns have come to in the last row.
    """

    event_id: str
    kind: str
    layout: Layout
    duration_s: float
    rows: int
    gram: Array
    projection: Array
    mode_gram: Array
    cuts: Array  # (S,) of every cut column at the end: pairs, or their like in variance
    counter_interval_s: float  # usual time between two readings of the counters, 0 without
    turns: TurnStatistics
    counters: CounterStatistics
    steps: ChannelSteps
    noise: ChannelNoise
    shown: ShownWheels
    extra_end: Array

    def seen_by(self, sampling: Sampling) -> Sampling:
        """A sampling with what the event says of its pulses and of the noise of its channels."""
        return self.noise.seen_by(self.counters.seen_by(sampling))


@dataclass(frozen=True, eq=False)
class TurnStatistics:
    """Inner products of integrated, centred columns of quiet pieces, and their noise.

    Of the ``pieces`` slopes: ``slope_gram`` (3, 3, A, A), and with the cosines m = 0 … M of the
    momentum ``slope_projection`` (1 + M, 3, A) and ``slope_mode_gram`` (1 + M, 1 + M);
    ``slope_time_s`` (r,) and ``slope_waves`` (r, 1 + M) are evenly thinned times of the pieces and
    the cosines there, the first of them |t − t̄|, ``slope_summed_s2`` (r,) the variances of summed
    white noise, ``slope_beyond_s3`` (r,) those of what a unit random walk has beside these cosines,
    and ``slope_shown`` (r, 2 + 2 W) the lines through their wheel rates; each stands
    for ``slope_stride`` pieces. Of the ``contrasts`` (G,) that are left, in groups: ``gram``
    (G, 3, 3, A, A), ``summed_s2`` (G,) and ``walked_s3`` (G,), mean squares per contrast
    (:class:`cassini_bayes.balance.statistics.turns.Turned`).
    """

    pieces: int
    slope_gram: Array
    slope_projection: Array
    slope_mode_gram: Array
    slope_time_s: Array
    slope_waves: Array
    slope_summed_s2: Array
    slope_beyond_s3: Array
    slope_shown: Array
    slope_stride: int
    contrasts: Places
    gram: Array
    summed_s2: Array
    walked_s3: Array


@dataclass(frozen=True, eq=False)
class CounterStatistics:
    """What counters leave open, by the times of the intervals in which something fired.

    ``row_time_s`` (r,) are evenly thinned times of the rows, each for ``stride`` of them;
    ``end_s`` (R,) are the intervals, ``fired`` (R, G) which couples did in them, ``square``
    (R, G) the pairs in them that may be close, by what they scatter, ``unlike`` (R, G, C, C) what
    unlike pulses scatter, ``steps`` (R, G) the nominal variances of both and ``slopes`` (R, G, C)
    what columns gain per on-time (:class:`Pairs`); ``open_s2`` (G,), ``open_ratio`` (R, G)
    and ``open_every`` (G,) say what rounded counters leave open of a couple's levels
    (:class:`.rounded_counters.Rounding`). ``gaps_s`` (m,) are the times,
    all as likely, from the end of a pulse to the next one of a pair that is close, ``paired_s``
    (m,) widths of pulses in pairs; ``widths_s``
    (m,) are widths of pulses, all as likely, none if they are not known, ``unsure_s`` how well the
    on-time of a firing is known. Where rows have pulses
    that are late, they are means over ``averaged`` rows in blocks of ``block_s`` (``block_rows``
    usually), ``late_width_s``
    is the mean width of pulses, ``late_rate_hz`` (G,) how often couples fire, ``late_first_s`` and
    ``late_every_s`` the ages at which readings find a pulse (:class:`LateRows`). ``step_s`` is the
    step of counters whose on-times are not known exactly, else 0. ``level_…`` are roundings that
    are unknowns (:class:`.LongLevels`).
    """

    row_time_s: Array
    stride: int
    end_s: Array
    fired: NDArray[np.bool_]
    square: Array
    unlike: Array
    steps: Array
    slopes: Array
    open_s2: Array
    open_ratio: Array
    open_every: Array
    gaps_s: Array
    paired_s: Array
    widths_s: Array
    unsure_s: float
    block_s: float
    block_rows: float
    averaged: float
    late_width_s: float
    late_rate_hz: Array
    late_first_s: float
    late_every_s: float
    step_s: float
    level_couple: Places
    level_begin_s: Array
    level_end_s: Array
    level_value_s: Array

    @property
    def has_late_pulses(self) -> bool:
        """Whether rows have pulses that are late: hardly one is without firing."""
        return self.block_s > 0.0

    @property
    def are_coarse(self) -> bool:
        """Whether what counters leave open is so much that its size matters."""
        return self.step_s > COARSE_STEP_S

    @property
    def long_levels(self) -> LongLevels:
        """Roundings that are unknowns."""
        return LongLevels(
            self.level_couple, self.level_begin_s, self.level_end_s, self.level_value_s
        )

    def seen_by(self, sampling: Sampling) -> Sampling:
        """A sampling with what the event's counters say of its pulses."""
        return replace(
            sampling,
            widths_s=tuple(self.widths_s.tolist()),
            unsure_s=self.unsure_s,
            gaps_s=tuple(self.gaps_s.tolist()),
            paired_s=tuple(self.paired_s.tolist()),
            block_s=self.block_s,
            block_rows=self.block_rows,
            levels=self.long_levels,
        )


@dataclass(frozen=True, eq=False)
class ShownWheels:
    """Measured wheel rates ``rate_rad_s`` (r, W) at the thinned rows of :class:`CounterStatistics`.

    Their rounding is the same in all rows in which a wheel rests.
    """

    rate_rad_s: Array


@dataclass(frozen=True)
class ChannelSteps:
    """Least steps of measured rates and wheel rates, 0 where they have none to be seen."""

    rate_rad_s: float = 0.0
    wheel_rad_s: float = 0.0


@dataclass(frozen=True)
class LateRows:
    """Of rows that have late pulses: length of their blocks, mean width of pulses, and how often.

    ``block_s`` is 0 where rows are between firings, else ``block_rows`` are usual in one;
    ``rate_hz`` (K,) is of every thruster. Readings
    find a pulse ``first_s`` after it begins or any number of times ``every_s`` later, which is 0
    where they find it at any time.
    """

    block_s: float = 0.0
    block_rows: float = 0.0
    width_s: float = 0.0
    rate_hz: tuple[float, ...] = ()
    first_s: float = 0.0
    every_s: float = 0.0


@dataclass(frozen=True)
class Preparation:
    """What a first look at an event's telemetry found, for the pass that reduces it."""

    steps: ChannelSteps = ChannelSteps()
    noise: ChannelNoise = NOT_SEEN
    read_s: Array = field(default_factory=lambda: np.zeros(0))  # (m,) readings around changes
    on_time_s: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (m, K) expected there
    pulses: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (m, K) counted there
    rounding: tuple[Rounding, ...] = ()  # (K,) of the thrusters' counters, between these
    gaps_s: tuple[float, ...] = ()  # of close pulses; without, a control cycle
    paired_s: tuple[float, ...] = ()  # widths of pulses that may be close
    widths_s: tuple[float, ...] = ()  # of pulses; without, those of a firing are alike
    late: LateRows = LateRows()  # without rows between firings

    @property
    def unsure_s(self) -> float:
        """Standard deviation of a usual firing's on-time, s, of the least known counter."""
        return math.sqrt(max((one.unsure_s2 for one in self.rounding), default=0.0))


@dataclass(frozen=True)
class _Inner:
    """Inner products over rows of vector columns (their axis first), scalar columns and cosines."""

    columns: Array  # (3 V + S, 3 V + S)
    mixed: Array  # (M, 3 V + S)
    modes: Array  # (M, M)

    def gather(self, other: _Inner) -> None:
        """Add those of other rows in place."""
        for own, more in zip(
            (self.columns, self.mixed, self.modes),
            (other.columns, other.mixed, other.modes),
            strict=True,
        ):
            own += more


def _inner_products(rows: Rows, layout: Layout, duration_s: float) -> _Inner:
    """Inner products over some rows, by symmetric products: scalars and twins only once."""
    n, scalars = len(rows.time_s), rows.scalar.shape[1]
    source = _twins(rows.vector, layout)
    own = np.flatnonzero(source == np.arange(len(source)))
    vector = rows.vector if len(own) == len(source) else rows.vector[:, :, own]
    vector = vector.reshape(n, -1)
    waves, to_modes = local_waves(rows.time_s / duration_s)
    rest = np.concatenate([rows.scalar, waves], axis=1)
    mixed, inner = vector.T @ rest, rest.T @ rest
    on_waves = np.concatenate([mixed[:, scalars:], inner[:scalars, scalars:]]).T
    mixed, scalar = mixed[:, :scalars], inner[:scalars, :scalars]
    every = np.r_[
        (np.arange(3)[:, None] * len(own) + np.searchsorted(own, source)).reshape(-1),
        3 * len(own) + np.arange(scalars),
    ]
    columns = np.block([[vector.T @ vector, mixed], [mixed.T, scalar]])
    modes = inner[scalars:, scalars:]
    if to_modes is not None:
        on_waves, modes = to_modes @ on_waves, to_modes @ modes @ to_modes.T
    return _Inner(columns[every[:, None], every], on_waves[:, every], modes)


def _by_axes(columns: Array, layout: Layout) -> Array:
    """Gram matrices (..., 3, 3, A, A), one per pair of axes, of those (..., 3 V + S, 3 V + S)."""
    vectors = len(layout.vector)
    own = [slice(c * vectors, (c + 1) * vectors) for c in range(3)]
    first, scalar, scalars = slice(vectors), slice(vectors, None), slice(3 * vectors, None)
    gram = np.empty((*columns.shape[:-2], 3, 3, layout.size, layout.size))
    for c, row in enumerate(own):
        for d, column in enumerate(own):
            block = gram[..., c, d, :, :]
            block[..., first, first] = columns[..., row, column]
            block[..., first, scalar] = columns[..., row, scalars]
            block[..., scalar, first] = columns[..., scalars, column]
            block[..., scalar, scalar] = columns[..., scalars, scalars]
    return gram


def _mixed_by_axes(mixed: Array, layout: Layout) -> Array:
    """Inner products (M, 3, A) with the columns of every axis, of those (M, 3 V + S)."""
    vectors = len(layout.vector)
    own, scalar = np.split(mixed, [3 * vectors], axis=1)
    by_axis = own.reshape(len(mixed), 3, vectors)
    along = np.broadcast_to(scalar[:, None], (len(mixed), 3, scalar.shape[1]))
    return np.concatenate([by_axis, along], axis=2)


def _twins(vector: Array, layout: Layout) -> NDArray[np.intp]:
    """For every vector column (V,) the first that is the same: thrusters of a couple often are."""
    source = np.arange(len(layout.vector))
    fired = source[layout.fired].reshape(-1, 3 * len(PULSE_COLUMNS))
    for couple in layout.couples:
        first = fired[couple[0]]
        for other in (fired[k] for k in couple[1:]):
            if np.array_equal(vector[..., first], vector[..., other]):
                source[other] = first
    return source


def local_waves(turn: Array) -> tuple[Array, Array | None]:
    """Functions (n, D) of places x = t/T (n,) that the cosines cos(m π x) are made of, and how.

    Returns also the (M, D) matrix that makes the cosines of them, None if they are the cosines.
    Where many rows span a small part of the event, all cosines are sums of few Chebyshev
    polynomials, to rounding: with phases of up to ±φ about the middle, polynomial d has a weight of
    the size of the Bessel function J_d(φ).
    """
    middle, half = 0.5 * (turn.min() + turn.max()), 0.5 * (turn.max() - turn.min())
    phase = np.pi * MODES * half
    count = int(phase + 9.0 * np.cbrt(phase) + 16.0)
    order = np.arange(1, MODES + 1)
    if count >= min(MODES, len(turn)):
        return np.cos(np.pi * turn[:, None] * order), None
    node = np.pi * (np.arange(count) + 0.5) / count
    at_nodes = np.cos(np.pi * order[:, None] * (middle + half * np.cos(node)))
    weights = 2.0 / count * at_nodes @ np.cos(node[:, None] * np.arange(count))
    weights[:, 0] *= 0.5
    x = (turn - middle) / max(half, np.finfo(float).tiny)
    waves = np.empty((count, len(turn)))
    waves[0], waves[1] = 1.0, x
    for d in range(2, count):
        waves[d] = 2.0 * x * waves[d - 1] - waves[d - 2]
    return waves.T, weights


def reduce_chunks(
    event_id: str,
    kind: str,
    chunks: Iterable[Samples],
    layout: Layout,
    sampling: Sampling,
    block_rows: int = BLOCK_ROWS,
    prepared: Preparation | None = None,
) -> EventStatistics:
    """Reduce telemetry that comes in chunks, in memory for one and for what was fired.

    Parameters
    ----------
    chunks
        Rows in order of time, as :class:`Samples`.
    block_rows
        Most rows whose columns are made at once: what extra columns see of an event.
    prepared
        What a first look found; without it no channel is rounded.

    Raises
    ------
    InputError
        Fewer than five rows can be used, or a counter's steps are longer than the pulses.
    """
    prepared = prepared or Preparation()
    _require_readable(event_id, layout, prepared.rounding)
    sampling = replace(
        sampling,
        widths_s=prepared.widths_s,
        unsure_s=prepared.unsure_s,
        gaps_s=prepared.gaps_s or (sampling.control_cycle_s,),
        paired_s=prepared.paired_s or sampling.paired_s,
        block_s=prepared.late.block_s,
        block_rows=prepared.late.block_rows,
    )
    sampling = replace(sampling, levels=_long_levels(prepared, layout, sampling))
    layout = replace(layout, levels=sampling.levels.couples)
    carry, used, at_readings, interval = Carry.start(layout), 0, 0, 0.0
    size = 3 * len(layout.vector) + len(layout.scalar)
    inner = _Inner(np.zeros((size, size)), np.zeros((MODES, size)), np.zeros((MODES, MODES)))
    turns, times, wheels = _Turns(layout, sampling), Thinned(), Thinned()
    wheel = slice(layout.wheel.start - len(layout.vector), layout.wheel.stop - len(layout.vector))
    extra_end = np.zeros(len(layout.extra))
    extra = slice(layout.extra_place.start - len(layout.vector), None)
    for chunk, final in _with_end(_in_blocks(chunks, block_rows)):
        rows, carry = settle(chunk, carry, layout, sampling, final)
        if len(rows.time_s) > 0:
            inner.gather(_inner_products(rows, layout, sampling.duration_s))
            turns.add(rows)
            times.add(rows.time_s)
            wheels.add(rows.scalar[:, wheel])
            extra_end = rows.scalar[-1, extra]
            used += len(rows.time_s)
        at_readings += int((chunk.has_state & chunk.has_counters).sum())
        interval = interval or counter_interval(chunk)
    if used < LEAST_ROWS:
        blocks = f" means over {sampling.block_s:g} s" if sampling.block_s > 0.0 else ""
        raise InputError(
            f"event {event_id}: telemetry",
            f"at least {LEAST_ROWS} rows with attitude, body rates and wheel rates at one time, "
            f"none within {sampling.guard_s:.2f} s of a firing, "
            "or as many means over rows at readings of the counters",
            f"{used}{blocks}",
            "give more telemetry, or the counters at a faster rate",
        )
    averaged = at_readings / used if sampling.block_s > 0.0 else 1.0
    return EventStatistics(
        event_id=event_id,
        kind=kind,
        layout=layout,
        duration_s=sampling.duration_s,
        rows=used,
        gram=_by_axes(inner.columns, layout),
        projection=_mixed_by_axes(inner.mixed, layout),
        mode_gram=inner.modes,
        cuts=carry.cuts,
        counter_interval_s=interval,
        turns=turns.statistics(),
        counters=_counter_statistics(
            Pairs.joined(carry.pairs), times, sampling, prepared, layout, averaged
        ),
        steps=prepared.steps,
        noise=prepared.noise,
        shown=ShownWheels(wheels.values),
        extra_end=extra_end,
    )


def _require_readable(event_id: str, layout: Layout, rounding: Sequence[Rounding]) -> None:
    """Refuse counters whose steps hide the pulses: what was fired cannot be read from them.

    The widths' scatter, which would then be noise, is not known well enough from such readings:
    overstated noise makes the inertia several standard deviations too large.
    """
    for name, own in zip(layout.thrusters, rounding, strict=False):
        if own.step_s > own.width_s:
            raise InputError(
                f"event {event_id}: on_time_{name}_s",
                f"a counter in finer steps than its pulses, {own.width_s:.3f} s on average",
                f"steps of {own.step_s:g} s",
                "give the counter in finer steps, or the sums of the bias as a totals row; if "
                "pulses are whole numbers of control cycles, say so by control_cycle_s in the "
                "spacecraft file",
            )


class Thinned:
    """Rows of arrays (n, …) that come in stretches, evenly thinned in constant memory.

    ``kept`` are those that stay, each for ``stride`` rows.
    """

    def __init__(self) -> None:
        self.stride = 1
        self._seen = 0
        self.kept: list[Array] = []

    def add(self, values: Array) -> None:
        """Take some more rows."""
        number = np.arange(self._seen, self._seen + len(values))
        self._seen += len(values)
        self.kept.append(values[number % self.stride == 0])
        while sum(map(len, self.kept)) > MOST_TIMES:
            self.kept = [self.values[::2]]
            self.stride *= 2

    @property
    def values(self) -> Array:
        """Those that stay, in one array."""
        return np.concatenate(self.kept)


def _long_levels(prepared: Preparation, layout: Layout, sampling: Sampling) -> LongLevels:
    """Roundings that are unknowns, of counters in coarse steps, from a first look at them."""
    coarse = any(one.step_s > COARSE_STEP_S for one in prepared.rounding)
    if not coarse or sampling.block_s > 0.0 or len(prepared.on_time_s) == 0:
        return NO_LEVELS
    nothing = np.full((len(prepared.read_s), 4), np.nan)
    samples = Samples(
        prepared.read_s, nothing, nothing[:, :3], nothing[:, :1], prepared.on_time_s,
        prepared.pulses,
    )  # fmt: skip
    pairs, _ = pairs_of(Counted(samples, -np.inf), layout, sampling)
    by_couple = _by_couple(prepared.rounding, layout)
    known = KnownLevels(
        pairs.end_s,
        pairs.fired,
        pairs.slopes,
        np.array([one.variance_s2 for one in by_couple]),
        _open_ratios(by_couple, prepared.read_s, pairs.end_s),
        np.array([one.every for one in by_couple]),
    )
    return longest(known, sampling.duration_s)


def _counter_statistics(
    pairs: Pairs,
    times: Thinned,
    sampling: Sampling,
    prepared: Preparation,
    layout: Layout,
    averaged: float,
) -> CounterStatistics:
    """Intervals with firings, neighbours joined where there are very many."""
    by_couple, late = _by_couple(prepared.rounding, layout), prepared.late
    steps = pairs.steps(sampling.pair_s2)
    ratio = _open_ratios(by_couple, prepared.read_s, pairs.end_s)
    rows = max(len(times.values) * times.stride, 1)
    most = min(MOST_STEPS, STEPS_BY_ROW * rows)
    whole = frozenset(sampling.levels.couples)
    pairs, steps, ratio = _joined(pairs, steps, ratio, sampling.duration_s, most, whole)
    return CounterStatistics(
        times.values,
        times.stride,
        pairs.end_s,
        pairs.fired,
        pairs.square,
        pairs.unlike,
        steps,
        pairs.slopes,
        np.array([one.variance_s2 for one in by_couple]),
        ratio,
        np.array([one.every for one in by_couple]),
        np.array(sampling.gaps_s),
        np.array(sampling.paired_s),
        np.array(sampling.widths_s),
        sampling.unsure_s,
        sampling.block_s,
        sampling.block_rows,
        averaged,
        late.width_s,
        np.array([max((late.rate_hz[k] for k in own), default=0.0) for own in layout.couples])
        if late.rate_hz
        else np.zeros(len(by_couple)),
        late.first_s,
        late.every_s,
        max((one.step_s for one in by_couple), default=0.0),
        sampling.levels.couple,
        sampling.levels.begin_s,
        sampling.levels.end_s,
        sampling.levels.value_s,
    )


def _joined(
    pairs: Pairs,
    steps: Array,
    ratio: Array,
    duration_s: float,
    most: int,
    whole: Container[int] = (),
) -> tuple[Pairs, Array, Array]:
    """Intervals with their steps and ratios (m, G), a couple's neighbours joined beyond so many.

    What joined ones have together is in the first of them: each couple has its own, as a level in a
    wrong place shows. None is joined over a quarter's end, as a column of cut tails stands for what
    is in its own quarter. Couples that are to stay ``whole`` keep theirs.
    """
    quarter = quarter_of(pairs.end_s, duration_s)
    fired, steps, ratio = pairs.fired.copy(), steps.copy(), ratio.copy()
    square, unlike, slopes = pairs.square.copy(), pairs.unlike.copy(), pairs.slopes.copy()
    for g in range(fired.shape[1]):
        own = np.flatnonzero(fired[:, g] | (steps[:, g] > 0.0))
        every = -(-len(own) // most)
        if every < 2 or g in whole:
            continue
        number = np.arange(len(own)) - np.searchsorted(quarter[own], quarter[own])
        starts = np.flatnonzero(number % every == 0)
        first, firings = own[starts], np.add.reduceat(fired[own, g].astype(np.float64), starts)
        for each in (square, unlike, steps, ratio, slopes):
            together = np.add.reduceat(each[own, g], starts, axis=0)
            each[own, g] = 0.0
            each[first, g] = together
        slopes[first, g] /= np.maximum(firings, 1.0)[:, None]
        fired[own, g] = False
        fired[first, g] = firings > 0.0
    kept = np.flatnonzero(fired.any(axis=1) | (steps > 0.0).any(axis=1))
    end_s, fired = pairs.end_s[kept], fired[kept]
    joined = Pairs(end_s, fired, square[kept], unlike[kept], slopes[kept])
    return joined, steps[kept], ratio[kept]


def _open_ratios(by_couple: Sequence[Rounding], read_s: Array, end_s: Array) -> Array:
    """Of every couple's :class:`Rounding`, at the ends (R,) of intervals with firings, (R, G)."""
    result = np.full((len(end_s), len(by_couple)), np.inf)
    place = np.searchsorted(read_s[1:], end_s - SAME_S)
    for g, one in enumerate(by_couple):
        if len(one.ratio) > 0:
            result[:, g] = one.ratio[place]
    return result


def _by_couple(rounding: Sequence[Rounding], layout: Layout) -> list[Rounding]:
    """What stays open of every couple's counters, from those of its thrusters."""
    by_thruster = rounding or (KNOWN,) * len(layout.thrusters)
    return [
        max((by_thruster[k] for k in own), key=lambda one: one.variance_s2)
        for own in layout.couples
    ]


class _Turns:
    """Gathers the inner products of quiet pieces from rows that come in stretches."""

    def __init__(self, layout: Layout, sampling: Sampling) -> None:
        size, waves = 3 * len(layout.vector) + len(layout.scalar), SLOPE_WAVES + 1
        self._layout, self._sampling = layout, sampling
        self._waiting: list[Rows] = []
        self._before = 0  # rows of the piece before, by which a corner at the first row shows
        self._places = Thinned()  # (p, …) times, cosines, noise and walk, lines of wheel rates
        self._pieces, self._contrasts = 0, np.zeros(SWING_GROUPS, dtype=np.int64)
        self._slopes = _Inner(
            np.zeros((size, size)), np.zeros((waves, size)), np.zeros((waves, waves))
        )
        self._swings = np.zeros((SWING_GROUPS, size, size))
        self._squares = np.zeros((SWING_GROUPS, 2))

    def add(self, rows: Rows) -> None:
        """Take more rows; those of a piece that may go on wait."""
        rows = Rows.joined([*self._waiting, rows])
        self._waiting = [rows]
        if len(rows.time_s) > LEAST_PIECE:
            self._work_up(is_last=False)

    def _work_up(self, *, is_last: bool) -> None:
        """Gather the pieces that are over."""
        if not self._waiting or len(self._waiting[0].time_s) < LEAST_PIECE:
            return
        (rows,), first = self._waiting, self._before
        breaks = piece_breaks(rows, self._layout, self._sampling)
        ends = [first + end for end in piece_ends(rows.time_s[first:], breaks[first:])]
        if not is_last:
            ends = ends[:-1]
        found = turned(rows, self._layout, ends, self._sampling)
        slopes, waves = found.slopes, found.waves
        self._slopes.gather(_Inner(slopes.T @ slopes, waves.T @ slopes, waves.T @ waves))
        times, squares = found.time_s[:, None], np.stack([found.summed_s2, found.beyond_s3], axis=1)
        self._places.add(np.concatenate([times, waves, squares, found.shown], axis=1))
        self._pieces += len(slopes)
        for own, swings in zip(self._swings, found.swings, strict=True):
            own += swings.T @ swings
        self._contrasts += found.counts
        self._squares += found.squares
        self._before = min(ends[-1], 1)
        self._waiting = [rows.part(slice(ends[-1] - self._before, None))]

    def statistics(self) -> TurnStatistics:
        """All of it, once the last rows have been added."""
        self._work_up(is_last=True)
        summed, walked = (self._squares / np.maximum(self._contrasts, 1)[:, None]).T.copy()
        width = SLOPE_WAVES + 6 + 2 * len(self._layout.wheels)
        places = np.concatenate([np.zeros((0, width)), *self._places.kept])
        return TurnStatistics(
            self._pieces,
            _by_axes(self._slopes.columns, self._layout),
            _mixed_by_axes(self._slopes.mixed, self._layout),
            self._slopes.modes,
            places[:, 0].copy(),
            places[:, 1 : SLOPE_WAVES + 2].copy(),
            places[:, SLOPE_WAVES + 2].copy(),
            places[:, SLOPE_WAVES + 3].copy(),
            places[:, SLOPE_WAVES + 4 :].copy(),
            self._places.stride,
            self._contrasts,
            _by_axes(self._swings, self._layout),
            summed,
            walked,
        )


def _in_blocks(chunks: Iterable[Samples], rows: int) -> Iterator[Samples]:
    """The same rows in blocks whose columns stay in the processor's cache."""
    for chunk in chunks:
        if len(chunk) <= rows:
            yield chunk
        else:
            for start in range(0, len(chunk), rows):
                yield chunk.part(start, start + rows)


def _with_end(blocks: Iterator[Samples]) -> Iterator[tuple[Samples, bool]]:
    """Every block, and whether it is the last."""
    previous: Samples | None = None
    for block in blocks:
        if previous is not None:
            yield previous, False
        previous = block
    if previous is not None:
        yield previous, True


def counter_interval(samples: Samples) -> float:
    """Median time between two readings of the counters, 0 where there are none."""
    time = samples.time_s[samples.has_counters]
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


LEAST_ROWS: Final = 5  # judgement: initial momentum and torque take two of them


_PARTS: Final[Mapping[str, Any]] = {
    "turns": TurnStatistics,
    "counters": CounterStatistics,
    "steps": ChannelSteps,
    "noise": ChannelNoise,
    "shown": ShownWheels,
}


def save_statistics(path: Path, statistics: EventStatistics) -> None:
    """Write statistics as a plain array archive, atomically."""
    layout = statistics.layout
    arrays = {
        "format": np.array(_FORMAT),
        "event_id": np.array(statistics.event_id),
        "kind": np.array(statistics.kind),
        "wheels": np.array(layout.wheels),
        "thrusters": np.array(layout.thrusters, dtype=np.str_),
        "duration_s": np.array(statistics.duration_s),
        "rows": np.array(statistics.rows),
        "gram": statistics.gram,
        "projection": statistics.projection,
        "mode_gram": statistics.mode_gram,
        "couples": np.array([couple_of(i, layout) for i in range(len(layout.thrusters))]),
        "cuts": statistics.cuts,
        "counter_interval_s": np.array(statistics.counter_interval_s),
    }
    for name, kind in _PARTS.items():
        own = getattr(statistics, name)
        arrays |= {f"{name}.{f.name}": np.asarray(getattr(own, f.name)) for f in fields(kind)}
    write_arrays(path, arrays)


def couple_of(place: int, layout: Layout) -> int:
    """Number of the couple that a thruster belongs to."""
    return next(g for g, couple in enumerate(layout.couples) if place in couple)


def couples_from(numbers: NDArray[np.int64]) -> tuple[tuple[int, ...], ...]:
    """Couples from the number of each thruster's couple: the inverse of :func:`couple_of`."""
    return tuple(
        tuple(int(place) for place in np.flatnonzero(numbers == g))
        for g in range(int(numbers.max(initial=-1)) + 1)
    )


def load_statistics(path: Path) -> EventStatistics | None:
    """Statistics written by :func:`save_statistics`; None if the file is missing or damaged.

    A cache: what cannot be read is computed again.
    """
    try:
        stored: dict[str, Any] = read_arrays(path, "the statistics of an event")
        if int(stored["format"]) != _FORMAT:
            return None
        layout = Layout(
            tuple(int(number) for number in stored["wheels"]),
            tuple(str(name) for name in stored["thrusters"]),
            couples_from(stored["couples"]),
            walk_cosines(float(stored["duration_s"])),
            tuple(int(couple) for couple in stored["counters.level_couple"]),
        )
        return EventStatistics(
            str(stored["event_id"]),
            str(stored["kind"]),
            layout,
            float(stored["duration_s"]),
            int(stored["rows"]),
            stored["gram"],
            stored["projection"],
            stored["mode_gram"],
            stored["cuts"],
            float(stored["counter_interval_s"]),
            extra_end=np.zeros(0),
            **{name: _part(kind, name, stored) for name, kind in _PARTS.items()},
        )
    except (InputError, ValueError, TypeError, KeyError):
        return None


def _part(kind: type[Any], name: str, stored: Mapping[str, Any]) -> Any:
    """One part of the statistics, its numbers as plain ones."""
    values = (stored[f"{name}.{field.name}"] for field in fields(kind))
    return kind(*(value.item() if value.ndim == 0 else value for value in values))
