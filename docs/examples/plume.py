"""A thruster's plume that hits the spacecraft: a torque of thrust times a lever about one axis.

The plume pushes on a surface: the torque acts across thrust d and lever arm q = (r − e) × d of its
thruster, q → q + lever · unit(d × q).
"""

from dataclasses import replace

import numpy as np

from cassini_bayes.effects.effect import Kind
from cassini_bayes.spacecraft import thruster_directions


def change(physics, parameters, values, setting):
    """The target's torque per newton at n points."""
    if physics.arms_m.shape[-1] == 0:  # an event without thrusters
        return physics
    k = setting.thruster
    direction = thruster_directions(setting.spacecraft, setting.branch)[:, k]
    across = np.cross(direction, physics.arms_m[..., k])
    across = across / np.linalg.norm(across, axis=-1, keepdims=True)
    added = values["lever_m"][:, None] * across  # (n, 3)
    arms = np.array(np.broadcast_to(physics.arms_m, (len(added), *physics.arms_m.shape[-2:])))
    arms[..., k] += added
    return replace(physics, arms_m=arms)


def simulate(plan, target, values):
    """The simulated side: what the flight does, by the simulation's own means."""
    return replace(plan, plume={**plan.plume, target: values["lever_m"]})


KIND = Kind(
    "plume",
    change,
    separation={
        "thruster_misalignment": "a measured velocity change: a plume on the spacecraft takes "
        "force away, a canted thruster turns it",
    },
)
