"""Do body rates and the turns of the attitude show the same motion?

Turn over step y = M x + bias, x the mean recorded rate of the step; M is the identity if both are
right. Rates are a noisy regressor, and plain least squares would find a factor below 1 out of noise
alone. The rates just before and after the step know the same motion with other noise: their mean
and their difference as instruments z give Σ (y − M x) zᵀ = 0 on average at the true M, with the
covariance Σ_u ⊗ Σ z zᵀ of its moments. The mean shows factors, axes and signs, the difference
rates that come early or late.

A body that is fired at every few seconds moves otherwise before and after a step than in it: such
instruments are weak. But a rotation, a reflection or a lag changes no noise, so that no instrument
is needed to weigh it: with R(Q, k) = Σ |y − Q x|², x taken k intervals earlier, and a noise nobody
knows, n log R(1, 0)/R(Q, k) is twice the logarithm of the likelihood ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.plausibility.attitudes import turns_rad
from cassini_bayes.events.plausibility.rows import Motion

GYRO_SD: Final = 0.01
"""Scale factors and misalignments of a gyro that are physics: the catalogue's rate_scale."""
LAG_SD_S: Final = 0.5
"""Delays of a gyro's filter that are physics (judgement: half a row of 1 Hz telemetry)."""
INSTRUMENTS: Final = 6  # rates of both neighbours, three axes each
LONGEST_STEP: Final = 3.0
"""Of the median: over longer gaps the mean of two rates is no mean rate (judgement)."""
LEAST_VARIANCE: Final = 1e-24  # (rad/s)², of noise: below any gyro's
LEAST_STEPS: Final = 12  # judgement: two for each instrument, fewer are not asked
SHARED: Final = 3.0
"""Steps that what one pulse brings counts for: a limit cycle in step with the rows drifts past them
(judgement, as for rounded counters)."""
STEP_S: Final = 8.0
"""Booms that swing faster are none of the body's turning; the body itself, fired at, is not much
slower."""
MOST_JOINED: Final = 8  # rows to a step: 8 s of 1 Hz telemetry
MOST_LAGS: Final = 20  # intervals either way: the choice costs BY_CHANCE
BIAS_SIGMAS: Final = 3.0  # of the mean difference: a bias beyond it has a chance of 0.3 %
NOISE_FREE: Final = 0.5  # of the turning, which rates explain that are no noise: judgement
BY_CHANCE: Final = 25.0
"""Of twice a log likelihood ratio: the best of all rotations (three angles) and of forty lags."""


