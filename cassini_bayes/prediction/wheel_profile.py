"""The wheel manager's speed profile (paper 001 section IV): a linear ramp, then an exponential.

The accelerating torque is I (ρ_f − ρ)/τ, limited to 0.03 N m. With p = seconds per rev/min of the
ramp (I/0.03 N m, in those units), a change Δ ramps until |ρ_f − ρ| = τ/p and then decays with τ:
t1 = p |Δ| − τ, and the bias ends at T = t1 + n τ, n = 6 (paper 001: 99.75 %). A change smaller than
τ/p is exponential from the start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array

SETTLING_TIMES: Final = 6.0
TAIL_POINTS: Final = (0.5, 1.0, 2.0, 3.0, SETTLING_TIMES)


@dataclass(frozen=True)
class WheelManager:
    """Ramp of every wheel (s per rev/min, by wheel number) and the loop's time constant (s)."""

    ramp_s_per_rpm: dict[int, float]
    loop_s: float


def ramp_end_s(manager: WheelManager, wheels: tuple[int, ...], change_rpm: Array) -> Array:
    """End of the linear part t1 of every wheel (W,), s; 0 where there is none."""
    ramp = np.array([manager.ramp_s_per_rpm[n] for n in wheels])
    return np.maximum(ramp * np.abs(change_rpm) - manager.loop_s, 0.0)


def duration_s(manager: WheelManager, wheels: tuple[int, ...], change_rpm: Array) -> float:
    """Duration of the bias: the last wheel's t1 + 6 τ (paper 001 eqs. 9, 18), s."""
    return float(ramp_end_s(manager, wheels, change_rpm).max() + SETTLING_TIMES * manager.loop_s)


def rates_rpm(
    manager: WheelManager, wheels: tuple[int, ...], start_rpm: Array, end_rpm: Array, time_s: Array
) -> Array:
    """Wheel rates (N, W) in rev/min at times (N,)."""
    change = end_rpm - start_rpm
    ramp = np.array([manager.ramp_s_per_rpm[n] for n in wheels])
    t1 = ramp_end_s(manager, wheels, change)
    left_at_t1 = np.minimum(np.abs(change), manager.loop_s / ramp)
    time = np.asarray(time_s, dtype=np.float64)[:, None]
    ramping = np.abs(change) - time / ramp
    settling = left_at_t1 * np.exp(-np.maximum(time - t1, 0.0) / manager.loop_s)
    left = np.where(time < t1, ramping, settling)
    return np.asarray(end_rpm - np.sign(change) * left)


def piece_times_s(manager: WheelManager, wheels: tuple[int, ...], change_rpm: Array) -> Array:
    """Where the pieces of a bias begin and end (S + 1,), s from its start."""
    t1 = ramp_end_s(manager, wheels, change_rpm)
    return np.unique(np.concatenate([[0.0], t1, *(t1 + k * manager.loop_s for k in TAIL_POINTS)]))


def segments_rpm(
    manager: WheelManager, wheels: tuple[int, ...], start_rpm: Array, end_rpm: Array
) -> Array:
    """Changes of the wheel rates (S, W) over pieces in which their direction hardly turns.

    Pieces end where a wheel leaves its ramp and at some points of every exponential; they add up
    to the commanded change exactly.
    """
    times = piece_times_s(manager, wheels, end_rpm - start_rpm)
    rates = rates_rpm(manager, wheels, start_rpm, end_rpm, times)
    rates[0], rates[-1] = start_rpm, end_rpm
    return np.asarray(np.diff(rates, axis=0))
