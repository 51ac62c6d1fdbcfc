"""The angular-momentum balance of one telemetry event, ready for likelihood calls.

Per row, in body axes,

    I ω + T I_w ρ − R h0 − Σ_k F_k q_k s_k − τ D = noise.

Here are the pattern of its columns and unknowns, its bands and Gram matrices. Columns are those of
:mod:`cassini_bayes.balance.statistics.columns`; what makes momentum of them is in
:mod:`.telemetry_weights`, their noise in :mod:`.telemetry_noise`, the normal equations in
:mod:`.telemetry_system`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple
from weakref import WeakValueDictionary

import numpy as np

from cassini_bayes.balance.band_products import BandProducts
from cassini_bayes.balance.bands import Band, OpenSquares, TurnBand, make_bands, turn_bands
from cassini_bayes.balance.kernel import (
    Entries,
    FastBands,
    FlatRows,
    SlowBands,
    Turns,
    TurnSums,
    TurnVariances,
)
from cassini_bayes.balance.physics import Physics, physics_of
from cassini_bayes.balance.rounded_wheels import HARMONICS, WheelSquares
from cassini_bayes.balance.statistics import EventStatistics, Layout, Sampling
from cassini_bayes.balance.statistics.late import LatePulses, late_pulses
from cassini_bayes.balance.statistics.layout import CUT_COLUMNS, couple_of
from cassini_bayes.balance.statistics.pairs import quarter_of
from cassini_bayes.balance.statistics.pulse_columns import PULSE_COLUMNS
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.spacecraft import Spacecraft

LEAST_INITIAL_SD_N_M_S: Final = 10.0  # flat: wheels known to 1 % have 0.3
# Over the root mean square of the measured momentum, whose mean is that of a bias's middle.
INITIAL_SD: Final = 3.0


@dataclass(frozen=True)
class EventUnknowns:
    """Places of one telemetry event's unknowns: K thrusts, then the event's own.

    Its own are the initial momentum (3), the steady torque (3) and what counters hide: cut tails
    (of a part of the event, unlike pulses as well) and long roundings; after all of them the normal
    equations have the measured momentum. ``first`` is the place of the first one.
    """

    thrusters: int
    hides: int
    first: int = 0

    @property
    def thrusts(self) -> slice:
        """The K thrusts."""
        return slice(self.first, self.first + self.thrusters)

    @property
    def initial(self) -> slice:
        """The initial momentum."""
        return slice(self.thrusts.stop, self.thrusts.stop + 3)

    @property
    def torque(self) -> slice:
        """The steady external torque."""
        return slice(self.initial.stop, self.initial.stop + 3)

    @property
    def tails(self) -> slice:
        """The cut tails, and what else counters hide."""
        return slice(self.torque.stop, self.torque.stop + self.hides)

    @property
    def own(self) -> slice:
        """All but the thrusts."""
        return slice(self.initial.start, self.tails.stop)

    @property
    def measured(self) -> int:
        """The measured momentum, in the normal equations."""
        return int(self.tails.stop)

    def at(self, first: int) -> EventUnknowns:
        """The event's own unknowns alone, from another place on."""
        return EventUnknowns(0, self.hides, first)


