"""The recorded motion of one event, and the momentum in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cassini_bayes.computing.arrays import Array
from cassini_bayes.simulation.kernel import Body
from cassini_bayes.spacecraft.units import RPM_PER_RAD_S


@dataclass(frozen=True, eq=False)
class PulseLog:
    """Commanded pulses of one thruster: start and width, s. Firings that touch are one pulse."""

    start_s: Array
    width_s: Array

    def on_time_s(self, time_s: ArrayLike) -> Array:
        """Cumulative commanded on-time up to a time: a running pulse counts as far as it went."""
        time = np.asarray(time_s, dtype=np.float64)
        before = np.searchsorted(self.start_s, time, side="right")
        whole = np.concatenate([[0.0], np.cumsum(self.width_s)])
        if self.start_s.size == 0:
            return np.zeros(time.shape)
        last = np.maximum(before - 1, 0)
        running = np.minimum(time - self.start_s[last], self.width_s[last])
        return np.asarray(np.where(before > 0, whole[last] + running, 0.0))

    def pulses(self, time_s: ArrayLike) -> Array:
        """Number of pulses that had started by a time."""
        time = np.asarray(time_s, dtype=np.float64)
        return np.searchsorted(self.start_s, time, side="right").astype(np.float64)


@dataclass(frozen=True, eq=False)
class Motion:
    """What happened, without noise, at N equally spaced times from 0 to the end.

    ``attitude`` is inertial-to-body, scalar last; rates, momenta and ``delta_v_body_m_s`` are in
    body axes; ``modes`` holds η then η̇ of every bending mode.
    """

    time_s: Array  # (N,)
    attitude: Array  # (N, 4)
    rate_rad_s: Array  # (N, 3)
    wheels_rad_s: Array  # (N, W)
    modes: Array  # (N, 2M)
    attitude_error_rad: Array  # (N, 3)
    angular_impulse_n_m_s: Array  # (N, 3) inertial
    delta_v_body_m_s: Array  # (N, 3)
    delta_v_inertial_m_s: Array  # (N, 3)
    tank_pressure_kpa: Array  # (N,)
    propellant_kg: Array  # (N,)
    pulses: Mapping[str, PulseLog]
    body: Body

    @property
    def wheels_rpm(self) -> Array:
        """Wheel rates (N, W) in rev/min."""
        return self.wheels_rad_s * RPM_PER_RAD_S

    @property
    def duration_s(self) -> float:
        """Time of the last record."""
        return float(self.time_s[-1])

    def momentum_body_n_m_s(self) -> Array:
        """Total angular momentum in body axes (N, 3): I ω + Σ a I_w ρ + Σ δ η̇."""
        half = self.modes.shape[1] // 2
        total = self.rate_rad_s @ self.body.inertia_kg_m2.T
        total = total + (self.wheels_rad_s * self.body.wheel_inertia_kg_m2) @ self.body.axes.T
        return np.asarray(total + self.modes[:, half:] @ self.body.couplings.T)

    def momentum_inertial_n_m_s(self) -> Array:
        """Total angular momentum in the inertial frame (N, 3)."""
        return rotate_to_inertial(self.attitude, self.momentum_body_n_m_s())


def rotate_to_inertial(attitude: Array, vectors: Array) -> Array:
    """Cᵀ v for attitudes (N, 4) and body vectors (N, 3); C = (s² − q·q) 1 + 2 q qᵀ − 2 s [q×]."""
    vector, scalar = attitude[:, :3], attitude[:, 3:]
    square = scalar**2 - np.sum(vector**2, axis=1, keepdims=True)
    along = 2.0 * vector * np.sum(vector * vectors, axis=1, keepdims=True)
    return np.asarray(square * vectors + along + 2.0 * scalar * np.cross(vector, vectors))
