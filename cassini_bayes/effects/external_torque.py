"""A steady torque in body axes that the priors do not have (solar, radioisotope generators)."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import AXES, with_more
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Clause


def change(physics: Physics, _: Parameters, values: Values, __: Setting) -> Physics:
    """The departures of all three axes added."""
    torque = np.stack([values[f"external_torque_{axis}_n_m"] for axis in AXES], axis=-1)
    return with_more(physics, steady_torque_n_m=torque)


KIND: Final = Kind(
    "external_torque",
    change,
    says=Clause(
        "a steady torque acts: {0} about X, {1} about Y, {2} about Z", 3 * (("µN m", 1e6),)
    ),
    separation={
        "thruster_leak": "a quiescent period at another attitude, or with the other branch's "
        "valves closed: a leak stays in body axes and goes with its latch valve, a solar torque "
        "turns with the Sun",
    },
)
