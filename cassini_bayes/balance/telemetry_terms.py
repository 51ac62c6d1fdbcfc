"""The angular-momentum balance of telemetry: weights of its columns, and its noise.

Per row, in body axes,

    I ω + T I_w ρ − R h0 − Σ_k F_k q_k s_k − τ D = noise

(:mod:`cassini_bayes.balance.statistics.columns` has the columns,
:mod:`cassini_bayes.balance.telemetry_system` the normal equations).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from cassini_bayes.balance.bands import Band, TurnBand, make_bands, turn_bands, walk_scales
from cassini_bayes.balance.kernel import Entries, FastBands, SlowBand, Turns
from cassini_bayes.balance.open_counters import OpenScales
from cassini_bayes.balance.physics import Physics, physics_of
from cassini_bayes.balance.rounded_wheels import WheelSquares, lasting_share
from cassini_bayes.balance.statistics import EventStatistics, Layout, Sampling
from cassini_bayes.balance.statistics.columns import (
    CUT_COLUMNS,
    WALK_COSINES,
    LostTails,
    lost_tails,
    quarter_of,
)
from cassini_bayes.balance.statistics.pulse_columns import PULSE_COLUMNS
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.spacecraft import Spacecraft
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

INITIAL_SD_N_M_S: Final = 10.0  # flat: wheels known to 1 % have 0.3
LEAST_RATE_RAD_S: Final = 1e-9  # noise that no gyro goes below: without any, turns have no say
SHARE_SPREAD: Final = 0.5  # relative sd of a couple's share of close pulses about that of all


@dataclass(frozen=True)
class EventUnknowns:
    """Places of one telemetry event's unknowns: K thrusts, then the event's own.

    Its own are the initial momentum (3), the steady torque (3) and the S cut tails (of a part of
    the event, unlike pulses as well); after all of them the normal equations have the measured
    momentum. ``first`` is the place of the first one.
    """

    thrusters: int
    cuts: int
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
        """The cut tails."""
        return slice(self.torque.stop, self.torque.stop + self.cuts)

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
        return EventUnknowns(0, self.cuts, first)


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
    fired: Places  # (3 C K,) of C pulse columns
    pulses: Places  # (K,)
    lost: Places  # (L,) tails that are cut on average
    lost_by: Places  # (L,) the thruster
    members: Array  # (S, K) ones where a thruster is of the couple whose tails may have been cut
    brought: tuple[tuple[int, int, str], ...]  # columns of effects: entry, thruster, name
    wheels: Places  # (W,)
    turns: Places  # (3,) turns of the attitude


@dataclass(frozen=True)
class Reduced:
    """The part of the Gram matrices that can have weight: a lever arm may be zero by design.

    ``entries`` are the places of the pattern's entries that are ever used, ``columns`` the columns
    of the layout that are left; ``row`` and ``start`` are the pattern for these.
    """

    entries: Places
    columns: Places  # (A',)
    row: Places
    start: Places
    wheels: Places  # (W,) columns of the wheel rates
    wheel_entries: Places  # (W,) places among the entries
    grams: Array  # (F, 3, 3, A', A') of the fast bands
    slow: Array  # (3, A', M) coordinates on the slow modes
    turns: Array  # (T, 3, 3, A', A') of the integrated columns of quiet pieces
    walk: Places  # (D,) columns of the slowest cosines of torque noise; none where there is none

    @cached_property
    def places(self) -> Entries:
        """The same for compiled code, torque noise's slowest cosines first, each for three axes."""
        walks = 3 * len(self.walk)
        row = np.r_[np.repeat(self.walk, 3), self.row]
        start = np.r_[np.arange(walks), walks + self.start]
        last = np.maximum.accumulate(row)[start[1:] - 1]
        return Entries(row, start, last + 1, self.wheels, walks + self.wheel_entries)


class OpenCounters(NamedTuple):
    """Covariance of tails and on-times that counters leave open, in each band."""

    rows: Array  # (n, 1 + F, 3, 3), (N m s)²
    turns: Array  # (n, T, 3, 3), (N m s²)²


