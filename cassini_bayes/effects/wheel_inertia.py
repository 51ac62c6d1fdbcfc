"""The spin inertia of a wheel is off its measured value."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import with_more
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Clause


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """The target's inertia larger by the departure."""
    numbers = [wheel.number for wheel in setting.spacecraft.wheels]
    unit = np.eye(len(numbers))[numbers.index(int(setting.target))]
    (departure,) = values.values()
    return with_more(physics, wheel_inertia_kg_m2=departure[..., None] * unit)


KIND: Final = Kind(
    "wheel_inertia",
    change,
    says=Clause("wheel {target} has a spin inertia of {0}", (("kg m²", 1.0),)),
    separation={
        "inertia": "slews about several axes and a measured velocity change during a bias",
    },
    throughout=True,
)
