"""Bands of a telemetry event's rows, and the wheel rates as latent variables in each.

The rows of an event are turned into modes (a constant and cosines, orthonormal over the rows that
are used, diagonal for a random walk) and a remainder that is faster than all of them. White channel
noise is the same in every band, the motion of the wheels is not: slow bands hold all of it. So what
a measured wheel rate says of the true one differs by band: docs/topics/telemetry-likelihood.md §3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache, wraps
from itertools import pairwise
from typing import Final, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from scipy.interpolate import CubicSpline

from cassini_bayes.balance.band_products import BandProducts
from cassini_bayes.balance.open_counters import short_levels, step_patterns
from cassini_bayes.balance.rounded_wheels import HARMONICS, ShownRows, WheelSquares, wheel_squares
from cassini_bayes.balance.statistics import EventStatistics
from cassini_bayes.balance.statistics.event_statistics import TurnStatistics
from cassini_bayes.balance.statistics.turns import slope_weights
from cassini_bayes.balance.statistics.walk import cosines, walk_cosines, walk_scales
from cassini_bayes.computing.arrays import Array

Result = TypeVar("Result")

EDGES: Final = (32, 128)  # of the bands, in modes: what is slower than T/16, then T/64
# What counters leave open is a walk, whose squares fall by a thousand from the first slow mode to
# the last.
SLOW_EDGES: Final = (1, 2, 4, 8, 16)
# The same of slopes of quiet pieces. The first mode is a constant, which the initial momentum takes
# up: the next ones hold most of what is known of torque noise.
SLOPE_EDGES: Final = (1, 2, 4, 8, 32)
SAME_PHASE: Final = 0.5  # steps between the means of neighbouring pieces
FEW_SLOPES: Final = 8  # modes of slopes that cost less one by one than as Gram matrices
ROWS_PER_MODE: Final = 2  # with as many modes as rows nothing is left that is faster than all
SPARSE_S: Final = 4.0  # per row and more: a wheel's ramp takes 16 s to end, within a few rows
SPARSE_EDGES: Final = (0.5, 0.75)  # of the bands of sparse rows, in rows
STILL: Final = 0.5  # probability that wheels do not move in a band
SPARSE_STILL: Final = 0.3  # the same in the fast bands of sparse rows
_INDEPENDENT: Final = 1e-9  # least share of the largest square that a mode of its own has
LOG_MOTION: Final = (-9.0, 34.0)  # range of the log of the wheels' motion over their noise
_LOG_NOISE: Final = (-32.0, 12.0)  # range of the log of the noise over the measured mean square
_NODES: Final = 800  # of the table and of the integral over s: the density is right to 1e-6


@dataclass(frozen=True)
class Band:
    """Part of the row space: modes of similar frequency, or all that is faster than the modes.

    ``walk`` (R,) or (1,) are the variances of a unit random walk's modes, s, and ``faster`` what
    the noise has of them: in the slow bands all but the walk's mean and its slowest cosines, which
    are unknowns. ``motion`` is None where wheels move by any amount. ``left_open`` are mean squares
    of what counters leave open, and ``wheels`` those of the noise of wheel rates. One that stands
    for several bands has them in ``parts``.
    """

    rows: int
    walk: Array
    faster: Array
    motion: CubicSpline | None  # of :func:`motion_table`
    left_open: OpenSquares
    wheels: WheelSquares
    parts: tuple[Band, ...] = ()

    @property
    def table(self) -> tuple[Array, Array]:
        """Nodes (T,) and coefficients (4, T − 1, 2) of the spline, of no length without one."""
        if self.motion is None:
            return np.zeros(0), np.zeros((4, 0, 2))
        return self.motion.x, np.ascontiguousarray(self.motion.c)


Bands = tuple[tuple[Band, ...], tuple[Band, ...], Array, BandProducts, WheelSquares]


def _once(function: Callable[[EventStatistics], Result]) -> Callable[[EventStatistics], Result]:
    """The function, which all models of an event share the result of."""
    made: WeakKeyDictionary[EventStatistics, Result] = WeakKeyDictionary()

    @wraps(function)
    def known(statistics: EventStatistics) -> Result:
        if statistics not in made:
            made[statistics] = function(statistics)
        return made[statistics]

    return known


@_once
def make_bands(statistics: EventStatistics) -> Bands:
    """Split an event's rows into bands.

    In slews the wheels are what turns the body, at every frequency that the controller has: nothing
    is said of them in any band, and next to nothing lost, the rates being far above their noise.

    Returns the slow bands, the fast bands (octaves of the faster modes, and all that no mode
    explains), all columns' coordinates (3, A, M) on the slow modes, their inner products in the
    fast bands, and the noise of wheel rates over all rows.
    """
    walk, faster, modes, turned = turned_modes(statistics)
    counters = statistics.counters
    time = counters.row_time_s
    waves = cosines(time, statistics.duration_s, len(turned))
    places, on_modes = Places(time, waves, counters.stride), waves @ turned
    left_open = open_modes(statistics, places, on_modes)
    shown = ShownRows(
        time,
        statistics.shown.rate_rad_s,
        statistics.steps.wheel_rad_s,
        counters.stride,
        counters.averaged,
    )
    of_wheels, everywhere = wheel_squares(shown, on_modes)
    # thrusters that fire in every interval answer what is late, at all frequencies that are left
    turning = statistics.kind == "slew" or statistics.counters.has_late_pulses
    still = SPARSE_STILL if is_sparse(statistics) else STILL
    edges = _edges(statistics, len(walk))

    def band(start: int, stop: int, faster: Array, motion: CubicSpline | None) -> Band:
        own_wheels = of_wheels.of_modes(start, stop).over(stop - start)
        noise = (left_open.of_modes(start, stop), own_wheels)
        return Band(stop - start, walk[start:stop], faster[start:stop], motion, *noise)

    inner = [edge for edge in SLOW_EDGES if edge < edges[1]]
    slow = [band(*ends, faster, None) for ends in pairwise([0, *inner, edges[1]])]
    slow_modes = np.ascontiguousarray(modes[..., : edges[1]])
    bands, parts = [], []
    for start, stop in pairwise(edges[1:]):
        motion = None if turning else motion_table(stop - start, still)
        bands.append(band(start, stop, walk, motion))
        parts.append(modes[..., start:stop])
    rows = statistics.rows - len(walk)
    if rows > 0:
        # Σ T/(4 N sin²(mπ/2N)) over the cosines of N even rows that are not there: an integral
        angle = np.pi * (len(walk) - 0.5) / (2.0 * statistics.rows)
        left = np.array([statistics.duration_s / (2.0 * np.pi * np.tan(angle) * rows)])
        motion = None if turning else motion_table(rows, still)
        slower = of_wheels.of_modes(0, len(walk))
        noise = (left_open.of_rest(rows), (everywhere - slower).over(rows))
        bands.append(Band(rows, left, left, motion, *noise))
    return (
        tuple(slow),
        tuple(bands),
        slow_modes,
        BandProducts(slow_modes, tuple(parts), statistics.gram if rows > 0 else None),
        everywhere.over(counters.stride * len(time)),
    )


def is_sparse(statistics: EventStatistics) -> bool:
    """Whether wheels still move at the highest frequencies that an event's rows can show."""
    still = statistics.kind != "slew" and not statistics.counters.has_late_pulses
    return still and statistics.duration_s > SPARSE_S * statistics.rows