NOTHING_OPEN: Final = OpenCounters(np.zeros((1, 1, 3, 3)), np.zeros((1, 1, 3, 3)))


@dataclass(frozen=True)
class TelemetryBalance:
    """One telemetry event, ready for likelihood calls.

    ``slow`` and ``fast`` are the bands of its rows (:mod:`cassini_bayes.balance.bands`), ``turns``
    the turns of the attitude over its quiet pieces.
    ``initial_mean_n_m_s`` centres the wide prior of the unknown initial momentum; ``spin`` (3, 3)
    is the mean of |h|² 1 − h hᵀ over the rows, by which attitude noise enters. ``constant`` (M,)
    is a constant of unit length on the slow modes; ``log_unit``, ``log_inertia`` (log |det I| at
    the prior means) and ``nominally_open``, what counters leave open there, belong to the measure
    of flat motion (:mod:`cassini_bayes.balance.flat_motion`).
    """

    statistics: EventStatistics
    sampling: Sampling
    pattern: Pattern
    wheel_places: tuple[int, ...]
    slow: Band
    fast: tuple[Band, ...]
    turns: tuple[TurnBand, ...]
    initial_mean_n_m_s: Array
    spin: Array
    wheels: WheelSquares  # over all rows
    reduced: Reduced
    constant: Array
    log_unit: float = 0.0
    log_inertia: float = 0.0
    nominally_open: OpenCounters = NOTHING_OPEN

    @property
    def id(self) -> str:
        """Name of the event."""
        return self.statistics.event_id

    @cached_property
    def extra(self) -> tuple[str, ...]:
        """Names of the columns that effects brought and that act on their own."""
        return tuple(name for name in self.statistics.layout.extra if "@" not in name)

    @cached_property
    def bands(self) -> tuple[SlowBand, FastBands, Turns]:
        """The bands for compiled code."""
        nodes, coefficients = zip(*(band.table for band in (self.slow, *self.fast)), strict=True)
        slow = SlowBand(
            self.reduced.slow, self.slow.faster, self.slow.square, nodes[0], coefficients[0]
        )
        fast = FastBands(
            np.ascontiguousarray(self.reduced.grams.transpose(0, 3, 1, 2, 4)),
            np.array([float(band.rows) for band in self.fast]),
            np.array([band.faster.mean() for band in self.fast]),
            np.array(nodes[1:]).reshape(len(self.fast), *nodes[0].shape),
            np.array(coefficients[1:]).reshape(len(self.fast), *coefficients[0].shape),
        )
        turns = np.ascontiguousarray(self.reduced.turns.transpose(0, 3, 1, 2, 4))
        return slow, fast, Turns(turns, np.array([float(own.contrasts) for own in self.turns]))

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
        return EventUnknowns(self.pattern.thrusters, len(self.pattern.cuts))


