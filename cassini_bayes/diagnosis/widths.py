"""How a verdict on the momentum balance depends on the widths of the effects' priors.

Another width w changes a cause's evidence by the posterior mean of a ratio of priors,
Z_w / Z = E[p_w(x) / p(x)], which its importance draws give for nothing. Where the draws do not
reach what the other prior likes (Pareto k̂ of the changed weights, above that of the draws' own) the
mode of a cause of some probability is found anew.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import TRUSTED_K, Weighed, over_beginnings
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import Hypothesis, compact, extend, none_hypothesis
from cassini_bayes.diagnosis.modes import mode_near
from cassini_bayes.sampling.warmstart import pareto_k

WORTH_A_SEARCH: Final = 0.01
"""Probability of a cause below which another width cannot make it first (judgement): a search takes
a second."""


def change_of_evidence(
    events: Events, weighed: Weighed[Hypothesis], probability: float, width: float
) -> float:
    """Change (nats) of a cause's log evidence with priors wider by a factor.

    Zero for causes whose evidence was not sampled, further than ten nats from the best. A cause
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
