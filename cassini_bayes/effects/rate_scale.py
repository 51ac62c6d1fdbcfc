"""A gyro's scale factor about a body axis: measured = (1 + scale) · true."""

from __future__ import annotations

from typing import Final

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import unit_vector, with_more
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Clause


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """Measured rates with the scale about the target's axis."""
    scale = values["rate_scale"][..., None] * unit_vector(setting.target)
    return with_more(physics, rate_scale=scale)


KIND: Final = Kind(
    "rate_scale",
    change,
    says=Clause(
        "the gyro reads rates about {TARGET} too large by {0} of themselves", (("%", 100.0),)
    ),
    separation={
        "inertia": "attitude from the star tracker against integrated rates over a large turn",
    },
)
