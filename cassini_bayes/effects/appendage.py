"""Damped oscillations and the answers of appendages to their body's motion, compiled."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.compilation import compiled

Array = NDArray[np.float64]
Places = NDArray[np.int64]
RENEWED: Final = 64  # rows after which cosine and sine are not those of the last row, turned
SAME_S: Final = 1e-9  # between two gaps


@compiled
def answer(
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
def products(
    time_s: Array,
    frequencies: tuple[Array, float],
    motion: tuple[Array, Array, Array, Places],
    left: Array,
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """Inner products over the rows of a cosine, a sine and driven rates, and with what is left.

    Parameters
    ----------
    time_s
        (n,) of the rows.
    frequencies
        Ω (f,) in rad/s and the damping ζ of exp(−ζΩt) cos Ωt and exp(−ζΩt) sin Ωt.
    motion
        As for :func:`answer`, coefficients (f, 4).
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
    driven, values = np.empty_like(slope), np.zeros(size)
    for f in range(angular.size):
        _recur(slope, change, coefficients[f], driven)
        own_squares, own_along = squares[f], along[f]
        step, turn, swing = -1.0, 0.0, 0.0
        for i in range(time_s.size):
            gap = time_s[i] - time_s[i - 1] if i > 0 else 0.0
            if abs(gap - step) > SAME_S:
                step = gap
                turn = np.exp(-damping * angular[f] * gap) * np.cos(angular[f] * gap)
                swing = np.exp(-damping * angular[f] * gap) * np.sin(angular[f] * gap)
            if i % RENEWED == 0:
                fading = np.exp(-damping * angular[f] * time_s[i])
                values[0] = fading * np.cos(angular[f] * time_s[i])
                values[1] = fading * np.sin(angular[f] * time_s[i])
            else:
                cosine, sine = values[0], values[1]
                values[0] = turn * cosine - swing * sine
                values[1] = swing * cosine + turn * sine
            for c in range(2, size):
                values[c] = driven[place[i], c - 2]
            for a in range(size):
                for b in range(a + 1):
                    own_squares[a, b] += values[a] * values[b]
                for axis in range(3):
                    own_along[a, axis] += values[a] * left[i, axis]
    return squares, along


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
