"""A calibrated p-value of the baseline: is anything left in its innovations?

Two statistics see two kinds of misfit: slow drifts (:func:`slow_statistic`) and oscillations
(:func:`line_statistic`). Replicates of the target are drawn from the linear model and refitted in
the same way, a parametric bootstrap, what records leave open among what is drawn and refitted
(:mod:`cassini_bayes.diagnosis.unresolved`). The two are combined by the smaller of their ranks
among data and replicates, which is ranked again among the same, so that neither has to be
independent of the other: uniform where the model is true.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.stats import rankdata

from cassini_bayes.balance.linearised import Linear, fitted_away
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.spectrum import LEAST_CYCLES, line_powers

MODES: Final = 16
"""Slowest cosines of an event: judgement, drifts down to a sixteenth of it; more would hide them
among noise."""
LEAST_SPAN_S: Final = 1e-9  # of an event of a single row: any above 0 gives it phase 0
REPLICATES: Final = 400  # 200 gave 0.005 where 600 gave 0.03 on a flight with nothing hidden


def slow_statistic(linear: Linear, left: Array, times: Sequence[Array]) -> Array:
    """Σ over events, axes and the slowest cosines of squared normalised projections, (r,)."""
    total = np.zeros(left.shape[1])
    place = 0
    for n, time in zip(linear.rows, times, strict=True):
        residual = left[place : place + 3 * n].reshape(n, 3, -1)
        place += 3 * n
        phase = np.pi * (time - time[0]) / max(time[-1] - time[0], LEAST_SPAN_S)
        modes = np.cos(phase[:, None] * np.arange(1, MODES + 1))
        norms = (modes**2).sum(0)
        power = np.einsum("nm,nar->mar", modes, residual) ** 2 / norms[:, None, None]
        total += power.sum((0, 1))
    return total


def line_statistic(linear: Linear, left: Array, times: Sequence[Array]) -> Array:
    """Largest power of any line |Σ r exp(−2πi f t)|²/n over events, axes and frequencies, (r,).

    Frequencies go from four cycles in the event to half the sampling rate
    (:func:`.spectrum.line_powers`).
    """
    largest = np.zeros(left.shape[1])
    place = 0
    for n, time in zip(linear.rows, times, strict=True):
        residual = left[place : place + 3 * n].reshape(n, -1)
        place += 3 * n
        _, power = line_powers(time, residual)
        if len(power) < LEAST_CYCLES:
            continue
        peaks = power[LEAST_CYCLES - 1 :].max(0).reshape(3, left.shape[1])
        largest = np.maximum(largest, peaks.max(0))
    return largest


def p_value(
    linear: Linear,
    target: Array,
    times: Sequence[Array],
    rng: np.random.Generator,
    replicates: int = REPLICATES,
) -> float:
    """Probability, if the model is true, of slow innovations or lines as large as these.

    Parameters
    ----------
    linear, target
        The whitened linear model, and what it is fitted to (m,), about the prior mean as
        replicates are.
    times
        Times of the rows of every event, s.
    rng
        For the replicates.
    replicates
        How many: the smallest value there is, is 1/(replicates + 1).
    """
    m, p = linear.columns.shape
    # the initial momentum's wide prior is only numerical: it is fitted away in replicates too
    sd = 1.0 / np.sqrt(linear.precision)
    draws = linear.columns @ (sd[:, None] * rng.standard_normal((p, replicates)))
    draws += rng.standard_normal((m, replicates))
    left = fitted_away(linear, np.concatenate([target[:, None], draws], axis=1))
    ranks = [
        rankdata(-statistic(linear, left, times), method="max")
        for statistic in (slow_statistic, line_statistic)
    ]
    # the other rank decides between equals
    order = np.minimum(*ranks) + np.maximum(*ranks) / (2.0 * (replicates + 1.0))
    return float((order <= order[0]).mean())
