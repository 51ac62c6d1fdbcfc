"""Ranks and their judgement: the envelope holds uniform ranks and catches others."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from cassini_bayes.results.ranks import (
    NULL_DRAWS,
    Ranks,
    coverage_p_values,
    envelope_band,
    envelope_p_values,
    holm,
    rank,
    ranks_of,
)


def test_envelope_p_values_are_uniform_for_uniform_ranks() -> None:
    """Of 1,000 uniform columns a tenth has p below 0.1, within binomial scatter."""
    p_values = envelope_p_values(np.random.default_rng(1).uniform(size=(100, 1_000)))
    share = (p_values < 0.1).mean()
    assert abs(share - 0.1) < 4 * np.sqrt(0.1 * 0.9 / 1_000)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda u: u**1.5,  # shifted
        lambda u: 0.5 + 0.6 * (u - 0.5),  # posteriors too wide
        lambda u: np.where(u < 0.5, u**2 * 2, 1 - 2 * (1 - u) ** 2),  # too narrow
    ],
)
def test_wrong_ranks_leave_the_envelope(wrong: object) -> None:
    """Shifted, too wide and too narrow posteriors are all caught with 300 repetitions."""
    assert callable(wrong)
    uniform = np.random.default_rng(2).uniform(size=(300, 5))
    assert envelope_p_values(wrong(uniform)).max() < 1e-3


def test_the_band_holds_whole_lines_with_its_probability() -> None:
    """The drawn 95 % band holds the whole ECDF of 95 % of uniform columns."""
    n = 80
    grid, low, high = envelope_band(n, 0.95)
    draws = np.random.default_rng(3).uniform(size=(n, 2_000))
    lines = np.array([(draws <= point).sum(0) / n for point in grid])
    inside = ((lines >= low[:, None]) & (lines <= high[:, None])).all(0).mean()
    # edges that are counts make the band a little wide
    assert 0.94 < inside < 0.99
    assert NULL_DRAWS >= 10_000


def test_holm_is_the_textbook_procedure() -> None:
    """Adjusted p-values of a worked example, monotone and at most one."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]).tolist() == [1.0, 1.0]


def test_coverage_p_values_against_the_binomial_test() -> None:
    """The doubled smaller tail is never below scipy's exact test, and flags 60 % coverage."""
    coverage = np.array([0.9, 0.8, 0.6, 1.0])
    found = coverage_p_values(coverage, 100)
    exact = [binomtest(round(100 * c), 100, 0.9).pvalue for c in coverage]
    assert (found >= np.array(exact) * 0.99).all()
    assert found[2] < 1e-10
    assert found[0] > 0.9


def test_ranks_count_draws_below_and_break_ties_at_random() -> None:
    """A truth above all draws ranks near one; a fixed parameter's rank is uniform."""
    rng = np.random.default_rng(5)
    assert rank(np.arange(999.0), 2_000.0, rng) > 0.99
    ties = np.array([rank(np.zeros(999), 0.0, rng) for _ in range(400)])
    assert abs(ties.mean() - 0.5) < 4 / np.sqrt(12 * 400)


def test_ranks_are_gathered_from_repetitions() -> None:
    """Arrays of repetitions, in whatever type they were kept, are ranks with their names."""
    kept = {"ranks": np.array([[0.1, 0.2]]), "pareto_k": np.array([0.3]), "by_chain": np.array([1])}
    found = ranks_of(["a", "b"], kept)
    assert isinstance(found, Ranks)
    assert found.names == ("a", "b")
    assert found.by_chain.tolist() == [True]