@dataclass(frozen=True)
class Pattern:
    """Which columns enter which unknown: entries in order of owner (:class:`EventUnknowns`).

    The other fields are places among the entries: by what a thrust acts, wheel rates and turns.
    """

    row: Places
    start: Places
    thrusters: int
    cuts: tuple[int, ...]  # places among the columns of cut tails that are not all zero
    cut_pairs: Array  # (S,) pairs that may be close in what they stand for
    cut_unlike: Array  # (S, C, C) and what unlike pulses scatter in it, s²
    level_slopes: Array  # (L, C) of roundings that are unknowns: what pulse columns gain by them
    fired: Places  # (3 C K,) of C pulse columns
    lost: Places  # (L,) tails that are cut on average
    lost_by: Places  # (L,) the thruster
    hiding: Places  # (S + L,) the couple that hides something
    brought: tuple[tuple[int, int, str], ...]  # columns of effects: entry, thruster, name
    wheels: Places  # (W,)
    turns: Places  # (3,) turns of the attitude

    @property
    def hidden(self) -> int:
        """Unknowns that counters hide, S + L: cut tails and unlike pulses, long roundings."""
        return len(self.hiding)

    def level_units(self, pulse_weights: Array) -> Array:
        """What pulses gain (n, L) per on-time of a long rounding, of weights (n, C) of columns."""
        return np.asarray(pulse_weights @ self.level_slopes.T)

    @property
    def owner(self) -> Places:
        """(B,) the unknown that every entry is a column of."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))

    @property
    def turned(self) -> Places:
        """Places (7,) of rates, their bias and turns, which integrated columns weigh otherwise."""
        first = self.start[-2]
        return np.concatenate([np.arange(first, first + 4), self.turns])


@dataclass(frozen=True)
class Reduced:
    """The part of the columns that can have weight: a lever arm may be zero by design.

    ``entries`` are the places of the pattern's entries that are ever used, ``columns`` the columns
    of the layout that are left; ``row`` and ``start`` are the pattern for these.
    """

    entries: Places
    columns: Places  # (A',)
    row: Places
    start: Places
    wheels: Places  # (W,) places of wheel rates among the entries
    turned: Places  # (V,) which of the pattern's ``turned`` are left
    turned_entries: Places  # (V,) their places among the entries
    walk: Places  # (3 D,) columns of the slowest cosines of torque noise; none where there is none

    @cached_property
    def places(self) -> Entries:
        """The same for compiled code, torque noise's slowest cosines first."""
        walks = len(self.walk)
        start = np.r_[np.arange(walks), walks + self.start]
        return Entries(start, walks + self.wheels, walks + self.turned_entries)

    @property
    def entered(self) -> Places:
        """The layout's column of every entry, in that order."""
        return self.columns[np.r_[self.walk, self.row]]


@dataclass(frozen=True, eq=False)
class CompiledBands:
    """The bands for compiled code, which has a column of its own for every entry."""

    slow: SlowBands
    fast: FastBands
    turns: Turns


class ColumnProducts(NamedTuple):
    """Inner products of B columns of a model."""

    slow: Array  # (3, B, M) coordinates on the slow modes
    grams: Array  # (F, 3, 3, B, B) of the fast bands
    slopes: Array  # (3, B, S) coordinates of integrated columns on the slowest modes of slopes
    turns: Array  # (T, 3, 3, B, B) of the integrated columns of quiet pieces


@dataclass(frozen=True)
class Products:
    """Inner products of all A columns of the layout, as :class:`ColumnProducts` has them.

    A model shares them with whatever is built on its events; ``compiled`` are those of the
    entries (as bytes) that some model's likelihood has needed, for as long as there is such a one.
    """

    slow: Array  # (3, A, M)
    fast: BandProducts
    slopes: Array  # (3, A, S)
    turns: BandProducts
    compiled: WeakValueDictionary[bytes, CompiledBands] = field(
        default_factory=WeakValueDictionary, init=False, repr=False, compare=False
    )

    def of(self, columns: Places) -> ColumnProducts:
        """Those of some columns, in their order."""
        slow, slopes = (np.ascontiguousarray(each[:, columns]) for each in (self.slow, self.slopes))
        return ColumnProducts(slow, self.fast.of(columns), slopes, self.turns.of(columns))


class OpenCounters(NamedTuple):
    """Covariance of tails and on-times that counters leave open, in each band."""

    rows: Array  # (n, S + F, 3, 3), (N m s)²
    turns: Array  # (n, T, 3, 3), (N m s²)²


class ChannelVariances(NamedTuple):
    """Variances of an event's channels at n points, for rows and turns; of each n, or one for all.

    Rates and attitudes are of one row: their rounding and what means leave of them are in them.
    """

    rate: Array  # (n,) of a measured body rate, rad²/s²
    attitude: Array  # (n,), rad²
    wheels: Array  # (n, S + F, W) of measured wheel rates, by band, rad²/s²
    turns: TurnVariances


