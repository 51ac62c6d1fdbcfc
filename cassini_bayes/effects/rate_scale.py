"""A gyro's scale factor about a body axis: measured = (1 + scale) · true."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import unit_vector, with_rate_errors
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.wording import Sizes


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """Measured rates with the scale about the target's axis."""
    scale = values["rate_scale"][..., None] * unit_vector(setting.target)
    return with_rate_errors(physics, np.zeros_like(scale), scale)


def says(sizes: Sizes, target: str) -> str:
    """In per cent."""
    return (
        f"the gyro reads rates about {target.upper()} too large by "
        f"{sizes['rate_scale'].said('%', 100.0)} of themselves"
    )


KIND: Final = Kind(
    "rate_scale",
    change,
    says=says,
    separation={
        "inertia": "attitude from the star tracker against integrated rates over a large turn",
    },
)
