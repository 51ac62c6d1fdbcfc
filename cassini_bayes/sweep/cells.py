"""One cell of a sweep: the stored draws weighted, and the model fitted anew where that fails.

With θ the walked parameters, L the collapsed likelihood and p the prior, a draw of the baseline has
weight

    w ∝ [L'(θ) p'(θ)] / [L(θ) p(θ)],

where L' differs from L only if the changed parameters are among those integrated out (or an event
is left out). Weighting the collapsed density rather than drawn-back thrusts keeps the weights of a
few dimensions, not of a hundred.

Draws say nothing of values that the old prior excludes, and k̂ cannot notice it: a uniform made
wider gives equal weights. Where a new prior allows such values, no draw has a weight.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from cassini_bayes.computing.arrays import Array
from cassini_bayes.files.as_arrays import arrays_of
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.quantiles import standard_normal_log_density
from cassini_bayes.priors.reader import Priors
from cassini_bayes.sampling.ensembles import SamplerSettings, sample
from cassini_bayes.sampling.warmstart import warm_start
from cassini_bayes.sweep.models import ModelFactory, SweepModel, values_of
from cassini_bayes.sweep.variations import Variation
from cassini_bayes.sweep.weights import (
    Change,
    Weights,
    batch_labels,
    change_between,
    change_on_same_draws,
    equal_weights,
    moments,
    smoothed_weights,
)

Refit = Literal["auto", "always", "never"]

REFIT_DRAWS: Final = 4_000
CHAIN_ESS: Final = 1_000
REWEIGHTED: Final = "reweighted"
REFITTED: Final = "re-fitted"
BY_CHAIN: Final = "re-fitted (chain)"
_BY_ROUNDING: Final = 1e-9  # probability beyond old bounds that the rounding of bounds may leave


@dataclass(frozen=True)
class Baseline:
    """The fit that a sweep starts from: its draws, and how to build its model anew.

    ``parameters`` are draws (n,) of the walked parameters and of the common thrust, ``values``
    (n, q) those of the quantities asked for, ``log_likelihood`` (n,) the collapsed one; ``batches``
    (n,) groups draws of one chain.
    """

    factory: ModelFactory
    parameters: Mapping[str, Array]
    names: tuple[str, ...]
    values: Array
    log_likelihood: Array
    batches: NDArray[np.int64]
    seed: int

    def stream(self, name: str) -> np.random.Generator:
        """A random stream of a cell's own, the same on every machine and in every order."""
        return np.random.default_rng(np.random.SeedSequence((self.seed, zlib.crc32(name.encode()))))


@dataclass(frozen=True)
class Estimate:
    """What one way of answering a cell gives: quality of its weights, moments, changes (q,)."""

    kind: str
    pareto_k: float
    effective: float
    mean: Array
    sd: Array
    quantiles: Array
    shift: Array
    shift_error: Array
    width: Array
    width_error: Array


def cell_arrays(
    baseline: Baseline, variation: Variation, refit: Refit
) -> dict[str, NDArray[np.generic]]:
    """Work out a cell: arrays to be stored.

    Keys ``<way>.<what>`` with way 0 (weighted draws) and, where fitted anew, 1; what is a field of
    :class:`Estimate`.

    Raises
    ------
    InputError
        The changed priors are so extreme that the model cannot be computed.
    """
    priors = variation.applied(baseline.factory.priors)
    with variation.named_in_errors():
        model = baseline.factory.build(priors, variation.event)
        weights, values = reweighted(baseline, variation, model)
        change = change_on_same_draws(baseline.values, values, weights.values, baseline.batches)
        result = _arrays("0", REWEIGHTED, weights, values, change)
        if refit == "always" or (refit == "auto" and not weights.trusted):
            rng = baseline.stream(variation.name)
            kind, weights, values, batches = refitted(model, baseline.names, rng)
            change = change_between(
                baseline.values, baseline.batches, values, weights.values, batches
            )
            result |= _arrays("1", kind, weights, values, change)
        return result