class Answered(NamedTuple):
    """What thrusters answer of an event's noise, about every axis.

    ``rows`` (3,) is how many, and ``weights`` (3, K), 1/(N m s), are what the momentum that a
    thruster delivers counts for. ``body_rows`` (3,) is by how many the body has more of the noise
    than that of its rates, and ``log_per_rate`` (3,) the log of the momentum per measured rate at
    which that is nothing.
    """

    rows: Array
    weights: Array
    body_rows: Array
    log_per_rate: Array


NOTHING_OPEN: Final = OpenCounters(np.zeros((1, 1, 3, 3)), np.zeros((1, 1, 3, 3)))


@dataclass(frozen=True)
class TelemetryBalance:
    """One telemetry event, ready for likelihood calls.

    ``slow`` and ``fast`` are bands of its rows (:mod:`cassini_bayes.balance.bands`), ``turns``
    the turns of the attitude over its quiet pieces.
    ``initial_mean_n_m_s`` (3,) and ``initial_sd_n_m_s`` are the wide prior of the unknown initial
    momentum, which is flat beside what data tell; ``spin`` (3, 3)
    is the mean of |h|² 1 − h hᵀ over the rows, by which attitude noise enters. ``constant`` (M,)
    is a constant of unit length on the slow modes; ``log_unit``, ``log_size`` (log |det I| at
    the prior means), ``nominally_open``, what counters leave open there, ``reference``, channels at
    the reference noise (n = 1), and ``answered`` belong to the measure of flat motion, which sets
    them (:mod:`cassini_bayes.balance.flat_motion`). ``thrusts_n`` (K,) are the event's thrusts to
    some percent, where its pulses deliver ``told_by_s`` each, s, on average: they size what
    counters leave open, and place the slow modes. ``late`` and ``answered`` are of rows that have
    late pulses.
    """

    statistics: EventStatistics
    sampling: Sampling
    pattern: Pattern
    wheel_places: tuple[int, ...]
    slow: tuple[Band, ...]
    fast: tuple[Band, ...]
    turns: tuple[TurnBand, ...]
    initial_mean_n_m_s: Array
    initial_sd_n_m_s: float
    spin: Array
    wheels: WheelSquares  # over all rows
    products: Products
    reduced: Reduced
    constant: Array
    thrusts_n: Array
    told_by_s: float
    late: LatePulses | None
    log_unit: float = 0.0
    log_size: float = 0.0
    nominally_open: OpenCounters = NOTHING_OPEN
    reference: ChannelVariances | None = None
    answered: Answered | None = None

    @property
    def id(self) -> str:
        """Name of the event."""
        return self.statistics.event_id

    @cached_property
    def extra(self) -> tuple[str, ...]:
        """Names of the columns that effects brought and that act on their own."""
        return tuple(name for name in self.statistics.layout.extra if "@" not in name)

    @cached_property
    def bands(self) -> CompiledBands:
        """The bands for compiled code, shared with all models that have the same entries."""
        known, entries = self.products.compiled, self.reduced.entered.tobytes()
        found = known.get(entries)
        if found is None:
            found = known[entries] = self._compiled_bands()
        return found

    def _compiled_bands(self) -> CompiledBands:
        first = np.r_[0, np.cumsum([band.contrasts for band in self.turns], dtype=np.int64)]
        first = first[first <= self.products.slopes.shape[2]]
        products = self.products.of(self.reduced.entered)
        slow = SlowBands(
            products.slow,
            self.flat_rows.first,
            np.concatenate([band.faster for band in self.slow]),
        )
        tables = [band.table for band in self.fast]
        nodes, coefficients = (np.array(each) for each in zip(*tables, strict=True))
        fast = FastBands(
            _by_column(products.grams),
            np.array([float(band.rows) for band in self.fast]),
            np.array([band.faster.mean() for band in self.fast]),
            nodes,
            coefficients,
        )
        turns = Turns(
            products.slopes,
            first,
            _by_column(products.turns[len(first) - 1 :]),
            self.contrasts,
        )
        return CompiledBands(slow, fast, turns)

    @cached_property
    def left_open(self) -> OpenSquares:
        """What counters leave open in slow bands, fast ones and those of turns (N, G, …)."""
        bands: list[Band | TurnBand] = [*self.slow, *self.fast, *self.turns]
        return OpenSquares(
            np.array([band.left_open.pairs for band in bands]),
            np.array([band.left_open.columns for band in bands]),
        )

    @cached_property
    def band_wheels(self) -> WheelSquares:
        """Mean squares of the noise of wheel rates in slow bands and fast ones (…, S + F, W)."""
        each = [band.wheels for band in (*self.slow, *self.fast)]
        return WheelSquares(
            np.stack([own.moving for own in each]),
            np.stack([own.seen for own in each]),
            np.stack([own.lasting for own in each], axis=1),
        )

    @cached_property
    def flat_rows(self) -> FlatRows:
        """The bands of rows in which wheels move by any amount, those that are one each by itself.

        Reference noise may have torque noise where a model has none.
        """
        fast = [
            (place, band)
            for place, whole in enumerate(self.fast)
            if whole.motion is None
            for band in whole.parts or (whole,)
        ]
        return FlatRows(
            np.r_[0, np.cumsum([band.rows for band in self.slow])],
            np.concatenate([band.walk for band in self.slow]),
            self.constant,
            np.array([place for place, _ in fast], dtype=np.int64),
            np.array([float(band.rows) for _, band in fast]),
            np.array([band.walk.mean() for _, band in fast]),
        )

    @cached_property
    def turn_sums(self) -> TurnSums:
        """Mean squares of the noise of turns, by band."""
        rounded = [band.rounded_s2 for band in self.turns]
        return TurnSums(
            np.array([band.summed_s2 for band in self.turns]),
            np.array(rounded).reshape(len(rounded), HARMONICS, len(self.wheel_places)),
        )

    @cached_property
    def contrasts(self) -> Array:
        """Contrasts (T,) of every band of turns."""
        return np.array([float(band.contrasts) for band in self.turns])

    @property
    def fires(self) -> bool:
        """Whether the event has thrusters that fired."""
        return self.pattern.thrusters > 0

    def wheel_weights(self, physics: Physics) -> Array:
        """Momentum (..., 3, W) of the event's wheels per rad/s."""
        return physics.wheel_weights[..., list(self.wheel_places)]

    @property
    def unknowns(self) -> EventUnknowns:
        """Places of the event's unknowns."""
        return EventUnknowns(self.pattern.thrusters, self.pattern.hidden)


