"""The measure in which motion is flat: the slope of the log likelihood at the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from telemetry_cases import (
    RPM,
    event_of,
    joint_of_slews,
    made_up_samples,
    nominal_values,
    telemetry_priors,
    wheel_weights,
)

import cassini_bayes.balance.telemetry_system
from cassini_bayes.balance.flat_motion import log_measure
from cassini_bayes.balance.physics import Physics, physics_of
from cassini_bayes.balance.statistics import Samples
from cassini_bayes.balance.telemetry_balance import TelemetryBalance
from cassini_bayes.balance.telemetry_noise import (
    TurnNoise,
    band_covariances,
    channel_variances,
    open_counters,
    turn_noise,
)
from cassini_bayes.computing.arrays import Array
from cassini_bayes.model import Model, build_model
from cassini_bayes.model.posterior import log_likelihood
from cassini_bayes.spacecraft import inertia_tensor
from cassini_bayes.spacecraft.parameters import NOISE_LEVELS

EVENTS = 24
# wheels and rates that put about as much into the balance
NOISE = {"rate_noise_rad_s": 2e-6, "wheel_noise_rpm": 0.6, "attitude_noise_rad": 1e-5}


def resting_slew(
    rng: np.random.Generator,
    rows: int = 120,
    noise: Mapping[str, float] = NOISE,
    torque_noise: float = 0.0,
) -> Samples:
    """A slew in which the body hardly moves: its rates are below their noise.

    All parameters but the noise levels are at their prior means. The momentum of white torque noise
    is in the body's motion.
    """
    values, priors = nominal_values(), telemetry_priors()
    rate_noise, wheel_noise, attitude_noise = noise.values()
    inertia, fine, step = inertia_tensor(values), 16, 4.0 / 16
    every = step * np.arange(fine * (rows - 1) + 1)
    rate = 1e-6 * np.sin(np.outer(every, [0.02, 0.013, 0.03]) + 6.28 * rng.random(3))
    kicks = torque_noise * np.sqrt(step) * rng.standard_normal((len(every) - 1, 3))
    gained = np.r_[np.zeros((1, 3)), np.cumsum(kicks, axis=0)]
    rate += gained @ np.linalg.inv(inertia)
    turned = 0.5 * step * (rate[1:] + rate[:-1])
    turns = np.r_[np.zeros((1, 3)), np.cumsum(turned, axis=0)]
    attitude, time = Rotation.from_rotvec(turns[::fine]), every[::fine]
    rate, gained = rate[::fine], gained[::fine]
    weights = wheel_weights(priors.spacecraft, values)
    total = attitude.inv().apply([5.0, -3.0, 8.0]) + gained
    wheels = (total - rate @ inertia) @ np.linalg.inv(weights).T
    measured = Rotation.from_rotvec(attitude_noise * rng.standard_normal((rows, 3))) * attitude
    return Samples(
        time,
        measured.as_quat(),
        rate + rate_noise * rng.standard_normal((rows, 3)),
        wheels + wheel_noise * RPM * rng.standard_normal((rows, 3)),
        np.zeros((rows, 0)),
        np.zeros((rows, 0)),
    )


@pytest.fixture(scope="module")
def slews() -> list[Model]:
    """Resting slews, each with a model of its own; the truth is z = 0."""
    rng = np.random.default_rng(20261123)
    priors = telemetry_priors().with_fixed("torque_noise_n_m_s05", 0.0)
    for name, value in NOISE.items():
        priors = priors.with_fixed(name, value)
    return [build_model([event_of(resting_slew(rng), priors)], priors) for _ in range(EVENTS)]


def slopes(models: list[Model], parameter: str) -> Array:
    """Slope of the log likelihood at the truth in the log of a parameter with a normal prior."""
    space = models[0].space
    place = space.names.index(parameter)
    z = np.zeros((2, space.dimension))
    z[:, place] = -0.05, 0.05
    values = space.to_parameters(z)[parameter]
    step = float(np.log(values[1] / values[0]))
    return np.array([np.diff(log_likelihood(model, z))[0] / step for model in models])


def z_of_mean(found: Array) -> float:
    """Mean in units of its standard error."""
    return float(found.mean() / found.std(ddof=1) * np.sqrt(len(found)))


def noise_of_turns(
    balance: TelemetryBalance,
    physics: Physics,
    values: Mapping[str, Array],
    *,
    whole: bool = False,
) -> TurnNoise:
    """As a likelihood call has it, or with the whole of the torque noise."""
    left_open = open_counters(balance, physics).turns
    walked = [band.walked_s3 if whole else band.faster_s3 for band in balance.turns]
    return turn_noise(balance, physics, channel_variances(balance, values), left_open, walked)


def test_exact_wheels_leave_the_determinant_of_the_inertia() -> None:
    """Where rates and turns alone are noisy, the measure is |det I| per rate, but one, and turn."""
    priors = telemetry_priors().with_fixed("torque_noise_n_m_s05", 0.0)
    for name, value in {**NOISE, "wheel_noise_rpm": 1e-9, "attitude_noise_rad": 1e-9}.items():
        priors = priors.with_fixed(name, value)
    slew = event_of(resting_slew(np.random.default_rng(3)), priors)
    model = build_model([slew], priors)
    balance = model.telemetry[0].balance
    logs = []
    for factor in (1.0, 1.3):
        values = {name: np.array([value]) for name, value in nominal_values().items()}
        values["inertia_zz_kg_m2"] *= factor
        values |= {name: np.array([value]) for name, value in slew.sampling.reference_noise}
        physics = physics_of(model.spacecraft, "B", values, fires=False)
        by_turn = noise_of_turns(balance, physics, values)
        measured = log_measure(balance, physics, by_turn)
        logs.append((measured[0], np.linalg.slogdet(physics.inertia_kg_m2)[1][0]))
    (before, inertia), (after, larger) = logs
    count = slew.statistics.rows - 1 + sum(band.contrasts for band in balance.turns)
    assert after - before == pytest.approx(count * (larger - inertia), rel=1e-6)
    assert before == pytest.approx(count * inertia, rel=1e-9)  # the unit


def test_pulses_are_no_part_of_the_measure() -> None:
    """Tail-off and share of close pulses change the noise of cut tails, not the measure."""
    priors = telemetry_priors()
    for name, value in priors.medians(NOISE_LEVELS).items():
        priors = priors.with_fixed(name, value)
    bias = event_of(made_up_samples(np.random.default_rng(4), 300), priors)
    model = build_model([bias], priors)
    balance, found, noises = model.telemetry[0].balance, [], []
    for fall, share in ((0.04, 0.1), (0.08, 0.5)):
        values = nominal_values() | {"tau_fall_s": fall, "close_pulse_share": share}
        values |= dict(bias.sampling.reference_noise)
        point = {name: np.array([value]) for name, value in values.items()}
        physics = physics_of(model.spacecraft, "B", point)
        left_open = open_counters(balance, physics)
        noise = noise_of_turns(balance, physics, point)
        unmixed = replace(noise, gain=np.zeros_like(noise.gain))
        found.append(float(log_measure(balance, physics, unmixed)[0]))
        rows = band_covariances(balance, physics, channel_variances(balance, point), left_open.rows)
        noises.append(np.linalg.slogdet(rows[0, 0])[1])
    assert noises[1] - noises[0] > 0.1  # cut tails are seen in these rows
    assert found[0] == found[1]


def test_the_measure_has_the_degree_of_the_rows_in_the_common_scale() -> None:
    """Inertia and wheels 30 % larger: |det I| per rate but one and per turn, torque noise or not.

    The noise of the balance itself, with torque noise of fixed size, grows less: the control.
    """
    priors = telemetry_priors()
    slew = event_of(resting_slew(np.random.default_rng(5)), priors)
    model = build_model([slew], priors)
    balance, measures, noises = model.telemetry[0].balance, [], []
    for size in (1.0, 1.3):
        values = {
            name: np.array([value * size if "inertia_" in name else value])
            for name, value in nominal_values().items()
        }
        values |= {name: np.array([value]) for name, value in slew.sampling.reference_noise}
        physics = physics_of(model.spacecraft, "B", values, fires=False)
        noise = noise_of_turns(balance, physics, values, whole=True)
        unmixed = replace(noise, gain=np.zeros_like(noise.gain))
        measures.append(float(log_measure(balance, physics, unmixed)[0]))
        noises.append(0.5 * np.linalg.slogdet(noise.covariance[0, 0])[1])
    count = slew.statistics.rows - 1 + sum(band.contrasts for band in balance.turns)
    assert measures[1] - measures[0] == pytest.approx(3.0 * count * np.log(1.3), rel=1e-9)
    assert noises[1] - noises[0] < 0.9 * 3.0 * np.log(1.3)


MOMENTS = ("inertia_xx_kg_m2", "inertia_yy_kg_m2", "inertia_zz_kg_m2")


@pytest.mark.statistical
def test_the_slope_at_the_truth_is_zero_on_average(slews: list[Model]) -> None:
    """No moment of inertia is drawn either way; 3.5 standard errors would be 1 in 700 seeds."""
    assert max(abs(z_of_mean(slopes(slews, name))) for name in MOMENTS) < 3.5


@pytest.mark.statistical
@pytest.mark.parametrize(("flat", "sign"), [("wheels", 1.0), ("body", -1.0)])
def test_flat_wheel_or_body_rates_draw_the_inertia(
    slews: list[Model], monkeypatch: pytest.MonkeyPatch, flat: str, sign: float
) -> None:
    """Control: flat wheel rates draw all moments upwards, flat body rates downwards."""

    def measure(
        event: TelemetryBalance,
        physics: Physics,
        by_turn: TurnNoise,
    ) -> Any:
        contrasts = np.array([band.contrasts for band in event.turns])
        of_turns = np.linalg.slogdet(np.eye(3) + by_turn.gain)[1] @ contrasts
        inertia = np.linalg.slogdet(physics.inertia_kg_m2)[1]
        rows = event.statistics.rows if flat == "wheels" else 0
        return of_turns + (rows + contrasts.sum()) * inertia

    monkeypatch.setattr(cassini_bayes.balance.telemetry_system, "log_measure", measure)
    assert min(sign * z_of_mean(slopes(slews, name)) for name in MOMENTS) > 5.0


def test_torque_noise_is_not_told_twice() -> None:
    """Its likelihood is nearly that of rows and turns as one normal, in which they share it.

    Control: the same normal with torque noise of their own in rows and in turns is four times as
    far from it. (What is left comes of modes of rows and turns that are not quite the same.)
    """
    rng = np.random.default_rng(20261124)
    noise = {"rate_noise_rad_s": 2e-6, "wheel_noise_rpm": 0.02, "attitude_noise_rad": 1e-5}
    priors = telemetry_priors()
    for name, value in noise.items():
        priors = priors.with_fixed(name, value)
    apart, twice = [], []
    for _ in range(8):
        slew = resting_slew(rng, 150, noise, torque_noise=7e-4)
        model = build_model([event_of(slew, priors)], priors)
        values = nominal_values() | noise
        logs = []
        for size in (2e-4, 7e-4):
            z = model.space.to_standard(values | {"torque_noise_n_m_s05": size})[None]
            found = values | {"torque_noise_n_m_s05": size}
            exact, unlike = joint_of_slews(model, found)
            logs.append([float(log_likelihood(model, z)[0]), exact, unlike])
        likelihood, exact, unlike = np.diff(logs, axis=0)[0]
        apart.append(abs(likelihood - exact))
        twice.append(abs(unlike - exact))
    assert np.mean(apart) < 0.25 * np.mean(twice)
