"""Rounded wheel rates: where a wheel rests its rounding lasts, where it is driven it repeats.

A wheel that passes one printed value after the other has a rounding that is another in every row:
noise of Δ²/12 beside that of the measurement. It is white unless the wheel is driven evenly: then
it comes back with every step, as lines (:func:`between_steps`). While a wheel rests, the rounding
is the same in all rows. How much a reading scatters then depends on where between two printed
values the wheel is, which is not known, but the scatter itself is seen. So rows at rest have the
variance that they show, one lasting error on top, and where readings change the slow motion that
they show (docs/topics/telemetry-likelihood.md §11).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array, Flags, Places

_HARMONICS: Final = 64  # of a sawtooth: the rest has less than a percent of its square
HARMONICS: Final = 4  # told apart: the rest has 17 % of the square
WINDOW: Final = 8  # rows on either side; a wheel that gains a step between their means moves
# Steps squared. Readings of two neighbouring values scatter by p (1 − p) <= 1/4, however the wheel
# rests; more than that is noise of half a step and more, which leaves nothing of a rounding.
DITHERED: Final = 0.3
LEAST_DRIFT: Final = 2 * WINDOW  # rows at rest for every cosine that tells slow motion
LEAST_PAUSE: Final = 3.0  # of a pause's length over that of the values on either side of it
LINES: Final = (8, 16, 32, 64, 128)  # rows on either side of a straight line through readings
LEAST_GAIN: Final = 3.0  # steps along a line: with fewer it follows the staircase, not the wheel
LEAST_LIKE: Final = 0.5  # ratio of slopes of a line's halves, for a wheel that is driven evenly
ROUNDING: Final = 1.0 / 12.0  # steps squared
CHANCE: Final = 2.5  # standard deviations of a mean square: what scatters more is no noise


@dataclass(frozen=True)
class WheelSquares:
    """Mean squares of the noise of W measured wheel rates over some modes or rows.

    The variance of a wheel is σ² m + s + Δ²/12 ((1 − Σ b_k) m + Σ_k b_k l_k), with ``moving`` m,
    ``seen`` s and ``lasting`` l: σ is the noise of the measurement, Δ the step, and b_k the share
    of the rounding in harmonic k that repeats at that noise (:func:`coherent_shares`).
    """

    moving: Array  # (W,) rows in which it moves
    seen: Array  # (W,) rad²/s², what rows at rest scatter, and how they drift
    lasting: Array  # (H, W) of a rounding that lasts or repeats, over that of a single row

    def __sub__(self, other: WheelSquares) -> WheelSquares:
        """What is left of sums of squares; rounding of the arithmetic leaves no less than none."""
        return WheelSquares(
            *(
                np.maximum(a - b, 0.0)
                for a, b in (
                    (self.moving, other.moving),
                    (self.seen, other.seen),
                    (self.lasting, other.lasting),
                )
            )
        )

    def of_modes(self, start: int, stop: int) -> WheelSquares:
        """Sums over some modes of squares (M, …)."""
        parts = (self.moving, self.seen, self.lasting)
        return WheelSquares(*(part[start:stop].sum(axis=0) for part in parts))

    def over(self, count: float) -> WheelSquares:
        """Means over so many modes or rows of what are sums."""
        return WheelSquares(self.moving / count, self.seen / count, self.lasting / count)


@dataclass(frozen=True)
class Rests:
    """Where one wheel rests, by row (r,).

    ``starts`` are the first rows of stretches that share a rounding, every row in which the wheel
    moves being one of its own; ``variance`` (r,) is what a row at rest scatters, in steps squared.
    """

    moving: Flags
    variance: Array
    starts: NDArray[np.intp]

    @property
    def lengths(self) -> NDArray[np.intp]:
        """Rows of every stretch."""
        return np.diff(self.starts, append=len(self.moving))


def rests(time_s: Array, levels: Array) -> Rests:
    """Where a wheel whose printed rates at times (r,) are whole numbers (r,) of steps rests.

    It moves where it gains a step over the window or is driven evenly (:func:`between_steps`), or
    passes through a printed value: comes from one side and leaves on the other, for good, and
    without a pause (:func:`_pauses`). Readings that change to and fro are one stretch at rest, and
    scatter by half the mean square of their differences; unless their mean goes on for a step and
    more (:func:`_wandering`). Half a reading of another value is added (Jeffreys' prior of a rare
    event): n readings alike do not say that there is no noise. Where they scatter by more than two
    values can (:data:`DITHERED`), rounding is white in all rows, as in one that moves.
    """
    mean_before, mean_after = means_beside(levels)
    driven = between_steps(time_s, levels)[1]
    moving = np.abs(mean_after - mean_before) > 1.0
    moving[0] = False
    moving |= driven
    came, left = _passed(levels, mean_before, mean_after)
    for first, last in zip(came.tolist(), left.tolist(), strict=True):
        if driven[first:last].any() or not _pauses(levels, first, last):
            moving[first:last] = True
    # a stretch ends where a value is passed, and at rows that move
    stays = ~moving & ~np.concatenate([[True], moving[:-1]])
    stays[came] = stays[left] = False
    wanders = _wandering(np.flatnonzero(~stays), mean_after)
    return _scattered(levels, moving | wanders, stays & ~wanders)


def _passed(levels: Array, mean_before: Array, mean_after: Array) -> tuple[Places, Places]:
    """First rows of values that are passed through, and those after them; noise is no passage."""
    change = np.diff(levels)
    edges = np.flatnonzero(change) + 1
    came, left = edges[:-1], edges[1:]
    side = np.sign(change[came - 1])
    passed = side == np.sign(change[left - 1])
    passed &= side * (levels[came] - mean_before[came]) > 0.5
    passed &= side * (mean_after[left] - levels[came]) > 0.5
    return came[passed], left[passed]


def _scattered(levels: Array, moving: Flags, stays: Flags) -> Rests:
    """Stretches of rows that stay, with what their readings scatter by."""
    rows, starts = len(levels), np.flatnonzero(~stays)
    lengths = np.diff(starts, append=rows)
    jumps = np.where(stays, np.diff(levels, prepend=levels[:1]) ** 2, 0.0)
    if 0.5 * jumps.sum() > DITHERED * np.count_nonzero(stays):
        return Rests(np.ones(rows, dtype=np.bool_), np.zeros(rows), np.arange(rows))
    scatter = 0.5 * (1.0 + np.add.reduceat(jumps, starts)) / lengths
    moving = moving | np.repeat(lengths == 1, lengths)
    return Rests(moving, np.where(moving, 0.0, np.repeat(scatter, lengths)), starts)


def means_beside(levels: Array) -> tuple[Array, Array]:
    """Means of a window before every row, and of one that begins with it, (r,): shorter at ends."""
    rows = len(levels)
    total = np.concatenate([[0.0], np.cumsum(levels)])
    at = np.arange(rows)
    before, after = np.maximum(at - WINDOW, 0), np.minimum(at + WINDOW, rows)
    mean_before = (total[at] - total[before]) / np.maximum(at - before, 1)
    return mean_before, (total[after] - total[at]) / (after - at)


def _wandering(starts: Places, mean_after: Array) -> Flags:
    """Rows (r,) of stretches in which means over a window (r,) are more than a step apart.

    Those of readings of two values never are: such a wheel goes on, and its noise hides its steps.
    """
    result = np.zeros(len(mean_after), dtype=np.bool_)
    lengths = np.diff(starts, append=len(mean_after))
    for stretch in np.flatnonzero(lengths >= LEAST_DRIFT):
        first, stop = starts[stretch], starts[stretch] + lengths[stretch]
        result[first:stop] = np.ptp(mean_after[first : stop - WINDOW + 1]) > 1.0
    return result


def _pauses(levels: Array, came: int, left: int) -> bool:
    """Whether a wheel that passes a value in rows from ``came`` to ``left`` stops there on its way.

    So it does between two slews. It shows that value for at least :data:`LEAST_DRIFT` rows, and
    :data:`LEAST_PAUSE` times as long as the values before and after it.
    """
    length = left - came
    if length < LEAST_DRIFT:
        return False
    value, limit = levels[came], math.ceil(length / LEAST_PAUSE)
    before, after = levels[max(came - limit, 0) : came], levels[left : left + limit]
    return all(
        bool(np.any((near != value) & (near != next_to)))
        for near, next_to in ((before, levels[came - 1]), (after, levels[left]))
    )


def between_steps(time_s: Array, levels: Array) -> tuple[Array, Flags]:
    """The rate (n,) of a wheel, in steps, from printed ones (n,) that are whole numbers of steps.

    Readings about a row have unlike roundings where the wheel moves, so that a straight line
    through them is known much better than one reading: to 0.05 steps by 32 of them. Every row has
    the shortest line of :data:`LINES` along which the wheel gains :data:`LEAST_GAIN`, or the
    longest there is. Also returns in which rows (n,) the wheel is driven evenly: both halves of
    such a line have like slopes, and readings scatter about it as rounding and their own noise do.
    A wheel that goes and stops, again and again, scatters more.
    """
    n, time = len(levels), time_s - time_s.mean()
    # half the square of a difference: the noise of a reading, and what its rounding changes by
    noise = 0.5 * np.diff(levels, prepend=levels[:1]) ** 2
    about = levels - levels.mean()
    sums = np.stack([np.ones(n), time, about, time**2, time * about, about**2, noise])
    sums = np.concatenate([np.zeros((7, 1)), sums.cumsum(axis=1)], axis=1)
    rate, driven, found = about, np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    for half in LINES:
        # rows near either end have the line through as many rows there
        first = np.clip(np.arange(n) - half, 0, max(n - 2 * half - 1, 0))
        stop = np.minimum(first + 2 * half + 1, n)
        line = _straight_lines(sums, first, stop)
        halves = [_straight_lines(sums, *ends).slope for ends in _halves(first, stop)]
        gained = np.abs(line.slope) * (time[stop - 1] - time[first])
        chosen = ~found & ((gained >= LEAST_GAIN) | (half == LINES[-1]))
        rate = np.where(chosen, line.height + line.slope * (time - line.middle), rate)
        ends = np.sort(np.stack(halves) * np.sign(line.slope), axis=0)
        chance = 1.0 + CHANCE * np.sqrt(2.0 / (stop - first))
        is_noise = line.scatter < chance * (ROUNDING + line.noise)
        is_even = (ends[0] > LEAST_LIKE * ends[1]) & is_noise
        driven |= chosen & (gained >= LEAST_GAIN) & is_even
        found |= chosen
    return rate + levels.mean(), driven


class _Lines(NamedTuple):
    """Straight lines through rows (n,): means of time and value, slopes, scatter, and noise."""

    middle: Array
    height: Array
    slope: Array
    scatter: Array
    noise: Array


def _halves(first: Places, stop: Places) -> tuple[tuple[Places, Places], tuple[Places, Places]]:
    middle = (first + stop) // 2
    return (first, middle), (middle, stop)


def _straight_lines(sums: Array, first: Places, stop: Places) -> _Lines:
    """Lines through rows from ``first`` to ``stop`` (n,).

    ``sums`` (7, 1 + n) are those of 1, t, y, t², t y, y² and noise over all rows before.
    """
    total = sums[:, stop] - sums[:, first]
    count, (t, y, square, mixed, power, noise) = np.maximum(total[0], 1.0), total[1:]
    spread, common = square / count - (t / count) ** 2, mixed / count - t * y / count**2
    slope = common / np.where(spread > 0.0, spread, np.inf)
    scatter = power / count - (y / count) ** 2 - slope * common
    return _Lines(t / count, y / count, slope, scatter, noise / count)


def coherent_shares(noise: Array) -> Array:
    """Shares (n, H) of the square of a rounding that repeat where a wheel's rate does.

    ``noise`` (n,) is that of the measurement, σ/Δ. It dithers: of a rate that rests at a phase x of
    the step the mean of what is printed is off by
    Σ_k (−1)^k Δ/(π k) exp(−2 π² k² σ²/Δ²) sin 2 π k x (the characteristic function of the noise at
    whole turns), and only that lasts. Over all phases the square of harmonic k is Δ²/12 times
    6/(π² k²) exp(−4 π² k² σ²/Δ²): together all of it without noise, 15 % at σ = 0.19 Δ. The last
    share is that of all further harmonics, too.
    """
    order = np.arange(1, _HARMONICS + 1)
    faded = np.exp(-((2.0 * np.pi * order * noise[:, None]) ** 2))
    each = 6.0 / np.pi**2 * faded / order**2
    last = each[:, HARMONICS - 1 :].sum(axis=1, keepdims=True)
    return np.concatenate([each[:, : HARMONICS - 1], last], axis=1)


@dataclass(frozen=True)
class ShownRows:
    """Printed wheel rates (r, W) at times (r,), s, in steps of ``step``, evenly thinned.

    Each row stands for ``stride`` of them. They are means over ``averaged`` rows, and if over more
    than one, next to nothing is in them of roundings that come back with every step.
    """

    time_s: Array
    rates: Array
    step: float
    stride: int = 1
    averaged: float = 1.0


def long_stretches(shown: ShownRows, least: int) -> list[tuple[int, slice]]:
    """Wheel and rows of all stretches of at least so many rows in which a rounding lasts.

    Wheels without a step have none.
    """
    if shown.step == 0.0:
        return []
    each = [rests(shown.time_s, np.round(own / shown.step)) for own in shown.rates.T]
    return [
        (wheel, slice(start, start + length))
        for wheel, own in enumerate(each)
        for start, length in zip(own.starts.tolist(), own.lengths.tolist(), strict=True)
        if length >= least
    ]


def wheel_squares(shown: ShownRows, on_modes: Array) -> tuple[WheelSquares, WheelSquares]:
    """Sums of squares of the noise of wheel rates: on every mode (M, …), on all rows (…).

    ``on_modes`` (r, M) are the modes at the rows shown.
    """
    rates, step, stride = shown.rates, shown.step, shown.stride
    modes, wheels, rows = on_modes.shape[1], rates.shape[1], stride * len(rates)
    if step == 0.0:
        none, lasting = np.zeros(wheels), np.zeros((HARMONICS, wheels))
        everywhere = WheelSquares(np.full(wheels, float(rows)), none, lasting)
        one, nothing = np.ones((modes, wheels)), np.zeros((modes, wheels))
        return WheelSquares(one, nothing, np.tile(lasting, (modes, 1, 1))), everywhere
    square = on_modes**2
    on, over = np.zeros((2, modes, wheels)), np.zeros((2, wheels))
    lasting, lasting_over = np.zeros((modes, HARMONICS, wheels)), np.zeros(wheels)
    for j, levels in enumerate(np.round(rates.T / step)):
        found = rests(shown.time_s, levels)
        lengths = found.lengths
        together = np.add.reduceat(on_modes, found.starts) ** 2
        at_rest = np.where(lengths > 1, stride**2, 0.0)
        by_row = np.stack([found.moving.astype(np.float64), step**2 * found.variance])
        on[:, :, j] = stride * by_row @ square
        over[:, j] = stride * by_row.sum(axis=1)
        lasting[:, :, j] = (at_rest @ together)[:, None]
        lasting_over[j] = stride * lengths[lengths > 1].sum()
        if shown.averaged > 1.0:
            lasting[:, :, j] += on[0, :, j, None] / shown.averaged
        else:
            lasting[:, :, j] += _repeating(shown, levels, found.moving, on_modes)
        lasting_over[j] += over[0, j] / shown.averaged
        for stretch in np.flatnonzero(lengths >= LEAST_DRIFT):
            start = found.starts[stretch]
            part = slice(start, start + lengths[stretch])
            drifts = step * _slow_motion(levels[part], found.variance[start])
            on[1, :, j] += stride**2 * ((drifts @ on_modes[part]) ** 2).sum(axis=0)
            over[1, j] += stride * (drifts**2).sum()
    of_all = np.tile(lasting_over, (HARMONICS, 1))
    return WheelSquares(on[0], on[1], lasting), WheelSquares(over[0], over[1], of_all)


def _repeating(shown: ShownRows, levels: Array, moving: Flags, on_modes: Array) -> Array:
    """Squares (M, H) on modes of harmonics of the rounding in rows in which a wheel moves.

    Harmonic k is |Σ φ exp(2π i k ρ)|² with ρ the rate in steps. What goes up and down between rows
    that are thinned is not as slow as it looks in them.
    """
    rate, _ = between_steps(shown.time_s, levels)
    passed = np.gradient(rate) / shown.stride  # steps from row to row, of all of them
    squares = np.zeros((on_modes.shape[1], HARMONICS))
    for k in range(1, HARMONICS + 1):
        apart = np.abs(k * passed - np.round(k * passed))
        at = shown.stride * (moving & ((apart * shown.stride <= 0.5) | (shown.stride == 1)))
        phase = 2.0 * np.pi * k * rate
        waves = np.stack([at * np.cos(phase), at * np.sin(phase)])
        squares[:, k - 1] = ((waves @ on_modes) ** 2).sum(axis=0)
    return squares


def _slow_motion(shown: Array, white: float) -> Array:
    """What a wheel at rest seems to do slowly (D, n), from what is printed (n,), in its unit.

    ``shown`` has :data:`LEAST_DRIFT` rows at least.

    Near the threshold of two printed values the mean of what is printed goes from one to the other
    within the noise, which may be much less than a step. So what looks like motion is mostly
    rounding. As an error it has the size that cosines show beyond ``white`` noise and its chance
    (one standard deviation), by octave.
    """
    n = len(shown)
    if np.ptp(shown) == 0.0:
        return np.zeros((0, n))
    order, place = np.arange(1, n // LEAST_DRIFT + 1), (np.arange(n) + 0.5) / n
    waves = np.sqrt(2.0 / n) * np.cos(np.pi * np.outer(order, place))
    octave = np.frexp(order)[1] - 1
    cosines = np.bincount(octave)
    square = np.bincount(octave, (waves @ shown) ** 2) / cosines
    excess = square - white * (1.0 + np.sqrt(2.0 / cosines))
    return np.asarray(np.sqrt(np.maximum(excess, 0.0))[octave, None] * waves)
