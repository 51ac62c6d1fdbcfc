"""The impulse of a pulse does not follow the assumed closed form: every one lasts longer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.effects.changes import with_more
from cassini_bayes.effects.effect import Kind, Setting, Values
from cassini_bayes.effects.printed import Printed
from cassini_bayes.effects.wording import Clause

OFFSET_SD_S: Final = 0.04
"""Of an on-time per pulse, as the catalogue's table has it (ten times what closed forms differ)."""


def change(physics: Physics, _: Parameters, values: Values, __: Setting) -> Physics:
    """Every pulse of every thruster goes on for longer by the same time."""
    offset = values["impulse_time_offset_s"]
    size = physics.arms_m.shape[-1]
    shift = np.broadcast_to(offset[..., None], (*offset.shape, size))
    return with_more(physics, impulse_offset_s=shift)


def doubt(printed: Printed, width: float) -> Mapping[str, Printed]:
    """Pulses that last longer, where estimates have tails."""
    if not printed.is_pulsed:
        return {}
    return {KIND.name: replace(printed, offset_sd_s=OFFSET_SD_S * width)}


KIND: Final = Kind(
    "pulse_shape",
    change,
    doubt=doubt,
    says=Clause("every pulse lasts {0} longer than its closed form has it", (("ms", 1e3),)),
)
