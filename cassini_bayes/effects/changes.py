"""Changes of the physics that several effects make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Physics
from cassini_bayes.computing.arrays import Array

AXES: Final = ("x", "y", "z")


def unit_vector(axis: str) -> Array:
    """Unit vector (3,) along a body axis."""
    return np.asarray(np.eye(3)[AXES.index(axis)])


def with_thrust_factor(physics: Physics, change: Array) -> Physics:
    """Thrust factors of all thrusters (n, K) times a change that broadcasts to it."""
    size = physics.arms_m.shape[-1]
    if size == 0:
        return physics
    whole = np.broadcast_to(np.asarray(physics.thrust_factor), (*change.shape[:-1], size))
    return replace(physics, thrust_factor=whole * change)


def with_steady_torque(physics: Physics, torque_n_m: Array) -> Physics:
    """A steady torque (n, 3) in body axes more."""
    return replace(physics, steady_torque_n_m=np.asarray(physics.steady_torque_n_m) + torque_n_m)


def with_columns(physics: Physics, weights: Mapping[str, Array]) -> Physics:
    """Weights of further columns of telemetry, by name."""
    return replace(physics, extra={**physics.extra, **weights})


def with_rate_errors(physics: Physics, bias_rad_s: Array, scale: Array) -> Physics:
    """Bias (n, 3) and scale (n, 3) of measured rates more."""
    return replace(
        physics,
        rate_bias_rad_s=np.asarray(physics.rate_bias_rad_s) + bias_rad_s,
        rate_scale=np.asarray(physics.rate_scale) + scale,
    )
