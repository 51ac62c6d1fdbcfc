"""Accelerometer counts: the information they carry is that of a plain normal on the readings."""

from __future__ import annotations

import numpy as np
import pytest
from event_cases import priors
from numpy.typing import NDArray
from scipy.stats import multivariate_normal
from test_measured_delta_v import MASS, physics_at

from cassini_bayes.balance.accelerometer import (
    accelerometer_information,
    accelerometer_statistics,
    count_columns,
)
from cassini_bayes.balance.measured_delta_v import OFFSET_SD_M_S
from cassini_bayes.balance.statistics import Samples, Sampling
from cassini_bayes.errors import InputError
from cassini_bayes.model.event_reduction import sampling_of
from cassini_bayes.spacecraft import thruster_directions

Array = NDArray[np.float64]
SCALE, BIAS = 2.0202e-3, 6e-5
BEFORE, BURN, AFTER = 100, 40, 100


def burn(thrust_n: Array, seed: int = 5) -> tuple[Samples, Array, Sampling]:
    """Rows each second: at rest, all Z thrusters in 125 ms pulses, at rest; the counts."""
    rng = np.random.default_rng(seed)
    names = priors().spacecraft.thruster_names("B")
    rows = BEFORE + BURN + AFTER
    gained = np.zeros((rows, 8))
    gained[BEFORE : BEFORE + BURN, :4] = rng.integers(2, 5, (BURN, 4))
    pulses = np.cumsum(gained, axis=0)
    nothing = np.full((rows, 3), np.nan)
    time = np.arange(float(rows))
    sampling = sampling_of(priors(), names, float(rows - 1), "first_order")
    samples = Samples(time, np.full((rows, 4), np.nan), nothing, nothing, 0.125 * pulses, pulses)
    velocity = -(pulses * effective_s(sampling)) @ thrust_n / MASS  # only Z thrusters fire
    counts = np.round((velocity - BIAS * time) / SCALE + rng.uniform(-0.5, 0.5))
    return samples, counts, sampling


def effective_s(sampling: Sampling) -> float:
    """Effective time of a pulse of 125 ms at the reference pulse parameters."""
    _, rise, fall = sampling.pulse_reference_s
    return float(0.125 + (fall - rise) * (1.0 - np.exp(-0.125 / rise)))


def parameters(bias: float = BIAS, scale: float = SCALE) -> dict[str, Array]:
    """One point."""
    return {
        "mass_kg": np.array([MASS]),
        "accelerometer_scale_m_s": np.array([scale]),
        "accelerometer_bias_m_s2": np.array([bias]),
    }


def test_information_equals_a_plain_normal() -> None:
    """Log density at any thrust, bias and scale: that of the stretches, offset as covariance."""
    thrust = 0.75 + 0.05 * np.random.default_rng(6).standard_normal(8)
    samples, counts, sampling = burn(thrust)
    cut = 120  # two chunks, in the middle of the burn
    parts = [(samples.part(0, cut), counts[:cut]), (samples.part(cut), counts[cut:])]
    statistics = accelerometer_statistics("burn", parts, sampling)
    directions = thruster_directions(priors().spacecraft, "B")
    physics = physics_at(sampling.pulse_reference_s)
    for bias, scale in ((BIAS, SCALE), (-2e-5, 1.1 * SCALE)):
        matrix, vector, constant = accelerometer_information(
            statistics, physics, directions, parameters(bias, scale), np.array([0.76])
        )
        step = thrust - 0.76
        found = constant[0] + vector[0] @ step - 0.5 * step @ matrix[0] @ step
        rest = [
            i for i in range(len(samples)) if i < BEFORE or i > BEFORE + BURN - 1 + sampling.guard_s
        ]
        stretches: list[list[int]] = []
        for i in rest:
            last = stretches[-1][-1] if stretches else None
            same = last is not None and counts[last] == counts[i]
            if same and np.array_equal(samples.pulses[last], samples.pulses[i]):
                stretches[-1].append(i)
            else:
                stretches.append([i])
        time = np.array([np.mean(samples.time_s[own]) for own in stretches])
        shown = np.array([counts[own[0]] - counts[0] for own in stretches])
        seconds = np.array([samples.pulses[own[0]] * effective_s(sampling) for own in stretches])
        mean = (seconds @ (directions[2] * thrust) / MASS - bias * (time - time[0])) / scale
        covariance = np.eye(len(shown)) / 12.0 + (OFFSET_SD_M_S / scale) ** 2
        expected = multivariate_normal.logpdf(shown - mean, np.zeros(len(shown)), covariance)
        assert statistics.readings == len(stretches)
        assert found == pytest.approx(expected, rel=1e-9)


def test_counts_from_before_the_event_change_nothing() -> None:
    """A counter that begins at 30,000 says what one does that begins at 0."""
    samples, counts, sampling = burn(np.full(8, 0.75))
    once = accelerometer_statistics("burn", [(samples, counts)], sampling)
    more = accelerometer_statistics("burn", [(samples, counts + 30_000.0)], sampling)
    assert np.array_equal(more.cross, once.cross)
    assert more.square == once.square > 0.0


def test_rows_of_one_count_are_one_reading() -> None:
    """Telemetry ten times as dense says no more: rounding does not average away."""
    samples, counts, sampling = burn(np.full(8, 0.75))
    once = accelerometer_statistics("burn", [(samples, counts)], sampling)
    again = np.repeat(np.arange(len(samples)), 3)
    dense = Samples(
        *(
            getattr(samples, name)[again]
            for name in ("time_s", "attitude", "rate_rad_s", "wheel_rad_s", "on_time_s", "pulses")
        )
    )
    times = dense.time_s + np.tile([0.0, 0.1, 0.2], len(samples))
    dense = Samples(
        times, dense.attitude, dense.rate_rad_s, dense.wheel_rad_s, dense.on_time_s, dense.pulses
    )
    more = accelerometer_statistics("burn", [(dense, counts[again])], sampling)
    assert more.readings == once.readings < 25
    assert more.gram[-2, -2] == pytest.approx(once.gram[-2, -2])


def test_count_columns_are_slopes_of_the_mean() -> None:
    """Counts that 0.01 N more and 1e-6 m/s² more add, reading by reading, in inner products."""
    samples, counts, sampling = burn(np.full(8, 0.75))
    counts[:] = np.arange(len(counts))  # every row a reading
    statistics = accelerometer_statistics("burn", [(samples, counts)], sampling)
    directions = thruster_directions(priors().spacecraft, "B")
    fired, drift = count_columns(
        statistics, physics_at(sampling.pulse_reference_s), directions, parameters()
    )
    step = 0.01 * fired[0].sum(0) + 1e-6 / BIAS * drift[0]
    rest = [
        i for i in range(len(samples)) if i < BEFORE or i > BEFORE + BURN - 1 + sampling.guard_s
    ]
    seconds = samples.pulses[rest].sum(1) * effective_s(sampling)
    added = (-0.01 * seconds / MASS - 1e-6 * samples.time_s[rest]) / SCALE
    expected = ((added - added.mean()) ** 2).sum()
    assert step @ statistics.centred_gram @ step == pytest.approx(expected, rel=1e-9)


def test_a_burn_without_rows_at_rest_is_refused() -> None:
    """Telemetry that ends while thrusters fire tells no velocity change."""
    samples, counts, sampling = burn(np.full(8, 0.75))
    counts[:BEFORE] = np.nan
    with pytest.raises(InputError, match="end after it"):
        accelerometer_statistics(
            "burn", [(samples.part(0, BEFORE + 5), counts[: BEFORE + 5])], sampling
        )
