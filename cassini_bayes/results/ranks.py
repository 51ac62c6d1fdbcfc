"""Ranks of true values among posterior draws, and their judgement.

If prior, likelihood and sampler agree with the mechanism that made the data, the rank of a true
value among its posterior draws is uniform (Talts et al. 2018; Modrák et al. 2023). Every campaign
of simulation-based calibration gathers such ranks over repetitions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from cassini_bayes.computing.arrays import Array, Flags

GRID: Final = 99
NULL_DRAWS: Final = 40_000
_NULL_SEED: Final = 2022


@dataclass(frozen=True)
class Ranks:
    """Ranks of the true values: (repetitions, parameters) as fractions in [0, 1]."""

    names: tuple[str, ...]
    ranks: Array
    pareto_k: Array
    by_chain: Flags

    def of_fitted(self) -> Ranks:
        """Only the parameters that the fitted model has: a control may fix one of the true ones."""
        kept = np.flatnonzero(np.isfinite(self.ranks).sum(0) == len(self.ranks))
        names = tuple(self.names[column] for column in kept)
        return replace(self, names=names, ranks=self.ranks[:, kept])

    def coverage(self, probability: float = 0.9) -> Array:
        """Share of repetitions whose central interval holds the truth, per parameter."""
        tail = (1.0 - probability) / 2.0
        return np.asarray(((self.ranks > tail) & (self.ranks < 1.0 - tail)).mean(0))


def rank(draws: Array, truth: float, rng: np.random.Generator) -> float:
    """Fraction of draws below the truth; ties (a fixed parameter) are broken at random."""
    below = float((draws < truth).sum())
    ties = float((draws == truth).sum())
    return (below + rng.uniform() * (ties + 1.0)) / (len(draws) + 1.0)


def envelope_p_values(ranks: Array) -> Array:
    """p-value of every column (P,) against the simultaneous ECDF envelope of uniform ranks.

    The statistic is the smallest two-sided binomial tail probability of the empirical distribution
    over a grid; its null distribution is simulated (Säilynoja, Bürkner & Vehtari 2022).
    """
    n = len(ranks)
    null = np.sort(_least_tail(np.random.default_rng(_NULL_SEED).uniform(size=(n, NULL_DRAWS)), n))
    result = _least_tail(ranks, n)
    return np.asarray((np.searchsorted(null, result, side="right") + 1.0) / (NULL_DRAWS + 1.0))


def _least_tail(ranks: Array, n: int) -> Array:
    """Smallest two-sided binomial tail probability of each column's ECDF on the grid, (P,)."""
    points = np.arange(1, GRID + 1) / (GRID + 1)
    columns = ranks.shape[1]
    cell = np.clip(np.ceil(ranks * (GRID + 1)).astype(np.int64) - 1, 0, GRID)
    place = cell + (GRID + 1) * np.arange(columns)
    histogram = np.bincount(place.ravel(), minlength=(GRID + 1) * columns)
    below = np.cumsum(histogram.reshape(columns, GRID + 1), axis=1)[:, :GRID]
    counts = np.arange(n + 1)[:, None]
    lower, upper = binom.cdf(counts, n, points), binom.sf(counts - 1, n, points)
    tail: Array = np.asarray(2.0 * np.minimum(lower, upper), dtype=np.float64)
    least = np.minimum(tail[below, np.arange(GRID)].min(axis=1), 1.0)
    return np.asarray(least, dtype=np.float64)


def envelope_band(n: int, probability: float) -> tuple[Array, Array, Array]:
    """Simultaneous band of the ECDF of n uniform ranks: grid, lower and upper edge, (G,) each."""
    draws = np.random.default_rng(_NULL_SEED).uniform(size=(n, NULL_DRAWS))
    level = float(np.quantile(_least_tail(draws, n), 1.0 - probability))
    points = np.arange(1, GRID + 1) / (GRID + 1)
    return points, binom.ppf(level / 2, n, points) / n, binom.isf(level / 2, n, points) / n


def holm(p_values: Sequence[float] | Array) -> Array:
    """Holm's adjusted p-values, in the order given."""
    values = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(values)
    scaled = values[order] * np.arange(len(values), 0, -1)
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return adjusted


def coverage_p_values(coverage: Array, n: int, probability: float = 0.9) -> Array:
    """Two-sided binomial p-values of the coverage of n intervals of a stated probability."""
    hits = np.rint(coverage * n)
    tail = np.minimum(binom.cdf(hits, n, probability), binom.sf(hits - 1, n, probability))
    return np.asarray(np.minimum(2.0 * tail, 1.0), dtype=np.float64)


def ranks_of(names: Sequence[str], repetitions: Mapping[str, NDArray[np.generic]]) -> Ranks:
    """Ranks of repetitions: their arrays ``ranks`` (n, P), ``pareto_k`` and ``by_chain`` (n,)."""
    return Ranks(
        tuple(names),
        np.asarray(repetitions["ranks"], dtype=np.float64),
        np.asarray(repetitions["pareto_k"], dtype=np.float64),
        np.asarray(repetitions["by_chain"], dtype=np.bool_),
    )
