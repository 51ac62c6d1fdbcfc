"""The change of effects that turn the spin axis of a wheel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.effect import Setting, Values
from cassini_bayes.spacecraft import wheel_axes


def with_moved_axes(
    physics: Physics, parameters: Parameters, values: Values, setting: Setting
) -> Physics:
    """Axes where the baseline's tilts and angles and the departures together put them."""
    moved = {name: np.asarray(parameters[name]) + value for name, value in values.items()}
    return replace(physics, wheel_axes=wheel_axes(setting.spacecraft, {**parameters, **moved}))
