"""An element of the spacecraft's inertia matrix is off its predicted value."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import AXES
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Sizes


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """The element and its mirror image larger by the departure."""
    i, j = (AXES.index(axis) for axis in setting.target)
    unit = np.zeros((3, 3))
    unit[i, j] = unit[j, i] = 1.0
    (departure,) = values.values()
    return replace(physics, inertia_kg_m2=physics.inertia_kg_m2 + departure[..., None, None] * unit)


def says(sizes: Sizes, target: str) -> str:
    """In kg m², an element of the matrix."""
    (element,) = sizes.values()
    return f"the inertia element {target} is {element.said('kg m²')}"


KIND: Final = Kind("inertia", change, says=says)
