"""Columns of telemetry that effects need beyond the balance's own.

A column named ``what@thruster`` is multiplied by that thruster's thrust and lever arm, so that its
weight is on-time (s per column unit); other columns carry a momentum weight of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics import ExtraColumn, RowContext
from cassini_bayes.effects.appendage import answer, products

Array = NDArray[np.float64]
WARMUP_NODES_S: Final = (0.5, 1.4, 4.0, 11.0, 32.0)
SHIFT_NODES_S: Final = (-2.0, -1.0, 0.0, 1.0, 2.0)
TAIL_S: Final = 0.030  # on-time that a pulse's tail adds, good to some milliseconds
FLEXIBLE: Final = ("flexible:cosine", "flexible:sine", "flexible:driven")
_SLOPE_STEP: Final = 0.05  # of what the span can tell apart


def warmup_column(thruster: str, time_constant_s: float) -> str:
    """Name of the column of a warm-up of this time constant."""
    return f"warmup:{time_constant_s:g}@{thruster}"


def warmup_tail_column(thruster: str, time_constant_s: float) -> str:
    """Name of the column of the tails that such a warm-up weakens."""
    return f"warmup-tail:{time_constant_s:g}@{thruster}"


def shift_column(thruster: str, offset_s: float) -> str:
    """Name of the column of counters looked up later by ``offset_s``."""
    return f"shift:{offset_s:g}@{thruster}"


def telemetry_columns(thrusters: Sequence[str]) -> tuple[ExtraColumn, ...]:
    """Every column that the catalogue needs and that does not depend on a first fit."""
    columns: list[ExtraColumn] = []
    for k, name in enumerate(thrusters):
        columns += [
            column
            for node in WARMUP_NODES_S
            for column in (
                ExtraColumn(warmup_column(name, node), partial(_warmup, k, node)),
                ExtraColumn(warmup_tail_column(name, node), partial(_warmup_tails, k, node)),
            )
        ]
        columns += [
            ExtraColumn(shift_column(name, node), partial(_shifted, k, node))
            for node in SHIFT_NODES_S
            if node != 0.0
        ]
    return tuple(columns)


def _warmup(place: int, time_constant_s: float, context: RowContext) -> Array:
    """Commanded on-time lost per unit of deficit so far: ∫ exp(−u/t_w) du over the on-time u."""
    on_time = context.on_time_at(context.time_s)[:, place]
    return np.asarray(time_constant_s * -np.expm1(-on_time / time_constant_s))


def _warmup_tails(place: int, time_constant_s: float, context: RowContext) -> Array:
    """Tails lost per unit of deficit so far: Σ exp(−u/t_w) over pulses that ended at on-time u.

    A tail is as weak as its pulse. Pulses between two readings are taken to be alike.
    """
    on_time, pulses = context.on_time_s[:, place], context.pulses[:, place]
    count = np.diff(pulses)
    width = np.divide(np.diff(on_time), count, out=np.zeros_like(count), where=count > 0.0)
    ratio = np.exp(-width / time_constant_s)
    alike = np.divide(1.0 - ratio**count, 1.0 - ratio, out=np.array(count), where=ratio < 1.0)
    lost = np.exp(-on_time[:-1] / time_constant_s) * ratio * alike
    lost = np.where(count > 0.0, lost, 0.0)
    return np.concatenate([[0.0], np.cumsum(lost)])[context.reading(context.time_s)]


def _shifted(place: int, offset_s: float, context: RowContext) -> Array:
    """Effective on-time that had been delivered but was shown ``offset_s`` later."""

    def counted(values: Array) -> Array:
        later = np.interp(context.time_s + offset_s, context.counter_time_s, values[:, place])
        now = np.interp(context.time_s, context.counter_time_s, values[:, place])
        return np.asarray(later - now)

    return counted(context.on_time_s) + TAIL_S * counted(context.pulses)


def flexible_columns(
    frequency_hz: float, damping: float, axis: int, span_s: float, motion: KnownMotion
) -> tuple[ExtraColumn, ...]:
    """Columns of an oscillation about an axis (:func:`oscillation_series`) and their slopes.

    Slopes are by frequency in units of 1/T and by damping in units of 1/(ΩT), T the span.
    """
    units = 1.0 / span_s, 1.0 / (2.0 * np.pi * frequency_hz * span_s)

    def series(place: int, by_line: float, by_damping: float, context: RowContext) -> Array:
        line = frequency_hz + by_line * units[0], damping + by_damping * units[1]
        found = oscillation_series(context.time_s, motion, *line)[place]
        return np.asarray(found if place < len(FLEXIBLE) - 1 else found[:, axis])

    def slope(place: int, by_line: float, by_damping: float, context: RowContext) -> Array:
        ahead = series(place, by_line, by_damping, context)
        return (ahead - series(place, -by_line, -by_damping, context)) / (2.0 * _SLOPE_STEP)

    columns = []
    for place, name in enumerate(FLEXIBLE):
        line, dying = flexible_slopes(name)
        columns += [
            ExtraColumn(name, partial(series, place, 0.0, 0.0)),
            ExtraColumn(line, partial(slope, place, _SLOPE_STEP, 0.0)),
            ExtraColumn(dying, partial(slope, place, 0.0, _SLOPE_STEP)),
        ]
    return tuple(columns)


def flexible_slopes(name: str) -> tuple[str, str]:
    """Names of the columns of a series' slopes by frequency and by damping."""
    return f"{name}:frequency", f"{name}:damping"


