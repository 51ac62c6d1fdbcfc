"""Rounded wheel rates: where a wheel rests its rounding lasts, elsewhere it is noise of every row.

A wheel that passes one printed value after the other has a rounding that is another in every row:
white noise of Δ²/12 beside that of the measurement. While a wheel rests, the rounding is the same
in all rows. How much a reading scatters then depends on where between two printed values the wheel
is, which is not known, but the scatter itself is seen. So rows at rest have the variance that they
show, one lasting error on top, and where readings change the slow motion that they show
(docs/topics/telemetry-likelihood.md §11).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array, Flags

_HARMONICS: Final = 64  # of a sawtooth: the rest has less than a percent of its square
HARMONICS: Final = 4  # told apart: the rest has 17 % of the square
WINDOW: Final = 8  # rows on either side; a wheel that gains a step between their means moves
# Steps squared. Readings of two neighbouring values scatter by p (1 − p) <= 1/4, however the wheel
# rests; more than that is noise of half a step and more, which leaves nothing of a rounding.
DITHERED: Final = 0.3
LEAST_DRIFT: Final = 2 * WINDOW  # rows at rest for every cosine that tells slow motion


@dataclass(frozen=True)
class WheelSquares:
    """Mean squares of the noise of W measured wheel rates over some modes or rows.

    The variance of a wheel is σ² ``moving`` + ``seen`` + Δ²/12 (``moving`` + b ``lasting``): σ is
    the noise of the measurement, Δ the step and b the share of the rounding that lasts at that
    noise.
    """

    moving: Array  # (W,) rows in which it moves
    seen: Array  # (W,) rad²/s², what rows at rest scatter, and how they drift
    lasting: Array  # (W,) of a rounding that lasts, over that of a single row

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
        """Sums over some modes of squares (M, W)."""
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


def rests(levels: Array) -> Rests:
    """Where a wheel whose printed rates are whole numbers (r,) of steps rests.

    It moves where it gains a step over the window, or passes through a printed value: comes from
    one side and leaves on the other, for good. Readings that change to and fro are one stretch at
    rest, and scatter by half the mean square of their differences. Half a reading of another value
    is added (Jeffreys' prior of a rare event): n readings alike do not say that there is no noise.
    Where they scatter by more than two values can (:data:`DITHERED`), rounding is white in all
    rows, as in one that moves.
    """
    rows = len(levels)
    total = np.concatenate([[0.0], np.cumsum(levels)])
    at = np.arange(rows)
    before, after = np.maximum(at - WINDOW, 0), np.minimum(at + WINDOW, rows)
    mean_before = (total[at] - total[before]) / np.maximum(at - before, 1)
    mean_after = (total[after] - total[at]) / (after - at)
    moving = (np.abs(mean_after - mean_before) > 1.0) & (at > before)
    change = np.diff(levels)
    edges = np.flatnonzero(change) + 1
    came, left = edges[:-1], edges[1:]
    passed = np.sign(change[came - 1]) == np.sign(change[left - 1])
    # noise to either side of a value is no passage
    passed &= np.abs(mean_after[left] - mean_before[came]) > 1.0
    for first, last in zip(came[passed], left[passed], strict=True):
        moving[first:last] = True
    # a stretch ends where a value is passed, and at rows that move
    stays = np.ones(rows, dtype=bool)
    stays[came[passed]] = stays[left[passed]] = stays[0] = False
    stays &= ~moving & ~np.concatenate([[True], moving[:-1]])
    starts = np.flatnonzero(~stays)
    lengths = np.diff(starts, append=rows)
    jumps = np.where(stays, np.diff(levels, prepend=levels[:1]) ** 2, 0.0)
    if 0.5 * jumps.sum() > DITHERED * np.count_nonzero(stays):
        return Rests(np.ones(rows, dtype=np.bool_), np.zeros(rows), at)
    scatter = 0.5 * (1.0 + np.add.reduceat(jumps, starts)) / lengths
    moving = moving | np.repeat(lengths == 1, lengths)
    return Rests(moving, np.where(moving, 0.0, np.repeat(scatter, lengths)), starts)


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


def long_stretches(rates: Array, step: float, least: int) -> list[tuple[int, slice]]:
    """Wheel and rows of all stretches of at least so many rows in which a rounding lasts.

    ``rates`` (r, W) are printed in steps; those without a step have none.
    """
    if step == 0.0:
        return []
    each = [rests(np.round(own / step)) for own in rates.T]
    return [
        (wheel, slice(start, start + length))
        for wheel, own in enumerate(each)
        for start, length in zip(own.starts.tolist(), own.lengths.tolist(), strict=True)
        if length >= least
    ]


def wheel_squares(
    rates: Array, step: float, on_modes: Array, stride: int
) -> tuple[WheelSquares, WheelSquares]:
    """Sums of squares of the noise of wheel rates (r, W): on every mode (M, W), on all rows (W,).

    ``on_modes`` (r, M) are the modes at these rows, each of which stands for ``stride`` rows.
    """
    modes, wheels, rows = on_modes.shape[1], rates.shape[1], stride * len(rates)
    if step == 0.0:
        none = np.zeros(wheels)
        everywhere = WheelSquares(np.full(wheels, float(rows)), none, none)
        return WheelSquares(*(np.tile(s, (modes, 1)) for s in (none + 1.0, none, none))), everywhere
    square = on_modes**2
    on, over = np.zeros((3, modes, wheels)), np.zeros((3, wheels))
    for j, levels in enumerate(np.round(rates.T / step)):
        found = rests(levels)
        lengths = found.lengths
        together = np.add.reduceat(on_modes, found.starts) ** 2
        at_rest = np.where(lengths > 1, stride**2, 0.0)
        by_row = np.stack([found.moving.astype(np.float64), step**2 * found.variance])
        on[:2, :, j] = stride * by_row @ square
        on[2, :, j] = at_rest @ together
        over[:2, j] = stride * by_row.sum(axis=1)
        over[2, j] = stride * lengths[lengths > 1].sum()
        for stretch in np.flatnonzero(lengths >= LEAST_DRIFT):
            start = found.starts[stretch]
            part = slice(start, start + lengths[stretch])
            drifts = step * _slow_motion(levels[part], found.variance[start])
            on[1, :, j] += stride**2 * ((drifts @ on_modes[part]) ** 2).sum(axis=0)
            over[1, j] += stride * (drifts**2).sum()
    return WheelSquares(*on), WheelSquares(*over)


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
