"""An appendage on a spring that moves against its body: what it answers to the body's own motion.

With Ω = 2π f and ζ of the clamped appendage its rate against the body, q, obeys
q'' + 2 ζ Ω q' + Ω² q = −ω'': a free oscillation, and an answer to the body's rate ω. Recursions
over rows are compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.balance.statistics.turns import WhiteTurns
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.computing.compilation import compiled

RENEWED: Final = 64
"""Rows after which cosine and sine are computed anew and not turned from the last row's: rounding
grows by some 1e-16 a row, so that 64 leave it below 1e-14."""
SAME_S: Final = 1e-9  # two gaps between rows that differ by less are one: rounding of times


def oscillation_series(
    time_s: Array, motion: KnownMotion, frequency_hz: float, damping: float
) -> tuple[Array, Array, Array]:
    """exp(−ζΩt) cos Ωt and exp(−ζΩt) sin Ωt (n,), and the driven rate (n, c), Ω = 2π f.

    t is counted from where the motion begins: events may begin long after their epoch.
    """
    phase = 2.0 * np.pi * frequency_hz * (time_s - motion.start_s)
    decay = np.exp(-damping * phase)
    driven = motion.driven(time_s, frequency_hz, damping)
    return decay * np.cos(phase), decay * np.sin(phase), driven


@dataclass(frozen=True)
class KnownMotion:
    """The body's motion as the rates before each row show it, on a grid of their median step.

    The last line before a row is that of the step before, so that a row's own noise is not in it:
    it would be taken for an answer to it.
    """

    start_s: float
    step_s: float
    slope: Array  # (g, c) of the rate after each grid point, rad/s²
    change: Array  # (g, c) of the last slope by that of the step before

    def driven(self, time_s: Array, frequency_hz: float, damping: float) -> Array:
        """Rate (n, c) of an appendage against its body at times (n,) of rows, rad/s.

        θ'' + 2 ζ Ω θ' + Ω² θ = −ω' with Ω = 2π f, at rest at the first row; ω goes in straight
        lines from row to row, and the response to them is exact.
        """
        slope, change, coefficients, place = self._recursion(
            time_s, np.array([frequency_hz]), damping
        )
        return np.asarray(_answer(slope, change, coefficients[0], place))

    def products(
        self, time_s: Array, frequency_hz: Array, damping: float, left: Array
    ) -> tuple[Array, Array]:
        """Inner products of :func:`oscillation_series` at many frequencies (f,), rows summed over.

        With each other, (f, 2 + c, 2 + c) in order of cosine, sine and driven rates, and with what
        is left, ``left`` (n, 3), (f, 2 + c, 3).
        """
        motion = self._recursion(time_s, frequency_hz, damping)
        shape = 2.0 * np.pi * frequency_hz, damping
        lower, along = _products(time_s - self.start_s, shape, motion, left)
        return lower + np.swapaxes(np.tril(lower, -1), 1, 2), along

    def _recursion(
        self, time_s: Array, frequency_hz: Array, damping: float
    ) -> tuple[Array, Array, Array, Places]:
        """What :func:`_answer` takes."""
        omega, step = 2.0 * np.pi * frequency_hz, self.step_s
        turned = omega * np.sqrt(1.0 - damping**2)
        decay = np.exp(-damping * omega * step)
        cosine, sine = decay * np.cos(turned * step), decay * np.sin(turned * step) / turned
        # of the transition of (θ, θ') over a step: its first column, and what a steady ω' adds
        first, second = cosine + damping * omega * sine, -(omega**2) * sine
        added = -(1.0 - first) / omega**2, -sine
        ahead = second * added[0] - first * added[1]
        coefficients = np.stack([added[1], ahead, -2.0 * cosine, decay**2], axis=1)
        place = np.round((time_s - self.start_s) / step).astype(np.int64)
        return self.slope, self.change, coefficients, np.clip(place, 0, len(self.slope) - 1)


def known_motion(time_s: Array, rate_rad_s: Array) -> KnownMotion:
    """The motion that samples of the rate (n, c) at times (n,) show; NaN is not sampled.

    All samples count, those during pulses as well. Where some are missing the line goes to the
    next one, whose noise is then in it.
    """
    measured = np.isfinite(rate_rad_s).all(1)
    time_s, rate_rad_s = time_s[measured], rate_rad_s[measured]
    step = float(np.median(np.diff(time_s)))
    grid = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    shown = np.stack([np.interp(grid, time_s, rate) for rate in rate_rad_s.T], axis=1)
    slope = np.diff(shown, axis=0, append=shown[-1:]) / step
    change = np.zeros_like(slope)
    change[2:] = slope[:-2] - slope[1:-1]
    return KnownMotion(float(time_s[0]), step, slope, change)


def products_of_turns(
    turns: WhiteTurns,
    motion: KnownMotion,
    frequency_hz: Array,
    damping: float,
    white: Array,
    units: Array,
) -> tuple[Array, Array]:
    """Inner products of a free oscillation's cosine and sine, integrated over quiet pieces.

    About directions (d) that are ``units`` (3, d) along whitened axes: with each other, (f, d, 2,
    2), and with what is left of turns, ``white`` (n, 3), (f, 2, d). With each other they count as a
    slope and as a swing in the noise of its frequency (of rows a step of the body's ``motion``
    apart). Its answer to that motion is not among them.
    """
    pieces, shares = turns.pieces, turns.slope_shares
    of_slopes, whole, along = _products_of_turns(
        (pieces.time_s - motion.start_s, turns.ramps, pieces.ends),
        np.column_stack([np.ones(len(shares)), shares]),
        2.0 * np.pi * frequency_hz,
        damping,
        turns.whitened_axes(white[:, :, None])[:, :, 0] @ units,
    )
    swings = turns.swing_shares(frequency_hz, motion.step_s)[:, :, None, None]
    squares = of_slopes[:, 1:] + swings * (whole[:, None] - of_slopes[:, :1])
    return np.einsum("ad,faij->fdij", units**2, squares), along


@compiled
def _answer(
    slope: Array, change: Array, coefficients: Array, place: Places
) -> Array:  # pragma: no cover - compiled
    """Rates (n, c) of an appendage against its body, y_t = b1 x_t−1 + b2 x_t−2 − a1 y… − a2 y…

    Parameters
    ----------
    slope
        (g, c) slopes of the body's rate along a grid, x.
    change
        (g, c) of the last slope, which enters with b1 alone.
    coefficients
        (4,) b1, b2, a1, a2.
    place
        (n,) grid points that are asked for.
    """
    whole = np.empty_like(slope)
    _recur(slope, change, coefficients, whole)
    result = np.empty((place.size, slope.shape[1]))
    for i in range(place.size):
        result[i] = whole[place[i]]
    return result


@compiled
def _products(
    time_s: Array,
    frequencies: tuple[Array, float],
    motion: tuple[Array, Array, Array, Places],
    left: Array,
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """Inner products over the rows of a cosine, a sine and driven rates, and with what is left.

    Parameters
    ----------
    time_s
        (n,) of the rows, from where the motion begins.
    frequencies
        Ω (f,) in rad/s and the damping ζ of exp(−ζΩt) cos Ωt and exp(−ζΩt) sin Ωt.
    motion
        As for :func:`_answer`, coefficients (f, 4).
    left
        (n, 3) what is left, about every axis.

    Returns
    -------
    (f, 2 + c, 2 + c), the lower triangle, and (f, 2 + c, 3).
    """
    (angular, damping), (slope, change, coefficients, place) = frequencies, motion
    size = 2 + slope.shape[1]
    squares = np.zeros((angular.size, size, size))
    along = np.zeros((angular.size, size, 3))
    driven, values, free = np.empty_like(slope), np.zeros(size), np.empty((2, time_s.size))
    for f in range(angular.size):
        _recur(slope, change, coefficients[f], driven)
        own_squares, own_along = squares[f], along[f]
        _oscillate(time_s, angular[f], damping, free)
        for i in range(time_s.size):
            values[0], values[1] = free[0, i], free[1, i]
            for c in range(2, size):
                values[c] = driven[place[i], c - 2]
            for a in range(size):
                for b in range(a + 1):
                    own_squares[a, b] += values[a] * values[b]
                for axis in range(3):
                    own_along[a, axis] += values[a] * left[i, axis]
    return squares, along


@compiled
def _products_of_turns(
    rows: tuple[Array, Array, Places],
    shares: Array,
    angular: Array,
    damping: float,
    left: Array,
) -> tuple[Array, Array, Array]:  # pragma: no cover - compiled
    """See :func:`products_of_turns`; Ω (f,) in rad/s.

    ∫ exp((i − ζ) Ωt) dt = exp((i − ζ) Ωt)/((i − ζ) Ω), from which the piece's mean is taken off.

    Parameters
    ----------
    rows
        Their times from where the motion begins and ramps (n,), bounds (p + 1,) of the pieces.
    shares
        (p, w) by which squares of slopes are weighed, in w ways.

    Returns
    -------
    Squares of slopes (f, w, 2, 2), of all (f, 2, 2), and products (f, 2, 3) with what is left.
    """
    time_s, ramp, ends = rows
    squares, along = np.zeros((angular.size, 2, 2)), np.zeros((angular.size, 2, 3))
    of_slopes = np.zeros((angular.size, shares.shape[1], 2, 2))
    free = np.empty((2, time_s.size))
    for f in range(angular.size):
        omega, own_along = angular[f], along[f]
        share = 1.0 / (omega * (1.0 + damping**2))
        _oscillate(time_s, omega, damping, free)
        of_cosine, of_sine, of_both = 0.0, 0.0, 0.0
        for piece in range(ends.size - 1):
            sum_cosine, sum_sine, slope_cosine, slope_sine = 0.0, 0.0, 0.0, 0.0
            for i in range(ends[piece], ends[piece + 1]):
                cosine, sine = free[0, i], free[1, i]
                gained = share * (sine - damping * cosine), -share * (cosine + damping * sine)
                sum_cosine += gained[0]
                sum_sine += gained[1]
                slope_cosine += ramp[i] * gained[0]
                slope_sine += ramp[i] * gained[1]
                of_cosine += gained[0] * gained[0]
                of_sine += gained[1] * gained[1]
                of_both += gained[0] * gained[1]
                for axis in range(3):
                    own_along[0, axis] += gained[0] * left[i, axis]
                    own_along[1, axis] += gained[1] * left[i, axis]
            count = ends[piece + 1] - ends[piece]
            of_cosine -= sum_cosine * sum_cosine / count
            of_sine -= sum_sine * sum_sine / count
            of_both -= sum_cosine * sum_sine / count
            for way in range(shares.shape[1]):
                own = of_slopes[f, way]
                own[0, 0] += shares[piece, way] * slope_cosine**2
                own[1, 1] += shares[piece, way] * slope_sine**2
                own[0, 1] += shares[piece, way] * slope_cosine * slope_sine
                own[1, 0] = own[0, 1]
        squares[f, 0, 0], squares[f, 1, 1] = of_cosine, of_sine
        squares[f, 0, 1] = squares[f, 1, 0] = of_both
    return of_slopes, squares, along


@compiled
def _oscillate(
    time_s: Array, omega: float, damping: float, series: Array
) -> None:  # pragma: no cover - compiled
    """Fill (2, n) with exp(−ζΩt) cos Ωt and exp(−ζΩt) sin Ωt, each row turned from the last."""
    step, turn, swing = -1.0, 0.0, 0.0
    for i in range(time_s.size):
        gap = time_s[i] - time_s[i - 1] if i > 0 else 0.0
        if abs(gap - step) > SAME_S:
            step = gap
            turn = np.exp(-damping * omega * gap) * np.cos(omega * gap)
            swing = np.exp(-damping * omega * gap) * np.sin(omega * gap)
        if i % RENEWED == 0:
            fading = np.exp(-damping * omega * time_s[i])
            series[0, i] = fading * np.cos(omega * time_s[i])
            series[1, i] = fading * np.sin(omega * time_s[i])
        else:
            cosine, sine = series[0, i - 1], series[1, i - 1]
            series[0, i] = turn * cosine - swing * sine
            series[1, i] = swing * cosine + turn * sine


@compiled
def _recur(
    slope: Array, change: Array, coefficients: Array, whole: Array
) -> None:  # pragma: no cover - compiled
    b1, b2, a1, a2 = coefficients
    for c in range(slope.shape[1]):
        before, last, x_before, x_last = 0.0, 0.0, 0.0, 0.0
        for t in range(slope.shape[0]):
            value = b1 * x_last + b2 * x_before - a1 * last - a2 * before
            before, last, x_before, x_last = last, value, x_last, slope[t, c]
            whole[t, c] = value + b1 * change[t, c]
