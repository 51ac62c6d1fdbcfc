"""Noise of an event's channels, as differences of their rows show it.

True motion is smooth from row to row as long as nothing fires: rates and wheel rates go in straight
lines, attitudes in parabolas. What second differences of the former and third ones of the latter
leave is noise. It is good to some percent and owes nothing to inertia or thrust, so that it says at
which noise the measure of flat motion is taken (docs/topics/telemetry-likelihood.md §3). Wheels in
steps that are coarse beside their noise have a rounding that is not white (:func:`_passing_noise`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cassini_bayes.balance.rounded_wheels import (
    ROUNDING,
    WINDOW,
    coherent_shares,
    means_beside,
)
from cassini_bayes.balance.statistics.rows import Samples
from cassini_bayes.balance.statistics.sampling import Sampling
from cassini_bayes.balance.statistics.turns import turns_between
from cassini_bayes.computing.arrays import Array, Flags, Places
from cassini_bayes.spacecraft.attitude import direction_cosines
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

SECOND: Final = 6.0  # variance of a second difference over that of a value
THIRD: Final = 20.0
LEAST_DIFFERENCES: Final = 30  # judgement: a noise level from these is good to a fifth
JITTER: Final = 0.01  # of the usual time between rows, by which a clock's may differ
OUTLYING: Final = 4.0  # standard deviations: corners of the motion, and hardly any noise
COARSE: Final = 0.4  # noise in steps: of more nothing of a rounding repeats
PASSING: Final = 0.3  # steps a row: a wheel as fast passes values enough for all places in a step
_TRIED: Final = np.linspace(0.0025, 2.0 * COARSE, 320)
"""Noise in steps. The least stands for none at all: 0 is what is not seen."""
NORMAL_MEDIAN: Final = 0.6745  # of the size of a standard normal


@dataclass(frozen=True)
class ChannelNoise:
    """Standard deviations of the white noise of channels without rounding; 0 where not seen."""

    rate_rad_s: float = 0.0
    wheel_rpm: float = 0.0
    attitude_rad: float = 0.0

    def seen_by(self, sampling: Sampling) -> Sampling:
        """The sampling with these as its reference noise, where the priors do not know it."""
        seen = {
            "rate_noise_rad_s": self.rate_rad_s,
            "wheel_noise_rpm": self.wheel_rpm,
            "attitude_noise_rad": self.attitude_rad,
        }
        seen = {name: seen[name] for name in sampling.noise_to_see if seen.get(name, 0.0) > 0.0}
        reference = tuple((dict(sampling.reference_noise) | seen).items())
        return replace(sampling, reference_noise=reference)


NOT_SEEN: Final = ChannelNoise()


def channel_noise(
    samples: Samples, stretch: Places, rate_step_rad_s: float, wheel_step_rad_s: float
) -> ChannelNoise:
    """Noise levels of complete rows that follow each other at the usual step.

    Parameters
    ----------
    samples
        N rows.
    stretch
        (N,) number of the stretch without firing that a row is in, -1 in none.
    rate_step_rad_s, wheel_step_rad_s
        Least steps of both channels, whose rounding is taken off.
    """
    gap = np.diff(samples.time_s)
    if len(gap) < LEAST_DIFFERENCES:
        return NOT_SEEN
    usual = float(np.median(gap))
    even = np.abs(gap - usual) < JITTER * usual
    quiet = even & (stretch[1:] == stretch[:-1]) & (stretch[1:] >= 0)
    # as far as the body turns in the usual time: a clock's jitter is no noise of attitudes
    turns = turns_between(direction_cosines(samples.attitude)) * (usual / gap)[:, None]
    rates = np.diff(samples.rate_rad_s, 2, axis=0)[quiet[1:] & quiet[:-1]]
    wheels = np.diff(samples.wheel_rad_s, 2, axis=0)[even[1:] & even[:-1]]
    angles = np.diff(turns, 2, axis=0)[quiet[2:] & quiet[1:-1] & quiet[:-2]]
    of_wheels = _noise(wheels, SECOND, wheel_step_rad_s)
    if of_wheels < COARSE * wheel_step_rad_s:
        passing = _passing_noise(samples, even[1:] & even[:-1], wheel_step_rad_s)
        of_wheels = passing or of_wheels
    return ChannelNoise(
        _noise(rates, SECOND, rate_step_rad_s),
        of_wheels / RAD_S_PER_RPM,
        _noise(angles, THIRD, 0.0),
    )


def _passing_noise(samples: Samples, even: Flags, step: float) -> float:
    """Noise of wheel rates in coarse steps, rad/s, by rows (N,) in which wheels pass them.

    Harmonic h of the rounding has the share b_h(σ) of its square that repeats with the wheel's rate
    (:func:`.coherent_shares`), of v steps a row, and the rest is white. So a second difference
    (N − 2, where ``even``) has the mean square, in steps,

        6 σ² + ½ (1 − Σ b_h) + Σ b_h · 16 sin⁴(π h v) / 12.

    A wheel that rests shows little of either. Taken for white, its rounding is more than is seen.
    0 of too few rows.
    """
    squares, speeds = [], []
    whole = slice(WINDOW - 1, 1 - WINDOW)  # differences with a window on either side
    for rates in samples.wheel_rad_s.T:
        levels = np.round(rates / step)
        before, after = means_beside(levels)
        # of the row in the middle: its windows are their length and a row apart
        speed = (after[2:] - before[1:-1])[whole] / (WINDOW + 1.0)
        difference = np.diff(levels, 2)[whole]
        used = even[whole] & (np.abs(speed) > PASSING) & (np.abs(difference) <= OUTLYING)
        squares.append(difference[used] ** 2)
        speeds.append(speed[used])
    square, speed = np.concatenate(squares), np.concatenate(speeds)
    if len(square) < LEAST_DIFFERENCES:
        return 0.0
    shares = coherent_shares(_TRIED)
    order = np.arange(1, shares.shape[1] + 1)
    repeated = (16.0 * np.sin(np.pi * np.multiply.outer(speed, order)) ** 4).mean(axis=0)
    white = SECOND * (_TRIED**2 + ROUNDING * (1.0 - shares.sum(axis=1)))
    left = white + ROUNDING * shares @ repeated - square.mean()
    return step * float(_TRIED[np.argmin(np.abs(left))])


def _noise(differences: Array, order: float, step: float) -> float:
    """Noise of values whose differences (n, c) have ``order`` times its variance.

    The rounding of ``step`` is taken off. Outlying differences are corners of the motion; of fewer
    than thirty nothing is said.
    """
    if len(differences) < LEAST_DIFFERENCES:
        return 0.0
    size = np.abs(differences)
    bound = OUTLYING * np.maximum(np.median(size, axis=0) / NORMAL_MEDIAN, step)
    kept = np.where(size <= bound, size, np.nan)
    square = float(np.nanmean(kept**2)) / order - step**2 / 12.0
    return float(np.sqrt(max(square, 0.0)))
