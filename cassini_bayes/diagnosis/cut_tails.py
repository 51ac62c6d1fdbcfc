"""Single cut tails, as columns of the innovations' linear model.

Counters do not say which pulses were a control cycle apart. For pairs within one counter interval
the likelihood has the mean loss and one unknown per couple of thrusters and quarter of the event
(docs/telemetry-likelihood.md §7). Two things it lacks, because a Gram matrix has few columns:

- which pairs of a quarter lost their tails;
- pairs with a counter reading in between, a quarter of all cut tails at 1 Hz. They are 4 % of the
  pairs of pulses in neighbouring intervals.

Each leaves a step in the momentum, up to fifteen standard deviations by all rows after it. Rows can
have a column for every one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics import Samples
from cassini_bayes.balance.statistics.columns import CUT_PARTS
from cassini_bayes.balance.telemetry_terms import cut_probability, lost_per_cut_s
from cassini_bayes.diagnosis.extended import Case, Hypothesis

Array = NDArray[np.float64]
ACROSS_S: Final = 0.035
"""Chance times counter interval: 0.036, 0.024 and 0.030 s in 23 simulated biases read every 1, 4
and 10 s."""


@dataclass(frozen=True)
class Losses:
    """Cut tails that one couple of thrusters may have had.

    ``profile`` (n, s): tails lost by every row per unit of each unknown, whose mean is 0 and
    variance ``variance`` (s,); ``mean`` (n,): tails lost on average that the likelihood lacks.
    """

    profile: Array
    variance: Array
    mean: Array


def chance_across(counter_interval_s: float) -> float:
    """Chance that pulses of two neighbouring counter intervals are a control cycle apart."""
    return min(0.5, ACROSS_S / counter_interval_s) if counter_interval_s > 0 else 0.0


def losses(
    samples: Samples,
    members: tuple[int, ...],
    time_s: Array,
    duration_s: float,
    counter_interval_s: float,
) -> Losses:
    """Possible cut tails of thrusters that only fire together, by the rows at ``time_s`` (n,)."""
    counted = samples.has_counters
    ends = samples.time_s[counted][1:]
    pulses = np.diff(samples.pulses[counted][:, list(members)], axis=0).max(axis=1, initial=0)
    within = _within(ends, np.maximum(pulses - 1.0, 0.0), time_s, duration_s)
    chance = cut_probability(counter_interval_s)
    later = ends[1:][(pulses[:-1] > 0) & (pulses[1:] > 0)]
    across = (time_s[:, None] >= later).astype(np.float64)
    rare = chance_across(counter_interval_s)
    variance = np.concatenate(
        [
            np.full(within.shape[1], chance * (1.0 - chance)),
            np.full(across.shape[1], rare * (1.0 - rare)),
        ]
    )
    return Losses(np.concatenate([within, across], axis=1), variance, rare * across.sum(1))


def _within(ends: Array, pairs: Array, time_s: Array, duration_s: float) -> Array:
    """Steps (n, s) of pairs within an interval, less the mean step of their quarter.

    With s_i = 0 or 1 for pair i of N and step H_i, Σ s_i H_i = (Σ s_i/N) Σ H_j + Σ s_i (H_i − H̄):
    the likelihood has the first part. √n for n pairs in one interval.
    """
    part = np.minimum((CUT_PARTS * ends / duration_s).astype(int), CUT_PARTS - 1)
    found = [np.zeros((len(time_s), 0))]
    for quarter in range(CUT_PARTS):
        own = np.flatnonzero((part == quarter) & (pairs > 0))
        if len(own) < 2:
            continue
        step = (time_s[:, None] >= ends[own]).astype(np.float64)
        mean = step @ pairs[own] / pairs[own].sum()
        found.append((step - mean[:, None]) * np.sqrt(pairs[own]))
    return np.concatenate(found, axis=1)


def single_cuts(
    case: Case, hypothesis: Hypothesis, z: Array, place: int, time_s: Array
) -> tuple[Array, Array, Array]:
    """What single cut tails change in the momentum of an event's rows, by the model at z (d,).

    A cut tail takes F q (τ_f − τ_r) exp(−0.125 s/τ_f), q summed over thrusters that fire together.

    Parameters
    ----------
    place
        Number of the event in the case.
    time_s
        (n,) times of its rows.

    Returns
    -------
    Columns (n, 3, s) in N m s, the variances (s,) of their unknowns, whose means are 0, and the
    mean (n, 3) that the likelihood lacks.
    """
    model, term = hypothesis.model, hypothesis.model.telemetry[place]
    statistics = term.event.statistics
    layout = statistics.layout
    mean = np.zeros((len(time_s), 3))
    columns, variances = [np.zeros((len(time_s), 3, 0))], [np.zeros(0)]
    physics = term.physics(model.points(z[None]))
    interval, duration = statistics.counter_interval_s, term.event.sampling.duration_s
    samples = case.sources[place].samples
    for members in layout.couples if layout.thrusters else ():
        found = losses(samples, members, time_s, duration, interval)
        arms = np.broadcast_to(physics.arms_m, (1, 3, len(layout.thrusters)))[0]
        lost = float(lost_per_cut_s(physics)[0]) * arms[:, list(members)].sum(1)
        taken = -model.thrust_prior.common_mean_n * lost
        columns.append(found.profile[:, None] * taken[:, None])
        variances.append(found.variance)
        mean += found.mean[:, None] * taken
    return np.concatenate(columns, axis=2), np.concatenate(variances), mean
