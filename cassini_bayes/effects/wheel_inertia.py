"""The spin inertia of a wheel is off its measured value."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Sizes


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """The target's inertia larger by the departure."""
    numbers = [wheel.number for wheel in setting.spacecraft.wheels]
    unit = np.eye(len(numbers))[numbers.index(int(setting.target))]
    (departure,) = values.values()
    return replace(
        physics, wheel_inertia_kg_m2=physics.wheel_inertia_kg_m2 + departure[..., None] * unit
    )


def says(sizes: Sizes, target: str) -> str:
    """In kg m²."""
    (inertia,) = sizes.values()
    return f"wheel {target} has a spin inertia of {inertia.said('kg m²')}"


KIND: Final = Kind(
    "wheel_inertia",
    change,
    says=says,
    separation={
        "inertia": "slews about several axes and a measured velocity change during a bias",
    },
)
