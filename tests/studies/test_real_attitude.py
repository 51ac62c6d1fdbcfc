"""Noise and gyro errors of attitude records: found where known, and what the real ones have."""

from __future__ import annotations

import numpy as np
import pytest

from cassini_bayes.published.attitude import attitude_records
from cassini_bayes.studies.real_attitude import gyro_errors, high_difference_noise, measured


@pytest.mark.parametrize("order", [2, 3, 4])
def test_white_noise_on_a_smooth_motion_is_found(order: int) -> None:
    """A parabola with noise of 0.3: 4,000 values leave 3 % at most."""
    rng = np.random.default_rng(1)
    time = np.linspace(0.0, 1.0, 4_000)[:, None]
    found = high_difference_noise(time**2 + 0.3 * rng.standard_normal((4_000, 2)), order)
    assert found == pytest.approx([0.3, 0.3], rel=0.08)


@pytest.mark.statistical
def test_scale_and_bias_are_not_drawn_by_noise_of_turns() -> None:
    """Small turns, noisy on both sides: scale 0.02 on average; a regression says −0.3 (control)."""
    rng = np.random.default_rng(2)
    likely, naive = [], []
    for _ in range(200):
        true = 2e-4 * rng.standard_normal(200)
        turned = true + 1e-4 * rng.standard_normal(200)
        integrated = 1.02 * true + 64e-6 + 1e-4 * rng.standard_normal(200)
        found, _ = gyro_errors(integrated, turned, np.full(200, 64.0), (1e-8, 1e-8))
        likely.append(found)
        naive.append(np.polyfit(turned, integrated - turned, 1)[0])
    mean = np.mean(likely, axis=0)
    error = np.std(likely, axis=0) / np.sqrt(200)
    assert abs(mean[1] - 1e-6) < 5 * error[1]
    assert abs(mean[0] - 0.02) < 0.1
    assert np.mean(naive) < -0.15


def test_real_records_have_the_noise_that_the_priors_take() -> None:
    """Rates 1.2e-5 to 2.6e-5 rad/s in steps of 5e-6, attitudes 0.5e-5 to 2.2e-5 rad."""
    for record in attitude_records():
        table = measured(record)
        assert table["rate_noise_rad_s"].between(1.2e-5, 2.6e-5).all()
        assert table["attitude_noise_third_rad"].between(5e-6, 2.4e-5).all()
