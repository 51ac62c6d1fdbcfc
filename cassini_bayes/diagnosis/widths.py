"""How a verdict depends on the widths of the effects' priors.

Another width w changes a cause's evidence by the posterior mean of a ratio of priors,
Z_w / Z = E[p_w(x) / p(x)], which its importance draws give for nothing. Where the draws do not
reach what the other prior likes (Pareto k̂ of the changed weights, above that of the draws' own) the
mode of a cause of some probability is found anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cassini_bayes.diagnosis.evidence import TRUSTED_K, Weighed
from cassini_bayes.diagnosis.extended import Hypothesis, compact, extend, none_hypothesis
from cassini_bayes.diagnosis.modes import settled
from cassini_bayes.diagnosis.naming import Verdict
from cassini_bayes.diagnosis.oscillation import case_of
from cassini_bayes.sampling.warmstart import pareto_k

Array = NDArray[np.float64]
WIDTHS: Final = (0.5, 2.0)
LEAST_PROBABILITY: Final = 1e-6
WORTH_A_SEARCH: Final = 0.01  # probability of a cause


def width_sensitivity(verdict: Verdict) -> dict[str, dict[str, float]]:
    """Probabilities of causes with every effect's prior half and twice as wide.

    Causes whose evidence was not sampled, further than ten nats from the best, keep it.
    """
    sampled = [w for w in verdict.weighed if w.hypothesis.effects and w.z is not None]
    none = none_hypothesis(verdict.case, verdict.catalogue)
    pairs = [(width, weighed) for width in WIDTHS for weighed in sampled]
    changed = {(width, own.name): _change(verdict, none, width, own) for width, own in pairs}
    return {
        f"{width:g}": _probabilities(
            verdict, {name: change for (own, name), change in changed.items() if own == width}
        )
        for width in WIDTHS
    }


def _probabilities(verdict: Verdict, changed: Mapping[str, float]) -> dict[str, float]:
    scores = {
        w.name: score + changed.get(w.name, 0.0)
        for w, score in zip(verdict.weighed, verdict.log_probabilities, strict=True)
    }
    total = logsumexp(list(scores.values()))
    shares = {name: float(np.exp(score - total)) for name, score in scores.items()}
    ordered = sorted(shares.items(), key=lambda pair: -pair[1])
    return {name: share for name, share in ordered if share > LEAST_PROBABILITY}


def _change(verdict: Verdict, none: Hypothesis, width: float, weighed: Weighed) -> float:
    """Change (nats) of a sampled cause's log evidence with priors wider by a factor."""
    log_weights = reweighted(weighed, width)
    is_minor = verdict.probabilities[weighed.name] < WORTH_A_SEARCH
    if is_minor or pareto_k(log_weights) < max(TRUSTED_K, weighed.pareto_k):
        return float(logsumexp(log_weights))
    case = case_of(verdict.case, weighed.hypothesis)
    full = none if case is verdict.case else none_hypothesis(case, verdict.catalogue)
    effects = [effect.scaled(width) for effect in weighed.hypothesis.effects]
    hypothesis = compact(extend(full, effects, case))
    point = weighed.hypothesis.model.space.to_parameters(weighed.mode.point[None])
    start = hypothesis.model.space.to_standard(point)[0]
    anew = settled(hypothesis.log_density, start, weighed.mode.factor)
    return anew.log_evidence - weighed.mode.log_evidence


def reweighted(weighed: Weighed, width: float) -> Array:
    """Log weights (n,) of a cause's own draws with priors wider by a factor.

    The log of their sum is the change of the log evidence.
    """
    assert weighed.z is not None
    assert weighed.log_weights is not None
    parameters = weighed.hypothesis.model.space.to_parameters(weighed.z)
    weights = np.array(weighed.log_weights)
    for effect in weighed.hypothesis.effects:
        for own, wider in zip(effect.parameters, effect.scaled(width).parameters, strict=True):
            value = parameters[own.name]
            with np.errstate(divide="ignore"):
                weights += wider.distribution.log_density(value)
                weights -= own.distribution.log_density(value)
    return weights
