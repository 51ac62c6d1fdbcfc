"""What wider and narrower priors do to a fit, from its own draws, for a page to show at once.

A prior block is made ¼ … 4 times as wide and the stored draws are weighted by p'(θ) / p(θ), as a
cell of a sweep does. Nothing is drawn back or fitted anew: what is integrated out takes part where
the fit keeps draws of it (the common thrust, one number), and where the weights cannot be trusted
the answer is that the draws do not reach.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.priors.reader import Priors
from cassini_bayes.sweep.cells import log_prior_ratio
from cassini_bayes.sweep.variations import Group
from cassini_bayes.sweep.weights import (
    QUANTILES,
    Weights,
    equal_weights,
    moments,
    smoothed_weights,
)

WIDTHS: Final = tuple(2.0 ** (step / 2.0) for step in range(-4, 5))
"""¼ … 4 in steps of √2."""
ERRORS: Final = 3.0  # Monte Carlo errors that a change has to exceed
LOW: Final = int(np.argmin(np.abs(QUANTILES - 0.05)))
HIGH: Final = int(np.argmin(np.abs(QUANTILES - 0.95)))


@dataclass(frozen=True)
class WidthEffect:
    """Quantities under one prior block at each of :data:`WIDTHS`: weights (W,), moments (W, q).

    ``low`` and ``high`` are the ends of the central 90 % interval; NaN where k̂ is infinite.
    """

    group: Group
    pareto_k: Array
    effective: Array
    trusted: NDArray[np.bool_]
    mean: Array
    sd: Array
    low: Array
    high: Array

    @property
    def size(self) -> float:
        """The largest change of a mean or a width that can be told, in the fit's own sd."""
        as_fitted = WIDTHS.index(1.0)
        fitted_sd = self.sd[as_fitted]
        shift, width = (
            np.abs(v - v[as_fitted])[self.trusted] / fitted_sd for v in (self.mean, self.sd)
        )
        return float(max(shift.max(initial=0.0), width.max(initial=0.0)))


def width_effects(
    priors: Priors,
    groups: Sequence[Group],
    draws: Mapping[str, Array],
    values: Array,
    least: float = 0.0,
) -> tuple[WidthEffect, ...]:
    """Weight draws of the groups' parameters (n,) and of quantities (n, q), group by group.

    Groups whose prior, made :data:`WIDTHS` [0] times as wide, moves nothing by ``least`` of its
    standard deviation, or by no more than the Monte Carlo error could, are left out.
    """
    even = equal_weights(len(values)).values
    mean, sd, order = values.mean(0), values.std(0), np.argsort(values, axis=0)
    result = []
    for group in groups:
        narrow = _weights(priors, group, draws, len(values), WIDTHS[0])
        weights = narrow.values if _in_support(narrow) else even
        shift = np.abs(weights @ values - mean) / sd
        width = np.abs(np.sqrt(weights @ (values - weights @ values) ** 2) / sd - 1.0)
        chance = ERRORS / np.sqrt(narrow.effective) if _in_support(narrow) else 0.0
        if max(shift.max(), width.max()) >= max(least, chance) or not _in_support(narrow):
            result.append(_effect(priors, group, draws, values, order))
    return tuple(result)


def _effect(
    priors: Priors,
    group: Group,
    draws: Mapping[str, Array],
    values: Array,
    order: NDArray[np.int64],
) -> WidthEffect:
    n, even = len(values), equal_weights(len(values)).values
    result = [_weights(priors, group, draws, n, width) for width in WIDTHS]
    told = np.array([_in_support(weights) for weights in result])[:, None, None]
    figures = []
    for weights in result:
        own = moments(values, weights.values if _in_support(weights) else even, order)
        figures.append((own.mean, own.sd, own.quantiles[LOW], own.quantiles[HIGH]))
    mean, sd, low, high = np.moveaxis(np.where(told, np.array(figures), np.nan), 1, 0)
    return WidthEffect(
        group,
        pareto_k=np.array([weights.pareto_k for weights in result]),
        effective=np.array([weights.effective for weights in result]),
        trusted=np.array([weights.trusted for weights in result]),
        mean=mean,
        sd=sd,
        low=low,
        high=high,
    )


def _weights(
    priors: Priors, group: Group, draws: Mapping[str, Array], n: int, width: float
) -> Weights:
    changed = priors.scaled(group.parameters, width=width)
    return smoothed_weights(log_prior_ratio(priors, changed, group.parameters, draws, n))


def _in_support(weights: Weights) -> bool:
    """Whether draws are left inside the changed prior, and it allows nothing beyond the old one."""
    return bool(np.isfinite(weights.pareto_k))
