"""What causes and a torque gain where every rounding of a counter has a column of its own.

What coarse counters leave open is noise of bands in the likelihood, a draw of its own in every
contrast. It comes from few levels where rows are long without firing, so that a cause that changes
pulses, or a torque that wanders, may win by them alone (docs/topics/telemetry-likelihood.md §11).
In the linear model of rows and turns every rounding has a column. With r what a cause leaves at its
mode, d what it adds there at its size, and V of all nuisances and roundings, it gains

    ½ (r + d)ᵀ V⁻¹ (r + d) − ½ rᵀ V⁻¹ r − ½ |z|²  =  dᵀ V⁻¹ r + ½ dᵀ V⁻¹ d − ½ |z|²

over the baseline, z the standard values of its size. Torque noise of density a has a column for
each of its cosines, of variance a², and gains the log of ∫ p(a) exp Δ(a) da beside the baseline's
mode (:func:`cassini_bayes.balance.linearised.change_of_evidence`), p the prior of ``unknown``.
Where the likelihood says more than that, the lesser counts. Causes of inertia, wheels and gyro are
left out: what they add is made of the channels, whose noise is smoothed in the linear model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.balance.linearised import change_of_evidence, diagonal
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import NONE, Weighed
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.innovations import effect_momentum, examined, left_by
from cassini_bayes.diagnosis.modes import LOG_2_PI
from cassini_bayes.diagnosis.rows_and_turns import BesideMode, side_by_side, torque_noise
from cassini_bayes.priors.distributions import Distribution

NODES: Final = np.linspace(-4.0, 4.0, 33)  # standard normals, of the prior of torque noise


def has_coarse_counters(hypothesis: Hypothesis) -> bool:
    """Whether some event has counters in coarse steps, and any width of pulses."""
    return any(term.balance.statistics.counters.are_coarse for term in hypothesis.model.telemetry)


def acts_on_pulses(none: Hypothesis, cause: Hypothesis, point: Array) -> bool:
    """Whether a cause leaves body, wheels and gyro as they are at a point (d,) of its model.

    One that a search has settled has columns of its own, and is no such cause.
    """
    if any(effect.search_result is not None for effect in cause.effects):
        return False
    before = none.model.points(point[None, : none.dimension])
    after = cause.model.points(point[None])
    return all(
        np.allclose(own.momentum_per_rate, other.momentum_per_rate)
        and np.allclose(own.wheel_weights, other.wheel_weights)
        and np.allclose(own.rate_bias_rad_s, other.rate_bias_rad_s)
        for own, other in (
            (a.physics(before), b.physics(after))
            for a, b in zip(none.model.telemetry, cause.model.telemetry, strict=True)
        )
    )


def gain_by_levels(none: Hypothesis, cause: Weighed[Hypothesis]) -> float:
    """Log density (nats) that a cause gains over the baseline in the linear model at its mode."""
    hypothesis, point = cause.hypothesis, cause.mode.point
    d = none.dimension
    beside = BesideMode.of(hypothesis, point, left_by(cause), walked=d)
    told = beside.information(effect_momentum(none, point[:d], [(hypothesis, point[None, d:])]))
    gained = told.vector[0] + 0.5 * told.matrix[0, 0]
    return float(gained - 0.5 * point[d:] @ point[d:])


def gain_by_wander(none: Weighed[Hypothesis], believed: Distribution) -> float:
    """Log evidence (nats) that torque noise gains in the linear model at the baseline's mode.

    ``believed`` is the prior of its density, N m s^½.
    """
    hypothesis, point = none.hypothesis, none.mode.point
    walks = []
    for term in hypothesis.model.telemetry:
        columns, variance = torque_noise(term.balance, term.event.usable_rows, 1.0)
        walks.append(columns * np.sqrt(variance))
    told = BesideMode.of(hypothesis, point, left_by(none)).information(side_by_side(walks))
    changes = change_of_evidence(
        *diagonal(told.matrix, told.vector), believed.quantile_of_standard(NODES)
    )
    weights = -0.5 * NODES**2
    return float(logsumexp(changes + weights) - logsumexp(weights))


def with_wander_by_levels(
    unknown: Weighed[Hypothesis], none: Weighed[Hypothesis], believed: Distribution
) -> Weighed[Hypothesis]:
    """``unknown``, a torque that wanders; ahead of ``none`` it has the lesser of both gains.

    With totals rows beside telemetry it stays as it is: what it says of these has no linear model.
    """
    by_bands = unknown.net_evidence - none.net_evidence
    model = none.hypothesis.model
    if by_bands <= 0.0 or model.totals or not has_coarse_counters(none.hypothesis):
        return unknown
    return replace(unknown, withheld=max(by_bands - gain_by_wander(none, believed), 0.0))


def with_levels(weighed: Sequence[Weighed[Hypothesis]]) -> list[Weighed[Hypothesis]]:
    """Everything weighed; causes of pulses ahead of ``none`` have the lesser of both gains.

    From the most probable on, until one of them that was looked at stays ahead.
    """
    result = list(weighed)
    none = next(w for w in result if w.name == NONE)
    if not has_coarse_counters(none.hypothesis):
        return result
    seen: set[str] = set()
    while True:
        best = max((w for w in result if w.is_cause), key=lambda w: w.score, default=none)
        if best.score <= none.score or best.name in seen:
            return result
        seen.add(best.name)
        hypothesis, point = best.hypothesis, best.mode.point
        if not acts_on_pulses(none.hypothesis, hypothesis, point):
            return result
        extra = len(point) - none.hypothesis.dimension
        by_bands = best.mode.value - none.mode.value + 0.5 * extra * LOG_2_PI
        looked_at = examined(best)
        withheld = max(by_bands - gain_by_levels(none.hypothesis, looked_at), 0.0)
        changed = replace(looked_at, withheld=withheld)
        result = [changed if w is best else w for w in result]
