"""One thruster weaker than the common level of its branch: F_k → F_k × factor, factor ≤ 1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import with_thrust_factor
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.printed import Printed
from cassini_bayes.effects.wording import Clause

DEFICIT_SD: Final = 0.2
"""Share that a thruster may lack, as the catalogue's table has it (paper 003: Z3A lost 23 %)."""


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """The target's thrust times the factor."""
    factor = values["thrust_factor"]
    whole = np.ones((*factor.shape, len(setting.thrusters)))
    whole[..., setting.thruster] = factor
    return with_thrust_factor(physics, whole)


def doubt(printed: Printed, width: float) -> Mapping[str, Printed]:
    """One of the thrusters that estimates name, weaker."""
    return {
        f"{KIND.name}:{name}": replace(printed, degraded=(name,), deficit_sd=DEFICIT_SD * width)
        for name in printed.thrusters
    }


KIND: Final = Kind(
    "thruster_degraded",
    change,
    doubt=doubt,
    says=Clause("{TARGET} delivers {0} of its thrust", (("%", 100.0),)),
    separation={
        "thruster_misalignment": "an accelerometer or Doppler velocity change: a weaker thruster "
        "pushes less, a canted one pushes elsewhere",
        "center_of_mass": "a measured velocity change per thruster pair: the centre of mass moves "
        "torque, not force",
    },
)