def make_balance(
    statistics: EventStatistics,
    sampling: Sampling,
    spacecraft: Spacecraft,
    nominal: Mapping[str, float],
    thrust_n: float,
) -> TelemetryBalance:
    """Prepare one event: everything that does not change during a fit.

    ``nominal`` are parameter values good to some percent (prior means): they centre the wide prior
    of the initial momentum and scale the attitude noise. ``thrust_n`` is the thrust to expect.
    """
    layout = statistics.layout
    numbers = [wheel.number for wheel in spacecraft.wheels]
    places = tuple(numbers.index(number) for number in layout.wheels)
    gram, rows = statistics.gram, statistics.rows
    physics = physics_of(
        spacecraft, "", {name: np.asarray(value) for name, value in nominal.items()}, fires=False
    )
    inertia, wheels = physics.inertia_kg_m2, physics.wheel_weights[:, list(places)]
    scalars = np.concatenate([inertia, np.zeros((3, 1)), wheels], axis=1)
    span = slice(layout.rate.start, layout.wheel.stop)
    squares = scalars @ (gram[0, 0, span, span] / rows) @ scalars.T
    start = np.linalg.lstsq(
        _initial_gram(statistics), _initial_target(statistics, scalars, span), rcond=None
    )[0]
    slow, fast, slow_modes, products, of_wheels = make_bands(statistics)
    turns, of_turns, slopes = turn_bands(statistics)
    pattern = _pattern(statistics)
    everything = np.arange(len(pattern.row))
    constant = slow_modes[0, layout.one]
    return TelemetryBalance(
        statistics=statistics,
        sampling=sampling,
        pattern=pattern,
        wheel_places=places,
        slow=slow,
        fast=fast,
        turns=turns,
        initial_mean_n_m_s=np.asarray(start, dtype=np.float64),
        initial_sd_n_m_s=max(LEAST_INITIAL_SD_N_M_S, INITIAL_SD * float(np.trace(squares)) ** 0.5),
        spin=np.trace(squares) * np.eye(3) - squares,
        wheels=of_wheels,
        products=Products(slow_modes, products, slopes, of_turns),
        reduced=Reduced(
            everything,
            np.arange(slow_modes.shape[1]),
            pattern.row,
            pattern.start,
            pattern.wheels,
            np.arange(len(pattern.turned)),
            pattern.turned,
            np.arange(layout.walk.start, layout.walk.stop),
        ),
        constant=constant / np.linalg.norm(constant),
        thrusts_n=np.full(pattern.thrusters, thrust_n),
        told_by_s=float(sampling.mean_pulse_s(sampling.pulse_reference_s)),
        late=_late(statistics, sampling),
    )


