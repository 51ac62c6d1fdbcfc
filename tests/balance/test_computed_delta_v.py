"""The computed ΔV channel against dense normals, published arithmetic and its own draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm
from totals_cases import flight

from cassini_bayes.balance.computed_delta_v import (
    ComputedDeltaV,
    channel_log_likelihood,
    draw_software,
    event_channel_log_likelihood,
    predicted_delta_v,
)
from cassini_bayes.model import build_model


@pytest.fixture(scope="module")
def channel() -> ComputedDeltaV:
    """The channel of the eight flight events."""
    found = build_model(*flight()).totals_rows.computed
    assert found is not None
    return found


def test_integrated_density_is_the_dense_normal(channel: ComputedDeltaV) -> None:
    """Eigenvalue form equals the density of N(X m, s² 1 + X V Xᵀ) to 1e-8, over noise scales."""
    mean = channel.design @ channel.prior_mean
    spread = channel.design * channel.prior_sd
    for sd in (3e-6, 1e-4, 1e-2):
        dense = multivariate_normal(mean, spread @ spread.T + sd**2 * np.eye(len(mean)))
        ours = channel_log_likelihood(channel, np.array([sd**2]))[0]
        assert ours == pytest.approx(dense.logpdf(channel.printed_m_s), rel=1e-8)


def test_draws_have_the_conditional_moments(channel: ComputedDeltaV) -> None:
    """Factor and on-time per pulse drawn back have the dense conditional mean and covariance."""
    n, sd = 40_000, 1e-4
    draws = draw_software(channel, np.full(n, sd**2), np.random.default_rng(1))
    precision = channel.design.T @ channel.design / sd**2 + np.diag(channel.prior_sd**-2.0)
    covariance = np.linalg.inv(precision)
    linear = channel.design.T @ channel.printed_m_s / sd**2
    mean = covariance @ (linear + channel.prior_mean / channel.prior_sd**2)
    error = (draws.mean(0) - mean) / np.sqrt(np.diag(covariance) / n)
    assert np.abs(error).max() < 4
    assert np.cov(draws.T) == pytest.approx(covariance, rel=0.05)


def test_prediction_is_the_tables_own_arithmetic(channel: ComputedDeltaV) -> None:
    """Factor one and no pulse term: thrust × total Z on-time / mass, 3.a's figures."""
    found = predicted_delta_v(channel, np.array([[1.0, 0.0]]))[0, 0]
    assert found == pytest.approx(0.77 * 48.36 / 2414.4, abs=1e-9)
    per_pulse = predicted_delta_v(channel, np.array([[0.0, 1.0]]))[0, 0]
    assert per_pulse == pytest.approx(0.77 * 378 / 2414.4, abs=1e-9)


def test_event_densities_are_plain_normals(channel: ComputedDeltaV) -> None:
    """Given factor, on-time per pulse and noise each printed figure is a normal of its own."""
    software = np.array([[1.01, 0.009]])
    density = event_channel_log_likelihood(channel, software, np.array([1e-8]))
    plain = norm(predicted_delta_v(channel, software)[0], 1e-4).logpdf(channel.printed_m_s)
    assert density[0] == pytest.approx(plain)


def test_printed_delta_v_is_far_from_the_on_times_alone(channel: ComputedDeltaV) -> None:
    """Negative control: without the pulse term every printed ΔV is missed by more than 2 %."""
    missed = channel.printed_m_s / predicted_delta_v(channel, np.array([[1.0, 0.0]]))[0] - 1
    assert (missed > 0.02).all()
