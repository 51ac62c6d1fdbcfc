"""What an event shows of its noise: of enough rows and contrasts, however bands end."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from cassini_bayes.balance.telemetry_balance import Products, TelemetryBalance
from cassini_bayes.balance.telemetry_information import _noise_seen

RATE, TURN = slice(0, 3), slice(3, 6)


def grams(sums: list[tuple[float, float]]) -> np.ndarray:
    """Inner products (B, 3, 3, 6, 6) of bands: sums of squares of each rate and of each turn."""
    result = np.zeros((len(sums), 3, 3, 6, 6))
    for band, (rate, turn) in enumerate(sums):
        np.fill_diagonal(result[band, 0, 0], [rate] * 3 + [turn] * 3)
    return result


@pytest.mark.parametrize(
    ("contrasts", "squares", "seen"),
    [
        ([36, 48], [36.0, 48.0 * 4.0], 2.0),  # the fastest
        ([35, 48, 1], [35.0, 48.0 * 4.0, 0.01], 2.0),  # one odd time step: no noise to tell
        ([5, 12, 1], [5.0, 12.0 * 4.0, 0.01], 2.0),  # few of all: the fullest
    ],
)
def test_the_noise_of_attitudes_is_that_of_the_fastest_band_with_enough_contrasts(
    contrasts: list[int], squares: list[float], seen: float
) -> None:
    """A single contrast says nothing of a noise; the prior's level is the most there is."""
    event = SimpleNamespace(
        statistics=SimpleNamespace(layout=SimpleNamespace(rate=RATE, turn=TURN)),
        fast=[SimpleNamespace(rows=100)],
        turns=[SimpleNamespace(contrasts=number) for number in contrasts],
        reduced=SimpleNamespace(columns=np.arange(6)),
    )
    products = SimpleNamespace(
        grams=grams([(900.0, 0.0)]), turns=grams([(0.0, square) for square in squares])
    )
    prior = {"rate_noise_rad_s": np.full(1, 1.5), "attitude_noise_rad": np.full(1, 10.0)}
    found = _noise_seen(cast(TelemetryBalance, event), cast(Products, products), prior)
    assert found["attitude_noise_rad"] == pytest.approx(seen)
    assert found["rate_noise_rad_s"] == pytest.approx(1.5)
