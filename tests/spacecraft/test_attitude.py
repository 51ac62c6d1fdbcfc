"""Attitude matrices against a library's."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cassini_bayes.computing.arrays import Array
from cassini_bayes.spacecraft.attitude import direction_cosines


def test_direction_cosines_are_a_rotation_library_s() -> None:
    """scipy's rotation of the inertial-to-body quaternion's inverse; q and −q are alike."""
    q: Array = np.array([[0.1, -0.4, 0.5, 0.3], [0.0, 0.0, 0.0, 1.0]])
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    to_body = direction_cosines(q)
    inverse = to_body.transpose(0, 2, 1)
    np.testing.assert_allclose(inverse, Rotation.from_quat(q).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(to_body, direction_cosines(-q), atol=1e-15)