def _arrays(
    way: str, kind: str, weights: Weights, values: Array, change: Change
) -> dict[str, NDArray[np.generic]]:
    numbers = vars(moments(values, weights.values)) | vars(change)
    return arrays_of(Estimate(kind, weights.pareto_k, weights.effective, **numbers), way)


def reweighted(
    baseline: Baseline, variation: Variation, model: SweepModel
) -> tuple[Weights, Array]:
    """Weights (n,) of the baseline's draws under a varied model, and the quantities there (n, q).

    Where what is integrated out changes, its draws are made anew at the same parameter points.
    """
    factory, draws = baseline.factory, baseline.parameters
    walked = factory.build(factory.priors).space.names
    before, after = factory.priors, variation.applied(factory.priors)
    kept = [name for name in variation.parameters if name in model.space.names]
    hidden = variation.kind == "without" or len(kept) < len(variation.parameters)
    surfaced = any(name not in walked for name in kept)
    log_ratio = log_prior_ratio(before, after, kept, draws, len(baseline.values))
    if not hidden:
        return smoothed_weights(log_ratio), baseline.values
    if surfaced:  # walked here, integrated out there: the two densities cannot be compared
        return smoothed_weights(np.full(len(log_ratio), -np.inf)), baseline.values
    z = model.space.to_standard({name: draws[name] for name in model.space.names})
    inside = np.asarray(np.isfinite(z).all(-1), dtype=np.bool_)
    z = np.where(inside[:, None], z, 0.0)
    log_ratio = log_ratio + model.log_likelihood(z) - baseline.log_likelihood
    rng = baseline.stream(f"{variation.name}: drawn back")
    values = values_of(model.quantities(z, rng), baseline.names)
    return smoothed_weights(np.where(inside, log_ratio, -np.inf)), values


def log_prior_ratio(
    before: Priors, after: Priors, names: Iterable[str], draws: Mapping[str, Array], n: int
) -> Array:
    """log p'(θ) − log p(θ) of draws (n,) of named parameters whose priors were changed.

    −inf throughout if a new prior allows values that the old one excludes: no draw can be there.
    """
    log_ratio = np.zeros(n)
    for name in names:
        old, new = before.parameters[name].distribution, after.parameters[name].distribution
        if old is not None and new is not None:
            if probability_outside(new, old.support) > _BY_ROUNDING:
                return np.full(n, -np.inf)
            log_ratio = log_ratio + new.log_density(draws[name]) - old.log_density(draws[name])
    return log_ratio


def probability_outside(distribution: Distribution, ends: tuple[float, float]) -> float:
    """Probability of values beyond either end of an interval, which may be infinite."""
    below, above = distribution.standard_of(ends)
    return float(ndtr(below) + ndtr(-above))


def refitted(
    model: SweepModel, names: tuple[str, ...], rng: np.random.Generator
) -> tuple[str, Weights, Array, NDArray[np.int64] | None]:
    """Importance draws from a proposal of the varied model's own; a chain where they fail.

    Returns the kind, weights (m,), quantities (m, q) and batches (None: independent draws).
    """

    def log_density(z: Array) -> Array:
        return np.asarray(model.log_likelihood(z) + standard_normal_log_density(z).sum(-1))

    warm = warm_start(
        log_density, model.space.dimension, rng, starts=model.starts, draws=REFIT_DRAWS
    )
    weights = smoothed_weights(warm.draws.log_weights)
    if weights.trusted:
        return REFITTED, weights, values_of(model.quantities(warm.draws.z, rng), names), None
    settings = SamplerSettings(target_ess=CHAIN_ESS, seed=int(rng.integers(2**31)))
    chains = sample(log_density, warm.proposal, settings)
    z, _ = chains.thinned(REFIT_DRAWS // settings.ensembles)
    m, n, d = z.shape
    values = values_of(model.quantities(z.reshape(-1, d), rng), names)
    return BY_CHAIN, equal_weights(m * n), values, batch_labels(m, n)
