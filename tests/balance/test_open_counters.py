"""What counters leave open: steps of single cut tails and levels of rounded counters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cassini_bayes.balance.open_counters import cut_patterns, level_patterns
from cassini_bayes.balance.statistics.reduction import CounterStatistics

DURATION_S = 80.0
TIME = np.arange(DURATION_S)
GAPS_S = np.array([0.125])
ENDS = np.array([3.0, 7.0, 13.0, 31.0])
STEP = (TIME[:, None] >= ENDS).astype(float)


def counters(pairs: list[float]) -> CounterStatistics:
    """One couple that fired in four intervals, with so many pairs in them."""
    weight = np.array(pairs)[:, None]
    fired = np.ones((4, 1), dtype=bool)
    open_s2, ratio, coarse = np.array([4e-6]), np.array([np.inf]), np.array([False])
    return CounterStatistics(
        TIME, 1, ENDS, fired, weight, open_s2, ratio, coarse, GAPS_S, np.zeros(0)
    )


def test_pairs_of_a_quarter_add_up_to_what_the_likelihood_has() -> None:
    """A step is its quarter's mean, which the likelihood has, and what is added; one: nothing."""
    found = cut_patterns(counters([1.0, 1.0, 1.0, 0.0]), 0, DURATION_S, STEP)
    for i in range(3):
        assert STEP[:, :3].mean(axis=1) + found[:, i] == pytest.approx(STEP[:, i])
    alone = cut_patterns(counters([1.0, 0.0, 0.0, 1.0]), 0, DURATION_S, STEP)
    assert not alone.any()


def test_several_pairs_of_an_interval_scatter_together() -> None:
    """Four pairs have twice the deviation of one, about a mean that leans to them."""
    found = cut_patterns(counters([4.0, 1.0, 0.0, 0.0]), 0, DURATION_S, STEP)
    mean = 0.8 * STEP[:, 0] + 0.2 * STEP[:, 1]
    assert found[:, 0] == pytest.approx(2.0 * (STEP[:, 0] - mean))
    assert found[:, 1] == pytest.approx(STEP[:, 1] - mean)


def test_a_rounding_lasts_until_the_next_firing() -> None:
    """Five levels of 2 ms, which add up to a constant."""
    found = level_patterns(counters([0.0] * 4), 0, STEP, np.ones((len(TIME), 1)))
    assert found.sum(axis=1) == pytest.approx(np.full(len(TIME), 2e-3))
    assert found[:, 1] == pytest.approx(2e-3 * ((TIME >= 3.0) & (TIME < 7.0)))


@pytest.mark.parametrize("coarse", [False, True])
def test_levels_bound_by_alike_widths_have_the_stated_covariance(coarse: bool) -> None:
    """Patterns squared are σ² (1 + D'D/q)⁻¹ seen in the rows, coarse ones with ends alone."""
    bound = replace(counters([0.0] * 4), open_ratio=np.array([0.3]), coarse=np.array([coarse]))
    free = level_patterns(counters([0.0] * 4), 0, STEP, np.ones((len(TIME), 1)))
    found = level_patterns(bound, 0, STEP, np.ones((len(TIME), 1)))
    apart = np.diff(np.eye(5), axis=0)
    seen = np.diag([1.0, 0.0, 0.0, 0.0, 1.0]) if coarse else np.eye(5)
    covariance = np.linalg.inv(seen + apart.T @ apart / 0.3)
    np.testing.assert_allclose(found @ found.T, free @ covariance @ free.T, atol=1e-18)
