"""A gyro's bias about a body axis: measured = true + bias."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import unit_vector, with_rate_errors
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Sizes


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """Measured rates with the bias about the target's axis."""
    (bias,) = values.values()
    about = bias[..., None] * unit_vector(setting.target)
    return with_rate_errors(physics, about, np.zeros_like(about))


def says(sizes: Sizes, target: str) -> str:
    """In µrad/s."""
    (bias,) = sizes.values()
    return f"the gyro reads {bias.said('µrad/s', 1e6)} too much about {target.upper()}"


KIND: Final = Kind("rate_bias", change, says=says)
