"""A damped oscillation about a direction of the body, and its columns of momentum.

What an appendage that swings keeps from the balance is a free oscillation and an answer to the
body's own motion (:mod:`cassini_bayes.effects.appendage`). Frequency, damping and direction are
clamped; columns have slopes by the first two.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from typing import Final

import numpy as np

from cassini_bayes.balance.statistics import ExtraColumn, RowContext, Samples
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.appendage import known_motion, oscillation_series
from cassini_bayes.effects.line_directions import BODY_AXES
from cassini_bayes.effects.line_shapes import Direction, Shapes
from cassini_bayes.effects.wording import decimals_of, rounded

SERIES: Final = ("flexible:cosine", "flexible:sine", "flexible:driven")
SLOPE_STEP: Final = 0.05
"""Of what the span can tell apart, for slopes by frequency and damping: judgement, a phase error of
0.3 rad at the end of the span, where a central difference is good to one percent."""
FASTEST: Final = 0.45  # cycles from row to row, of what trapezoids still show


@dataclass(frozen=True)
class BalancedRates:
    """Rates (N, 3) of an event, rad/s, as the balance of momentum shows them, NaN where not known.

    ``of`` is the digest of those that were measured, ``known`` the share of rows that have better.
    """

    of: str
    rate_rad_s: Array
    known: float

    @staticmethod
    def instead(measured_rad_s: Array, rate_rad_s: Array, known: float) -> BalancedRates:
        """Rates for those that were measured, both (N, 3)."""
        return BalancedRates(_digest(measured_rad_s), rate_rad_s, known)


@dataclass(frozen=True)
class Oscillation:
    """A damped oscillation about a unit vector in body axes, its frequency and damping clamped.

    Departures from them are counted in what ``span_s`` can tell apart: 1/T of the frequency,
    1/(ΩT) of the damping. ``step_s`` lies between the rates that show how the body moves.
    ``direction_sd_deg`` is the standard deviation of an oblique direction along each arc across it,
    0 for a body axis. ``log_looks`` is what the search costs, ``log_gain`` what it found, nats,
    about what the fit had left; ``swing_scale`` and ``share_scale`` are those of the priors' scales
    that have most of the evidence (:data:`.line_shapes.SIZES`). Motion is that of ``balanced``
    rates where an event has them; ``measured`` is the share of rows without.

    Where events have starts of their own, ``turns`` has for each of them, in the order of
    ``balanced``, the real and imaginary part of what makes its c + i s of the fit's
    (:func:`.line_starts.turns`), and ``log_start`` what its start cost, nats, of the search; of an
    event that is not among them nothing is known of how it starts, and it has no free oscillation.
    """

    frequency_hz: float
    damping: float
    direction: Direction
    direction_sd_deg: float = 0.0
    log_looks: float = 0.0
    log_gain: float = 0.0
    span_s: float = 3_600.0
    step_s: float = 1.0
    swing_scale: float = 1.0
    share_scale: float = 1.0
    measured: float = 1.0
    turns: tuple[tuple[float, float], ...] = ()
    log_start: float = 0.0
    balanced: tuple[BalancedRates, ...] = field(default=(), compare=False)
    shapes: tuple[Shapes, ...] = field(default=(), compare=False)

    @property
    def said(self) -> str:
        """What it swings about, and whether every event has a start of its own."""
        return f"{self._about}, started anew in every event" if self.turns else self._about

    @property
    def _about(self) -> str:
        """A body axis by its name, or a unit vector in body axes."""
        if self.direction in BODY_AXES:
            return f"about {'XYZ'[BODY_AXES.index(self.direction)]}"
        parts = ", ".join(rounded(part, 2) for part in self.direction)
        off = rounded(self.direction_sd_deg, min(decimals_of(self.direction_sd_deg), 0))
        return f"about ({parts}) in body axes, ± {off}° (1 σ)"

    @property
    def prior_scales(self) -> Mapping[str, float]:
        """Of its sizes by key."""
        swing = dict.fromkeys(("cosine_rad_s", "sine_rad_s"), self.swing_scale)
        return {**swing, "inertia_fraction": self.share_scale}

    @property
    def record(self) -> Mapping[str, object]:
        """Direction in body axes, its standard deviation, degrees, and how events start."""
        return {
            "direction": list(self.direction),
            "direction_sd_deg": self.direction_sd_deg,
            "starts": "own" if self.turns else "alike",
        }

    def log_start_of(self, samples: Samples) -> float:
        """What the start of an event cost of the search, nats: nothing where all are alike."""
        return self.log_start if self.turns and self._place(samples) is not None else 0.0

    def _place(self, samples: Samples) -> int | None:
        """Which of the events that the search has seen it is."""
        of = _digest(samples.rate_rad_s)
        return next((i for i, rates in enumerate(self.balanced) if rates.of == of), None)

    def _turn(self, place: int | None) -> complex:
        """What turns the free oscillation of an event in that place from the fit's."""
        if not self.turns:
            return 1.0
        return 0.0 if place is None else complex(*self.turns[place])

    def columns(self, samples: Samples) -> tuple[ExtraColumn, ...]:
        """The three series (:func:`oscillation_series`) of an event and their slopes.

        Slopes are by frequency in units of 1/T and by damping in units of 1/(ΩT), T the span.
        """
        seen = self._place(samples)
        rate = samples.rate_rad_s if seen is None else self.balanced[seen].rate_rad_s
        motion = known_motion(samples.time_s, rate)
        of_rows = over_trapezoids(self.frequency_hz, motion.step_s)
        turn = self._turn(seen)
        unit_hz = 1.0 / self.span_s
        unit_damping = 1.0 / (2.0 * np.pi * self.frequency_hz * self.span_s)

        def series(place: int, by_line: float, by_damping: float, context: RowContext) -> Array:
            line = self.frequency_hz + by_line * unit_hz, self.damping + by_damping * unit_damping
            cosine, sine, driven = oscillation_series(context.time_s, motion, *line)
            if place == len(SERIES) - 1:
                return np.asarray(driven @ self.direction)
            # of (c + i s) r, r the turn, c has Re r cos + Im r sin, and s that of i r
            own = turn * 1j**place
            return np.asarray(own.real * cosine + own.imag * sine)

        def slope(place: int, by_line: float, by_damping: float, context: RowContext) -> Array:
            ahead = series(place, by_line, by_damping, context)
            return (ahead - series(place, -by_line, -by_damping, context)) / (2.0 * SLOPE_STEP)

        columns = []
        for place, name in enumerate(SERIES):
            by_line, by_damping = slope_names(name)
            columns += [
                ExtraColumn(own, values, of_rows)
                for own, values in (
                    (name, partial(series, place, 0.0, 0.0)),
                    (by_line, partial(slope, place, SLOPE_STEP, 0.0)),
                    (by_damping, partial(slope, place, 0.0, SLOPE_STEP)),
                )
            ]
        return tuple(columns)


def slope_names(name: str) -> tuple[str, str]:
    """Names of the columns of a series' slopes by frequency and by damping."""
    return f"{name}:frequency", f"{name}:damping"


def _digest(values: Array) -> str:
    return sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


def over_trapezoids(frequency_hz: float, step_s: float) -> float:
    """Integral of a swing over that by trapezoids of its rows: tan x / x, x = π f Δ."""
    half = np.pi * min(frequency_hz * step_s, FASTEST)
    return float(np.tan(half) / half)
