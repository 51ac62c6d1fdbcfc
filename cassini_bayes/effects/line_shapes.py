"""Sizes of an oscillation over all lines that it may be: posterior of one, and of many.

A line that dies fast and an appendage that answers little are much alike, so that a fit near one
damping says too little of both. About a baseline's mode a line's sizes s (cosine, sine, share of
the inertia; prior scales S) are linear: with the Gram matrix G of its columns and Aᵀy of what is
left, both with what the baseline takes away taken off,

    s ~ N(C S Aᵀy, C),  C = (S G S + 1)⁻¹,  log Z = bᵀ C b / 2 + log det C / 2,  b = S Aᵀy,

in units of S, and the share is not below zero (docs/topics/criticism.md §2). Lines share the
probability by Z, the prior of their damping, and the frequencies that they stand for. There is a
cosine and a sine for every free oscillation: one in all events, or P of them
(:class:`.line_starts.LineStarts`); a line has 2 P + 1 sizes.

How large a swing is nobody knows to an order of magnitude: the scales S are one of several
(:func:`scales_of_sizes`), K of them, all alike a priori.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, ndtr, ndtri, softmax

from cassini_bayes.computing.arrays import Array, Places

Direction = tuple[float, float, float]
"""Unit vector in body axes."""
Line = tuple[float, float, Direction]
"""Frequency (Hz), damping, and what it swings about."""
SIZES: Final = (1.0, 0.3, 0.1, 0.03)
"""Of the priors' scales, as the order of magnitude is not known (judgement): down to swings that
only hours of rates ten times finer than Cassini's show. With one scale a swing that is a tenth of
it pays 5 nats more than one that is as large, a share 2; in every event where each starts anew."""
NODES: Final = (3e-4, 1e-3, 2e-3, 4e-3, 7e-3, 1.2e-2, 2e-2, 4e-2)
NEAR_BEST: Final = (-2.0, -1.0, 0.0, 1.0, 2.0)  # standard deviations
"""Dampings that sizes are averaged over, and those about the best; frequencies about theirs."""
UNDAMPED: Final = 0.2  # prior probability of none, as one of five that are looked at
DAMPED: Final = (1e-5, 5e-2)  # and of the others, uniform in their logarithm
LEAST_LOG_SHARE: Final = -14.0
"""Of a line's weight in that of the most probable one: ten thousand as small are a hundredth."""
LEAST_BEND: Final = 0.05  # nats: a frequency is known to four steps at least, or it is another line
FREQUENCY_STEP: Final = 0.3  # of a line's width, for its curvature by frequency: judgement
SPAN_STEP: Final = 0.05
"""Of what the span can tell apart, for the curvature by damping; as slopes of columns have it."""


def scales_of_sizes(scales: tuple[float, float], swings: int) -> Array:
    """Scales (K, 2 P + 1) that are believed in of P free oscillations and of the share.

    ``scales`` are the priors' of a cosine or sine and of the share.
    """
    each = [[swing] * 2 * swings + [share] for swing in SIZES for share in SIZES]
    return np.asarray(np.array(each) * ([scales[0]] * 2 * swings + [scales[1]]))


def even_mixture(log_evidence: ArrayLike) -> Array:
    """Log evidence (...) of alternatives that are alike a priori, by that (K, ...) of each."""
    each = np.asarray(log_evidence)
    mixture: Array = np.asarray(np.logaddexp.reduce(each, axis=0) - np.log(len(each)))
    return mixture


class Posterior(NamedTuple):
    """Sizes of one line, or of many (...), in prior scales, and its evidence against none, nats.

    ``mean`` (..., q) and ``covariance`` (..., q, q) of q = 2 P + 1 sizes are those before the
    share's bound at zero.
    """

    log_evidence: Array
    mean: Array
    covariance: Array

    @property
    def of_all_sizes(self) -> Array:
        """Log evidence (...) with all scales, of those (K, ...) by each."""
        return even_mixture(self.log_evidence)

    @staticmethod
    def stacked(each: Iterable[Posterior]) -> Posterior:
        """Those (K,) of several lines as one (K, C)."""
        return Posterior(*(np.stack(own, axis=1) for own in zip(*each, strict=True)))


