"""The two axes of a cant: across the force and each other, for every direction."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassini_bayes.computing.arrays import Array
from cassini_bayes.spacecraft import cant_axes

X, Y, Z = np.eye(3)


def off_orthonormal(direction: Array, axes: Array) -> float:
    """How far d, e1, e2 are from three orthogonal unit vectors."""
    frame = np.stack([direction, *axes])
    return float(np.abs(frame @ frame.T - np.eye(3)).max())


@given(st.tuples(*3 * (st.floats(-1.0, 1.0),)).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_any_direction_has_two_axes_across_it(vector: tuple[float, float, float]) -> None:
    """d, e1 and e2 are orthonormal; e1 leans towards X, or Y for a force along X; e2's largest
    component is positive.
    """
    direction = np.array(vector) / np.linalg.norm(vector)
    first, second = cant_axes(direction)
    assert off_orthonormal(direction, np.array([first, second])) < 1e-14
    assert first[1 if abs(direction[0]) > 0.9 else 0] > 0.0
    assert second.max() == np.abs(second).max()


@pytest.mark.parametrize(
    ("direction", "first", "second"),
    [(Y, X, Z), (-Y, X, Z), (Z, X, Y), (-Z, X, Y), (X, Y, Z), (-X, Y, Z)],
)
def test_forces_along_body_axes_are_canted_along_the_others(
    direction: Array, first: Array, second: Array
) -> None:
    """To the last bit, as Cassini's thrusters have been."""
    np.testing.assert_array_equal(cant_axes(direction), [first, second])


def test_the_rules_before_were_not_across_an_oblique_force() -> None:
    """Negative control: X and |d × X|, and X and Y, lean towards the force, or have no length."""
    direction = np.array([0.36, 0.48, 0.8])
    assert off_orthonormal(direction, np.stack([X, np.abs(np.cross(direction, X))])) > 0.3
    assert off_orthonormal(direction, np.stack([X, Y])) > 0.3
    assert off_orthonormal(X, np.stack([X, np.abs(np.cross(X, X))])) == 1.0
