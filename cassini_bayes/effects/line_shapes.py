"""Sizes of an oscillation over its dampings: posterior of one line, and of lines alike.

A line that dies fast and an appendage that answers little are much alike, so that a fit near one
damping says too little of both. About a baseline's mode a line's sizes s (cosine, sine, share of
the inertia; prior scales S) are linear: with the Gram matrix G of its columns and Aᵀy of what is
left, both with what the baseline takes away taken off,

    s ~ N(C S Aᵀy, C),  C = (S G S + 1)⁻¹,  log Z = bᵀ C b / 2 + log det C / 2,  b = S Aᵀy,

in units of S, and the share is not below zero (docs/topics/criticism.md §2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri

from cassini_bayes.computing.arrays import Array

Line = tuple[float, float, int]
"""Frequency (Hz), damping, and axis."""
NODES: Final = (3e-4, 1e-3, 2e-3, 4e-3, 7e-3, 1.2e-2, 2e-2, 4e-2)
NEAR_BEST: Final = (-2.0, -1.0, 0.0, 1.0, 2.0)  # standard deviations
"""Dampings that sizes are averaged over, and those about the best."""
UNDAMPED: Final = 0.2  # prior probability of none, as one of five that are looked at
DAMPED: Final = (1e-5, 5e-2)  # and of the others, uniform in their logarithm
LEAST_BEND: Final = 0.05  # nats: a frequency is known to four steps at least, or it is another line
FREQUENCY_STEP: Final = 0.3  # of a line's width, for its curvature by frequency: judgement
SPAN_STEP: Final = 0.05
"""Of what the span can tell apart, for the curvature by damping; as slopes of columns have it."""


class Posterior(NamedTuple):
    """Sizes of one line, or of many (...), in prior scales, and its evidence against none, nats.

    ``mean`` (..., 3) and ``covariance`` (..., 3, 3) are those before the share's bound at zero.
    """

    log_evidence: Array
    mean: Array
    covariance: Array


@dataclass(frozen=True)
class Shapes:
    """Posterior of a line over K dampings, each with the frequency that is best for it.

    ``mean`` (K, 3) and ``covariance`` (K, 3, 3) are those of cosine, sine (rad/s) and share of the
    inertia before the share's bound at zero, ``weight`` (K,) the probabilities.
    """

    weight: Array
    damping: Array
    frequency_hz: Array
    frequency_sd_hz: Array
    mean: Array
    covariance: Array


def posterior(gram: Array, projection: Array, size: Array) -> Posterior:
    """Posterior of columns with Gram (..., 3, 3) and Aᵀy (..., 3), prior scales (..., 3).

    The last size, a share of the inertia, is not below zero: the prior's half below it lies above.
    """
    precision = gram * size[..., :, None] * size[..., None, :] + np.eye(gram.shape[-1])
    covariance: Array = np.asarray(np.linalg.inv(precision))
    b = projection * size
    mean = (covariance @ b[..., None])[..., 0]
    above = np.log(2.0) + log_ndtr(mean[..., -1] / np.sqrt(covariance[..., -1, -1]))
    evidence = 0.5 * (b * mean).sum(-1) + 0.5 * np.linalg.slogdet(covariance)[1] + above
    return Posterior(np.asarray(evidence), mean, covariance)


def shapes_over_dampings(
    posterior_of: Callable[[Line], Posterior],
    line: Line,
    span_s: float,
    scales: Array,
) -> Shapes:
    """A line found at other dampings (:data:`NODES`), for each with its best frequency.

    ``span_s`` is that of the longest event, ``scales`` (3,) are the priors' of the sizes.
    """

    def score(other: Line) -> float:
        return float(posterior_of(other).log_evidence)

    frequency_hz, found, axis = line
    step = SPAN_STEP / (2.0 * np.pi * frequency_hz * span_s)
    middle = max(found, step)
    _, sd = _peak([score((frequency_hz, middle + d, axis)) for d in (-step, 0.0, step)], step)
    near = found + sd * np.array(NEAR_BEST)
    near = near[(near > DAMPED[0]) & (near < DAMPED[1])]
    dampings = np.concatenate([[0.0], np.unique(np.concatenate([NODES, near]))])
    low, high = _cells(dampings)
    damped = (1.0 - UNDAMPED) * np.log(high[1:] / low[1:]) / np.log(DAMPED[1] / DAMPED[0])
    prior = np.concatenate([[UNDAMPED], damped])
    rows = []
    for damping in dampings:
        step = FREQUENCY_STEP * float(np.hypot(1.0 / span_s, damping * frequency_hz))
        shifts = (frequency_hz - step, frequency_hz, frequency_hz + step)
        shift, sd = _peak([score((f, damping, axis)) for f in shifts], step)
        best = frequency_hz + shift
        rows.append((best, sd, *posterior_of((best, damping, axis))))
    frequency, frequency_sd, evidence, mean, covariance = (
        np.array(own) for own in zip(*rows, strict=True)
    )
    weight = prior * np.exp(evidence - evidence.max())
    return Shapes(
        weight / weight.sum(),
        dampings,
        frequency,
        frequency_sd,
        scales * mean,
        covariance * np.outer(scales, scales),
    )


def draw_shapes(
    shapes: Shapes, rng: np.random.Generator, draws: int
) -> tuple[Array, Array, Array, Array]:
    """Draws: cosine and sine (n, 2), rad/s; share, frequency (Hz) and damping, (n,) each."""
    place = rng.choice(len(shapes.weight), draws, p=shapes.weight)
    mean, covariance = shapes.mean[place], shapes.covariance[place]
    sd = np.sqrt(covariance[:, 2, 2])
    below = ndtr(-mean[:, 2] / sd)
    share = mean[:, 2] + sd * ndtri(below + (1.0 - below) * rng.uniform(size=draws))
    share = np.maximum(share, 0.0)
    along = (share - mean[:, 2]) / covariance[:, 2, 2]
    swing = mean[:, :2] + covariance[:, :2, 2] * along[:, None]
    rest = (
        shapes.covariance[:, :2, :2]
        - (shapes.covariance[:, :2, 2:] * shapes.covariance[:, 2:, :2])
        / shapes.covariance[:, 2:, 2:]
    )
    factors = np.linalg.cholesky(rest)[place]
    swing = swing + (factors @ rng.standard_normal((draws, 2, 1)))[..., 0]
    noise = rng.standard_normal(draws)
    frequency = shapes.frequency_hz[place] + shapes.frequency_sd_hz[place] * noise
    low, high = _cells(shapes.damping)
    return swing, share, frequency, rng.uniform(low[place], high[place])


def _peak(values: Sequence[float], step: float) -> tuple[float, float]:
    """Where a parabola through three log densities has its peak, from the middle, and its sd."""
    below, middle, above = values
    bend = max(2.0 * middle - below - above, LEAST_BEND)
    shift = step * float(np.clip(0.5 * (above - below) / bend, -2.0, 2.0))
    return shift, step / float(np.sqrt(bend))


def _cells(damping: Array) -> tuple[Array, Array]:
    """Bounds (K,) of what dampings stand for: none for itself, others half-way to the next."""
    middle = 0.5 * (damping[2:] + damping[1:-1])
    return np.concatenate([[0.0, DAMPED[0]], middle]), np.concatenate([[0.0], middle, DAMPED[1:]])
