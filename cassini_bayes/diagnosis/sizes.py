"""Sizes of causes: posterior draws of an effect's parameters, and their intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from cassini_bayes.balance.linearised import Linear, whitened
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.diagnosis.case import H, Size, Weighed
from cassini_bayes.diagnosis.cut_tails import single_cuts
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.innovations import linearise
from cassini_bayes.diagnosis.unresolved import timed
from cassini_bayes.effects.effect import Effect
from cassini_bayes.model.posterior import Model
from cassini_bayes.sampling.warmstart import TRUSTED_K
from cassini_bayes.spacecraft.parameters import TORQUES

SizeDraws = Callable[[Weighed[H]], tuple[dict[str, Array], Array]]
SUMMARY_DRAWS: Final = 2_000
"""Of a Laplace approximation: the ends of a 90 % interval scatter by 0.05 standard deviations."""


def size_draws(
    weighed: Weighed[Hypothesis], rng: np.random.Generator
) -> tuple[dict[str, Array], Array]:
    """Draws (n,) of every size of a cause by key, and their weights (n,).

    What counters leave open is in them (:func:`with_unresolved`), how finely the data tell a size
    (``known_to`` of its kind), and what a term's form leaves out (``form_error`` of its table, and
    ``late_form_error`` where rows have late pulses).
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
    has_late_rows = any(term.balance.late is not None for term in model.telemetry)
    for effect in hypothesis.effects:
        for key, share in effect.form_error + (effect.late_form_error if has_late_rows else ()):
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
        if parameter.is_departure and parameter.baseline in baseline:
            values[parameter.key] = values[parameter.key] + baseline[parameter.baseline]
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

    With X the linear model's columns and C the covariance of whitened rows with tails that are cut,
    β what is fitted, r = C⁻¹ (y − X β), U the columns of :func:`.unresolved.timed` with variances
    v, and everything that is open summed over,

        G = Xᵀ C⁻¹ X + P,  T = Uᵀ C⁻¹ U + 1/v,  B = Xᵀ C⁻¹ U,  G' = G − B T⁻¹ Bᵀ,

    draws move by Δ = −(G'⁻¹ B T⁻¹ Uᵀ r)_z and are widened by N(0, (G'⁻¹ − G⁻¹)_zz). What is open
    belongs to one event each, so that every T is of one event. Cases with totals rows, whose
    information the linear model does not have, stay as they are.
    """
    model = hypothesis.model
    opened = [timed(hypothesis, mode, i) for i in range(len(model.telemetry))]
    if model.totals or not any(len(variance) for _, variance in opened):
        return z
    linear, factors = linearise(hypothesis, mode)
    cuts = [single_cuts(hypothesis, mode, i) for i in range(len(model.telemetry))]
    d, size = len(mode), len(linear.precision)
    events = [
        _with_cuts(linear, i, whitened(columns, factor), variance)
        for i, ((columns, variance), factor) in enumerate(zip(cuts, factors, strict=True))
    ]
    gram, pull = np.diag(linear.precision), np.zeros(size)
    pull[:d] = -mode  # of the prior, whose centre is not the mode
    for event in events:
        gram[np.ix_(event.kept, event.kept)] += event.columns.T @ event.over(event.columns)
        pull[event.kept] += event.columns.T @ event.over(event.target)
    fitted = np.linalg.solve(gram, pull)
    wider, pulled = gram.copy(), np.zeros(size)
    for event, (columns, variance), factor in zip(events, opened, factors, strict=True):
        own = whitened(columns, factor)
        left = event.over(event.target - event.columns @ fitted[event.kept])
        across = event.columns.T @ event.over(own)
        inner = own.T @ event.over(own) + np.diag(1.0 / variance)
        taken = np.linalg.solve(inner, np.column_stack([across.T, own.T @ left]))
        wider[np.ix_(event.kept, event.kept)] -= across @ taken[:, :-1]
        pulled[event.kept] -= across @ taken[:, -1]
    move = np.linalg.solve(wider, pulled)[:d]
    added = np.linalg.inv(wider)[:d, :d] - np.linalg.inv(gram)[:d, :d]
    values, vectors = np.linalg.eigh(0.5 * (added + added.T))
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(z + move + rng.standard_normal(z.shape) @ spread.T)


class _WithCuts(NamedTuple):
    """One event's whitened rows: target (m,), the columns (m, k) that it has, ``kept`` of all.

    ``cuts`` (m, s) are U, ``inner`` (s, s) Uᵀ U + 1/v of tails that are cut.
    """

    target: Array
    columns: Array
    kept: Places
    cuts: Array
    inner: Array

    def over(self, values: Array) -> Array:
        """C⁻¹ times values (m, …), C = 1 + U v Uᵀ."""
        taken = np.linalg.solve(self.inner, self.cuts.T @ values)
        return np.asarray(values - self.cuts @ taken)


def _with_cuts(linear: Linear, place: int, cuts: Array, variance: Array) -> _WithCuts:
    own = linear.columns.parts[place]
    inner = cuts.T @ cuts + np.diag(1.0 / variance)
    return _WithCuts(linear.target[linear.parts[place]], own.values, own.places, cuts, inner)
