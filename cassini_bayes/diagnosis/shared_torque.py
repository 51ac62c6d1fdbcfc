"""A steady torque that all events share is named only beyond what the baseline's prior allows.

The model gives every event a torque of its own, T_e ~ N(t, s²) about each axis. Events at one
attitude share theirs, and one that is 2 s off in all of E events would then be as unlikely as E
such departures. So half of the baseline's probability is of torques with a common part, c ~ N(0,
s²), half of torques without, and the cause ``external_torque``, c ~ N(0, S²), has to explain more
than that. The data are linear in c. With their information Λ on it and b = Λ ĉ,

    Δ = log Z(s) − log Z(0) = ½ bᵀ (Λ + s⁻²)⁻¹ b − ½ log |1 + s² Λ|,

and log(½ + ½ e^Δ), where that is positive, is taken off the evidence of the cause. Λ and b follow
from the cause's mode and curvature, in which N(0, S²) is included.

That is done where the torque leads and the baseline would then lead. The other hypotheses have no
common part, either: of a leak, or of ``unknown``, that may stand for the torque it is not known how
much they would lose, so what is ahead of them stays there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.linearised import mean_change_of_evidence
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import NONE, Weighed
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.second_reckoning import leads

KIND: Final = "external_torque"


def gain_of_width(mean: Array, covariance: Array, width: Array) -> float:
    """log Z(s) − log Z(0) of departures c (k,) that are normal beforehand, s = ``width`` (k,).

    ``mean`` (k,) and ``covariance`` (k, k) are those of c where it is N(0, 1) beforehand, all in
    units of that.
    """
    precision = np.linalg.inv(covariance)
    told, vector = precision - np.eye(len(mean)), precision @ mean
    in_widths = width[:, None] * told * width
    return mean_change_of_evidence(in_widths, width * vector, np.ones(1), np.zeros(1))


def torque_again(weighed: Sequence[Weighed[Hypothesis]]) -> list[Weighed[Hypothesis]]:
    """Everything weighed; a leading torque of all events has lost what is within the prior.

    If something else than the baseline would then lead, all stays as it is.
    """
    first = max(weighed, key=lambda own: own.score)
    if not _is_shared_torque(first):
        return list(weighed)
    again = [_withheld(own) if own is first else own for own in weighed]
    return again if leads(again) == NONE else list(weighed)


def _is_shared_torque(weighed: Weighed[Hypothesis]) -> bool:
    """Whether it is a steady torque alone that acts in all of several events."""
    effects, begins = weighed.hypothesis.effects, weighed.begins
    return (
        len(effects) == 1
        and effects[0].kind.name == KIND
        and len(weighed.hypothesis.model.event_ids) > 1
        and (begins is None or not begins.event)
    )


def _withheld(weighed: Weighed[Hypothesis]) -> Weighed[Hypothesis]:
    sizes = weighed.hypothesis.sizes
    (effect,) = weighed.hypothesis.effects
    scales = np.array([parameter.distribution.scale for parameter in effect.parameters])
    covariance = weighed.mode.factor @ weighed.mode.factor.T
    gain = gain_of_width(
        weighed.mode.point[sizes],
        covariance[sizes, sizes],
        weighed.hypothesis.model.torque_sd_n_m / scales,
    )
    explained = float(np.logaddexp(0.0, gain) - np.log(2.0))
    return replace(weighed, withheld=max(weighed.withheld, explained))