def make_balance(
    statistics: EventStatistics,
    sampling: Sampling,
    spacecraft: Spacecraft,
    nominal: Mapping[str, float],
) -> TelemetryBalance:
    """Prepare one event: everything that does not change during a fit.

    ``nominal`` are parameter values good to some percent (prior means): they centre the wide prior
    of the initial momentum and scale the attitude noise.
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
    slow, fast, slow_modes, grams, of_wheels = make_bands(statistics)
    turns, turn_grams = turn_bands(statistics)
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
        spin=np.trace(squares) * np.eye(3) - squares,
        wheels=of_wheels,
        reduced=Reduced(
            everything,
            np.arange(slow_modes.shape[1]),
            pattern.row,
            pattern.start,
            np.arange(layout.wheel.start, layout.wheel.stop),
            pattern.wheels,
            grams,
            slow_modes,
            turn_grams,
            np.arange(layout.walk.start, layout.walk.stop),
        ),
        constant=constant / np.linalg.norm(constant),
    )


def without_idle_columns(
    event: TelemetryBalance, physics: Physics, thrust_n: float, *, walks: bool
) -> TelemetryBalance:
    """The same event without the columns whose weights vanish at every one of a few points.

    ``physics`` holds parameter points in general position, (n, …); ``walks`` tells whether there is
    torque noise. Likelihood calls cost half as much without idle columns.
    """
    pattern = event.pattern
    used = np.any(balance_weights(event, physics, thrust_n) != 0.0, axis=(0, 2))
    used[pattern.turns] = len(event.turns) > 0  # without weight in rows
    entries = np.flatnonzero(used)
    # in the order in which the unknowns need them: inner products are symmetric
    columns, first = np.unique(pattern.row[entries], return_index=True)
    columns = columns[np.argsort(first)]
    if walks:
        columns = np.r_[event.reduced.walk, columns]
    place = np.empty(len(event.reduced.slow[0]), dtype=np.int64)
    place[columns] = np.arange(len(columns))
    owner = np.repeat(np.arange(len(pattern.start) - 1), np.diff(pattern.start))
    counts = np.bincount(owner[entries], minlength=len(pattern.start) - 1)
    full = event.reduced
    reduced = Reduced(
        entries=entries,
        columns=columns,
        row=place[pattern.row[entries]],
        start=np.concatenate([[0], np.cumsum(counts)]),
        wheels=place[full.wheels],
        wheel_entries=np.searchsorted(entries, pattern.wheels),
        grams=np.ascontiguousarray(full.grams[..., columns[:, None], columns]),
        slow=np.ascontiguousarray(full.slow[:, columns]),
        turns=np.ascontiguousarray(full.turns[..., columns[:, None], columns]),
        walk=place[full.walk] if walks else full.walk[:0],
    )
    return replace(event, reduced=reduced)


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
    # of the measure, whose reference noise may have torque noise
    walk = np.array([sum(band.rows * band.walk.mean() for band in event.fast) / rows])
    reduced, nominally_open = event.reduced, event.nominally_open
    return replace(
        event,
        fast=(replace(first, rows=rows, walk=walk, faster=walk),),
        reduced=replace(reduced, grams=reduced.grams.sum(axis=0, keepdims=True)),
        nominally_open=nominally_open._replace(rows=nominally_open.rows[:, :2]),
    )


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
        couple = next(g for g, members in enumerate(layout.couples) if k in members)
        own = [layout.cut.start + p for p in cuts if divmod(p, CUT_COLUMNS) == (couple, 0)]
        count = layout.pulse_count.start + k
        after = sum(map(len, entries)) + per_thruster + 1
        lost += [(after + i, k) for i in range(len(own))]
        added = _owned(layout, name)
        brought += [(after + len(own) + i, k, column) for i, column in enumerate(added)]
        entries.append([*range(first, first + per_thruster), count, *own, *added.values()])
    entries += [[column] for column in range(layout.torque.stop)]
    entries += [[layout.cut.start + place] for place in cuts]
    measured = [*range(layout.rate.start, layout.turn.stop)]
    torque = range(layout.torque.start, layout.torque.stop)
    entries.append([*measured, *torque, *_owned(layout, "").values()])
    start = np.cumsum([0, *map(len, entries)]).astype(np.int64)
    thrusters = len(layout.thrusters)
    members = np.zeros((len(cuts), thrusters))
    for i, place in enumerate(cuts):
        members[i, list(layout.couples[place // CUT_COLUMNS])] = 1.0
    places = np.array(lost, dtype=np.int64).reshape(-1, 2)
    pairs, unlike = _of_cut_columns(statistics, cuts)
    return Pattern(
        row=np.array([column for own in entries for column in own]),
        start=start,
        thrusters=thrusters,
        cuts=cuts,
        cut_pairs=pairs,
        cut_unlike=unlike,
        fired=(start[:thrusters, None] + np.arange(per_thruster)).ravel(),
        pulses=start[:thrusters] + per_thruster,
        lost=places[:, 0],
        lost_by=places[:, 1],
        members=members,
        brought=tuple(brought),
        wheels=start[-2] + 4 + np.arange(len(layout.wheels)),
        turns=start[-2] + 4 + len(layout.wheels) + np.arange(3),
    )


def _of_cut_columns(statistics: EventStatistics, cuts: Sequence[int]) -> tuple[Array, Array]:
    """Pairs (S,) and scatter of unlike pulses (S, C, C) that columns of cut tails stand for."""
    counters, size = statistics.counters, len(PULSE_COLUMNS)
    part = quarter_of(counters.end_s, statistics.duration_s)
    pairs, unlike = np.zeros(len(cuts)), np.zeros((len(cuts), size, size))
    for i, (couple, column) in enumerate(divmod(place, CUT_COLUMNS) for place in cuts):
        own = part == column - 1 if column > 0 else np.ones(len(part), dtype=bool)
        pairs[i] = counters.weight[own, couple].sum()
        unlike[i] = counters.unlike[own, couple].sum(axis=0)
    return pairs, unlike


def _owned(layout: Layout, thruster: str) -> dict[str, int]:
    """Extra columns that act through a thruster's thrust (named ``what@thruster``), or the rest."""
    return {
        name: layout.extra_place.start + i
        for i, name in enumerate(layout.extra)
        if name.partition("@")[2] == thruster
    }