def _edges(statistics: EventStatistics, modes: int) -> list[int]:
    """0, the end of the slow modes, and the ends of the fast bands of modes."""
    inner = {*EDGES}
    if is_sparse(statistics):
        places = [int(share * statistics.rows) for share in SPARSE_EDGES]
        inner = {*(edge for edge in EDGES if edge < places[0]), *places}
    return [0, *sorted(edge for edge in inner if 0 < edge < modes), modes]


@dataclass(frozen=True)
class OpenSquares:
    """Squares per couple of what counters leave open (:mod:`cassini_bayes.balance.open_counters`).

    ``pairs`` (…, G) of pairs of variance 1, ``columns`` (…, G, C, C), s², of what pulse columns
    gain beyond what is expected: unlike pulses and roundings.
    """

    pairs: Array
    columns: Array

    def __bool__(self) -> bool:
        return bool(self.pairs.any() or self.columns.any())


@dataclass(frozen=True)
class OpenModes:
    """The same on every mode (M, G, …), and summed over all rows (G, …)."""

    modes: OpenSquares
    rows: OpenSquares

    def of_modes(self, start: int, stop: int) -> OpenSquares:
        """Mean squares over some modes."""
        pairs, columns = self.modes.pairs[start:stop], self.modes.columns[start:stop]
        return OpenSquares(pairs.mean(axis=0), columns.mean(axis=0))

    def of_rest(self, rows: int) -> OpenSquares:
        """Mean squares over the R rows that no mode explains."""
        pairs = np.maximum(self.rows.pairs - self.modes.pairs.sum(axis=0), 0.0)
        columns = self.rows.columns - self.modes.columns.sum(axis=0)
        return OpenSquares(pairs / rows, columns / rows)


