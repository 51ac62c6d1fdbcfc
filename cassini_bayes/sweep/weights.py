"""Weighted draws: Pareto-smoothed weights, moments, and their Monte Carlo errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import logsumexp

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.arviz_import import arviz
from cassini_bayes.sampling.warmstart import ALL_ALIKE, TRUSTED_K

FEWEST_DRAWS: Final = 400.0
"""Effective, below which an answer is not trusted: a mean is then good to a twentieth of its
standard deviation (400^-½)."""
BATCHES: Final = 10  # of consecutive draws, in every chain
QUANTILES: Final = (np.arange(199) + 1.0) / 200.0
_FEWEST_IN_SUPPORT: Final = 50  # draws: fewer leave no tail of ten to fit k̂ to (judgement)


@dataclass(frozen=True)
class Weights:
    """Normalised weights (n,) with the tail index and the effective number of draws they leave."""

    values: Array
    pareto_k: float
    effective: float

    @property
    def trusted(self) -> bool:
        """Whether estimates from these weights, and their errors, can be relied upon."""
        return self.pareto_k <= TRUSTED_K and self.effective >= FEWEST_DRAWS


@dataclass(frozen=True)
class Moments:
    """Weighted mean, standard deviation and quantiles of quantities: (q,), (q,), (199, q)."""

    mean: Array
    sd: Array
    quantiles: Array


@dataclass(frozen=True)
class Change:
    """What a changed prior does to quantities, in units of the baseline: (q,) each.

    ``shift`` is the mean's change over the baseline's standard deviation, ``width`` the ratio of
    standard deviations; the errors are one Monte Carlo standard error.
    """

    shift: Array
    shift_error: Array
    width: Array
    width_error: Array


def trusted_rows(table: pd.DataFrame) -> pd.Series:
    """Which rows of a sweep's table can be relied upon, by the rule of :attr:`Weights.trusted`."""
    return (table["pareto_k"] <= TRUSTED_K) & (table["effective_draws"] >= FEWEST_DRAWS)


def equal_weights(n: int) -> Weights:
    """Weights of n draws that need none."""
    return Weights(np.full(n, 1.0 / n), 0.0, float(n))


def smoothed_weights(log_ratio: Array) -> Weights:
    """Pareto-smoothed importance weights (Vehtari et al. 2024) of log density ratios (n,).

    −inf (a draw outside the new support) is a weight of zero. Draws all of one weight have k̂ = 0;
    with fewer than fifty draws inside the support k̂ is ∞ and the weights are NaN.
    """
    inside = np.isfinite(log_ratio)
    if inside.sum() < _FEWEST_IN_SUPPORT:
        return Weights(np.full(len(log_ratio), np.nan), np.inf, 0.0)
    kept = log_ratio[inside]
    if np.ptp(kept) < ALL_ALIKE:
        smoothed, k = np.zeros(len(kept)), 0.0
    else:
        # 1 / Σ exp(ΔL) of ArviZ's fit overflows where a trial of it is far from the best: 1/inf is
        # its weight, zero
        with np.errstate(over="ignore"):
            smoothed, shape = arviz().psislw(kept - kept.max())
        k = float(shape)
    values = np.zeros(len(log_ratio))
    values[inside] = np.exp(smoothed - logsumexp(smoothed))
    return Weights(values, k, float(1.0 / (values**2).sum()))


def moments(values: Array, weights: Array, order: NDArray[np.int64] | None = None) -> Moments:
    """Weighted moments of values (n, q) with normalised weights (n,).

    ``order`` (n, q) sorts the values, where they are looked at under many weights.
    """
    mean = weights @ values
    sd = np.sqrt(weights @ (values - mean) ** 2)
    order = np.argsort(values, axis=0) if order is None else order
    cumulative = np.cumsum(weights[order], axis=0) - 0.5 * weights[order]
    quantiles = np.stack(
        [
            np.interp(QUANTILES, cumulative[:, j], values[order[:, j], j])
            for j in range(values.shape[1])
        ],
        axis=-1,
    )
    return Moments(mean, sd, quantiles)


def batch_labels(chains: int, draws: int) -> NDArray[np.int64]:
    """Batch of every draw (chains · draws,): consecutive draws of a chain, ten batches each."""
    within = np.arange(draws) * BATCHES // draws
    return (np.arange(chains)[:, None] * BATCHES + within).reshape(-1)


def influence(values: Array, weights: Array) -> tuple[Array, Array]:
    """Influence of every draw on the weighted mean and on the log of the sd, (n, q) each.

    Sums of them over draws are zero; their scatter is that of the estimates (delta method).
    """
    mean = weights @ values
    centred = values - mean
    variance = weights @ centred**2
    safe = np.where(variance > 0, variance, 1.0)
    on_mean = weights[:, None] * centred
    on_log_sd = 0.5 * weights[:, None] * (centred**2 / safe - 1.0)
    return on_mean, np.where(variance > 0, on_log_sd, 0.0)


def error_of(scores: Array, batches: NDArray[np.int64] | None) -> Array:
    """Standard error (q,) of a sum of influences (n, q).

    Draws of a chain are correlated: ``batches`` (n,) says which belong together, and their sums are
    taken as independent. None: the draws are independent.
    """
    if batches is None:
        return np.asarray(np.sqrt((scores**2).sum(0)))
    sums = np.zeros((int(batches.max()) + 1, scores.shape[1]))
    np.add.at(sums, batches, scores)
    count = len(sums)
    return np.asarray(np.sqrt((sums**2).sum(0) * count / (count - 1.0)))


def change_on_same_draws(
    base: Array, varied: Array, weights: Array, batches: NDArray[np.int64]
) -> Change:
    """Change between draws (n, q) and the same parameter points weighted, with its error.

    ``varied`` are the quantities at the same points under the changed model (the same numbers where
    only the weights differ), so most of the Monte Carlo error cancels.
    """
    return _change(base, varied, weights, lambda old, new: error_of(new - old, batches))


def change_between(
    base: Array,
    base_batches: NDArray[np.int64],
    varied: Array,
    weights: Array,
    batches: NDArray[np.int64] | None,
) -> Change:
    """Change between two independent sets of draws, (n, q) and weighted (m, q)."""

    def error(old: Array, new: Array) -> Array:
        return np.asarray(np.hypot(error_of(old, base_batches), error_of(new, batches)))

    return _change(base, varied, weights, error)


def _change(
    base: Array, varied: Array, weights: Array, error: Callable[[Array, Array], Array]
) -> Change:
    """Change of weighted draws from equal ones; ``error`` is of the influences of both."""
    even = equal_weights(len(base)).values
    before, after = moments(base, even), moments(varied, weights)
    both = zip(influence(base, even), influence(varied, weights), strict=True)
    mean_error, log_sd_error = (error(old, new) for old, new in both)
    scale = np.where(before.sd > 0, before.sd, np.nan)
    ratio = after.sd / scale
    return Change(
        shift=(after.mean - before.mean) / scale,
        shift_error=mean_error / scale,
        width=ratio,
        width_error=ratio * log_sd_error,
    )
