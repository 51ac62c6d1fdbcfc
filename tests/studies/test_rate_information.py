"""Attitude against integrated rates: bias and scale of gyros against made-up flights."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cassini_bayes.balance.statistics import Samples
from cassini_bayes.balance.statistics.turns import turns_between
from cassini_bayes.spacecraft.attitude import direction_cosines
from cassini_bayes.studies.blind import rate_information as module
from cassini_bayes.studies.blind.rate_information import rate_information


def made_up(
    bias: float,
    scale: float,
    rng: np.random.Generator,
    noise: tuple[float, float] = (2e-5, 2e-6),
    seconds: float = 2000.0,
) -> Samples:
    """A body turning slowly about Z with swings, its rates misread about Z.

    ``noise`` is that of the attitude (rad) and of rates (rad/s).
    """
    time = np.arange(0.0, seconds)
    rate = 2e-4 * np.sin(time / 150.0)
    angle = 2e-4 * 150.0 * (1.0 - np.cos(time / 150.0))
    angle = angle + noise[0] * rng.standard_normal(len(time))
    attitude = np.zeros((len(time), 4))
    attitude[:, 2], attitude[:, 3] = np.sin(angle / 2), np.cos(angle / 2)
    rates = noise[1] * rng.standard_normal((len(time), 3))
    rates[:, 2] += (1.0 + scale) * rate + bias
    return Samples(
        time,
        attitude,
        rates,
        np.zeros((len(time), 3)),
        np.empty((len(time), 0)),
        np.empty((len(time), 0)),
    )


def test_attitude_tells_rate_bias_and_scale() -> None:
    """Bias and scale come back within four of their standard deviations; none gives none."""
    for bias, scale in ((3e-6, 0.0), (0.0, 0.02), (0.0, 0.0)):
        samples = made_up(bias, scale, np.random.default_rng(3))
        information = rate_information(samples)
        covariance = np.linalg.inv(information.precision[2])
        found = covariance @ information.linear[2]
        miss = (found - np.array([bias, scale])) / np.sqrt(np.diag(covariance))
        assert np.abs(miss).max() < 4.0
        assert np.sqrt(covariance[0, 0]) < 5e-7
    turned = turns_between(direction_cosines(made_up(0.0, 0.0, np.random.default_rng(0)).attitude))
    assert np.abs(turned[:, :2]).max() < 1e-12


def gyro_nats(count: int) -> NDArray[np.float64]:
    """What bias and scale gain at best on flights without either, attitude noise outweighing."""
    found = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        information = rate_information(made_up(0.0, 0.0, rng, (3e-5, 1e-6), 3600.0))
        linear = information.linear[2]
        found.append(0.5 * linear @ np.linalg.solve(information.precision[2], linear))
    return np.array(found)


def test_gyros_without_errors_gain_as_chance_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of a χ² of two: mean 1; with the walk of rate noise left to chance it is far more."""
    nats = gyro_nats(80)
    assert abs(nats.mean() - 1.0) < 4.0 / np.sqrt(len(nats))
    assert nats.max() < np.log(len(nats)) + 5.0
    monkeypatch.setattr(module, "high_difference_noise", lambda *_: np.zeros(3))
    assert gyro_nats(20).max() > np.log(len(nats)) + 5.0