def oscillation_series(
    time_s: Array, motion: KnownMotion, frequency_hz: float, damping: float
) -> tuple[Array, Array, Array]:
    """exp(−ζΩt) cos Ωt and exp(−ζΩt) sin Ωt (n,), and the driven rate (n, c), Ω = 2π f."""
    phase = 2.0 * np.pi * frequency_hz * time_s
    decay = np.exp(-damping * phase)
    driven = motion.driven(time_s, frequency_hz, damping)
    return decay * np.cos(phase), decay * np.sin(phase), driven


@dataclass(frozen=True)
class KnownMotion:
    """What the rates before each row say of the body's motion, on a grid of their median step.

    The last line before a row is that of the step before, so that a row's own noise is not in it:
    it would be taken for an answer to it.
    """

    start_s: float
    step_s: float
    slope: Array  # (g, c) of the rate after each grid point, rad/s²
    change: Array  # (g, c) of the last slope by that of the step before

    def driven(self, time_s: Array, frequency_hz: float, damping: float) -> Array:
        """Rate (n, c) of an appendage against its body at times (n,) of rows, rad/s.

        θ'' + 2 ζ Ω θ' + Ω² θ = −ω' with Ω = 2π f, at rest at the first row; ω goes in straight
        lines from row to row, and the response to them is exact.
        """
        slope, change, coefficients, place = self._recursion(
            time_s, np.array([frequency_hz]), damping
        )
        return np.asarray(answer(slope, change, coefficients[0], place))

    def products(
        self, time_s: Array, frequency_hz: Array, damping: float, left: Array
    ) -> tuple[Array, Array]:
        """Inner products of :func:`oscillation_series` at many frequencies (f,), rows summed over.

        With each other, (f, 2 + c, 2 + c) in order of cosine, sine and driven rates, and with what
        is left, ``left`` (n, 3), (f, 2 + c, 3).
        """
        motion = self._recursion(time_s, frequency_hz, damping)
        lower, along = products(time_s, (2.0 * np.pi * frequency_hz, damping), motion, left)
        return lower + np.swapaxes(np.tril(lower, -1), 1, 2), along

    def _recursion(
        self, time_s: Array, frequency_hz: Array, damping: float
    ) -> tuple[Array, Array, Array, NDArray[np.int64]]:
        """What :func:`appendage.answer` takes."""
        omega, step = 2.0 * np.pi * frequency_hz, self.step_s
        turned = omega * np.sqrt(1.0 - damping**2)
        decay = np.exp(-damping * omega * step)
        cosine, sine = decay * np.cos(turned * step), decay * np.sin(turned * step) / turned
        # of the transition of (θ, θ') over a step: its first column, and what a steady ω' adds
        first, second = cosine + damping * omega * sine, -(omega**2) * sine
        added = -(1.0 - first) / omega**2, -sine
        ahead = second * added[0] - first * added[1]
        coefficients = np.stack([added[1], ahead, -2.0 * cosine, decay**2], axis=1)
        place = np.round((time_s - self.start_s) / step).astype(np.int64)
        return self.slope, self.change, coefficients, np.clip(place, 0, len(self.slope) - 1)


def known_motion(time_s: Array, rate_rad_s: Array) -> KnownMotion:
    """The motion that samples of the rate (n, c) at times (n,) tell; NaN is not sampled.

    All samples count, those during pulses as well. Where some are missing the line goes to the
    next one, whose noise is then in it.
    """
    seen = np.isfinite(rate_rad_s).all(1)
    time_s, rate_rad_s = time_s[seen], rate_rad_s[seen]
    step = float(np.median(np.diff(time_s)))
    grid = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    shown = np.stack([np.interp(grid, time_s, rate) for rate in rate_rad_s.T], axis=1)
    slope = np.diff(shown, axis=0, append=shown[-1:]) / step
    change = np.zeros_like(slope)
    change[2:] = slope[:-2] - slope[1:-1]
    return KnownMotion(float(time_s[0]), step, slope, change)


def hat_weights(value: Array, nodes: Array) -> Array:
    """Weights (n, nodes) of piecewise linear interpolation at values (n,), held at the ends."""
    inside = np.clip(value, nodes[0], nodes[-1])
    place = np.clip(np.searchsorted(nodes, inside, side="right") - 1, 0, len(nodes) - 2)
    share = (inside - nodes[place]) / (nodes[place + 1] - nodes[place])
    result = np.zeros((*inside.shape, len(nodes)))
    np.put_along_axis(result, place[..., None], (1.0 - share)[..., None], axis=-1)
    np.put_along_axis(result, place[..., None] + 1, share[..., None], axis=-1)
    return result


def lagrange_weights(value: Array, nodes: Array) -> Array:
    """Weights (n, nodes) of the polynomial through all nodes, at values (n,) between them."""
    inside = np.clip(value, nodes[0], nodes[-1])[..., None]
    result = np.ones((*inside.shape[:-1], len(nodes)))
    for i, node in enumerate(nodes):
        others = np.delete(nodes, i)
        result[..., i] = ((inside - others) / (node - others)).prod(-1)
    return result
