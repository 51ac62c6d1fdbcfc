"""Scores of predictive draws against one outcome; all keep the outcome's unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cassini_bayes.computing.arrays import Array, Flags


def central_interval(draws: Array, probability: float = 0.9) -> Array:
    """Ends (2, …) of the central interval of draws (n, …)."""
    tail = (1.0 - probability) / 2.0
    return np.asarray(np.quantile(draws, [tail, 1.0 - tail], axis=0))


def covered(draws: Array, outcome: ArrayLike, probability: float = 0.9) -> Flags:
    """Whether the central interval holds the outcome, per trailing element."""
    low, high = central_interval(draws, probability)
    return np.asarray((np.asarray(outcome) >= low) & (np.asarray(outcome) <= high))


def interval_score(draws: Array, outcome: ArrayLike, probability: float = 0.9) -> Array:
    """Width of the central interval plus 2/α times the distance outside it (Gneiting 2007)."""
    low, high = central_interval(draws, probability)
    y = np.asarray(outcome, dtype=np.float64)
    outside = np.maximum(low - y, 0.0) + np.maximum(y - high, 0.0)
    return np.asarray(high - low + 2.0 / (1.0 - probability) * outside)


def crps(draws: Array, outcome: ArrayLike) -> Array:
    """Continuous ranked probability score E|X − y| − ½ E|X − X′| of draws (n, …).

    The second mean runs over different draws (unbiased in n); a point prediction's score is its
    absolute error.
    """
    y = np.asarray(outcome, dtype=np.float64)
    n = len(draws)
    ordered = np.sort(draws, axis=0)
    rank = 2.0 * np.arange(1, n + 1) - n - 1.0
    shape = (n,) + (1,) * (draws.ndim - 1)
    half_spread = (rank.reshape(shape) * ordered).sum(0) / (n * (n - 1.0))
    return np.asarray(np.abs(draws - y).mean(0) - half_spread)
