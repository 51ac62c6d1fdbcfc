"""Readings of rounded counters, made up."""

from __future__ import annotations

import numpy as np

from cassini_bayes.computing.arrays import Array

CYCLE_S = 0.125


def readings(widths: Array, step: float) -> tuple[Array, Array, Array]:
    """Rounded and true cumulative on-time and pulses (m, 1), a firing every third reading."""
    m = 3 * len(widths) + 1
    true, count = np.zeros((m, 1)), np.zeros((m, 1))
    places = 3 * np.arange(len(widths)) + 1
    for place, width in zip(places, widths, strict=True):
        true[place:] += width
        count[place:] += 1.0
    return step * np.round(true / step), true, count
