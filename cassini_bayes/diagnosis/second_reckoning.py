"""A second reckoning of what is ahead of the baseline, with a column for all that counters hide.

What counters leave open is noise of bands in the likelihood, a draw of its own in every contrast.
It comes from few levels and steps where rows are long without firing, so that a cause that changes
pulses, or a torque that wanders, may win by them alone (docs/topics/telemetry-likelihood.md §11).
In the linear model of rows and turns every rounding and every tail has a column, as it has in the
p-value. With y what the baseline leaves at the nuisances of a cause's mode, d what the cause adds
there at its size, and V of the baseline's nuisances, it gains

    ½ yᵀ V⁻¹ y − ½ (y − d)ᵀ V⁻¹ (y − d) − ½ |z|²  =  dᵀ V⁻¹ y − ½ dᵀ V⁻¹ d − ½ |z|²

over the baseline, z the standard values of its size. V is the baseline's and not the cause's: with
a leak there, a centre of mass moves the torque of the leak, and would explain it in a baseline that
has none. Torque noise of density a has columns for its
cosines of two minutes and more, of variance a², and gains the log of ∫ p(a) exp Δ(a) da
(:func:`cassini_bayes.balance.linearised.change_of_evidence`), p the prior of ``unknown``. It is
taken beside the baseline's mode and beside that of ``unknown``, and the larger one counts: a
baseline that bent may have taken up what is there. Where the likelihood says more than that, the
lesser counts.

What the same model says of a steady torque, or of a leak, beyond its evidence is no lever of
thrusters (:func:`named_in_columns`).

``unknown`` is reckoned again with any counters. Of causes it is those of pulses where counters have
coarse steps: what inertia, wheels and gyro add is made of the channels, whose noise is smoothed in
the linear model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.balance.linearised import mean_change_of_evidence
from cassini_bayes.balance.physics import Physics
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import NONE, UNKNOWN, H, Weighed
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.innovations import (
    effect_momentum,
    innovations,
    left_by,
)
from cassini_bayes.diagnosis.modes import LOG_2_PI
from cassini_bayes.diagnosis.rows_and_turns import BesideMode, side_by_side, torque_noise
from cassini_bayes.effects.effect import Remainder, settled_for
from cassini_bayes.priors.distributions import Distribution

LEAKS: Final = np.linspace(-6.0, 6.0, 1_201)  # standard values of a size that is never nothing
NODES: Final = np.linspace(-4.0, 4.0, 97)  # standard normals, of the prior of torque noise


def has_coarse_counters(hypothesis: Hypothesis) -> bool:
    """Whether some event has counters in coarse steps, and any width of pulses."""
    return any(term.balance.statistics.counters.are_coarse for term in hypothesis.model.telemetry)


def acts_on_pulses(none: Hypothesis, cause: Hypothesis, point: Array) -> bool:
    """Whether a cause leaves body, wheels and gyro as they are at a point (d,) of its model.

    One that a search has settled has columns of its own, and is no such cause.
    """
    return not settled_for(cause.effects) and all(
        np.allclose(own.momentum_per_rate, other.momentum_per_rate)
        and np.allclose(own.wheel_weights, other.wheel_weights)
        and np.allclose(own.rate_bias_rad_s, other.rate_bias_rad_s)
        for own, other in _without_and_with(none, cause, point)
    )


def _without_and_with(
    none: Hypothesis, cause: Hypothesis, point: Array
) -> Iterator[tuple[Physics, Physics]]:
    """Physics of every telemetry event, of the baseline and of a cause at a point of its model."""
    before = none.model.points(point[None, : none.dimension])
    after = cause.model.points(point[None])
    for own, other in zip(none.model.telemetry, cause.model.telemetry, strict=True):
        yield own.physics(before), other.physics(after)


def gain_by_levels(none: Hypothesis, cause: Weighed[Hypothesis]) -> float:
    """Log density (nats) that a cause gains over the baseline in the linear model at its mode."""
    nuisances, sizes = np.split(cause.mode.point, [none.dimension])
    beside = BesideMode.of(none, nuisances, innovations(none, nuisances))
    told = beside.information(effect_momentum(none, nuisances, [(cause.hypothesis, sizes[None])]))
    return float(told.vector[0] - 0.5 * told.matrix[0, 0] - 0.5 * sizes @ sizes)


def acts_between_pulses(none: Hypothesis, cause: Hypothesis, point: Array) -> bool:
    """Whether a cause leaves pulses, body, wheels and gyro as they are: a torque that is steady."""
    return acts_on_pulses(none, cause, point) and all(
        _thrusters_columns(own) == _thrusters_columns(other)
        and all(map(np.allclose, _of_pulses(own), _of_pulses(other)))
        for own, other in _without_and_with(none, cause, point)
    )


def _of_pulses(physics: Physics) -> tuple[Array | float, ...]:
    """All by which pulses give momentum."""
    factors = (physics.thrust_factor, physics.impulse_offset_s, physics.close_share)
    return (physics.arms_m, *physics.tau_s, *factors)


def _thrusters_columns(physics: Physics) -> set[str]:
    """Columns of effects that act through a thrust, ``what@thruster``."""
    return {name for name in physics.extra if "@" in name}


def gains_of_columns(none: Weighed[Hypothesis], causes: Sequence[Hypothesis]) -> dict[str, float]:
    """Log evidence (nats) that steady torques gain in the linear model about the baseline's mode.

    Their momentum is linear in their sizes, which have their priors. Of sizes that are nothing in
    the middle, as those of a torque, it is ½ hᵀ (M + 1)⁻¹ h − ½ log |1 + M|. Of one that never is,
    as a leak's, with the ratio ρ(z) to that in the middle, it is the log of the mean over z of
    exp(ρ h − ½ ρ² M).

    Parameters
    ----------
    none
        The baseline with its mode.
    causes
        Of :func:`acts_between_pulses`, by whose names the result is.
    """
    base, point = none.hypothesis, none.mode.point
    ratios = [_ratios(cause) for cause in causes]
    values = [
        np.eye(cause.dimension - base.dimension) if ratio is None else np.zeros((1, 1))
        for cause, ratio in zip(causes, ratios, strict=True)
    ]
    added = effect_momentum(base, point, list(zip(causes, values, strict=True)))
    told = BesideMode.of(base, point, left_by(none)).information(added)
    gains, ends = {}, np.cumsum([0, *map(len, values)])
    for cause, ratio, begin, end in zip(causes, ratios, ends[:-1], ends[1:], strict=True):
        matrix, vector = told.matrix[begin:end, begin:end], told.vector[begin:end]
        if ratio is None:
            gains[cause.name] = mean_change_of_evidence(matrix, vector, np.ones(1), np.zeros(1))
        else:
            each = ratio * vector[0] - 0.5 * ratio**2 * matrix[0, 0] - 0.5 * LEAKS**2
            gains[cause.name] = float(logsumexp(each) - logsumexp(-0.5 * LEAKS**2))
    return gains


def _ratios(cause: Hypothesis) -> Array | None:
    """Sizes at :data:`LEAKS` over that in the middle; None of several, or of nothing there."""
    sizes = [own.distribution for effect in cause.effects for own in effect.parameters]
    middle = sizes[0].quantile_of_standard(np.zeros(1))
    if len(sizes) > 1 or not middle.all():
        return None
    return np.asarray(sizes[0].quantile_of_standard(LEAKS) / middle)


def named_in_columns(weighed: Sequence[Weighed[Hypothesis]]) -> float:
    """By how much (nats) the linear model says more of a steady torque than its evidence does.

    Where counters have coarse steps the likelihood may not tell one that is, in the linear model, a
    lever of thrusters, too. 0 at least, and with totals rows beside telemetry.
    """
    none = next(w for w in weighed if w.name == NONE)
    coarse = has_coarse_counters(none.hypothesis) and not none.hypothesis.model.totals
    causes = [
        w
        for w in weighed
        if coarse
        and w.is_cause
        and acts_between_pulses(none.hypothesis, w.hypothesis, w.mode.point)
    ]
    if not causes:
        return 0.0
    gains = gains_of_columns(none, [w.hypothesis for w in causes])
    told = (w.net_evidence - none.net_evidence for w in causes)
    more = (gains[w.name] - max(nats, 0.0) for w, nats in zip(causes, told, strict=True))
    return max(0.0, *more)


def gain_by_wander(
    hypothesis: Hypothesis, point: Array, left: Remainder, believed: Distribution
) -> float:
    """Log evidence (nats) that torque noise gains beside the baseline, linear about a point (d,).

    ``left`` is what the baseline leaves there, ``believed`` the prior of the density of torque
    noise, N m s^½.
    """
    walks = []
    for term in hypothesis.model.telemetry:
        columns, variance = torque_noise(term.balance, term.event.usable_rows, 1.0)
        walks.append(columns * np.sqrt(variance))
    told = BesideMode.of(hypothesis, point, left).information(side_by_side(walks))
    densities = believed.quantile_of_standard(NODES)
    return mean_change_of_evidence(told.matrix, told.vector, densities, -0.5 * NODES**2)


def unknown_again(
    unknown: Weighed[Hypothesis], none: Weighed[Hypothesis], believed: Distribution
) -> Weighed[Hypothesis]:
    """``unknown``, a torque that wanders, with the lesser of both gains over ``none``."""
    return with_lesser_gain(unknown, none, gain_of_unknown(unknown, none, believed))


def gain_of_unknown(
    unknown: Weighed[Hypothesis], none: Weighed[Hypothesis], believed: Distribution
) -> float:
    """Log evidence (nats) that ``unknown`` gains over ``none`` by columns.

    Infinite with totals rows beside telemetry, or without telemetry: what it says of these has no
    linear model, and its evidence stays as it is.
    """
    model, baseline = none.hypothesis.model, none.hypothesis
    if model.totals or not model.telemetry:
        return float("inf")
    beside = baseline.part_of(unknown.hypothesis, unknown.mode.point)
    about = [(none.mode.point, left_by(none)), (beside, innovations(baseline, beside))]
    return max(gain_by_wander(baseline, at, left, believed) for at, left in about)


def with_lesser_gain(unknown: Weighed[H], none: Weighed[H], gained: float) -> Weighed[H]:
    """``unknown`` with the lesser of its gain over ``none`` and of ``gained`` by columns, nats.

    Where draws have replaced Laplace's evidence of either, what is withheld is another.
    """
    by_bands = unknown.own_evidence - none.net_evidence
    return replace(unknown, withheld=max(by_bands - gained, 0.0))


def leads(weighed: Sequence[Weighed[Hypothesis]]) -> str:
    """Name of the most probable hypothesis."""
    return max(weighed, key=lambda own: own.score).name


def reckoned_again(
    weighed: Sequence[Weighed[Hypothesis]], believed: Distribution, *, unknown_too: bool = True
) -> list[Weighed[Hypothesis]]:
    """Everything weighed; what is ahead of ``none`` has the lesser of both gains.

    Causes from the most probable on, until one of them that was looked at stays ahead, or has no
    second reckoning; then ``unknown``, if it leads and was not looked at before (``unknown_too``).
    With totals rows beside telemetry all stay as they are.
    """
    result = list(weighed)
    none = next(w for w in result if w.name == NONE)
    known: set[str] = set()
    while has_coarse_counters(none.hypothesis) and not none.hypothesis.model.totals:
        best = max((w for w in result if w.is_cause), key=lambda own: own.score, default=none)
        hypothesis, point = best.hypothesis, best.mode.point
        if best.score <= none.score or best.name in known:
            break
        if not acts_on_pulses(none.hypothesis, hypothesis, point):
            break
        known.add(best.name)
        extra = len(point) - none.hypothesis.dimension
        by_bands = best.mode.value - none.mode.value + 0.5 * extra * LOG_2_PI
        withheld = by_bands - gain_by_levels(none.hypothesis, best)
        changed = replace(best, withheld=max(withheld, best.withheld))
        result = [changed if own is best else own for own in result]
    if unknown_too and leads(result) == UNKNOWN:
        result = [unknown_again(w, none, believed) if w.name == UNKNOWN else w for w in result]
    return result
