"""Answer of a damped appendage to its body's motion, step by step, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.compilation import compiled

Array = NDArray[np.float64]
Places = NDArray[np.int64]


@compiled
def answers(
    slope: Array, change: Array, coefficients: Array, place: Places
) -> Array:  # pragma: no cover - compiled
    """Rates (f, n, c) of appendages against their body, y_t = b1 x_t−1 + b2 x_t−2 − a1 y… − a2 y…

    Parameters
    ----------
    slope
        (g, c) slopes of the body's rate along a grid, x.
    change
        (g, c) of the last slope, which enters with b1 alone.
    coefficients
        (f, 4) b1, b2, a1, a2 of every appendage.
    place
        (n,) grid points that are asked for.
    """
    steps, channels = slope.shape
    result = np.empty((len(coefficients), place.size, channels))
    answer = np.empty((steps, channels))
    for f in range(len(coefficients)):
        b1, b2, a1, a2 = coefficients[f]
        for c in range(channels):
            before, last, x_before, x_last = 0.0, 0.0, 0.0, 0.0
            for t in range(steps):
                value = b1 * x_last + b2 * x_before - a1 * last - a2 * before
                before, last, x_before, x_last = last, value, x_last, slope[t, c]
                answer[t, c] = value + b1 * change[t, c]
        for i in range(place.size):
            for c in range(channels):
                result[f, i, c] = answer[place[i], c]
    return result