def balance_weights(
    event: TelemetryBalance, physics: Physics, thrust_n: float, kept: Array | None = None
) -> Array:
    """Weights (n, B, 3) of all entries of the pattern, in its order, at a batch of n points.

    The measured momentum is that of the measured rates and wheels, or with the matrices ``kept``
    (n, W, W) of a band that of the estimate of the true wheel rates. For residuals and their
    derivatives: the same columns and weights that the likelihood has.
    """
    wheels = event.wheel_weights(physics)
    if kept is not None:
        wheels = wheels @ kept
    weights = _unknown_weights(event, physics, len(physics.inertia_kg_m2), thrust_n)
    weights[:, event.pattern.start[-2] :] = _measured_weights(event, physics, wheels)
    return weights


def noise_covariance(
    event: TelemetryBalance,
    physics: Physics,
    parameters: Mapping[str, Array],
    kept: Array | None = None,
) -> Array:
    """Covariance (n, 3, 3) of the white noise of a row's balance, (N m s)².

    ``kept`` (n, W, W) is the share of the wheels' noise that stays where their true rates are
    estimated.
    """
    wheels = event.wheel_weights(physics)
    left = wheels if kept is None else wheels @ kept
    noise = wheel_variance(event, parameters)[:, None, :]
    other = covariance_beside_wheels(event, physics, parameters)
    return np.asarray(other + (left * noise) @ np.swapaxes(wheels, -1, -2))


def wheel_variance(event: TelemetryBalance, parameters: Mapping[str, Array]) -> Array:
    """Variance (n, W) of a measured wheel rate, its rounding included, rad²/s²."""
    return _wheel_variances(event, parameters, event.wheels)


def rate_variance(event: TelemetryBalance, parameters: Mapping[str, Array]) -> Array:
    """Variance (n,) of a measured body rate, its rounding included, rad²/s²."""
    rounding = event.statistics.steps.rate_rad_s**2 / 12.0
    return np.asarray(parameters["rate_noise_rad_s"] ** 2 + rounding)


def band_wheel_variances(event: TelemetryBalance, parameters: Mapping[str, Array]) -> Array:
    """Variance (n, 1 + F, W) of measured wheel rates by band, rad²/s²: rounding is not white."""
    each = [_wheel_variances(event, parameters, b.wheels) for b in (event.slow, *event.fast)]
    return np.ascontiguousarray(np.stack(each, axis=1))


def _wheel_variances(
    event: TelemetryBalance, parameters: Mapping[str, Array], squares: WheelSquares
) -> Array:
    """Variance (n, W) of wheel rates by the mean squares of their noise, rad²/s²."""
    noise = (parameters["wheel_noise_rpm"] * RAD_S_PER_RPM)[:, None]
    rounding = event.statistics.steps.wheel_rad_s**2 / 12.0
    share = _lasting_share(event, parameters)
    white = (noise**2 + rounding) * squares.moving + squares.seen
    return np.asarray(white + rounding * share[:, None] * squares.lasting)