@dataclass(frozen=True)
class Places:
    """Times (r,) of evenly thinned rows, each for ``stride`` of them.

    ``waves`` (r, 1 + cosines): a constant and cosines there.
    """

    time_s: Array
    waves: Array
    stride: int


def open_modes(statistics: EventStatistics, places: Places, on_modes: Array) -> OpenModes:
    """What counters leave open, on modes that are ``on_modes`` (r, M) at the places."""
    counters, stride = statistics.counters, places.stride
    weight = places.waves[:, :1]
    step = weight * (places.time_s[:, None] >= counters.end_s)
    couples, number = counters.square.shape[1], on_modes.shape[1]
    size = counters.slopes.shape[2]
    # squares (M + 1, G, …) on every mode, and at last over all rows
    pairs = np.zeros((number + 1, couples))
    columns = np.zeros((number + 1, couples, size, size))
    for g in range(couples if len(counters.end_s) > 0 else 0):
        steps, intervals = step_patterns(counters, g, statistics.duration_s, step)
        square = (stride * on_modes.T @ steps) ** 2
        square = np.concatenate([square, stride * (steps**2).sum(axis=0)[None]])
        pairs[:, g] = square @ counters.square[intervals, g]
        columns[:, g] = np.tensordot(square, counters.unlike[intervals, g], (1, 0))
        levels = short_levels(counters, g, step, weight)
        if levels.any():
            used = levels.any(axis=(0, 2))
            levels = levels[:, used]
            on_mode = stride * np.tensordot(on_modes, levels, (0, 0))
            square = np.concatenate(
                [
                    on_mode @ on_mode.swapaxes(1, 2),
                    stride * np.tensordot(levels, levels, ((0, 2), (0, 2)))[None],
                ]
            )
            columns[:, g, np.flatnonzero(used)[:, None], np.flatnonzero(used)] += square
    return OpenModes(OpenSquares(pairs[:-1], columns[:-1]), OpenSquares(pairs[-1], columns[-1]))


@dataclass(frozen=True)
class TurnBand:
    """Contrasts of turns over quiet pieces, and what beside the attitude is in their noise.

    Mean squares per contrast: of summed white noise, of every wheel's rounding by harmonic (H, W),
    of a unit random walk, of it without its slowest cosines, which are unknowns, and per couple of
    what counters leave open.
    """

    contrasts: int
    summed_s2: float
    rounded_s2: Array
    walked_s3: float
    faster_s3: float
    left_open: OpenSquares  # each times s²


