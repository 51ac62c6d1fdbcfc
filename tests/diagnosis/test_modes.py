"""Modes with their curvature against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from cassini_bayes.diagnosis.modes import find_mode


def test_laplace_is_exact_for_a_normal() -> None:
    """On a Gaussian the evidence by Laplace is the determinant formula, ridges included."""
    rng = np.random.default_rng(5)
    root = np.diag([1.0, 0.03, 0.3]) @ np.linalg.qr(rng.standard_normal((3, 3)))[0]
    precision = np.linalg.inv(root @ root.T)

    def density(z: np.ndarray) -> np.ndarray:
        gap = z - 0.2
        return np.asarray(-0.5 * np.einsum("ni,ij,nj->n", gap, precision, gap))

    mode = find_mode(density, 3)
    wanted = 1.5 * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(precision)[1]
    assert mode.log_evidence == pytest.approx(wanted, abs=1e-3)