def _lasting_share(event: TelemetryBalance, parameters: Mapping[str, Array]) -> Array:
    """Share (n,) of the rounding of wheel rates that lasts; without steps there is none."""
    step, noise = event.statistics.steps.wheel_rad_s, parameters["wheel_noise_rpm"]
    return lasting_share(noise * RAD_S_PER_RPM / step) if step > 0.0 else np.zeros_like(noise)


def covariance_beside_wheels(
    event: TelemetryBalance, physics: Physics, parameters: Mapping[str, Array]
) -> Array:
    """Covariance (n, 3, 3) of what rates and attitudes put into a row, (N m s)²."""
    by_rate = physics.momentum_per_rate
    rate = rate_variance(event, parameters)[:, None, None]
    attitude = parameters["attitude_noise_rad"][:, None, None] ** 2
    return np.asarray(rate * by_rate @ np.swapaxes(by_rate, -1, -2) + attitude * event.spin)


def band_covariances(
    event: TelemetryBalance, physics: Physics, parameters: Mapping[str, Array], left_open: Array
) -> Array:
    """Covariance (n, 1 + F, 3, 3) in every band but for wheels and torque noise, (N m s)².

    What counters leave open is slower than the rows: ``left_open`` (:class:`OpenCounters`) differs
    by band.
    """
    white = covariance_beside_wheels(event, physics, parameters)
    return np.ascontiguousarray(white[:, None] + left_open)


@dataclass(frozen=True)
class TurnNoise:
    """What turns of quiet pieces say once the rows are known, by band (n, T, 3, 3).

    ``gain`` is Q = D A⁻¹, of the covariance D of what rates and turns see alike and that A of the
    gyro's own noise; ``covariance``, (N m s²)², is that of the balance of the turns with Q times
    the momentum by which turns and gyro differ (:func:`turn_weights`).
    """

    gain: Array
    covariance: Array


def turn_noise(
    event: TelemetryBalance,
    physics: Physics,
    parameters: Mapping[str, Array],
    left_open: Array,
    torque_s3: Sequence[float],
) -> TurnNoise:
    """Noise of the turns of quiet pieces, given the rows.

    A contrast of the integrated rows has the noise a + d, of the gyro and of all that is shared;
    that of the turns θ + d. Given the former, the latter is θ + d − A-weighted guess of d: its
    balance plus Q times turn less gyro has the covariance

        (1 + Q) I Σ_θ Iᵀ (1 + Q)ᵀ + D + Q D,      Q = D A⁻¹

    (docs/topics/telemetry-likelihood.md §5). ``left_open`` is that of :class:`OpenCounters`, and
    ``torque_s3`` (T,) what of a unit random walk is in the noise of every band
    (:class:`.TurnBand`).
    """
    shared = _shared_turn_covariances(event, physics, parameters, torque_s3) + left_open
    inertia, by_rate = physics.inertia_kg_m2, physics.momentum_per_rate
    rate = np.maximum(rate_variance(event, parameters), LEAST_RATE_RAD_S**2)[:, None, None]
    of_gyro = rate * by_rate @ np.swapaxes(by_rate, -1, -2)
    attitude = parameters["attitude_noise_rad"][:, None, None] ** 2
    of_turns = (attitude * inertia @ np.swapaxes(inertia, -1, -2))[:, None]
    summed = np.array([band.summed_s2 for band in event.turns])[:, None, None]
    gain = shared @ np.linalg.inv(of_gyro)[:, None] / summed
    more = np.eye(3) + gain
    covariance = more @ of_turns @ np.swapaxes(more, -1, -2) + more @ shared
    return TurnNoise(gain, np.ascontiguousarray(covariance))


def _shared_turn_covariances(
    event: TelemetryBalance,
    physics: Physics,
    parameters: Mapping[str, Array],
    torque_s3: Sequence[float],
) -> Array:
    """Covariance (n, T, 3, 3) of what is in integrated rows and in turns alike, (N m s²)².

    But for what counters leave open.
    """
    wheels = event.wheel_weights(physics)
    white = replace(event.wheels, lasting=np.zeros(len(event.wheel_places)))
    noise = _wheel_variances(event, parameters, white)
    rounding = event.statistics.steps.wheel_rad_s**2 / 12.0
    lasting = rounding * _lasting_share(event, parameters)[:, None]
    by_torque = parameters["torque_noise_n_m_s05"][:, None, None] ** 2 * np.eye(3)
    each = [
        (wheels * (band.summed_s2 * noise + band.rounded_s2 * lasting)[:, None])
        @ np.swapaxes(wheels, -1, -2)
        + walked * by_torque
        for band, walked in zip(event.turns, torque_s3, strict=True)
    ]
    return np.array(each).reshape(-1, *by_torque.shape).swapaxes(0, 1)


