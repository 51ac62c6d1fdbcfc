"""Spectrum of what a model leaves: how much of the innovations goes at which frequency.

Of white innovations w_i, each of variance one, at times i Δ the power |Σ w_i exp(−2πi f iΔ)|²/n has
mean one, and an exponential distribution: the largest of N independent frequencies exceeds P with
probability 1 − (1 − exp(−P))^N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cassini_bayes.balance.linearised import InnovationRows
from cassini_bayes.computing.arrays import Array

AXES: Final = "xyz"
FEWEST_ROWS: Final = 16  # of an event, for a spectrum of more than a few places
LEAST_CYCLES: Final = 4  # of an oscillation in an event: what is slower is a drift (judgement)
RARE: Final = 0.01  # chance of a peak as high, below which it is named


@dataclass(frozen=True)
class Spectrum:
    """Power (F,) of an event's whitened innovations about a body axis at frequencies (F,), Hz."""

    event: str
    axis: str
    frequency_hz: Array
    power: Array

    @property
    def peak(self) -> int:
        """Place of the highest summit of four cycles or more in the event.

        A summit is no lower than either neighbour: the skirt of a drift is none.
        """
        padded = np.concatenate([self.power, [0.0]])
        first = LEAST_CYCLES - 1
        centre, before, after = padded[first:-1], padded[first - 1 : -2], padded[first + 1 :]
        summits = np.where((centre >= before) & (centre >= after), centre, 0.0)
        return first + int(summits.argmax())

    @property
    def chance(self) -> float:
        """Of a peak as high somewhere, if the innovations were white."""
        count = len(self.power) - LEAST_CYCLES + 1
        return float(-np.expm1(count * np.log1p(-np.exp(-self.power[self.peak]))))

    @property
    def share(self) -> float:
        """Of the power that stands in the peak and the places beside it."""
        around = slice(max(self.peak - 1, 0), self.peak + 2)
        return float(self.power[around].sum() / self.power.sum())

    @property
    def record(self) -> dict[str, Any]:
        """The peak."""
        return {
            "event": self.event,
            "axis": self.axis,
            "peak_hz": float(self.frequency_hz[self.peak]),
            "power": float(self.power[self.peak]),
            "share": self.share,
            "chance": self.chance,
        }


def line_powers(time_s: Array, white: Array) -> tuple[Array, Array]:
    """Frequencies (F,), Hz, and |Σ w exp(−2πi f t)|²/n (F, k) of columns (n, k) at times (n,).

    Rows stand on the grid of their median step, absent ones as zeros: one Fourier transform.
    Frequencies go from one cycle in the event to half the sampling rate.
    """
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    at = np.round((time_s - time_s[0]) / step).astype(np.int64)
    grid = np.zeros((int(at[-1]) + 1, white.shape[1]))
    np.add.at(grid, at, white)
    power = np.abs(np.fft.rfft(grid, axis=0)[1:]) ** 2 / len(time_s)
    return np.asarray(np.fft.rfftfreq(len(grid), step)[1:], dtype=np.float64), power


def spectra(rows: Sequence[InnovationRows]) -> tuple[Spectrum, ...]:
    """Spectra of every event of more than sixteen rows, about every body axis."""
    result = []
    for event in rows:
        if len(event.time_s) > FEWEST_ROWS:
            frequency, power = line_powers(event.time_s, event.white)
            result += [Spectrum(event.event, a, frequency, power[:, c]) for c, a in enumerate(AXES)]
    return tuple(result)
