"""The spin axis of a wheel is tilted: unit(a + u e1 + v e2), a its nominal axis."""

from __future__ import annotations

from typing import Final

from cassini_bayes.effects.changes import with_moved_axes
from cassini_bayes.effects.effect import Kind
from cassini_bayes.effects.wording import Clause

KIND: Final = Kind(
    "wheel_alignment",
    with_moved_axes,
    says=Clause(
        "the spin axis of wheel {target} is tilted by u = {0} and v = {1}", 2 * (("mrad", 1e3),)
    ),
)
