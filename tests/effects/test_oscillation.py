"""Columns of an oscillation are integrated as it swings."""

from __future__ import annotations

import numpy as np
import pytest

from cassini_bayes.balance.statistics.rows import Samples
from cassini_bayes.balance.statistics.turns import Pieces
from cassini_bayes.effects.oscillation import Oscillation


@pytest.mark.parametrize("hertz", [0.03, 0.06, 0.1])
def test_a_swing_is_integrated_as_it_swings(hertz: float) -> None:
    """Rows four seconds apart: trapezoids see 0.95 to 0.41 of the integral, columns all of it."""
    time_s = np.arange(0.0, 400.0, 4.0)
    none = np.zeros((len(time_s), 0))
    samples = Samples(time_s, np.zeros((len(time_s), 4)), np.zeros((len(time_s), 3)), *[none] * 3)
    cosine = Oscillation(hertz, 0.0, (1.0, 0.0, 0.0)).columns(samples)[0]
    omega = 2.0 * np.pi * hertz
    pieces = Pieces(time_s, np.array([0, 40, 100]))
    by_rows = pieces.integrated(np.cos(omega * time_s)[:, None])[:, 0]
    exact = pieces.centred(np.sin(omega * time_s)[:, None] / omega)[:, 0]
    assert cosine.over_trapezoids * by_rows == pytest.approx(exact, abs=1e-9 / omega)
    assert cosine.over_trapezoids > 1.04
