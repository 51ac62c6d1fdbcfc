"""An element of the spacecraft's inertia matrix is off its predicted value."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import AXES, with_more
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Clause


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """The element and its mirror image larger by the departure."""
    i, j = (AXES.index(axis) for axis in setting.target)
    unit = np.zeros((3, 3))
    unit[i, j] = unit[j, i] = 1.0
    (departure,) = values.values()
    return with_more(physics, inertia_kg_m2=departure[..., None, None] * unit)


KIND: Final = Kind(
    "inertia",
    change,
    says=Clause("the inertia element {target} is {0}", (("kg m²", 1.0),)),
    needs_turns=True,
)