def merged_bands(event: TelemetryBalance) -> TelemetryBalance:
    """The same event with its fast bands as one, if they differ only in torque noise.

    For models without torque noise: where all that the wheels show is motion, as in slews, rows of
    all frequencies have the same weights and the same covariance.
    """
    if len(event.fast) < 2 or any(band.motion is not None for band in event.fast):
        return event
    if any(band.left_open for band in event.fast):  # slower than the rows: unlike in every band
        return event
    if event.statistics.steps.wheel_rad_s > 0.0:  # rounding, too, differs by band
        return event
    first, rows = event.fast[0], sum(band.rows for band in event.fast)
    walk = np.array([sum(band.rows * band.walk.mean() for band in event.fast) / rows])
    whole = replace(first, rows=rows, walk=walk, faster=walk, parts=event.fast)
    products, nominally_open = event.products, event.nominally_open
    reference = event.reference
    if reference is not None:
        reference = reference._replace(wheels=reference.wheels[:, : 1 + len(event.slow)])
    return replace(
        event,
        reference=reference,
        fast=(whole,),
        products=replace(products, fast=products.fast.as_one()),
        nominally_open=nominally_open._replace(rows=nominally_open.rows[:, : 1 + len(event.slow)]),
    )


def _by_column(grams: Array) -> Array:
    """Gram matrices (F, 3, 3, B, B) as (F, B, 3, 3, B): what a column needs lies together."""
    return np.ascontiguousarray(grams.transpose(0, 3, 1, 2, 4))


def _initial_gram(statistics: EventStatistics) -> Array:
    first = statistics.layout.initial
    return np.asarray(sum(statistics.gram[c, c, first, first] for c in range(3)))


def _initial_target(statistics: EventStatistics, scalars: Array, span: slice) -> Array:
    first = statistics.layout.initial
    return np.asarray(sum(statistics.gram[c, c, first, span] @ scalars[c] for c in range(3)))


