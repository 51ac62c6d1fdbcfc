"""A gyro's bias about a body axis: measured = true + bias."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.changes import unit_vector, with_rate_errors
from cassini_bayes.effects.effect import Kind, Setting, Values


def rate_errors(values: Values, setting: Setting) -> tuple[Array, Array]:
    """The bias about the target's axis, and no scale."""
    (bias,) = values.values()
    about = bias[..., None] * unit_vector(setting.target)
    return about, np.zeros_like(about)


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """Measured rates with the bias."""
    return with_rate_errors(physics, *rate_errors(values, setting))


KIND: Final = Kind("rate_bias", change, rate_errors=rate_errors)
