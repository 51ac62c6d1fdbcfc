"""The spin axis of a wheel is tilted: unit(a + u e1 + v e2), a its nominal axis."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.spacecraft import wheel_axes


def change(physics: Physics, parameters: Parameters, values: Values, setting: Setting) -> Physics:
    """Axes at the tilts of the baseline and the departures together."""
    tilted = {name: np.asarray(parameters[name]) + value for name, value in values.items()}
    return replace(physics, wheel_axes=wheel_axes(setting.spacecraft, {**parameters, **tilted}))


KIND: Final = Kind("wheel_alignment", change)
