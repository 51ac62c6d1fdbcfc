"""Measured velocity changes: the information they carry is that of a plain normal on all rows."""

from __future__ import annotations

import numpy as np
import pytest
from event_cases import priors
from scipy.stats import multivariate_normal

from cassini_bayes.balance.measured_delta_v import (
    OFFSET_SD_M_S,
    delta_v_information,
    delta_v_statistics,
)
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.statistics import Samples, Sampling
from cassini_bayes.errors import InputError
from cassini_bayes.model.event_reduction import sampling_of
from cassini_bayes.spacecraft import thruster_directions

MASS, NOISE = 2380.0, 3e-5


def burn(rows: int = 12) -> tuple[Samples, np.ndarray, Sampling]:
    """A quiet stretch, four seconds of firing in 125 ms pulses, and a quiet stretch."""
    rng = np.random.default_rng(5)
    names = priors().spacecraft.thruster_names("B")
    on_time, pulses = np.zeros((rows, 8)), np.zeros((rows, 8))
    gained = np.zeros((rows, 8))
    gained[4:8, :4] = rng.integers(1, 4, (4, 4))
    pulses = np.cumsum(gained, axis=0)
    on_time = 0.125 * pulses
    nothing = np.full((rows, 3), np.nan)
    time = np.arange(float(rows))
    samples = Samples(time, np.full((rows, 4), np.nan), nothing, nothing, on_time, pulses)
    measured = 1e-3 * rng.standard_normal((rows, 3))
    return samples, measured, sampling_of(priors(), names, float(rows - 1), "first_order")


def physics_at(tau: tuple[float, float, float]) -> Physics:
    """Only what a velocity change depends on: the pulse parameters."""
    rise, fall = np.array([tau[1]]), np.array([tau[2]])
    nothing = np.zeros((1, 3, 3))
    return Physics(nothing, nothing, np.zeros((1, 3)), np.zeros((3, 8)), (rise * 0, rise, fall))


def test_information_equals_a_plain_normal() -> None:
    """Log density at any thrusts equals that of all rows at once with the offset as covariance."""
    samples, measured, sampling = burn()
    cut = 5  # two chunks
    parts = [(samples.part(0, cut), measured[:cut]), (samples.part(cut), measured[cut:])]
    statistics = delta_v_statistics("burn", parts, sampling)
    directions = thruster_directions(priors().spacecraft, "B")
    parameters = {
        "mass_kg": np.array([MASS]),
        "delta_v_noise_m_s": np.array([NOISE]),
        "delta_v_resolution_m_s": np.array([1e-5]),
    }
    tau = sampling.pulse_reference_s
    common = np.array([0.76])
    matrix, vector, constant = delta_v_information(
        statistics, physics_at(tau), directions, parameters, common
    )
    thrust = 0.76 + 0.05 * np.random.default_rng(6).standard_normal(8)
    step = thrust - 0.76
    found = constant[0] + vector[0] @ step - 0.5 * step @ matrix[0] @ step
    # quiet rows: before the first firing interval, and those after the last by the guard time
    rows = [i for i in range(len(samples)) if i < 4 or i > 7 + sampling.guard_s]
    width = 0.125
    effective = width + (tau[2] - tau[1]) * (1 - np.exp(-width / tau[1]))
    seconds = samples.pulses * effective
    mean = np.array([directions @ (thrust * seconds[i]) / MASS for i in rows])
    variance = NOISE**2 + 1e-10 / 12
    covariance = variance * np.eye(len(rows)) + OFFSET_SD_M_S**2
    expected = sum(
        multivariate_normal.logpdf(
            measured[rows, c] - measured[0, c] - mean[:, c], np.zeros(len(rows)), covariance
        )
        for c in range(3)
    )
    assert statistics.rows == len(rows)
    assert found == pytest.approx(expected, rel=1e-7)


def test_what_a_counter_had_summed_up_before_changes_nothing() -> None:
    """A velocity change that begins at 500 m/s is that from its first reading on."""
    samples, measured, sampling = burn()
    once = delta_v_statistics("burn", [(samples, measured)], sampling)
    before = np.array([500.0, -20.0, 3.0])
    more = delta_v_statistics("burn", [(samples, measured + before)], sampling)
    assert more.cross == pytest.approx(once.cross, abs=1e-9)
    assert more.square == pytest.approx(once.square, abs=1e-12)
    assert more.last_m_s == pytest.approx(measured[-1] - measured[0], abs=1e-9)


def test_a_burn_without_quiet_rows_is_refused() -> None:
    """Telemetry that ends while thrusters fire tells no velocity change."""
    samples, measured, sampling = burn()
    measured[:4] = np.nan
    with pytest.raises(InputError, match="end after it"):
        delta_v_statistics("burn", [(samples.part(0, 8), measured[:8])], sampling)
