"""The spin axis of a wheel is tilted: unit(a + u e1 + v e2), a its nominal axis."""

from __future__ import annotations

from typing import Final

from cassini_bayes.effects.effect import Kind
from cassini_bayes.effects.wheel_axes import with_moved_axes
from cassini_bayes.effects.wording import Sizes


def says(sizes: Sizes, target: str) -> str:
    """In milliradians about both axes across."""
    tilts = " and ".join(
        f"{name} = {size.said('mrad', 1e3)}"
        for name, size in zip("uv", sizes.values(), strict=True)
    )
    return f"the spin axis of wheel {target} is tilted by {tilts}"


KIND: Final = Kind("wheel_alignment", with_moved_axes, says=says)
