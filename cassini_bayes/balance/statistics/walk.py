"""A random walk of the momentum, which white torque noise makes: its cosines and their sizes."""

from __future__ import annotations

import math

import numpy as np

from cassini_bayes.computing.arrays import Array

# The slowest cosines of torque noise are unknowns: rows and turns see them alike. How many matter
# grows with the duration (docs/topics/telemetry-likelihood.md §8).
COSINE_S = 300.0  # of the event, for each cosine
WALK_COSINES = 6, 16  # as few, as many: the slow band has twice as many modes


def walk_cosines(duration_s: float) -> int:
    """How many of the slowest cosines of torque noise are unknowns of an event."""
    fewest, most = WALK_COSINES
    return min(max(fewest, math.ceil(duration_s / COSINE_S)), most)


def cosines(time_s: Array, duration_s: float, count: int) -> Array:
    """The cosines cos(m π t/T), m = 0 … M − 1, at times (n,): (n, M)."""
    return np.asarray(np.cos(np.pi / duration_s * time_s[:, None] * np.arange(count)))


def walk_scales(duration_s: float, cosines: int) -> Array:
    """Standard deviations (1 + cosines,) of the mean and the cosines of a unit random walk, s^½.

    Momentum gained from white torque noise of density a² has a mean of variance a² T/3 and cosine
    coefficients of variance 2 a² T/(m π)² (Karhunen-Loève expansion of a random walk about its
    mean).
    """
    order = np.arange(1, 1 + cosines)
    return np.asarray(np.sqrt(duration_s) * np.r_[1.0 / np.sqrt(3.0), np.sqrt(2.0) / order / np.pi])


def walk_columns(time_s: Array, since_start: Array, duration_s: float, count: int) -> Array:
    """R e_j [cos(mπt/T) − 1] (n, 3, 3 M), M cosines; ``since_start`` (n, 3, 3) are the R e_j."""
    gained = cosines(time_s, duration_s, 1 + count)[:, 1:] - 1.0
    columns = gained[:, None, :, None] * since_start[:, :, None, :]
    return np.asarray(columns.reshape(len(time_s), 3, 3 * count))