@dataclass(frozen=True)
class Shapes:
    """Posterior over K lines, each of which stands for others of its damping and frequency.

    ``log_weight`` (K,) are logs of their probabilities but for a constant, ``damping`` (K, 2) the
    bounds of those that they stand for, uniform in the logarithm. ``mean`` (K, q) and
    ``covariance`` (K, q, q) are those of cosines, sines (rad/s) and share of the inertia before the
    share's bound at zero.
    """

    log_weight: Array
    damping: Array
    frequency_hz: Array
    frequency_sd_hz: Array
    mean: Array
    covariance: Array

    def less(self, nats: float) -> Shapes:
        """All lines so much less probable."""
        return replace(self, log_weight=self.log_weight - nats)

    @staticmethod
    def by_width(parts: Sequence[Shapes]) -> tuple[Shapes, ...]:
        """All lines of several, those of as many sizes joined."""
        widths = dict.fromkeys(part.mean.shape[1] for part in parts)
        each = ([part for part in parts if part.mean.shape[1] == width] for width in widths)
        return tuple(map(Shapes.joined, each))

    @staticmethod
    def joined(parts: Sequence[Shapes]) -> Shapes:
        """All lines of several, without those of a millionth of the most probable one."""
        own = [[getattr(part, field.name) for part in parts] for field in fields(Shapes)]
        log_weight, *others = (np.concatenate(values) for values in own)
        kept = log_weight > log_weight.max() + LEAST_LOG_SHARE
        return Shapes(log_weight[kept], *(values[kept] for values in others))


def posterior(gram: Array, projection: Array, size: Array) -> Posterior:
    """Posterior of columns with Gram (..., q, q) and Aᵀy (..., q), prior scales (..., q).

    The last size, a share of the inertia, is not below zero: the prior's half below it lies above.
    """
    precision = gram * size[..., :, None] * size[..., None, :] + np.eye(gram.shape[-1])
    covariance: Array = np.asarray(np.linalg.inv(precision))
    b = projection * size
    mean = (covariance @ b[..., None])[..., 0]
    above = np.log(2.0) + log_ndtr(mean[..., -1] / np.sqrt(covariance[..., -1, -1]))
    evidence = 0.5 * (b * mean).sum(-1) + 0.5 * np.linalg.slogdet(covariance)[1] + above
    return Posterior(np.asarray(evidence), mean, covariance)


class Dampings(NamedTuple):
    """Dampings from low to high, uniform in the logarithm, of which one stands for all."""

    one: float
    low: float
    high: float

    @property
    def log_prior(self) -> float:
        """Log of their prior probability."""
        if self.high == 0.0:
            return float(np.log(UNDAMPED))
        share = np.log(self.high / self.low) / np.log(DAMPED[1] / DAMPED[0])
        return float(np.log((1.0 - UNDAMPED) * share))


NONE: Final = Dampings(0.0, 0.0, 0.0)


def shapes_of_cells(
    found: Posterior, frequency_hz: Array, damping: Dampings, width_hz: float, scales: Array
) -> Shapes:
    """Lines (K C,) that stand for all within ``width_hz`` about C frequencies.

    ``found`` (K, C) are their posteriors by K scales of the sizes, ``scales`` (K, q).
    """
    weight = found.log_evidence + damping.log_prior + np.log(width_hz / len(scales))
    covariance = found.covariance * (scales[:, None, :, None] * scales[:, None, None, :])
    return Shapes(
        weight.ravel(),
        np.tile(damping[1:], (weight.size, 1)),
        np.tile(frequency_hz, len(scales)),
        np.full(weight.size, width_hz / np.sqrt(12.0)),
        (scales[:, None] * found.mean).reshape(-1, scales.shape[1]),
        covariance.reshape(-1, *covariance.shape[-2:]),
    )