@_once
def turn_bands(statistics: EventStatistics) -> tuple[tuple[TurnBand, ...], BandProducts, Array]:
    """Slopes of the quiet pieces by frequency, then their swings; and their inner products.

    Torque noise and what counters leave open are slow, so that slopes are told apart by modes as
    rows are (:func:`turned_modes`). Returns the bands, columns' inner products in them, and their
    coordinates (3, A, M) on the first modes, of whole bands with few modes.
    """
    turns = statistics.turns
    bands: list[TurnBand] = []
    parts: list[Array] = []
    modes = np.zeros((*turns.gram.shape[2:4], 0))
    if turns.pieces > 0:
        bands, parts, modes = _slope_bands(statistics)
    whole = turns.slope_gram if len(parts) < len(bands) else None
    swings = np.flatnonzero(turns.contrasts)
    others = tuple(turns.gram[g] for g in swings)
    products = BandProducts(modes[..., :0], tuple(parts), whole, others)
    couples, size = statistics.counters.slopes.shape[1:]
    nothing = OpenSquares(np.zeros(couples), np.zeros((couples, size, size)))
    # the summed rounding of a wheel at rest is a ramp: nothing of it is in swings
    moving = np.tile(make_bands(statistics)[4].moving, (HARMONICS, 1))
    walk = statistics.layout.walk
    scale = walk_scales(statistics.duration_s, statistics.layout.cosines)[1:]
    for g in swings:
        contrasts = int(turns.contrasts[g])
        summed_s2, walked_s3 = float(turns.summed_s2[g]), float(turns.walked_s3[g])
        of_axes = np.trace(turns.gram[g][..., walk, walk]).diagonal()
        slowest = np.repeat(scale**2, 3) @ of_axes / (3.0 * contrasts)
        squares = (summed_s2, summed_s2 * moving, walked_s3, max(walked_s3 - float(slowest), 0.0))
        bands.append(TurnBand(contrasts, *squares, nothing))
    return tuple(bands), products, np.ascontiguousarray(modes)


def _slope_bands(statistics: EventStatistics) -> tuple[list[TurnBand], list[Array], Array]:
    """Bands of slopes, their modes (3, A, m), and the first modes.

    The last band has none, where it is all that no mode explains.
    """
    turns = statistics.turns
    walk, faster, turned = diagonal_walk(turns.slope_mode_gram, statistics.duration_s, turns.pieces)
    modes = np.tensordot(turns.slope_projection, turned, (0, 0))
    places = Places(turns.slope_time_s, turns.slope_waves, turns.slope_stride)
    on_modes = turns.slope_waves @ turned
    left_open = open_modes(statistics, places, on_modes)
    rounded, all_rounded = rounded_slopes(turns, on_modes, statistics.steps.wheel_rad_s)
    # of each piece its own: noise summed over a long one is far more than over a short one
    summed = turns.slope_stride * turns.slope_summed_s2 @ on_modes**2
    faster_still = turns.slope_stride * turns.slope_beyond_s3 @ on_modes**2
    walk, faster = walk + faster_still, faster + faster_still
    bands, parts = [], []
    # the slowest cosines are unknowns: modes that are theirs have next to no walk beside them
    edges = {*SLOPE_EDGES, 1 + statistics.layout.cosines}
    inner = sorted(edge for edge in edges if edge < len(walk))
    for start, stop in pairwise([0, *inner, len(walk)]):
        walked_s3, faster_s3 = (float(each[start:stop].mean()) for each in (walk, faster))
        summed_s2, rounded_s2 = float(summed[start:stop].mean()), rounded[start:stop].mean(axis=0)
        squares = (summed_s2, rounded_s2, walked_s3, faster_s3)
        bands.append(TurnBand(stop - start, *squares, left_open.of_modes(start, stop)))
        parts.append(modes[..., start:stop])
    if (rows := turns.pieces - len(walk)) > 0:
        # thinned pieces may leave too little for the rest: that of one piece at least
        summed_s2, walked_s3 = (
            float(max((turns.slope_stride * each.sum() - known.sum()) / rows, each.min()))
            for each, known in (
                (turns.slope_summed_s2, summed),
                (turns.slope_beyond_s3, faster_still),
            )
        )
        left = np.maximum(all_rounded - rounded.sum(axis=0), 0.0) / rows
        squares = (summed_s2, left, walked_s3, walked_s3)
        bands.append(TurnBand(rows, *squares, left_open.of_rest(rows)))
    return bands, parts, modes[..., :FEW_SLOPES]


