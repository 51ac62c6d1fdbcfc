"""Firings as counters show them: what was fired in an interval between readings, not when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.balance.statistics import Samples
from cassini_bayes.computing.arrays import Array

TAIL_S: Final = 0.030
"""On-time that a pulse's tail adds: τ_fall − τ_rise of the priors files, good to some milliseconds
of 155 where it serves, in what depends on a pulse's moment alone."""
LEAST_IDLE: Final = 1e-3
"""Part of an interval without firing below which nothing is open: a division by zero otherwise."""


@dataclass(frozen=True)
class FiredIntervals:
    """Counter intervals (m,) in which thrusters that only fire together did, not without pause.

    ``momentum_n_m_s`` (m, 3) is what they gave, ``scatter`` (m,) the variance that single moments
    have left: 1/n of one pulse's with n pulses, times the share of the interval without firing.
    """

    start_s: Array
    end_s: Array
    momentum_n_m_s: Array
    scatter: Array


def fired_intervals(samples: Samples, members: tuple[int, ...], force: Array) -> FiredIntervals:
    """When a couple fired, of thrusters at places ``members``; ``force`` (3, K): torque in N m."""
    counted = samples.has_counters
    time = samples.time_s[counted]
    places = list(members)
    on_time = np.diff(samples.on_time_s[counted][:, places], axis=0)
    pulses = np.diff(samples.pulses[counted][:, places], axis=0)
    fired = np.flatnonzero(np.any((on_time > 0.0) | (pulses > 0.0), axis=1))
    on_time, pulses = on_time[fired], pulses[fired]
    start, end = time[:-1][fired], time[1:][fired]
    given = (on_time + TAIL_S * pulses) @ force[:, places].T
    idle = 1.0 - on_time.max(1, initial=0.0) / (end - start)
    scatter = idle / np.maximum(pulses.max(1, initial=0.0), 1.0)
    kept = idle > LEAST_IDLE
    return FiredIntervals(start[kept], end[kept], given[kept], scatter[kept])