def shapes_over_dampings(
    posterior_of: Callable[[Line], Posterior],
    line: Line,
    span_s: float,
    scales: Array,
) -> Shapes:
    """A line found at other dampings (:data:`NODES`), for each at five frequencies.

    ``posterior_of`` has those (K,) of a line by K scales of the sizes, ``scales`` (K, q).
    ``span_s`` is that of the longest event.
    """

    def evidence_of(other: Line) -> float:
        return float(posterior_of(other).of_all_sizes)

    def peak(middle: float, step: float, damping: float) -> tuple[float, float]:
        shifted = ((middle + s, damping, direction) for s in (-step, 0.0, step))
        shift, sd = _peak([evidence_of(other) for other in shifted], step)
        return middle + shift, sd

    frequency_hz, found, direction = line
    step = SPAN_STEP / (2.0 * np.pi * frequency_hz * span_s)
    middle = max(found, step)
    beside = ((frequency_hz, middle + d, direction) for d in (-step, 0.0, step))
    _, sd = _peak([evidence_of(other) for other in beside], step)
    near = found + sd * np.array(NEAR_BEST)
    near = near[(near > DAMPED[0]) & (near < DAMPED[1])]
    cells = []
    for damping in _cells(np.unique(np.concatenate([NODES, near]))):
        step = FREQUENCY_STEP * float(np.hypot(1.0 / span_s, damping.one * frequency_hz))
        best, sd = peak(frequency_hz, step, damping.one)
        evidence = evidence_of((best, damping.one, direction))
        cells.append((evidence + damping.log_prior + np.log(sd), damping, best, sd))
    most = max(weight for weight, *_ in cells)
    shapes = []
    for weight, damping, best, sd in cells:
        if weight < most + LEAST_LOG_SHARE:
            continue
        best, sd = peak(best, sd, damping.one)  # a wide parabola leans where a line is strong
        frequencies = best + sd * np.array(NEAR_BEST)
        each = (posterior_of((float(f), damping.one, direction)) for f in frequencies)
        shapes.append(shapes_of_cells(Posterior.stacked(each), frequencies, damping, sd, scales))
    return Shapes.joined(shapes)


def draw_shapes(
    parts: Sequence[Shapes], rng: np.random.Generator, draws: int
) -> tuple[Array, Array, Array, Array]:
    """Draws (n,): amplitude (rad/s), share, frequency (Hz) and damping.

    ``parts`` are lines of P free oscillations and of others; of an amplitude the root of its mean
    square over these.
    """
    weights = np.concatenate([part.log_weight for part in parts])
    of_part = np.repeat(np.arange(len(parts)), [len(part.log_weight) for part in parts])
    chosen = rng.choice(len(weights), draws, p=softmax(weights))
    result = np.empty((4, draws))
    for k, part in enumerate(parts):
        own = np.flatnonzero(of_part[chosen] == k)
        place = chosen[own] - int(np.searchsorted(of_part, k))
        result[:, own] = _drawn(part, place, rng)
    amplitude, share, frequency, damping = result
    return amplitude, share, frequency, damping


def _drawn(shapes: Shapes, place: Places, rng: np.random.Generator) -> tuple[Array, ...]:
    """One draw of every line in ``place`` (n,)."""
    draws = len(place)
    mean, covariance = shapes.mean[place], shapes.covariance[place]
    sd = np.sqrt(covariance[:, -1, -1])
    below = ndtr(-mean[:, -1] / sd)
    share = mean[:, -1] + sd * ndtri(below + (1.0 - below) * rng.uniform(size=draws))
    share = np.maximum(share, 0.0)
    along = (share - mean[:, -1]) / covariance[:, -1, -1]
    swing = mean[:, :-1] + covariance[:, :-1, -1] * along[:, None]
    rest = (
        shapes.covariance[:, :-1, :-1]
        - (shapes.covariance[:, :-1, -1:] * shapes.covariance[:, -1:, :-1])
        / shapes.covariance[:, -1:, -1:]
    )
    factors = np.linalg.cholesky(rest)[place]
    swing = swing + (factors @ rng.standard_normal((*swing.shape, 1)))[..., 0]
    noise = rng.standard_normal(draws)
    frequency = shapes.frequency_hz[place] + shapes.frequency_sd_hz[place] * noise
    low, high = shapes.damping[place].T
    with np.errstate(divide="ignore", invalid="ignore"):  # no damping stands for itself
        damping = np.where(low > 0.0, low * (high / low) ** rng.uniform(size=draws), 0.0)
    amplitude = np.sqrt(2.0 * np.mean(swing**2, axis=1))
    return amplitude, share, frequency, damping


def _peak(values: Sequence[float], step: float) -> tuple[float, float]:
    """Where a parabola through three log densities has its peak, from the middle, and its sd."""
    below, middle, above = values
    bend = max(2.0 * middle - below - above, LEAST_BEND)
    shift = step * float(np.clip(0.5 * (above - below) / bend, -2.0, 2.0))
    return shift, step / float(np.sqrt(bend))


def _cells(dampings: Array) -> list[Dampings]:
    """What dampings (K,) above zero stand for, half-way to the next, and none for itself."""
    bounds = np.concatenate([DAMPED[:1], 0.5 * (dampings[1:] + dampings[:-1]), DAMPED[1:]])
    some = zip(dampings.tolist(), bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)
    return [NONE, *(Dampings(*own) for own in some)]
