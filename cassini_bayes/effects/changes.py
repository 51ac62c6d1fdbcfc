"""Changes of the physics that several effects make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.effect import Setting, Values
from cassini_bayes.spacecraft import wheel_axes

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


def with_more(physics: Physics, **added: Array) -> Physics:
    """Quantities of the physics, by name, with something added to each."""
    sums: dict[str, Any] = {
        name: np.asarray(getattr(physics, name)) + more for name, more in added.items()
    }
    return replace(physics, **sums)


def with_moved_axes(
    physics: Physics, parameters: Parameters, values: Values, setting: Setting
) -> Physics:
    """The target's axis where the baseline's tilts and angle and the departures together put it.

    What another effect has moved it by is added, to first order.
    """
    craft, number = setting.spacecraft, int(setting.target)
    named = craft.wheel(number).by_key
    moved = {
        named[key]: np.asarray(parameters[named[key]]) + value for key, value in values.items()
    }
    # another wheel may share the parameter, and stays where it is
    is_target = np.array(craft.wheel_numbers) == number
    change = wheel_axes(craft, {**parameters, **moved}) - wheel_axes(craft, parameters)
    axes = physics.wheel_axes + change
    axes = axes / np.linalg.norm(axes, axis=-2, keepdims=True)
    return replace(physics, wheel_axes=np.where(is_target, axes, physics.wheel_axes))


def with_columns(physics: Physics, weights: Mapping[str, Array]) -> Physics:
    """Weights of further columns of telemetry, by name."""
    return replace(physics, extra={**physics.extra, **weights})