def rounded_slopes(turns: TurnStatistics, on_modes: Array, step: float) -> tuple[Array, Array]:
    """Squares (M, H, W) of roundings of wheel rates by mode of slopes and harmonic; on all (H, W).

    Over that of a single row. A rounding repeats where the rate moves by a step: harmonic k of a
    rate φ(t) in steps is in a slope |Σ w exp(2πi k φ)| times, w what a row has in it. Straight
    lines stand for the rate. As long as a wheel stays within half a step from piece to piece, it
    has the same phase in all of them, and one that stays within a step altogether rests
    (docs/topics/telemetry-likelihood.md §11). ``on_modes`` (r, M) are the modes at the thinned
    pieces.
    """
    stride, wheels = turns.slope_stride, (turns.slope_shown.shape[1] - 2) // 2
    total = np.zeros((on_modes.shape[1], HARMONICS, wheels))
    if step == 0.0:
        return total, total[0]
    levels, drifts = np.split(turns.slope_shown[:, 2:] / step, 2, axis=1)
    stretches = [np.flatnonzero(np.r_[True, np.abs(np.diff(x)) > SAME_PHASE]) for x in levels.T]
    for j, starts in enumerate(stretches):
        lengths = np.diff(starts, append=len(levels))
        apart = np.maximum.reduceat(levels[:, j], starts) - np.minimum.reduceat(
            levels[:, j], starts
        )
        rests = np.repeat((apart <= 1.0) & (lengths > 1), lengths)
        levels[rests, j] = drifts[rests, j] = 0.0  # noise, which would spoil the phase
    turned = np.zeros((len(levels), HARMONICS, wheels), dtype=np.complex128)
    order = np.arange(1, HARMONICS + 1)[:, None, None]
    sizes, of_size = np.unique(turns.slope_shown[:, :2].round(3), axis=0, return_inverse=True)
    for i, size in enumerate(sizes):
        own = np.flatnonzero(of_size.reshape(-1) == i)
        time = np.linspace(-0.5, 0.5, int(size[0])) * size[1]
        phase = levels[own, :, None] + drifts[own, :, None] * time
        turned[own] = np.exp(2j * np.pi * order * phase[:, None]) @ slope_weights(time)
    for j, starts in enumerate(stretches):
        alone = np.where(np.diff(starts, append=len(levels)) == 1, stride, stride**2)
        for k in range(HARMONICS):
            together = np.add.reduceat(turned[:, k, j, None] * on_modes, starts)
            total[:, k, j] = alone @ np.abs(together) ** 2
    return total, stride * (np.abs(turned) ** 2).sum(axis=0)


def turned_modes(statistics: EventStatistics) -> tuple[Array, Array, Array, Array]:
    """Constant and cosines, turned to be orthonormal over the rows with a diagonal random walk.

    Returns the variances (M,) of a unit random walk and of it without its mean and slowest cosines,
    all columns' coordinates (3, A, M), and the matrix (1 + cosines, M) that makes the modes of a
    constant and cosines.
    """
    layout, gram = statistics.layout, statistics.gram
    one = layout.one
    mixed = statistics.projection[:, 0, one]
    square = np.block(
        [[gram[0, 0, one, one][None, None], mixed[None]], [mixed[:, None], statistics.mode_gram]]
    )
    most = statistics.rows // (1 if is_sparse(statistics) else ROWS_PER_MODE)
    values, faster, turned = diagonal_walk(square, statistics.duration_s, most)
    constant = np.stack([gram[0, c, one] for c in range(3)])
    seen = np.concatenate([constant[None], statistics.projection])
    return values, faster, np.tensordot(seen, turned, (0, 0)), turned


