"""Modes with their curvature against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from cassini_bayes.diagnosis.modes import find_mode, mode_near


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


SD = np.array([1.0, 0.5, 0.02])
CENTRE = np.array([0.3, -0.2, 0.1])
EXACT = 1.5 * np.log(2 * np.pi) + np.log(SD).sum()
POINTS_OF_A_LOOK = 3 * 4 + 1


@pytest.mark.parametrize(("too_narrow", "looks"), [(1.0, 2), (20.0, 2), (130.0, 2), (1000.0, 4)])
def test_a_look_widens_an_axis_by_all_that_it_tells(too_narrow: float, looks: int) -> None:
    """An axis a hundred times too narrow beside right ones takes no look more than right ones."""
    taken = []

    def density(z: np.ndarray) -> np.ndarray:
        taken.append(len(z))
        return np.asarray(-0.5 * (((z - CENTRE) / SD) ** 2).sum(1))

    mode = mode_near(density, CENTRE + 0.3 * SD, np.diag(SD / [too_narrow, 1.0, 1.0]))
    assert mode.log_evidence == pytest.approx(EXACT, abs=1e-3)
    assert mode.is_whole
    assert taken.count(POINTS_OF_A_LOOK) <= looks


@pytest.mark.parametrize("too_narrow", [30.0, 130.0, 1000.0])
def test_rounding_does_not_make_an_axis_run_away(too_narrow: float) -> None:
    """Of a log density with rounding of 1e-6 nats the evidence is right from any axes."""

    def density(z: np.ndarray) -> np.ndarray:
        rounding = 1e-6 * np.sin(1e9 * z.sum(1))
        return np.asarray(-0.5 * (((z - CENTRE) / SD) ** 2).sum(1) + rounding)

    mode = mode_near(density, CENTRE + 0.3 * SD, np.diag(SD / [too_narrow, 1.0, 1.0]))
    assert mode.log_evidence == pytest.approx(EXACT, abs=0.02)


def test_a_density_that_bends_within_a_wide_step_is_found_all_the_same() -> None:
    """Flat in the middle, with walls: hardly a curvature there, which says nothing of width."""

    def density(z: np.ndarray) -> np.ndarray:
        gap = (z - CENTRE) / SD
        return np.asarray(-0.5 * (gap[:, 1:] ** 2).sum(1) - 0.002 * gap[:, 0] ** 2 - gap[:, 0] ** 8)

    mode = mode_near(density, CENTRE + 0.1 * SD, np.diag(SD / [30.0, 1.0, 1.0]))
    assert np.all(np.isfinite(mode.factor))
    assert mode.point == pytest.approx(CENTRE, abs=0.3)
    # of the flat axis alone: by quadrature, within what Laplace can say of such a shape
    grid = np.linspace(-3.0, 3.0, 4001)
    along = np.log(np.trapezoid(np.exp(-0.002 * grid**2 - grid**8), grid) * SD[0])
    wanted = along + np.log(2 * np.pi) + np.log(SD[1:]).sum()
    assert abs(mode.log_evidence - wanted) < 1.0
