"""Turns of the attitude beside those of the gyro: the momentum balance over quiet pieces.

The attitude is measured as well as the rates, and over some seconds its differences are the better
rate: real records have rates of 2e-5 rad/s and attitudes of 1e-5 rad, so that 32 s of attitudes
every 4 s tell the mean rate to 4e-7 rad/s, those of rates to 7e-6. Within a piece in which nothing
fires the balance holds at all times, so its integral does:

    I Θ(t) + ∫ T I_w ρ dt = ∫ [R h0 + Σ F_k q_k s_k + τ …] dt + constant + I θ(t),

Θ the turn of the body since the piece began, θ the attitude's white noise. The constant is the
piece's own and free, so that columns are centred: what is left of a piece of m rows are its slope
and m − 2 swings. Pieces end at firings (when in a counter interval a pulse
came is not known, and that shifts the angle, not the rate), at gaps, where wheels change their
acceleration between rows, and after :data:`LONGEST_S`, beyond which the integrated noise of wheel
rates would be more than that of the attitude. Derivation: ``docs/topics/telemetry-likelihood.md``
§5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from cassini_bayes.balance.statistics.columns import Rows
from cassini_bayes.balance.statistics.layout import Layout
from cassini_bayes.balance.statistics.rows import SAME_S
from cassini_bayes.balance.statistics.sampling import Sampling
from cassini_bayes.balance.statistics.walk import cosines, walk_scales
from cassini_bayes.computing.arrays import Array, Flags, Places
from cassini_bayes.computing.cached import cached_property

LONGEST_S: Final = 32.0  # of a piece: by then attitudes tell its rate to 4e-7 rad/s
LEAST_PIECE: Final = 2  # rows: one contrast, the mean rate
HALF_PERIODS_S: Final = (8.0, 4.0, 2.0)
"""Where contrasts beside the slopes are divided: noise that is summed up goes as their square."""
SWING_GROUPS: Final = len(HALF_PERIODS_S) + 1
SLOPE_WAVES: Final = 128  # cosines of the momentum that slopes of pieces are seen on
GAP: Final = 2.5  # times the time between the rows before, or after
_NYQUIST: Final = 0.49  # cycles from row to row, nearly: nothing is left of the fastest


@dataclass(frozen=True)
class Turned:
    """Integrated and centred columns of some pieces, and what else their noise is made of.

    A piece of m rows has m − 1 contrasts of unit noise. One is along the ramp t − t̄: its **slope**,
    a momentum as every row's, known |t − t̄| times as well as by one rate of the attitude's noise.
    Whatever is constant within a piece (cut tails, rounded counters, torque noise gathered before)
    is in the slopes alone. The m − 2 others are **swings**, in G = 4 groups by their half periods
    (:data:`HALF_PERIODS_S`), slow ones first: attitude noise is the same in all of them, noise of
    rows is summed up, two hundred times more in the slowest group than in the fastest (1 Hz).

    ``slopes`` (p, 3 V + S) are vector columns (axis first) and scalar columns, one row for every
    piece at ``time_s`` (p,); ``waves`` (p, 1 + M) are those of the cosines cos(m π t/T), m = 0 … M,
    the first of them |t − t̄|; ``summed_s2`` (p,) are the variances of unit white noise of a rate
    summed up by trapezoids, which grow with the square of a piece's length; ``beyond_s3`` (p,) are
    those of a unit random walk that these cosines lack; ``shown``
    (p, 2 + 2 W) are a piece's rows and how long it is (s), and the straight lines through its wheel
    rates: means (rad/s), then slopes (rad/s²). ``swings`` are the columns (n, 3 V + S) on the
    contrasts of every group or, what is left of the fastest, at rows; ``counts`` (G,) the contrasts
    and ``squares`` (G, 2) sums of squares: of the same white noise (s²), and of a unit random walk
    since the piece began, integrated (s³).
    """

    time_s: Array
    slopes: Array
    waves: Array
    summed_s2: Array
    beyond_s3: Array
    shown: Array
    swings: tuple[Array, ...]
    counts: Places
    squares: Array


@dataclass(frozen=True)
class Pieces:
    """Quiet pieces of rows at times (n,): rows ``ends[i]`` to ``ends[i + 1]`` of each."""

    time_s: Array
    ends: Places

    def integrated(self, values: Array) -> Array:
        """∫ values dt (n, c) from row to row, less its mean over every piece."""
        return self.centred(_integral(self.time_s, values))

    def centred(self, values: Array) -> Array:
        """Values (n, c) less their mean over every piece."""
        counts = np.diff(self.ends)
        means = np.add.reduceat(values, self.ends[:-1], axis=0) / counts[:, None]
        return np.asarray(values - np.repeat(means, counts, axis=0))


@dataclass(frozen=True)
class WhiteTurns:
    """What integrals over quiet pieces are multiplied by, so that their noise is white.

    Turns of the attitude have white noise; integrals of rows have theirs summed up, most in the
    slope of a piece. With S the integral of a piece's rows, centred, and r the variance of a row's
    noise over that of a turn, the noise of all rows of a piece is 1 + r S Sᵀ in units of a turn's.

    ``of_row`` (p, M) are the places of the rows of all pieces, n where there are fewer than M;
    ``modes`` (p, M, M) the eigenvectors of S Sᵀ without the constant, ``summed_s2`` (p, M) its
    eigenvalues, ``slope_s2`` (p,) its square of the ramp; ``ratio_per_s2`` (3,) are the r of
    whitened axes.
    """

    pieces: Pieces
    of_row: Places
    modes: Array
    summed_s2: Array
    slope_s2: Array
    ratio_per_s2: Array

    @staticmethod
    def over(pieces: Pieces, ratio_per_s2: Array) -> WhiteTurns:
        """Those of pieces, for ratios (3,) of the noise of a row to that of a turn, 1/s²."""
        counts, n = np.diff(pieces.ends), len(pieces.time_s)
        most = int(counts.max())
        of_row = pieces.ends[:-1, None] + np.arange(most)
        of_row = np.where(np.arange(most) < counts[:, None], of_row, n)
        modes, summed = np.zeros((len(counts), most, most)), np.zeros((len(counts), most))
        slope = np.zeros(len(counts))
        known: dict[bytes, tuple[Array, Array, float]] = {}
        for piece, (start, count) in enumerate(zip(pieces.ends[:-1], counts, strict=True)):
            if count < LEAST_PIECE:
                continue
            time = pieces.time_s[start : start + count]
            step = np.round(np.diff(time) / SAME_S).tobytes()
            if step not in known:
                known[step] = _piece_modes(time)
            own, summed[piece, : count - 1], slope[piece] = known[step]
            modes[piece, :count, : count - 1] = own
        return WhiteTurns(pieces, of_row, modes, summed, slope, ratio_per_s2)

    @cached_property
    def _are_modes(self) -> Flags:
        """Which places (p, M) are modes of a piece: one fewer than it has rows."""
        counts = np.diff(self.pieces.ends)
        most = self.of_row.shape[1]
        return np.asarray(np.arange(most) < np.where(counts < LEAST_PIECE, 0, counts - 1)[:, None])

    def in_modes(self, values: Array) -> Array:
        """Integrals (n, c), centred over pieces, along the modes of these, (m, c).

        Inner products are those of the integrals.
        """
        padded = np.concatenate([values, np.zeros((1, values.shape[1]))])[self.of_row]
        return np.asarray((np.swapaxes(self.modes, 1, 2) @ padded)[self._are_modes])

    def weights(self, axis: int) -> Array:
        """What integrals along modes are multiplied by, (m,), so that an axis's noise is white.

        Axes are whitened ones.
        """
        summed = self.ratio_per_s2[axis] * self.summed_s2[self._are_modes]
        return np.asarray(1.0 / np.sqrt(1.0 + summed))

    def whitened(self, values: Array, axis: int) -> Array:
        """Integrals (n, c), centred over pieces, with the noise of a whitened axis made white."""
        along = np.zeros((*self.of_row.shape, values.shape[1]))
        along[self._are_modes] = self.weights(axis)[:, None] * self.in_modes(values)
        result = np.zeros((len(values) + 1, values.shape[1]))
        result[self.of_row] = self.modes @ along
        return result[:-1]

    def whitened_axes(self, values: Array) -> Array:
        """Integrals (n, 3, c) about the three whitened axes, each with its noise made white."""
        return np.stack([self.whitened(values[:, axis], axis) for axis in range(3)], axis=1)

    def swing_shares(self, frequency_hz: Array, step_s: float) -> Array:
        """Share (f, 3) that noise leaves of a swing, by its square, but for what slopes have of it.

        Noise of its frequency, summed up by trapezoids Δ long, has Δ/(2 tan π f Δ) of its size.
        """
        tangent = np.tan(np.pi * np.minimum(frequency_hz * step_s, _NYQUIST))
        summed_s2 = (0.5 * step_s / tangent) ** 2
        return np.asarray(1.0 / (1.0 + np.multiply.outer(summed_s2, self.ratio_per_s2)))

    @property
    def slope_shares(self) -> Array:
        """Share (p, 3) that noise leaves of slopes, by their squares."""
        return np.asarray(1.0 / (1.0 + np.multiply.outer(self.slope_s2, self.ratio_per_s2)))

    @property
    def ramps(self) -> Array:
        """The ramp (n,) of every piece, of unit length; zero in a piece of one row."""
        ramp = self.pieces.centred(self.pieces.time_s[:, None])[:, 0]
        length = np.sqrt(np.add.reduceat(ramp**2, self.pieces.ends[:-1]))
        counts = np.diff(self.pieces.ends)
        return np.asarray(ramp / np.repeat(np.where(length > 0.0, length, 1.0), counts))


def _piece_modes(time_s: Array) -> tuple[Array, Array, float]:
    """Eigenvectors (m, m − 1) of S Sᵀ and eigenvalues (m − 1,), s², and the square of the ramp."""
    summed = _integral(time_s, np.eye(len(time_s)))
    summed = summed - summed.mean(axis=0)
    values, vectors = np.linalg.eigh(summed @ summed.T)
    centred = vectors[:, 1:]  # the first is a constant, of eigenvalue 0
    slope = float((slope_weights(time_s) ** 2).sum())
    return centred, np.maximum(values[1:], 0.0), slope


def pieces_of(rows: Rows, layout: Layout, sampling: Sampling) -> Pieces:
    """The quiet pieces of all rows of an event, at least two."""
    ends = piece_ends(rows.time_s, piece_breaks(rows, layout, sampling))
    return Pieces(rows.time_s, np.array(ends))


def turns_between(cosines: Array) -> Array:
    """Turns (n − 1, 3) rad of the body between inertial-to-body matrices (n, 3, 3), body axes."""
    step = cosines[1:] @ np.swapaxes(cosines[:-1], 1, 2)
    sine = 0.5 * np.stack(
        [
            step[:, 1, 2] - step[:, 2, 1],
            step[:, 2, 0] - step[:, 0, 2],
            step[:, 0, 1] - step[:, 1, 0],
        ],
        axis=1,
    )
    size = np.linalg.norm(sine, axis=1)
    angle = np.arcsin(np.clip(size, 0.0, 1.0))
    stretch = np.where(size > 0, angle / np.where(size > 0, size, 1.0), 1.0)
    return np.asarray(sine * stretch[:, None])


def piece_breaks(rows: Rows, layout: Layout, sampling: Sampling) -> Flags:
    """Whether a piece ends between a row and the next, (n − 1,): a firing, a gap, a corner."""
    fired = np.any(np.diff(rows.pulses, axis=0) != 0.0, axis=1)
    return np.asarray(fired | gaps(rows.time_s) | _corners(rows, layout, sampling))


def gaps(time_s: Array) -> Flags:
    """Whether the time to the next row (n − 1,) is much more than that before or after it.

    By its neighbours, not by what is usual in the event: rows may come more seldom from some time
    on.
    """
    step = np.diff(time_s)
    before, after = np.r_[np.inf, step[:-1]], np.r_[step[1:], np.inf]
    return np.asarray(step > GAP * np.minimum(before, after))


def piece_ends(time_s: Array, breaks: Flags) -> list[int]:
    """Bounds of the pieces of rows at times (n,): rows ``ends[i]`` to ``ends[i + 1]`` of each.

    The last piece may go on with rows still to come.
    """
    ends, start = [0], time_s[0]
    for i, is_break in enumerate(breaks):
        if is_break or time_s[i + 1] - start > LONGEST_S + SAME_S:
            ends.append(i + 1)
            start = time_s[i + 1]
    return [*ends, len(time_s)]


def _corners(rows: Rows, layout: Layout, sampling: Sampling) -> Flags:
    """Intervals (n − 1,) next to a row at which a wheel changes its acceleration.

    Its rate then has a second difference beyond ``corner_rad_s``, its noise; that matters where
    times the step it exceeds ``corner_rad`` (what the trapezoid misses, against the attitude's
    noise).
    """
    n, vectors = len(rows.time_s), rows.vector.shape[2]
    found = np.zeros(max(n - 1, 0), dtype=bool)
    if n < 3:
        return found
    wheels = rows.scalar[:, layout.wheel.start - vectors : layout.wheel.stop - vectors]
    step = np.diff(rows.time_s)[:, None]
    slope = np.diff(wheels, axis=0) / step
    bend = np.abs(np.diff(slope, axis=0)) * step[1:]
    corner = np.any(
        (bend > sampling.corner_rad_s) & (bend * step[1:] > sampling.corner_rad), axis=1
    )
    found[:-1] |= corner
    found[1:] |= corner
    return found


def turned(rows: Rows, layout: Layout, ends: list[int], sampling: Sampling) -> Turned:
    """Integrate and centre the columns of the pieces between bounds."""
    vectors = rows.vector.shape[2]
    n = len(rows.time_s)
    flat = np.concatenate([rows.vector.reshape(n, -1), rows.scalar], axis=1)
    wheel = slice(layout.wheel.start + 2 * vectors, layout.wheel.stop + 2 * vectors)
    times, slopes, waves = [], [np.zeros((0, flat.shape[1]))], [np.zeros((0, SLOPE_WAVES + 1))]
    shown = [np.zeros((0, 2 + 2 * len(layout.wheels)))]
    swings = [[np.zeros((0, flat.shape[1]))] for _ in range(SWING_GROUPS)]
    of_slopes: list[float] = []
    beyond_s3: list[float] = []
    scale = walk_scales(sampling.duration_s, SLOPE_WAVES)[1:]
    counts, squares = np.zeros(SWING_GROUPS, dtype=np.int64), np.zeros((SWING_GROUPS, 2))
    for start, stop in pairwise(ends):
        if stop - start < LEAST_PIECE:
            continue
        time = rows.time_s[start:stop]
        own, is_steady = _integrated(rows, flat, slice(start, stop), layout, sampling)
        gained = _integral(time, cosines(time, sampling.duration_s, SLOPE_WAVES + 1))
        basis, group = contrasts_of(time)
        times.append(time.mean())
        shown.append(_lines(time, flat[start:stop, wheel]))
        slopes.append(basis[1:2] @ own)
        waves.append(basis[1:2] @ gained)
        whole_s3 = walk_square(time, slope_weights(time), sampling.duration_s)
        beyond_s3.append(max(whole_s3 - float(((waves[-1][:, 1:] * scale) ** 2).sum()), 0.0))
        seen = basis @ own
        left = own - basis.T @ seen
        for one in (seen, left):
            one[:, is_steady] = 0.0
        each, of_left = noise_squares(time, basis)
        of_slopes.append(float(each[1, 0]))
        for g in range(SWING_GROUPS):
            swings[g].append(seen[2:][group == g])
            squares[g] += each[2:][group == g].sum(axis=0)
        counts += np.bincount(group, minlength=SWING_GROUPS)
        if (beyond := len(time) - len(basis)) > 0:
            swings[-1].append(left)
            counts[-1] += beyond
            squares[-1] += of_left
    return Turned(
        np.array(times),
        np.concatenate(slopes),
        np.concatenate(waves),
        np.array(of_slopes),
        np.array(beyond_s3),
        np.concatenate(shown),
        tuple(np.concatenate(one) for one in swings),
        counts,
        squares,
    )


def _integrated(
    rows: Rows, flat: Array, piece: slice, layout: Layout, sampling: Sampling
) -> tuple[Array, Flags]:
    """Integrals (m, ·) of the columns ``flat`` (n, ·) over a piece, turns among them.

    With them which columns are steady: a constant sums up to a ramp, of which nothing but rounding
    errors would be left.
    """
    offset = 2 * rows.vector.shape[2]  # scalar columns come once, vectors for each axis
    turn = slice(layout.turn.start + offset, layout.turn.stop + offset)
    extra = slice(layout.extra_place.start + offset, layout.extra_place.stop + offset)
    result = _integral(rows.time_s[piece], flat[piece])
    result[:, extra] *= np.array([column.over_trapezoids for column in sampling.extra])
    turns = turns_between(rows.cosines[piece])
    result[:, turn] = np.concatenate([np.zeros((1, 3)), np.cumsum(turns, axis=0)])
    is_steady = np.all(flat[piece] == flat[piece.start], axis=0)
    is_steady[turn] = False
    return result, is_steady


def _lines(time_s: Array, rates: Array) -> Array:
    """Rows, duration, and means and slopes of wheel rates (m, W) over a piece, (1, 2 + 2 W)."""
    centred = time_s - time_s.mean()
    slopes = centred @ rates / (centred @ centred)
    size = (len(time_s), time_s[-1] - time_s[0])
    return np.concatenate([size, rates.mean(axis=0), slopes])[None]


def contrasts_of(time_s: Array) -> tuple[Array, Places]:
    """Contrasts (q, m) of a piece with rows at times (m,), orthonormal, and groups (q − 2,).

    The first is a constant, the second the ramp t − t̄. The others are its cosines, slow ones first,
    as far as they are slower than the fastest group of :data:`HALF_PERIODS_S`; of that group are
    all contrasts that are not here.
    """
    long_s = time_s[-1] - time_s[0]
    most = min(len(time_s) - 1, math.floor(long_s / HALF_PERIODS_S[-1] + SAME_S))
    order = np.arange(2, most + 1)
    waves = np.cos(np.multiply.outer((time_s - time_s[0]) / long_s, np.pi * order))
    plane = [np.ones((len(time_s), 1)), (time_s - time_s.mean())[:, None]]
    basis, size = np.linalg.qr(np.concatenate([*plane, waves], axis=1))
    half_s = long_s / order + SAME_S
    group = np.searchsorted(-np.array(HALF_PERIODS_S), -half_s, side="left")
    return (basis * np.where(np.diag(size) < 0.0, -1.0, 1.0)).T, group


def slope_weights(time_s: Array) -> Array:
    """What the rows (m,) of a piece put into its slope, s."""
    ramp = time_s - time_s.mean()
    return _of_integrals(time_s, ramp / np.linalg.norm(ramp))


def noise_squares(time_s: Array, basis: Array) -> tuple[Array, Array]:
    """Squares of what noise of the rows puts into the integrals of a piece, per unit of it.

    With A the trapezoidal rule as a matrix (m, m) and W a random walk at the rows, |b A|², s², and
    |b A W|², s³, of every contrast b of an orthonormal ``basis`` (q, m), (q, 2), and the same of
    all contrasts that are not in it, (2,). In sums over the rows: rows may be many, A has their
    square.
    """
    m, time_s = len(time_s), time_s - time_s.mean()
    step, after = np.diff(time_s), np.arange(m - 1, -1, -1.0)
    own, later = _weights_of_rows(time_s)
    summed = (_of_integrals(time_s, basis) ** 2).sum(axis=1)
    summed_of_all = (own**2).sum() + after @ later**2
    # a step of the walk has, at later rows, what passed since the middle of its interval
    middle = time_s[:-1] + 0.5 * step
    square = _later(time_s**2) - 2.0 * middle * _later(time_s) + middle**2 * after[:-1]
    walked = (_later(basis * time_s) - middle * _later(basis)) ** 2 @ step
    each = np.stack([summed, walked], axis=1)
    of_all = np.array([summed_of_all, step @ square])
    return each, np.maximum(of_all - each.sum(axis=0), 0.0)


def walk_square(time_s: Array, weights: Array, duration_s: float) -> float:
    """Variance of a weighted sum of a unit random walk about its mean over the event, s times w².

    For weights w (m,) at times t (m,) of an event of length T; the walk less its mean has the
    covariance T/3 − max(t, t′) + (t² + t′²)/(2 T).
    """
    total = weights.sum()
    later = weights @ (time_s * (2.0 * np.cumsum(weights) - weights))
    return float(total**2 * duration_s / 3.0 - later + total * (weights @ time_s**2) / duration_s)


def _of_integrals(time_s: Array, along: Array) -> Array:
    """Weights (…, m) of the rows in sums ``along`` (…, m) the integrals: along · A, s."""
    own, later = _weights_of_rows(time_s)
    result = own * along
    result[..., :-1] += later[:-1] * _later(along)
    return result


def _weights_of_rows(time_s: Array) -> tuple[Array, Array]:
    """What every row (m,) puts into the integral up to itself and up to later rows, s."""
    half = 0.5 * np.diff(time_s)
    own = np.r_[0.0, half]
    return own, own + np.r_[half, 0.0]


def _later(values: Array) -> Array:
    """Sums (…, m − 1) of values (…, m) over later rows."""
    return np.cumsum(values[..., :0:-1], axis=-1)[..., ::-1]


def _integral(time_s: Array, values: Array) -> Array:
    """∫ values dt by the trapezoidal rule from the first row, (m, …)."""
    step = np.diff(time_s)[:, None]
    gained = 0.5 * step * (values[1:] + values[:-1])
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(gained, axis=0)])
