"""The spin axis of a wheel is tilted: unit(a + u e1 + v e2), a its nominal axis."""

from __future__ import annotations

from typing import Final

from cassini_bayes.effects.effect import Kind
from cassini_bayes.effects.wheel_axes import with_moved_axes

KIND: Final = Kind("wheel_alignment", with_moved_axes)
