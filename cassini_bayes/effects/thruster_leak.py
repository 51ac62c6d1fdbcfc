"""A valve that passes thrust without command: a steady force along its thruster, F_leak q_k."""

from __future__ import annotations

from typing import Final

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import with_steady_torque
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Sizes


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """The leak's torque at the target's lever arm."""
    if physics.arms_m.shape[-1] == 0:
        return physics
    arm = physics.arms_m[..., setting.thruster]
    return with_steady_torque(physics, values["leak_n"][..., None] * arm)


def says(sizes: Sizes, target: str) -> str:
    """In µN."""
    return f"{target.upper()} leaks {sizes['leak_n'].said('µN', 1e6)} of thrust without command"


KIND: Final = Kind("thruster_leak", change, says=says)
