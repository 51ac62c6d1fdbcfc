"""Spectra of innovations: a line is found where it is, white noise has none."""

from __future__ import annotations

import numpy as np

from cassini_bayes.balance.linearised import InnovationRows
from cassini_bayes.diagnosis.spectrum import spectra


def rows_of(white: np.ndarray, event: str = "e") -> InnovationRows:
    """Rows at 1 Hz with these innovations, and channels of zeros."""
    n = len(white)
    nothing = np.zeros((n, 3))
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    return InnovationRows(
        event, np.arange(n, dtype=float), white, white, nothing, nothing, np.zeros((n, 0)),
        (1, 2, 4), (), np.eye(3), attitude,
    )  # fmt: skip


def test_a_line_is_found_at_its_frequency_with_its_power() -> None:
    """A sine of amplitude A has power n A²/4: closed form, beside noise of power one."""
    n, amplitude, frequency = 1000, 0.8, 0.21
    white = np.random.default_rng(1).standard_normal((n, 3))
    white[:, 1] += amplitude * np.sin(2.0 * np.pi * frequency * np.arange(n))
    found = {s.axis: s for s in spectra([rows_of(white)])}
    assert found["y"].frequency_hz[found["y"].peak] == 0.21
    expected = n * amplitude**2 / 4.0
    assert abs(found["y"].power.max() - expected) < 4.0 * np.sqrt(2.0 * expected)
    assert found["y"].chance < 1e-10
    assert min(found["x"].chance, found["z"].chance) > 1e-3


def test_the_chance_of_a_peak_is_uniform_for_white_noise() -> None:
    """In 300 spectra of white noise the chance is below a tenth in a tenth of them."""
    rng = np.random.default_rng(2)
    chances = [s.chance for _ in range(100) for s in spectra([rows_of(rng.normal(size=(256, 3)))])]
    share = np.mean(np.array(chances) < 0.1)
    assert abs(share - 0.1) < 3.0 * np.sqrt(0.09 / len(chances))
