"""All thrusters stronger or weaker than in the propulsion model: F → F × factor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import with_thrust_factor
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.printed import FACTOR, Printed
from cassini_bayes.effects.wording import Clause

LEAST_SD: Final = 0.02
"""Fraction: judgement, the least that a doubted thrust departs by where it is said to be exact."""


def change(physics: Physics, _: Parameters, values: Values, __: Setting) -> Physics:
    """Every thrust times the factor."""
    return with_thrust_factor(physics, values["thrust_factor"][..., None])


def doubt(printed: Printed, width: float) -> Mapping[str, Printed]:
    """A thrust that is known less well."""
    sd = FACTOR * width * max(printed.thrust_sd, LEAST_SD)
    return {KIND.name: replace(printed, thrust_sd=sd)}


KIND: Final = Kind(
    "thrust_scale",
    change,
    doubt=doubt,
    says=Clause(
        "all thrusters deliver {0} of the thrust that the propulsion model predicts",
        (("%", 100.0),),
    ),
    separation={
        "tail_off": "a long firing (delta-V) beside short pulses: thrust counts seconds, tails "
        "count pulses",
        "pulse_shape": "a long firing (delta-V) beside short pulses: thrust counts seconds, "
        "offsets count pulses",
        "center_of_mass": "a measured velocity change: the centre of mass moves torque, not force",
        "wheel_inertia": "a slew on wheels alone: thrust plays no part there",
    },
)
