"""The two axes along which the force of a thruster can be canted."""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array

ALONG_X: Final = 0.9
"""A direction with more than this of X, either way, is along X: within 26° of it."""


def cant_axes(direction: Array) -> Array:
    """Unit vectors e1, e2 (2, 3) across a force direction d (3,) and each other, body axes.

    e1 is body X without its part along d (Y instead of X where d is along X), and e2 = ±d × e1,
    signed so that its largest component is positive. So e1, e2 are X, Z for thrusters along ±Y,
    X, Y for those along ±Z, and Y, Z for those along ±X.
    """
    body = np.eye(3)[1 if abs(direction[0]) > ALONG_X else 0]
    across = body - (body @ direction) * direction
    first = across / np.linalg.norm(across)
    second = np.cross(direction, first)
    if second[np.argmax(np.abs(second))] < 0.0:
        second = -second
    return np.stack([first, second])
