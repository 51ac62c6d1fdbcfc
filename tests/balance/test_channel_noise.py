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


@pytest.mark.parametrize("jitter_s", [1e-5, 3e-3])
def test_the_jitter_of_a_clock_is_no_noise(jitter_s: float) -> None:
    """Levels are as they were, also of attitudes while the body turns by 5 mrad a row.

    Control: at the jitter's 3 ms these turns would be 2e-5 rad off by themselves.
    """
    rng = np.random.default_rng(2)
    samples = accelerating(rng)
    time_s = samples.time_s + jitter_s * rng.uniform(-1.0, 1.0, ROWS)
    turning = 5e-3 * time_s
    q = samples.attitude
    cosine, sine = np.cos(turning / 2.0)[:, None], np.sin(turning / 2.0)[:, None]
    # about Z, before the turns that the samples have
    turned = cosine * q + sine * np.column_stack([q[:, 1], -q[:, 0], q[:, 3], -q[:, 2]])
    seen = replace(samples, time_s=time_s, attitude=turned)
    found = channel_noise(seen, np.zeros(ROWS, dtype=np.intp), 0.0, 0.0)
    assert found.rate_rad_s == pytest.approx(LEVELS.rate_rad_s, rel=CLOSE)
    assert found.wheel_rpm == pytest.approx(LEVELS.wheel_rpm, rel=CLOSE)
    assert found.attitude_rad == pytest.approx(LEVELS.attitude_rad, rel=CLOSE)


def turning_and_pausing(rng: np.random.Generator, noise_rpm: float) -> Samples:
    """Wheels in steps of 1 rpm that three turns of 400 s change; they pause in between."""
    time_s, torque = np.arange(4_800.0), np.zeros(4_800)
    for begin in (100, 1_700, 3_300):
        torque[begin : begin + 400] = np.sin(2.0 * np.pi * np.arange(400) / 400.0)
    rates = rng.uniform(0.5, 3.0, 3) * np.cumsum(torque)[:, None] + [11.1, 300.0, 70.8]
    rates += noise_rpm * rng.standard_normal(rates.shape)
    level, none = np.tile([0.0, 0.0, 0.0, 1.0], (4_800, 1)), np.zeros((4_800, 0))
    shown = RAD_S_PER_RPM * np.round(rates)
    return Samples(time_s, level, np.zeros((4_800, 3)), shown, none, none)


@pytest.mark.parametrize("noise_rpm", [0.1, 0.15, 0.25])
def test_wheels_in_coarse_steps_are_read_where_they_pass_them(noise_rpm: float) -> None:
    """Squares of the noise of ten flights, to 7 % of what the measure has: with the rounding's.

    Control: with the rounding taken for white in pauses as well nothing is left of 0.15 rpm. So it
    was in a flight of another simulator, and an inertia was named at 16.6 nats for it.
    """
    rng, still = np.random.default_rng(5), np.zeros(4_800, dtype=np.intp)
    squares, white = [], []
    for _ in range(10):
        samples = turning_and_pausing(rng, noise_rpm)
        squares.append(channel_noise(samples, still, 0.0, RAD_S_PER_RPM).wheel_rpm ** 2)
        shown = samples.wheel_rad_s / RAD_S_PER_RPM
        white.append(np.mean(np.diff(shown, 2, axis=0) ** 2) / 6.0 - 1.0 / 12.0)
    assert np.mean(squares) == pytest.approx(noise_rpm**2, abs=0.07 * (noise_rpm**2 + 1.0 / 12.0))
    assert noise_rpm > 0.2 or max(white) < 0.0


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
