"""How a verdict on the momentum balance depends on the widths of the effects' priors.

Another width w changes a cause's evidence by the posterior mean of a ratio of priors,
Z_w / Z = E[p_w(x) / p(x)], which its importance draws give for nothing. Where the draws do not
reach what the other prior likes (Pareto k̂ of the changed weights, above that of the draws' own) the
mode of a cause of some probability is found anew. For a page that shows many widths at once nothing
is found anew: there k̂ says where the draws do not reach (:func:`by_width`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import Ranking, Size, Weighed, over_beginnings
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import Hypothesis, compact, extend, none_hypothesis
from cassini_bayes.diagnosis.modes import mode_near
from cassini_bayes.diagnosis.sizes import mixed, size_draws, summarised
from cassini_bayes.diagnosis.verdict import normalised
from cassini_bayes.sampling.warmstart import TRUSTED_K, pareto_k
from cassini_bayes.sweep.widths import WIDTHS

WORTH_A_SEARCH: Final = 0.01
"""Probability of a cause below which another width cannot make it first (judgement): a search takes
a second."""


def change_of_evidence(
    events: Events, weighed: Weighed[Hypothesis], probability: float, width: float
) -> float:
    """Change (nats) of a cause's log evidence with priors wider by a factor.

    Zero for causes whose evidence was not sampled, far behind the best. A cause
    that may begin with several events changes by the mean over them.
    """
    return over_beginnings(
        weighed, lambda own, share: _change(events, own, share * probability, width)
    )


def _change(
    events: Events, weighed: Weighed[Hypothesis], probability: float, width: float
) -> float:
    if weighed.z is None or not weighed.hypothesis.effects:
        return 0.0
    log_weights = reweighted(weighed, width)
    is_minor = probability < WORTH_A_SEARCH
    if is_minor or pareto_k(log_weights) < max(TRUSTED_K, weighed.pareto_k):
        return float(logsumexp(log_weights))
    effects = [effect.scaled(width) for effect in weighed.hypothesis.effects]
    with_columns = events.with_columns_of(effects)
    hypothesis = compact(extend(none_hypothesis(with_columns), effects))
    point = weighed.hypothesis.model.space.to_parameters(weighed.mode.point[None])
    start = hypothesis.model.space.to_standard(point)[0]
    other = mode_near(hypothesis.log_density, start, weighed.mode.factor)
    return other.log_evidence - weighed.mode.log_evidence


def reweighted(weighed: Weighed[Hypothesis], width: float) -> Array:
    """Log weights (n,) of a cause's own draws with priors wider by a factor.

    The log of their sum is the change of the log evidence.
    """
    assert weighed.z is not None
    assert weighed.log_weights is not None
    parameters = weighed.hypothesis.model.space.to_parameters(weighed.z)
    weights = np.array(weighed.log_weights)
    for effect in weighed.hypothesis.effects:
        for old, wider in zip(effect.parameters, effect.scaled(width).parameters, strict=True):
            value = parameters[old.name]
            with np.errstate(divide="ignore"):
                weights += wider.distribution.log_density(value)
                weights -= old.distribution.log_density(value)
    return weights


def by_width(verdict: Ranking[Hypothesis], rng: np.random.Generator) -> list[dict[str, Any]]:
    """The verdict at each of :data:`WIDTHS`, by weighting the draws that there are.

    Returns
    -------
    A record per width: ``probabilities`` by name, ``cause``, the most probable as diagnosed, with
    its ``sizes``, and ``pareto_k``, the worst of the causes that have some probability before or
    after. ``trusted`` is false where that is above 0.7, or where the cause has no draws.
    """
    cause = next((w for w in verdict.weighed if w.is_cause), None)
    draws = None if cause is None else _draws_of_sizes(cause, rng)
    result = []
    for width in WIDTHS:
        scores, reach = {}, {}
        for weighed, score in zip(verdict.weighed, verdict.log_probabilities, strict=True):
            scores[weighed.name], reach[weighed.name] = _score_at(weighed, float(score), width)
        after, before = normalised(scores), verdict.probabilities
        told = [name for name in after if max(after[name], before[name]) >= WORTH_A_SEARCH]
        worst = max(reach[name] for name in told)
        sizes = {} if cause is None or draws is None else _sizes_at(cause, draws, width)
        is_trusted = worst <= TRUSTED_K and (draws is not None or cause is None)
        result.append(
            {
                "width": width,
                "pareto_k": worst if np.isfinite(worst) else None,
                "trusted": bool(is_trusted),
                "probabilities": after,
                "cause": None if cause is None else cause.name,
                "sizes": {
                    key: {"mean": size.mean, "sd": size.sd, "hdi_90": list(size.interval)}
                    for key, size in sizes.items()
                },
            }
        )
    return result


def _score_at(weighed: Weighed[Hypothesis], score: float, width: float) -> tuple[float, float]:
    """Log of evidence times prior at another width, and the Pareto k̂ of the weights behind it."""
    reach = [-np.inf]

    def change(own: Weighed[Hypothesis], share: float) -> float:
        if own.z is None or not own.hypothesis.effects:
            return 0.0
        log_weights = reweighted(own, width)
        if share >= WORTH_A_SEARCH:
            reach.append(own.pareto_k if width == 1.0 else pareto_k(log_weights))
        return float(logsumexp(log_weights))

    return score + over_beginnings(weighed, change), float(max(reach))


def _draws_of_sizes(
    cause: Weighed[Hypothesis], rng: np.random.Generator
) -> dict[int, dict[str, Array]] | None:
    """Draws of a cause's sizes, the same for all widths, by the ``id`` of each beginning's fit.

    None where it has no importance draws that could be weighted.
    """
    each = [way for _, _, way in cause.searched] or [cause]
    if any(way.z is None or way.pareto_k >= TRUSTED_K for way in each):
        return None
    return {id(way): size_draws(way, rng)[0] for way in each}


def _sizes_at(
    cause: Weighed[Hypothesis], draws: Mapping[int, dict[str, Array]], width: float
) -> dict[str, Size]:
    """Sizes of a cause at another width, by its draws."""

    def drawn(own: Weighed[Hypothesis]) -> tuple[dict[str, Array], Array]:
        log_weights = reweighted(own, width)  # none may be left beside 1, far out in a prior
        return draws[id(own)], np.exp(log_weights - logsumexp(log_weights))

    return summarised(*mixed(drawn, cause))
