"""A thruster pushes elsewhere: unit(d + a e1 + b e2), d its nominal direction.

e1 and e2 are those of :func:`.cant_axes`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Clause
from cassini_bayes.spacecraft import (
    cant_axes,
    centre_of_mass,
    thruster_directions,
    thruster_positions,
)


def change(physics: Physics, parameters: Parameters, values: Values, setting: Setting) -> Physics:
    """The target's lever arm at the canted direction."""
    if physics.arms_m.shape[-1] == 0:
        return physics
    k = setting.thruster
    direction = thruster_directions(setting.spacecraft, setting.branch)[:, k]
    first, second = cant_axes(direction)
    force = (
        direction
        + values["cant_a_rad"][..., None] * first
        + values["cant_b_rad"][..., None] * second
    )
    force = force / np.linalg.norm(force, axis=-1, keepdims=True)
    places = thruster_positions(setting.spacecraft, setting.branch, parameters)[..., k]
    arm = places - centre_of_mass(parameters)
    moved = np.cross(arm, force) - np.cross(arm, direction)
    arms = np.array(
        np.broadcast_to(physics.arms_m, (*moved.shape[:-1], *physics.arms_m.shape[-2:]))
    )
    arms[..., k] += moved
    return replace(physics, arms_m=arms)


KIND: Final = Kind(
    "thruster_misalignment",
    change,
    says=Clause(
        "{TARGET} is canted by {0} towards X (Y if it pushes along X) and {1} towards the other"
        " axis across its thrust",
        2 * (("°", 180.0 / np.pi),),
    ),
)
