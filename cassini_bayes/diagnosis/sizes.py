"""Sizes of causes: posterior draws of an effect's parameters, and their intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from cassini_bayes.balance.linearised import with_unknowns
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import H, Size, Weighed
from cassini_bayes.diagnosis.cut_tails import single_cuts
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.innovations import linearise
from cassini_bayes.diagnosis.unresolved import timed
from cassini_bayes.effects.effect import Effect
from cassini_bayes.model.posterior import TORQUES, Model
from cassini_bayes.sampling.warmstart import TRUSTED_K

SizeDraws = Callable[[Weighed[H]], tuple[dict[str, Array], Array]]
SUMMARY_DRAWS: Final = 2_000
"""Of a Laplace approximation: the ends of a 90 % interval scatter by 0.05 standard deviations."""


def size_draws(
    weighed: Weighed[Hypothesis], rng: np.random.Generator
) -> tuple[dict[str, Array], Array]:
    """Draws (n,) of every size of a cause by key, and their weights (n,).

    What counters leave open is in them (:func:`with_unresolved`), how finely the data tell a size
    (``known_to`` of its kind), and what a term's form leaves out (``form_error`` of its table).
    """
    hypothesis = weighed.hypothesis
    z, weights = effect_draws(weighed, rng)
    z = with_unresolved(hypothesis, weighed.mode.point, z, rng)
    values = effect_values(hypothesis, z)
    model = hypothesis.model
    for effect in hypothesis.effects:
        if effect.kind.drawn is not None:
            setting = effect.setting(model.spacecraft, model.branch)
            values |= effect.kind.drawn(setting, rng, len(z))
        for key, step in effect.kind.known_to.items():
            known_to = 2.0 * model.spacecraft.control_cycle_s if step is None else step
            values[key] = values[key] + known_to * rng.uniform(-0.5, 0.5, len(z))
    for effect in hypothesis.effects:
        for key, share in effect.form_error:
            values[key] = values[key] * (1.0 + share * rng.standard_normal(len(z)))
    return values, weights


def mixed(drawn: SizeDraws[H], weighed: Weighed[H]) -> tuple[dict[str, Array], Array]:
    """Draws of sizes over the events that a cause may begin with, each with its probability."""
    each = [(share, drawn(way)) for _, share, way in weighed.searched]
    if not each:
        return drawn(weighed)
    keys = each[0][1][0]
    return (
        {key: np.concatenate([values[key] for _, (values, _) in each]) for key in keys},
        np.concatenate([share * weights / weights.sum() for share, (_, weights) in each]),
    )


def effect_draws(
    weighed: Weighed[Any], rng: np.random.Generator, draws: int = SUMMARY_DRAWS
) -> tuple[Array, Array]:
    """Posterior draws (n, d) in z and their weights (n,): importance or Laplace draws.

    Importance draws of a Pareto k̂ above 0.7 are a few that outweigh all others: an interval of
    theirs would be far too narrow.
    """
    if weighed.z is not None and weighed.log_weights is not None and weighed.pareto_k < TRUSTED_K:
        return weighed.z, np.exp(weighed.log_weights)
    mode = weighed.mode
    white = rng.standard_normal((draws, len(mode.point)))
    return mode.point + white @ mode.factor.T, np.full(draws, 1.0 / draws)


def effect_values(hypothesis: Hypothesis, z: Array) -> dict[str, Array]:
    """Sizes (n,) of a hypothesis's effects at z: departures added to the baseline's parameter."""
    sizes = (sizes_of(hypothesis.model, effect, z) for effect in hypothesis.effects)
    return {key: values for size in sizes for key, values in size.items()}


def sizes_of(model: Model, effect: Effect, z: Array) -> dict[str, Array]:
    """Sizes (n,) of one effect of a model by key, at walked coordinates z (n, d)."""
    parameters = model.space.to_parameters(z)
    baseline = {**dict(zip(TORQUES, model.torque_mean_n_m, strict=True)), **parameters}
    values = effect.values(parameters)
    for parameter in effect.parameters:
        if parameter.is_departure and parameter.key in baseline:
            values[parameter.key] = values[parameter.key] + baseline[parameter.key]
    if effect.kind.report is None:
        return values
    return dict(effect.kind.report(values, effect.setting(model.spacecraft, model.branch)))


def summarised(values: Mapping[str, Array], weights: Array) -> dict[str, Size]:
    """Mean, standard deviation and shortest 90 % interval of weighted draws (n,) by key."""
    total = weights.sum()
    sizes = {}
    for key, draws in values.items():
        mean = float(weights @ draws / total)
        sd = float(np.sqrt(weights @ (draws - mean) ** 2 / total))
        sizes[key] = Size(mean, sd, weighted_interval(draws, weights))
    return sizes


def weighted_interval(
    values: Array, weights: Array, probability: float = 0.9
) -> tuple[float, float]:
    """Shortest interval with at least this probability of values (n,) with weights (n,)."""
    order = np.argsort(values)
    ordered, cumulative = values[order], np.cumsum(weights[order])
    starts = np.concatenate([[0.0], cumulative[:-1]])
    ends = np.searchsorted(cumulative, starts + probability * cumulative[-1] - 1e-12)
    valid = ends < len(ordered)
    widths = ordered[ends[valid]] - ordered[valid]
    first = int(np.argmin(widths))
    return float(ordered[valid][first]), float(ordered[ends[valid]][first])


def with_unresolved(
    hypothesis: Hypothesis, mode: Array, z: Array, rng: np.random.Generator
) -> Array:
    """Posterior draws z (n, d) about a mode (d,), moved and widened by when pulses were fired.

    With X the linear model's columns, U those of what is open (:mod:`unresolved`), r what the
    model leaves at its mode, G and G' the Gram matrices of X and of (X, U) with their priors'
    precision, draws move by Δ and are widened by N(0, Σ' − Σ), where

        (Δ, u) = G'⁻¹ (0, Uᵀ r),  Σ = (G⁻¹)_zz,  Σ' = (G'⁻¹)_zz,

    U those of :func:`cassini_bayes.diagnosis.unresolved.timed`. Cases with totals rows, whose
    information the linear model does not have, stay as they are.
    """
    model = hypothesis.model
    opened = [timed(hypothesis, mode, i) for i in range(len(model.telemetry))]
    if model.totals or not any(len(variance) for _, variance in opened):
        return z
    linear, factors = linearise(hypothesis, mode)
    cuts = [single_cuts(hypothesis, mode, i) for i in range(len(model.telemetry))]
    linear = with_unknowns(linear, cuts, factors)
    wide = with_unknowns(linear, opened, factors)
    d, size = len(mode), linear.columns.shape[1]
    gram = linear.gram()
    pull = np.zeros(size)
    pull[:d] = mode  # of the prior, whose centre is not the mode
    fitted = np.linalg.solve(gram, linear.columns.T @ linear.target - pull)
    slope = wide.columns.T @ (linear.target - linear.columns @ fitted)
    slope[:size] = 0.0
    wider = wide.gram()
    move = np.linalg.solve(wider, slope)[:d]
    added = np.linalg.inv(wider)[:d, :d] - np.linalg.inv(gram)[:d, :d]
    values, vectors = np.linalg.eigh(0.5 * (added + added.T))
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(z + move + rng.standard_normal(z.shape) @ spread.T)
