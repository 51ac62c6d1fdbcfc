"""A valve that passes thrust without command: a steady force along its thruster, F_leak q_k."""

from __future__ import annotations

from typing import Final

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import with_more
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Clause


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """The leak's torque at the target's lever arm."""
    if physics.arms_m.shape[-1] == 0:
        return physics
    arm = physics.arms_m[..., setting.thruster]
    return with_more(physics, steady_torque_n_m=values["leak_n"][..., None] * arm)


KIND: Final = Kind(
    "thruster_leak",
    change,
    says=Clause("{TARGET} leaks {0} of thrust without command", (("µN", 1e6),)),
)
