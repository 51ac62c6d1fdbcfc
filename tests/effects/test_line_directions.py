"""Directions of a line: the evidence of all of them against a fine grid, and which is taken."""

from __future__ import annotations

import numpy as np
import pytest

from cassini_bayes.effects.line_directions import (
    ALONG_AXES,
    BODY_AXES,
    AllDirections,
    hemisphere,
)

OBLIQUE = np.array([0.31, -0.82, 0.49]) / np.linalg.norm([0.31, -0.82, 0.49])


def test_directions_of_a_hemisphere_are_spread_evenly() -> None:
    """Unit vectors whose mean square along every axis is a third."""
    each = hemisphere(2_000)
    assert np.linalg.norm(each, axis=1) == pytest.approx(1.0)
    assert each.T @ each / 2_000 == pytest.approx(np.eye(3) / 3.0, abs=2e-3)
    assert each[:, 2].min() > 0.0


def test_columns_of_a_direction_are_those_of_the_line_along_it() -> None:
    """Gram and projection of a direction equal those of its columns written out."""
    rng = np.random.default_rng(4)
    cosine, sine, *driven = columns = rng.standard_normal((5, 50))
    left, moments, scales = (
        rng.standard_normal((50, 3)),
        np.array([8.0, 7.0, 6.0]),
        np.array([[0.1, 0.1, 0.05], [0.05, 0.05, 0.1]]),
    )
    whole = np.kron(np.eye(3), columns.T)
    seen = AllDirections(whole.T @ whole, whole.T @ left.T.ravel(), moments, scales)
    about = OBLIQUE @ np.array(driven)
    plain = np.stack([np.outer(OBLIQUE, own).ravel() for own in (cosine, sine, -about)], axis=1)
    found = seen.posterior_about(OBLIQUE[None])
    for of, covariance, by_rows in zip(scales, found.covariance, found.mean, strict=True):
        size = (np.square(OBLIQUE) @ moments) * of
        precision = np.eye(3) + (plain * size).T @ (plain * size)
        assert covariance[0] == pytest.approx(np.linalg.inv(precision))
        mean = np.linalg.solve(precision, (plain * size).T @ left.T.ravel())
        assert by_rows[0] == pytest.approx(mean)


@pytest.mark.parametrize(("along_axis", "sigmas"), [(False, 9.0), (False, 3.0), (True, 6.0)])
def test_the_evidence_of_all_directions_is_that_of_a_fine_grid(
    along_axis: bool, sigmas: float
) -> None:
    """Laplace's over the hemisphere, and three body axes, against 40,000 directions."""
    rng = np.random.default_rng(6)
    columns = rng.standard_normal((400, 5))
    direction = BODY_AXES[1] if along_axis else OBLIQUE
    moments, scales = np.array([8.0, 7.0, 6.0]), np.array([[1.0, 1.0, 0.5]])
    size = sigmas / np.sqrt(400.0)
    left = rng.standard_normal((400, 3)) + size * np.outer(columns[:, 0], direction)
    whole = np.kron(np.eye(3), columns)
    seen = AllDirections(whole.T @ whole, whole.T @ left.T.ravel(), moments, scales)
    everywhere = seen.evidence_about(hemisphere(40_000))
    oblique = np.logaddexp.reduce(everywhere) - np.log(40_000)
    axes = np.logaddexp.reduce(seen.about_axes.log_evidence[0]) - np.log(3.0)
    exact = np.logaddexp(np.log(ALONG_AXES) + axes, np.log(1.0 - ALONG_AXES) + oblique)
    assert seen.log_evidence == pytest.approx(exact, abs=0.5)
    if not along_axis and sigmas > 5.0:
        best = seen.evidence_about(np.array([seen.best]))[0]
        assert best == pytest.approx(everywhere.max(), abs=0.02)
        # a line has no sign: squares of the sine to the best direction, two arcs of them
        weights = np.exp(everywhere - everywhere.max())
        across = 1.0 - (hemisphere(40_000) @ seen.best) ** 2
        spread = np.sqrt(0.5 * np.average(across, weights=weights))
        assert seen.oblique_sd_rad == pytest.approx(spread, rel=0.1)
    assert (seen.best in BODY_AXES) == along_axis or sigmas < 5.0
