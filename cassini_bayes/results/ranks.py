"""Ranks of true values among posterior draws: repetitions kept on disk, and their judgement.

If prior, likelihood and sampler agree with the mechanism that made the data, the rank of a true
value among its posterior draws is uniform (Talts et al. 2018; Modrák et al. 2023). Every campaign
of simulation-based calibration is a set of repetitions with seeds of their own, so a killed one
loses the unfinished files only and the result does not depend on the number of processes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom
from threadpoolctl import threadpool_limits

from cassini_bayes.computing.arrays import Array, Flags
from cassini_bayes.errors import CassiniBayesError
from cassini_bayes.files.checkpoint import CheckpointStore

GRID: Final = 99
NULL_DRAWS: Final = 40_000
_NULL_SEED: Final = 2022


class RankCampaign(Protocol):
    """Repetitions that can be run one by one, in any process."""

    @property
    def per_file(self) -> int:
        """Repetitions that one checkpoint file holds."""

    def identity(self) -> str:
        """What finished repetitions depend on: seed, data, priors, code."""

    def names(self) -> tuple[str, ...]:
        """Names of the ranked scalars."""

    def repetition(self, index: int) -> tuple[Array, float, bool]:
        """Ranks (P,), Pareto k̂, and whether a chain stood in for importance draws."""


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
    found = _least_tail(ranks, n)
    return np.asarray((np.searchsorted(null, found, side="right") + 1.0) / (NULL_DRAWS + 1.0))


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


def run_repetitions(
    campaign: RankCampaign, repetitions: int, folder: Path, jobs: int
) -> Iterator[tuple[int, int]]:
    """Run the repetitions that are not yet in ``folder``; yields (done, total) as files finish."""
    store = CheckpointStore(folder, campaign.identity())
    files = range(-(-repetitions // campaign.per_file))
    missing = [index for index in files if store.load(_file(index)) is None]
    done = len(files) - len(missing)
    yield min(done * campaign.per_file, repetitions), repetitions
    with ProcessPoolExecutor(max_workers=jobs) as pool:
        pending = {pool.submit(_one_file, campaign, index): index for index in missing}
        for future in as_completed(pending):
            try:
                block = future.result()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)  # else all others would run first
                raise
            store.save(_file(pending[future]), block)
            done += 1
            yield min(done * campaign.per_file, repetitions), repetitions


def _file(index: int) -> str:
    return f"ranks_{index:05d}"


def _one_file(campaign: RankCampaign, index: int) -> dict[str, NDArray[np.generic]]:
    first = index * campaign.per_file
    with threadpool_limits(1):  # the work is spread over processes; more threads would compete
        results = [campaign.repetition(i) for i in range(first, first + campaign.per_file)]
    return {
        "ranks": np.stack([result[0] for result in results]),
        "pareto_k": np.array([result[1] for result in results]),
        "by_chain": np.array([result[2] for result in results]),
    }


def read_ranks(campaign: RankCampaign, repetitions: int, folder: Path) -> Ranks:
    """Collect the finished repetitions of a campaign.

    Raises
    ------
    CassiniBayesError
        Some are missing.
    """
    store = CheckpointStore(folder, campaign.identity())
    blocks = []
    for index in range(-(-repetitions // campaign.per_file)):
        block = store.load(_file(index))
        if block is None:
            raise CassiniBayesError(f"{folder}: {_file(index)} is missing: run the campaign again")
        blocks.append(block)
    return Ranks(
        names=campaign.names(),
        ranks=np.concatenate([np.asarray(b["ranks"], dtype=np.float64) for b in blocks]),
        pareto_k=np.concatenate([np.asarray(b["pareto_k"], dtype=np.float64) for b in blocks]),
        by_chain=np.concatenate([np.asarray(b["by_chain"], dtype=np.bool_) for b in blocks]),
    )