def open_counters(event: TelemetryBalance, physics: Physics, thrust_n: float) -> OpenCounters:
    """Covariances of tails and on-times that counters leave open, at n points."""
    n = len(physics.inertia_kg_m2)
    bands: Sequence[Band | TurnBand] = (event.slow, *event.fast, *event.turns)
    result = np.zeros((n, len(bands), 3, 3))
    if event.fires and any(band.left_open for band in bands):
        scales = open_scales(event, physics, thrust_n)
        across = np.swapaxes(scales.torque_n_m, -1, -2)
        for place, band in enumerate(bands):
            own = band.left_open
            square = scales.variance_s2(own.pairs, own.columns)
            result[:, place] = (scales.torque_n_m * square[:, None]) @ across
    of_rows = 1 + len(event.fast)
    return OpenCounters(result[:, :of_rows], result[:, of_rows:])


def open_scales(event: TelemetryBalance, physics: Physics, thrust_n: float) -> OpenScales:
    """Torques of couples, what pairs scatter, and weights of pulse columns."""
    n, couples = len(physics.inertia_kg_m2), event.statistics.layout.couples
    if not event.fires:
        nothing = LostTails(np.zeros(n), np.zeros(n))
        return OpenScales(np.zeros((n, 3, 0)), nothing, np.zeros((n, len(PULSE_COLUMNS))))
    arms = np.broadcast_to(physics.arms_m, (n, 3, event.pattern.thrusters))
    together = [arms[..., list(own)].sum(-1) for own in couples]
    rise, fall = (np.broadcast_to(tau, (n,)) for tau in physics.tau_s[1:])
    gaps, share = event.statistics.counters.gaps_s, close_share(physics, n)
    pulse = event.sampling.pulses.weights(physics.tau_s)
    return OpenScales(
        thrust_n * np.stack(together, axis=-1),
        lost_tails(gaps, rise, fall, share),
        np.broadcast_to(pulse, (n, pulse.shape[-1])),
    )


def close_share(physics: Physics, n: int) -> Array:
    """Share (n,) of close pulses, which widened priors may take out of its bounds."""
    return np.asarray(np.clip(np.broadcast_to(physics.close_share, (n,)), 0.0, 1.0))


def turn_weights(event: TelemetryBalance, physics: Physics, weights: Array, gain: Array) -> Array:
    """Weights (n, T, B, 3) for integrated columns, at the gains (n, T, 3, 3) of the bands.

    Turns of the body need no gyro; where rates and turns err alike, by which both differ from each
    other tells the error of each: (1 + Q) I Θ − Q I (∫ω_m dt − ∫b dt)/(1 + s) + all else.
    """
    n, bands = gain.shape[:2]
    result = np.repeat(weights[:, None], bands, axis=1)
    first = event.pattern.start[event.unknowns.measured]
    # in rows they are those of the gyro's momentum, per rate and per its bias
    of_gyro = weights[:, None, first : first + 4]
    result[:, :, first : first + 4] = -of_gyro @ np.swapaxes(gain, -1, -2)
    inertia = np.broadcast_to(physics.inertia_kg_m2, (n, 3, 3))[:, None]
    turned = inertia + gain @ inertia
    result[:, :, event.pattern.turns] = np.swapaxes(turned, -1, -2)
    return result


