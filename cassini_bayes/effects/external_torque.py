"""A steady torque in body axes that the priors do not have (solar, radioisotope generators)."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import AXES, with_steady_torque
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Sizes


def change(physics: Physics, _: Parameters, values: Values, __: Setting) -> Physics:
    """The departures of all three axes added."""
    torque = np.stack([values[f"external_torque_{axis}_n_m"] for axis in AXES], axis=-1)
    return with_steady_torque(physics, torque)


def says(sizes: Sizes, _: str) -> str:
    """In µN m about body axes."""
    parts = ", ".join(
        f"{sizes[f'external_torque_{axis}_n_m'].said('µN m', 1e6)} about {axis.upper()}"
        for axis in AXES
    )
    return f"a steady torque acts: {parts}"


KIND: Final = Kind(
    "external_torque",
    change,
    says=says,
    separation={
        "thruster_leak": "a quiescent period at another attitude, or with the other branch's "
        "valves closed: a leak stays in body axes and goes with its latch valve, a solar torque "
        "turns with the Sun",
    },
)