@dataclass(frozen=True, eq=False)
class Turning:
    """Moments of turns with rates: what any map of recorded rates to true ones leaves of them."""

    turned: Array  # Σ y zᵀ (3, 6)
    recorded: Array  # Σ x zᵀ (3, 6)
    quickened: Array  # Σ ẋ zᵀ (3, 6)
    driven: Array  # Σ f zᵀ (3, 6), f what half an interval of the wheels' drive is, by step
    instruments: Array  # Σ z zᵀ (6, 6)
    squares: tuple[Array, Array, Array]  # Σ y yᵀ, Σ x yᵀ, Σ x xᵀ (3, 3) of their noise
    pulsed: Array  # (3, 6, 6) Σ p z zᵀ by axis, p what pulses at unknown moments vary a step by
    steps: int
    each: tuple[Array, Array]  # y and x (n, 3) of every interval between two rows
    jumped: Array  # (n,) variance that its pulses bring to an interval, all axes together
    bias_rad_s: Array  # (3,) by which rates may be off on the whole: what is found, and its noise

    def variance(self, rate: Array) -> Array:
        """Variance (3,) of the noise of one step's turn less ``rate`` times its rates.

        Without what pulses bring.
        """
        turned, common, recorded = self.squares
        left = turned - 2.0 * rate @ common + rate @ recorded @ rate.T
        return np.maximum(np.diag(left) / self.steps, LEAST_VARIANCE)

    def factor(self, axes: Sequence[int]) -> float:
        """The one factor of recorded rates that brings turns about some axes nearest."""
        inverse = np.linalg.inv(self.instruments)
        kicked = np.trace(self.pulsed, axis1=1, axis2=2) / np.trace(self.instruments)
        weights = 1.0 / (self.variance(np.eye(3)) + kicked)[list(axes)]
        turned, recorded = self.turned[list(axes)], self.recorded[list(axes)]
        common = float(np.sum(weights[:, None] * (turned @ inverse) * recorded))
        own = float(np.sum(weights[:, None] * (recorded @ inverse) * recorded))
        return common / own if own > 0.0 else np.nan

    def misfit(self, rate: Array, axes: Sequence[int] = (0, 1, 2)) -> float:
        """χ² of the moments if true rates are ``rate`` (3, 3) times those recorded.

        A gyro's scale factors, misalignments and delays may lean away from it at a price.
        """
        recorded, quickened = rate @ self.recorded, LAG_SD_S * (rate @ self.quickened)
        variance, total = self.variance(rate), 0.0
        for axis in axes:
            gap = self.turned[axis] - recorded[axis]
            lean = GYRO_SD**2 * recorded.T @ recorded
            lean += np.outer(quickened[axis], quickened[axis])
            lean += np.outer(self.driven[axis], self.driven[axis])
            # noise-free rates about one axis alone leave directions that nothing is known of
            covariance = variance[axis] * self.instruments + self.pulsed[axis] + lean
            total += float(gap @ np.linalg.lstsq(covariance, gap)[0])
        return total

    def misaligned(self, rate: Array, axes: Sequence[int] = (0, 1, 2)) -> float:
        """n log of the ratio by which other axes, another lag or size fit better, at their best.

        Rates are ``rate`` (3, 3) times those recorded. Two readings of the likelihood, the larger
        counts: rates are as good as free of noise, and only the difference has any (if the best of
        them explain half of the turning at least; of a body at rest rates are nothing else, and the
        best rotation of noise grows with the root of the rows); or both have
        as much as they like, so that Σ y x estimates the power of the motion, which is neither
        negative nor above Σ x² or Σ y². A gyro's misalignment may be physics: as much as it brings
        is noise. Intervals weigh by their noise, that of half of them and of what thrusters fire:
        one of a first catch, with seconds of thrust, would turn the best rotation by degrees.
        """
        chosen = list(axes)
        y, x = self.each[0][:, chosen], (self.each[1] @ rate.T)[:, chosen]
        usual = max(float(np.median(np.sum((y - x) ** 2, axis=1))), LEAST_VARIANCE)
        weight = usual / (usual + self.jumped)
        noise = (3.0 * GYRO_SD) ** 2

        lags = range(1, min(MOST_LAGS, len(y) // 4) + 1)
        # rows of the turns and of the rates
        pairs = [(slice(None), slice(None))]
        for k in lags:
            late, soon = slice(k, None), slice(None, -k)
            pairs += [(late, soon), (soon, late)]
        weighted = weight[:, None] * y
        yy, xx, moved, same = np.array(
            [
                (
                    np.sum(weighted[now] * y[now]),
                    np.sum(weight[now] @ x[now] ** 2),
                    np.sum(weight[now] @ x[then] ** 2),
                    np.sum(weighted[now] * x[now]),
                )
                for now, then in pairs
            ]
        ).T
        common = np.array([weighted[now].T @ x[then] for now, then in pairs])
        # Σ y x of the axes that fit best
        best = common[:, 0, 0]
        if len(chosen) > 1:
            best = np.linalg.svd(common, compute_uv=False).sum(axis=1)
        with np.errstate(over="ignore", invalid="ignore"):  # of damaged cells
            moves = yy * xx * moved != 0.0
            yy, xx, moved, same, best = (each[moves] for each in (yy, xx, moved, same, best))
            first = (yy + xx - 2.0 * same) / (yy + xx) + noise
            first /= np.maximum((yy + moved - 2.0 * best) / (yy + moved), 0.0) + noise
            first = np.where(best**2 > NOISE_FREE * yy * moved, first, 1.0)
            power, small = np.maximum(same, 0.0), np.minimum(xx, yy)
            as_is = np.where(power <= small, yy * xx - power**2, small * (yy + xx - 2.0 * power))
            second = as_is / (yy * xx) + noise
            second /= np.maximum(1.0 - best**2 / (yy * moved), 0.0) + noise
        largest = float(np.fmax.reduce(np.fmax(first, second), initial=1.0))
        return len(y) * float(np.log(largest))


def turning_of(
    motion: Motion, drive_rad_s: Array | None = None, fired_rad_s: Array | None = None
) -> Turning | None:
    """The moments; None where there are too few steps.

    Where thrusters take what wheels give, the body's rate falls between pulses and jumps with them.
    If pulses begin with the rows the mean of two rates is off by half an interval of that fall, for
    as long as the wheels ramp: so much it may lean. ``drive_rad_s`` (n, 3) are the rates that the
    body would have by the wheels alone, ``fired_rad_s`` (2, n, 3) by what thrusters push about each
    axis one way, and by what they push the other; without, nothing fires.

    A pulse that brings J somewhere in an interval leaves the mean of two rates off by up to J/2,
    with the variance J²/12. Two that push to and fro in one interval bring it twice, though little
    of what they bring stays. Where pulses come in step with the rows this lasts, and second
    differences do not see it: it counts for :data:`SHARED` steps. It is counted in the steps that
    were fired in, where rates are largest: spread over all steps it would be too little there.

    Steps join intervals up to :data:`STEP_S`: booms that swing faster than that are none of
    the body's turning, and rates sampled at their swing's ends would look too large or too small.
    """
    intervals_s, rates = np.diff(motion.time_s), motion.rate_rad_s
    stride = int(np.clip(round(STEP_S / float(np.median(intervals_s))), 1, MOST_JOINED))
    count = len(intervals_s) // stride
    if count < LEAST_STEPS:
        return None
    used = count * stride

    def joined(values: Array) -> Array:
        """Sums over the intervals of each step."""
        return np.asarray(values[:used].reshape(count, stride, -1).sum(axis=1))

    step_s = joined(intervals_s)
    between, turns = 0.5 * (rates[1:] + rates[:-1]), turns_rad(motion.attitude)
    mean = joined(between * intervals_s[:, None]) / step_s
    turned = joined(turns) / step_s
    quick = joined(np.diff(rates, axis=0)) / step_s
    given = np.zeros_like(rates) if drive_rad_s is None else drive_rad_s
    fired = np.zeros((1, *rates.shape)) if fired_rad_s is None else fired_rad_s
    half = 0.5 * joined(intervals_s[:, None] * np.diff(given, axis=0)) / step_s
    kicks = np.sum(np.diff(fired, axis=1) ** 2, axis=0) / 12.0  # of an interval
    kicked = SHARED * joined(intervals_s[:, None] ** 2 * kicks) / step_s**2
    # rows that no other step than the one before, or the one after, has at its ends
    before = rates[:used].reshape(count, stride, 3).mean(axis=1)
    after = rates[1 : used + 1].reshape(count, stride, 3).mean(axis=1)
    around = np.concatenate([before[:-2] + after[2:], after[2:] - before[:-2]], axis=1)
    good = (step_s <= LONGEST_STEP * np.median(step_s))[1:-1, 0]
    inner_steps = (turned[1:-1], mean[1:-1], quick[1:-1], half[1:-1], around)
    y, x, dx, f, z = (v[good] - v[good].mean(axis=0) for v in inner_steps)
    scale = np.abs(z).max(axis=0)
    z = z / np.where(scale > 0.0, scale, 1.0)
    # a trace of ridge: a rate that never varies is no instrument, and must not divide by zero
    inner = z.T @ z + 1e-9 * np.eye(INSTRUMENTS)
    pulsed = np.stack([(z * each[:, None]).T @ z for each in kicked[1:-1][good].T])
    # noise by second differences: what a wrong factor leaves is smooth, and is no noise
    bent_y, bent_x = (np.diff(v, 2, axis=0) / np.sqrt(6.0) for v in (y, x))
    squares = (bent_y.T @ bent_y, bent_x.T @ bent_y, bent_x.T @ bent_x)
    usual = intervals_s <= LONGEST_STEP * np.median(intervals_s)
    each = ((turns / intervals_s[:, None])[usual], between[usual])
    apart = each[0] - each[1]
    bias = np.abs(apart.mean(axis=0)) + BIAS_SIGMAS * apart.std(axis=0) / np.sqrt(len(apart))
    each = (each[0] - each[0].mean(axis=0), each[1] - each[1].mean(axis=0))
    jumped = np.sum(kicks[usual], axis=1)
    moments = (y.T @ z, x.T @ z, dx.T @ z, f.T @ z)
    return Turning(*moments, inner, squares, pulsed, len(y) - 2, each, jumped, bias)
