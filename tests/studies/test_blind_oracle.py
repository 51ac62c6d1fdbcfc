"""The linear-Gaussian oracle against brute force, and its ranks against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from cassini_bayes.diagnosis.verdict import CONFOUNDED_NATS
from cassini_bayes.studies.blind.oracle import Classifier, Side, log_evidence

RNG = np.random.default_rng(4)
COLUMNS = RNG.standard_normal((40, 4))
NUISANCE = RNG.standard_normal((40, 3))
V = np.eye(40) + NUISANCE @ NUISANCE.T
GRAM = COLUMNS.T @ np.linalg.solve(V, COLUMNS)
BOTH = Side("two", (0, 1), -np.inf, np.inf, 0.0)
HALF = Side("half", (2,), 0.0, 4.0, 0.0)
FREE = Side("free", (3,), -np.inf, np.inf, 0.0)


def score(y: np.ndarray) -> np.ndarray:
    """The statistic b of data y."""
    return np.asarray(COLUMNS.T @ np.linalg.solve(V, y))


def test_evidence_is_that_of_the_whole_data() -> None:
    """Two sizes: the ratio of two multivariate normal densities of all the data."""
    y = RNG.multivariate_normal(np.zeros(40), V)
    with_it = V + COLUMNS[:, :2] @ COLUMNS[:, :2].T
    wanted = multivariate_normal.logpdf(y, cov=with_it) - multivariate_normal.logpdf(y, cov=V)
    assert log_evidence(GRAM, score(y)[None], BOTH)[0] == pytest.approx(wanted, abs=1e-8)


@pytest.mark.parametrize("size", [-1.5, 0.0, 3.0])
def test_evidence_between_bounds_is_the_integral(size: float) -> None:
    """One size between bounds: quadrature of the likelihood ratio over the truncated prior."""
    y = RNG.multivariate_normal(np.zeros(40), V) + size * COLUMNS[:, 2]
    b, g = score(y)[2], GRAM[2, 2]
    s = np.linspace(HALF.low, HALF.high, 20_001)
    prior = norm.pdf(s) / (norm.cdf(HALF.high) - norm.cdf(HALF.low))
    wanted = np.log(np.trapezoid(prior * np.exp(s * b - 0.5 * g * s**2), s))
    assert log_evidence(GRAM, score(y)[None], HALF)[0] == pytest.approx(wanted, abs=1e-5)


def test_ranks_find_a_clear_cause_and_no_faint_one() -> None:
    """A cause of many sigma is always first; one of size zero is so by chance alone."""
    y = 8.0 * COLUMNS[:, 2]
    classifier = Classifier(GRAM, score(y), (BOTH, HALF, FREE, Side("half", (2,), -4.0, 0.0, -9.0)))
    assert classifier.names == ("two", "half", "free")
    assert classifier.rank_by_data("half") == 0
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(4), GRAM, 400)
    assert 0.05 < (classifier.ranks(draws, "half") == 0).mean() < 0.7
    assert classifier.expected("half", np.array([8.0]), np.random.default_rng(2)) == 1.0


def test_a_group_has_what_explains_the_same_data_better() -> None:
    """A size at the far end of its prior, and the same change under a prior four times as wide.

    The wider one is more than three nats better there, and cannot be told from the true one by
    anybody. At a size of one scale it is a little worse, and the other way round the narrow one is
    more than three nats behind.
    """
    columns = np.column_stack([COLUMNS[:, 2], 4.0 * COLUMNS[:, 2], COLUMNS[:, 3]])
    gram = columns.T @ np.linalg.solve(V, columns)
    names = ("narrow", "wide", "other")
    sides = tuple(Side(name, (i,), -np.inf, np.inf, 0.0) for i, name in enumerate(names))
    classifier = Classifier(gram, np.zeros(3), sides)
    far = np.array([4.0])
    narrow, wide = (log_evidence(gram, gram[:1] * far, side)[0] for side in sides[:2])
    assert wide - narrow > CONFOUNDED_NATS
    assert classifier.group("narrow", far) == ("narrow", "wide")
    assert classifier.group("narrow", far / 4.0) == ("narrow", "wide")
    assert classifier.group("wide", far / 4.0) == ("wide",)
