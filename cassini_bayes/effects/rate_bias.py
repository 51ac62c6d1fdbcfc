"""A gyro's bias about a body axis: measured = true + bias."""

from __future__ import annotations

from typing import Final

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import unit_vector, with_more
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Clause


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """Measured rates with the bias about the target's axis."""
    (bias,) = values.values()
    return with_more(physics, rate_bias_rad_s=bias[..., None] * unit_vector(setting.target))


KIND: Final = Kind(
    "rate_bias",
    change,
    says=Clause("the gyro reads {0} too much about {TARGET}", (("µrad/s", 1e6),)),
)
