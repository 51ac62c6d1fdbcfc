"""The centre of mass is off its predicted place along a body axis: lever arms change by −s × d."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import unit_vector, with_more
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Clause
from cassini_bayes.spacecraft import thruster_directions


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """Every lever arm about the moved centre."""
    if physics.arms_m.shape[-1] == 0:
        return physics
    directions = thruster_directions(setting.spacecraft, setting.branch)
    turned = np.cross(unit_vector(setting.target), directions.T).T  # (3, K)
    (shift,) = values.values()
    return with_more(physics, arms_m=-shift[..., None, None] * turned)


KIND: Final = Kind(
    "center_of_mass",
    change,
    says=Clause("the centre of mass lies at {target} = {0}", (("mm", 1e3),)),
)
