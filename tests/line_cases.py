"""A body whose oscillations are searched for: rows, moments of inertia, noise and prior scales."""

from __future__ import annotations

import numpy as np

from cassini_bayes.computing.arrays import Array

TIME = np.arange(0.0, 1_200.0)
INERTIA = np.array([8_000.0, 7_000.0, 4_000.0])
NOISE = np.diag([0.02, 0.02, 0.01])  # N m s
SCALES = (1e-5, 0.01)


def body(time_s: Array) -> Array:
    """A smooth rate, rad/s, slow beside a sample."""
    return np.asarray(2e-4 * np.sin(2 * np.pi * time_s / 90.0) * np.exp(-time_s / 700.0))
