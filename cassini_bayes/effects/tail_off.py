"""The tail-off time constant τ_fall is not that of the propulsion model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.printed import FACTOR, Printed
from cassini_bayes.effects.wording import Clause

LEAST_TAU_S: Final = 1e-3
"""A tail shorter than that is none: keeps exp(−t/τ) finite, as no pulse is so well known."""
LEAST_SD_S: Final = 0.002
"""Judgement: the least that a doubted tail-off departs by where tests are said to be exact."""


def change(physics: Physics, _: Parameters, values: Values, __: Setting) -> Physics:
    """τ_fall longer by the departure."""
    delay, rise, fall = physics.tau_s
    longer = np.maximum(fall + values["tau_fall_s"], LEAST_TAU_S)
    return replace(physics, tau_s=(delay, rise, longer))


def doubt(printed: Printed, width: float) -> Mapping[str, Printed]:
    """A tail-off that is known less well, where estimates have tails."""
    if not printed.is_pulsed:
        return {}
    sd = FACTOR * width * max(printed.fall_sd_s, LEAST_SD_S)
    return {KIND.name: replace(printed, fall_sd_s=sd)}


KIND: Final = Kind(
    "tail_off",
    change,
    doubt=doubt,
    says=Clause("thrust tails off with a time constant of {0}", (("ms", 1e3),)),
    separation={
        "pulse_shape": "pulses of different widths: only there do a tail-off and an offset per "
        "pulse differ",
    },
)