def diagonal_walk(square: Array, duration_s: float, most: int) -> tuple[Array, Array, Array]:
    """Combinations of a constant and cosines that are orthonormal, with a diagonal random walk.

    ``square`` (1 + cosines, 1 + cosines) are inner products over rows. Returns the variances
    (M,) over a², largest first and at most ``most`` of them, those (M,) without the walk's mean and
    its slowest cosines (:func:`.walk_cosines`), and the matrix (1 + cosines, M).
    """
    scale = walk_scales(duration_s, len(square) - 1)
    values, turn = np.linalg.eigh(scale[:, None] * square * scale)
    kept = np.flatnonzero(values > _INDEPENDENT * values[-1])[::-1][: max(most, 1)]
    values, turn = values[kept], turn[:, kept]
    turned = turn / np.sqrt(values) * scale[:, None]
    slowest = slice(0, 1 + walk_cosines(duration_s))
    seen = scale[slowest, None] * (square[slowest] @ turned)
    return values, np.maximum(values - (seen**2).sum(axis=0), 0.0), turned


@lru_cache(maxsize=64)
def motion_table(rows: int, no_motion: float = STILL) -> CubicSpline:
    """Log density of R measured rates and E[V̂/(σ² (1 + s))], against t = log(σ²/V̂).

    With V̂ their mean square, h = R/2 and s = S/σ² zero, of probability ``no_motion``, or of density
    ds/s on e^LOG_MOTION, the density times V̂^h is the mean of
    exp(−h (t + log(1 + s) + e^(−t)/(1 + s))). Both depend on R and ``no_motion`` alone.
    Gauss-Legendre sums over log s: about the peak at s = e^(−t) − 1, whose width in log V
    is (2/R)^½, and on either side of it.
    """
    half = 0.5 * rows
    width = half**-0.5
    low, high = np.arcsinh(np.array(_LOG_NOISE) / width)
    t = np.clip(width * np.sinh(np.linspace(low, high, _NODES)), *_LOG_NOISE)[:, None]
    peak = np.maximum(np.expm1(np.maximum(-t, 0.0)), width)
    spread = np.minimum(width * (1.0 + peak) / peak, 1.0)
    inner = [np.clip(np.log(peak) + sign * 12.0 * spread, *LOG_MOTION) for sign in (-1.0, 1.0)]
    edges = [np.full_like(t, LOG_MOTION[0]), *inner, np.full_like(t, LOG_MOTION[1])]
    parts = [_legendre(a, b, n) for (a, b), n in zip(pairwise(edges), (48, 160, 48), strict=True)]
    log_s, weight = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    motion = np.exp(log_s)
    exponent = -half * (t + np.log1p(motion) + np.exp(-t) / (1.0 + motion))
    still = -half * (t + np.exp(-t))
    top = np.maximum(exponent.max(axis=1, keepdims=True), still)
    moves = (1.0 - no_motion) / (LOG_MOTION[1] - LOG_MOTION[0])
    density = moves * weight * np.exp(exponent - top)
    at_rest = no_motion * np.exp(still - top)[:, 0]
    total = density.sum(axis=1) + at_rest
    noise_share = (at_rest + (density / (1.0 + motion)).sum(axis=1)) / total
    explained = np.exp(-t[:, 0]) * noise_share
    return CubicSpline(t[:, 0], np.stack([top[:, 0] + np.log(total), explained], axis=1))


def _legendre(low: Array, high: Array, count: int) -> tuple[Array, Array]:
    """Nodes and weights (T, count) of Gauss-Legendre sums between bounds (T, 1)."""
    node, weight = _unit_legendre(count)
    half = 0.5 * (high - low)
    return low + half * (1.0 + node), half * weight


@cache
def _unit_legendre(count: int) -> tuple[Array, Array]:
    """Nodes and weights between −1 and 1: for the many tables of one process."""
    return np.polynomial.legendre.leggauss(count)
