"""Attitude against integrated rates: information of the quaternions on the gyros.

Over an interval the attitude turns by φ and the measured rates integrate to φ' ; with measured
rates (1 + s) ω + b, φ' − φ = b Δt + s φ + noise per body axis. The noise is the attitude's white
noise at both ends and a random walk (rate noise, steps of the rate between samples). Sums over
blocks have covariance σ² K + q B, K tridiagonal (2, −1), which the sine transform makes diagonal;
σ² and q are estimated from the same sums by maximum likelihood, q not below what the noise of the
measured rates adds up to: an estimate of zero would take the lowest sines for exact. What is left
of the channel is its information on b and s: log L(b, s) − log L(0, 0) = ηᵀx − ½ xᵀΛx.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.fft import dst
from scipy.optimize import minimize

from cassini_bayes.balance.statistics import Samples
from cassini_bayes.balance.statistics.turns import turns_between
from cassini_bayes.computing.arrays import Array
from cassini_bayes.spacecraft.attitude import direction_cosines
from cassini_bayes.studies.real_attitude import high_difference_noise

BLOCKS: Final = 200
"""Of an event, summed over: judgement, both noises are told apart, and sine transforms are
short."""
_LEAST_BLOCKS: Final = 8  # for two noises and two unknowns

RATE_KINDS: Final = ("rate_bias", "rate_scale")
"""Kinds of errors of the gyros, in the order of the information."""


@dataclass(frozen=True)
class RateInformation:
    """Precision (3, 2, 2) and linear term (3, 2) of rate bias [rad/s] and scale [1] per axis."""

    precision: Array
    linear: Array

    def __add__(self, other: RateInformation) -> RateInformation:
        """Two events together."""
        return RateInformation(self.precision + other.precision, self.linear + other.linear)


NOTHING = RateInformation(np.zeros((3, 2, 2)), np.zeros((3, 2)))


def rate_information(samples: Samples) -> RateInformation:
    """Information of one event's attitudes and rates on rate bias and scale."""
    state = np.flatnonzero(samples.has_state)
    turned = turns_between(direction_cosines(samples.attitude[state]))
    steps = np.diff(samples.time_s[state])
    rates = samples.rate_rad_s[state]
    integrated = 0.5 * (rates[1:] + rates[:-1]) * steps[:, None]
    size = max(1, len(steps) // BLOCKS)
    count = len(steps) // size
    if count < _LEAST_BLOCKS:
        return NOTHING

    def blocks(values: Array) -> Array:
        summed = values[: count * size].reshape(count, size, -1).sum(1)
        return np.asarray(dst(summed, type=1, axis=0, norm="ortho"))

    missed, time, angle = blocks(integrated - turned), blocks(steps[:, None]), blocks(turned)
    kept = 2.0 - 2.0 * np.cos(np.pi * np.arange(1, count + 1) / (count + 1))
    precision, linear = np.zeros((3, 2, 2)), np.zeros((3, 2))
    walked = size * float((steps**2).mean()) * high_difference_noise(rates, 2) ** 2
    for axis in range(3):
        columns = np.stack([time[:, 0], angle[:, axis]], axis=1)
        weight = 1.0 / _block_variance(missed[:, axis], columns, kept, float(walked[axis]))
        precision[axis] = columns.T @ (weight[:, None] * columns)
        linear[axis] = columns.T @ (weight * missed[:, axis])
    return RateInformation(precision, linear)


def _block_variance(missed: Array, columns: Array, kept: Array, walked: float) -> Array:
    """Variance (m,) of every sine coefficient: σ² kept + q, both by restricted likelihood.

    ``walked`` is the least q (rad²).
    """
    scale = float(np.var(missed)) + 1e-30
    unit = columns / (np.linalg.norm(columns, axis=0) + 1e-30)

    def cost(logs: Array) -> float:
        variance = scale * (np.exp(logs[0]) * kept + np.exp(logs[1])) + walked
        weighted = unit / variance[:, None]
        gram = unit.T @ weighted + 1e-12 * np.eye(2) / scale
        fitted = np.linalg.solve(gram, weighted.T @ missed)
        left = missed - unit @ fitted
        return float(
            0.5 * np.log(variance).sum()
            + 0.5 * (left**2 / variance).sum()
            + 0.5 * np.linalg.slogdet(gram * scale)[1]
        )

    result = minimize(cost, np.array([-1.0, -3.0]), method="Nelder-Mead")
    return np.asarray(scale * (np.exp(result.x[0]) * kept + np.exp(result.x[1])) + walked)


def combined(parts: Sequence[RateInformation]) -> RateInformation:
    """All events together."""
    return sum(parts, NOTHING)