def _pattern(statistics: EventStatistics) -> Pattern:
    layout = statistics.layout
    cuts = tuple(int(place) for place in np.flatnonzero(statistics.cuts > 0))
    entries: list[list[int]] = []
    lost: list[tuple[int, int]] = []
    brought: list[tuple[int, int, str]] = []
    per_thruster = 3 * len(PULSE_COLUMNS)
    for k, name in enumerate(layout.thrusters):
        first = layout.fired.start + per_thruster * k
        couple = couple_of(k, layout)
        own = [layout.cut.start + p for p in cuts if divmod(p, CUT_COLUMNS) == (couple, 0)]
        after = sum(map(len, entries)) + per_thruster
        lost += [(after + i, k) for i in range(len(own))]
        added = _owned(layout, name)
        brought += [(after + len(own) + i, k, column) for i, column in enumerate(added)]
        entries.append([*range(first, first + per_thruster), *own, *added.values()])
    entries += [[column] for column in range(layout.torque.stop)]
    entries += [[layout.cut.start + place] for place in cuts]
    entries += [[column] for column in range(layout.level.start, layout.level.stop)]
    measured = [*range(layout.rate.start, layout.turn.stop)]
    torque = range(layout.torque.start, layout.torque.stop)
    entries.append([*measured, *torque, *_owned(layout, "").values()])
    start = np.cumsum([0, *map(len, entries)]).astype(np.int64)
    thrusters = len(layout.thrusters)
    hiding = [*(place // CUT_COLUMNS for place in cuts), *layout.levels]
    places = np.array(lost, dtype=np.int64).reshape(-1, 2)
    pairs, unlike = _of_cut_columns(statistics, cuts)
    return Pattern(
        row=np.array([column for own in entries for column in own]),
        start=start,
        thrusters=thrusters,
        cuts=cuts,
        cut_pairs=pairs,
        cut_unlike=unlike,
        level_slopes=_level_slopes(statistics),
        fired=(start[:thrusters, None] + np.arange(per_thruster)).ravel(),
        lost=places[:, 0],
        lost_by=places[:, 1],
        hiding=np.array(hiding, dtype=np.int64),
        brought=tuple(brought),
        wheels=start[-2] + 4 + np.arange(len(layout.wheels)),
        turns=start[-2] + 4 + len(layout.wheels) + np.arange(3),
    )


def _late(statistics: EventStatistics, sampling: Sampling) -> LatePulses | None:
    """What is late in the rows of an event that hardly has one between firings."""
    counters = statistics.counters
    if not counters.has_late_pulses:
        return None
    of_pulse = (sampling.pulse_shape, sampling.pulse_reference_s)
    return late_pulses(*of_pulse, counters.late_width_s, counters.late_rate_hz)


def _of_cut_columns(statistics: EventStatistics, cuts: Sequence[int]) -> tuple[Array, Array]:
    """Pairs (S,) and scatter of unlike pulses (S, C, C) that columns of cut tails stand for."""
    counters, size = statistics.counters, len(PULSE_COLUMNS)
    part = quarter_of(counters.end_s, statistics.duration_s)
    pairs, unlike = np.zeros(len(cuts)), np.zeros((len(cuts), size, size))
    for i, (couple, column) in enumerate(divmod(place, CUT_COLUMNS) for place in cuts):
        own = part == column - 1 if column > 0 else np.ones(len(part), dtype=bool)
        pairs[i] = counters.square[own, couple].sum()
        unlike[i] = counters.unlike[own, couple].sum(axis=0)
    return pairs, unlike


def _level_slopes(statistics: EventStatistics) -> Array:
    """What pulse columns gain per on-time (L, C) for couples of long roundings, over the first."""
    counters = statistics.counters

    def of_couple(g: int) -> Array:
        own = counters.slopes[counters.fired[:, g], g]
        if len(own) == 0:  # all that it fired was before the first attitude
            return np.asarray(np.eye(1, len(PULSE_COLUMNS))[0])
        return np.asarray(own.mean(axis=0) / own[:, 0].mean())

    each = [of_couple(g) for g in statistics.layout.levels]
    return np.array(each).reshape(-1, len(PULSE_COLUMNS))


def _owned(layout: Layout, thruster: str) -> dict[str, int]:
    """Extra columns that act through a thruster's thrust (named ``what@thruster``), or the rest."""
    return {
        name: layout.extra_place.start + i
        for i, name in enumerate(layout.extra)
        if name.partition("@")[2] == thruster
    }
