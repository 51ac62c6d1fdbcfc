"""Attitudes as turns from one to the next, and in other conventions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array

_CONJUGATE: Final = np.array([-1.0, -1.0, -1.0, 1.0])


def turns_rad(attitude: Array) -> Array:
    """Small turns (n − 1, 3) in body axes from one attitude to the next."""
    old, new = attitude[:-1], attitude[1:]
    scalar = np.einsum("ij,ij->i", old, new)
    vector = old[:, 3:] * new[:, :3] - new[:, 3:] * old[:, :3] - np.cross(old[:, :3], new[:, :3])
    vector *= np.where(scalar < 0.0, -1.0, 1.0)[:, None]
    size = np.linalg.norm(vector, axis=1)
    angle = 2.0 * np.arctan2(size, np.abs(scalar))
    return np.asarray(vector * (angle / np.where(size > 0.0, size, 1.0))[:, None])


CONVENTIONS: Final[Mapping[str, Callable[[Array], Array]]] = {
    "body → J2000": lambda attitude: attitude * _CONJUGATE,
    "scalar-first": lambda attitude: np.roll(attitude, -1, axis=1),
    "scalar-first and body → J2000": lambda attitude: np.roll(attitude, -1, axis=1) * _CONJUGATE,
    "scalar-first, inverted as scalar-last": lambda attitude: _inverted_before(attitude, -1),
    "scalar-last, read as scalar-first": lambda attitude: np.roll(attitude, 1, axis=1),
    "scalar-last, inverted as scalar-first": lambda attitude: _inverted_before(attitude, 1),
}
"""What makes ours of attitudes (n, 4) that a file has in another convention. The last three come
from a channel map whose order is wrong, and its direction right."""


def _inverted_before(attitude: Array, shift: int) -> Array:
    """Attitudes (n, 4) inverted again, columns moved by a shift, and inverted."""
    return np.asarray(np.roll(attitude * _CONJUGATE, shift, axis=1) * _CONJUGATE)