def walk_weights(event: TelemetryBalance, parameters: Mapping[str, Array]) -> Array:
    """Weights (n, 3 D, 3) of the slowest cosines of torque noise, for standard normals.

    Every cosine has one unknown per axis. It is in rows and in turns alike, which as two noises
    would seem to tell the same thing independently (docs/topics/telemetry-likelihood.md §8).
    """
    cosines = WALK_COSINES if len(event.reduced.walk) > 0 else 0
    scale = walk_scales(event.statistics.duration_s, cosines)[1:]
    weights = np.multiply.outer(parameters["torque_noise_n_m_s05"], np.kron(scale, np.eye(3)).T)
    return np.asarray(weights)


def _measured_weights(event: TelemetryBalance, physics: Physics, wheels: Array) -> Array:
    """Weights of the measured momentum's entries, in their order; turns have none in rows.

    What a steady torque or an effect's own column puts in is taken off the measured momentum.
    """
    n, by_rate = len(wheels), physics.momentum_per_rate
    bias = np.broadcast_to(physics.rate_bias_rad_s, (n, 3))
    shift = by_rate @ bias[..., None]
    torque = -np.broadcast_to(physics.steady_torque_n_m, (n, 3))
    extra = [-np.broadcast_to(physics.extra.get(name, 0.0), (n, 3)) for name in event.extra]
    return np.concatenate(
        [
            np.swapaxes(by_rate, -1, -2),
            -shift[..., 0][:, None],
            np.swapaxes(wheels, -1, -2),
            np.zeros((n, 3, 3)),
            np.repeat(torque[:, :, None], 3, axis=2),
            *(weight[:, None] for weight in extra),
        ],
        axis=1,
    )


def _unknown_weights(event: TelemetryBalance, physics: Physics, n: int, thrust_n: float) -> Array:
    """Weights (n, B, 3) of the unknowns' entries."""
    pattern, places = event.pattern, event.unknowns
    weights = np.zeros((n, len(pattern.row), 3))
    k = pattern.thrusters
    tails = pattern.start[places.tails.start]
    weights[:, pattern.start[places.initial.start] : tails] = 1.0
    if k > 0:
        arms = np.broadcast_to(physics.arms_m, (n, 3, k))
        scales = open_scales(event, physics, thrust_n)
        offset = np.broadcast_to(physics.impulse_offset_s, (n, k))
        arm = np.swapaxes(arms, -1, -2)
        fired = arm[..., :, None] * scales.pulse_weights[:, None, None, :]
        weights[:, pattern.fired] = fired.reshape(n, -1, 1)
        weights[:, pattern.pulses] = offset[:, :, None] * arm
        weights[:, pattern.lost] = -scales.lost.mean_s[:, None, None] * arm[:, pattern.lost_by]
        for entry, thruster, name in pattern.brought:
            if name in physics.extra:
                on_time = np.asarray(physics.extra[name])
                weights[:, entry] = on_time[:, None] * arm[:, thruster]
        couples = thrust_n * pattern.members @ arm
        unit = cut_unit_s(event, scales)
        weights[:, tails : tails + len(pattern.cuts)] = unit[..., None] * couples
    return weights


def own_prior(
    event: TelemetryBalance, torque_mean_n_m: Array, torque_sd_n_m: Array
) -> tuple[Array, Array]:
    """Prior mean and sd (U,) of the event's own unknowns, independent normals."""
    tails = np.ones(len(event.pattern.cuts))  # in units of their sd
    return (
        np.concatenate([event.initial_mean_n_m_s, torque_mean_n_m, np.zeros(len(tails))]),
        np.concatenate([np.full(3, INITIAL_SD_N_M_S), torque_sd_n_m, tails]),
    )


def cut_unit_s(event: TelemetryBalance, scales: OpenScales) -> Array:
    """Cut tails per standard deviation of every unknown (n, S), over their columns.

    Of a couple's departure from the share of close pairs: half of what is lost on average. Of a
    part of the event: the scatter of its pairs and unlike pulses, over how many there are.
    """
    pattern = event.pattern
    places = np.array(pattern.cuts, dtype=np.int64)
    of_all = SHARE_SPREAD * scales.lost.mean_s[:, None]
    variance = scales.variance_s2(pattern.cut_pairs, pattern.cut_unlike)
    of_part = np.sqrt(variance) / event.statistics.cuts[places]
    return np.where(places % CUT_COLUMNS == 0, of_all, of_part)
