"""Noise of channels from differences of their rows: levels, what is taken off, what is not seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from telemetry_cases import event_of, made_up_samples, telemetry_priors

from cassini_bayes.balance.statistics.channel_noise import NOT_SEEN, ChannelNoise, channel_noise
from cassini_bayes.balance.statistics.rows import Samples
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

LEVELS = ChannelNoise(rate_rad_s=3e-6, wheel_rpm=0.6, attitude_rad=8e-6)
ROWS = 2_000
CLOSE = 0.08  # four standard errors of 2,000 third differences about three axes


def accelerating(rng: np.random.Generator, step_rpm: float = 0.0) -> Samples:
    """Wheels that change their acceleration every 100 s turn a body about Z; rows every second."""
    time_s = np.arange(float(ROWS))
    torque = 5e-7 * np.repeat(rng.choice([-1.0, 1.0], ROWS // 100), 100)
    rate = np.cumsum(torque)
    angle = np.cumsum(rate)
    wheel = -5_000.0 / 0.16 * rate[:, None] * np.ones(3)
    turn = 0.5 * (
        np.column_stack([0.0 * angle, 0.0 * angle, angle])
        + LEVELS.attitude_rad * rng.standard_normal((ROWS, 3))
    )
    attitude = np.column_stack([turn, np.ones(ROWS)])
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    wheel += LEVELS.wheel_rpm * RAD_S_PER_RPM * rng.standard_normal((ROWS, 3))
    if step_rpm > 0.0:
        step = step_rpm * RAD_S_PER_RPM
        wheel = np.round(wheel / step) * step
    rates = np.column_stack([0.0 * rate, 0.0 * rate, rate])
    rates += LEVELS.rate_rad_s * rng.standard_normal((ROWS, 3))
    none = np.zeros((ROWS, 0))
    return Samples(time_s, attitude, rates, wheel, none, none)


@pytest.mark.parametrize("step_rpm", [0.0, 1.0])
def test_levels_are_those_of_the_noise(step_rpm: float) -> None:
    """Motion and corners leave nothing, rounding is taken off; control: the plain scatter."""
    samples = accelerating(np.random.default_rng(1), step_rpm)
    found = channel_noise(samples, np.zeros(ROWS, dtype=np.intp), 0.0, step_rpm * RAD_S_PER_RPM)
    assert found.rate_rad_s == pytest.approx(LEVELS.rate_rad_s, rel=CLOSE)
    assert found.wheel_rpm == pytest.approx(LEVELS.wheel_rpm, rel=CLOSE)
    assert found.attitude_rad == pytest.approx(LEVELS.attitude_rad, rel=CLOSE)
    assert samples.rate_rad_s[:, 2].std() > 10.0 * LEVELS.rate_rad_s


def test_rows_with_firing_tell_of_wheels_alone() -> None:
    """Pulses change rates and attitudes between rows; wheels do not answer them."""
    samples = accelerating(np.random.default_rng(2))
    found = channel_noise(samples, np.full(ROWS, -1), 0.0, 0.0)
    assert (found.rate_rad_s, found.attitude_rad) == (0.0, 0.0)
    assert found.wheel_rpm == pytest.approx(LEVELS.wheel_rpm, rel=CLOSE)
    few = samples.part(0, 20)
    assert channel_noise(few, np.zeros(20, dtype=np.intp), 0.0, 0.0) == NOT_SEEN


def test_priors_that_know_a_level_keep_it() -> None:
    """A level that is fixed stays, one that is not seen has the prior's median."""
    priors = telemetry_priors()
    samples = made_up_samples(np.random.default_rng(3), 300)
    event = event_of(samples, priors)
    medians = priors.medians(["rate_noise_rad_s", "wheel_noise_rpm", "torque_noise_n_m_s05"])
    shown = dict(replace(LEVELS, attitude_rad=0.0).seen_by(event.sampling).reference_noise)
    free = [name for name in medians if priors.parameters[name].sd > 0.0]
    assert event.sampling.noise_to_see == tuple(
        name for name in dict(event.sampling.reference_noise) if priors.parameters[name].sd > 0.0
    )
    assert "rate_noise_rad_s" in free
    assert shown["rate_noise_rad_s"] == LEVELS.rate_rad_s
    assert shown["torque_noise_n_m_s05"] == medians["torque_noise_n_m_s05"]
    fixed = event_of(samples, priors.with_fixed("rate_noise_rad_s", 7e-6))
    assert dict(fixed.sampling.reference_noise)["rate_noise_rad_s"] == 7e-6
