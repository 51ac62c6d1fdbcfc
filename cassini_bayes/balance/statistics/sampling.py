"""How telemetry is turned into columns: pulses, gaps and widths of an event, what pairs lose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cassini_bayes.balance.statistics.long_levels import NO_LEVELS, LongLevels
from cassini_bayes.balance.statistics.pulse_columns import PulseBasis
from cassini_bayes.balance.statistics.rows import SAME_S
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.spacecraft.pulses import STEADY_S, PulseShape

USUAL_SHARE = 0.3  # of close pairs
LEAST_PAIR_S2 = 1e-12  # (1 µs)²: where no tail is cut, unlike widths are all that scatters
LEAST_FALL_S = 1e-4  # a valve that closes at once: nothing of its thrust is left a cycle later
# How often pulses are a control cycle apart is the controller's business (0.45 to 0 of the pairs
# within a second): a share that is inferred, and how it falls with the time between two counter
# readings (docs/topics/telemetry-likelihood.md §7).
ALIKE_S = 1.0  # pairs of pulses within it are as often close as any


@dataclass(frozen=True)
class RowContext:
    """What a column that an effect brings may depend on, at the n rows that enter the balance.

    ``counter_time_s``, ``on_time_s`` and ``pulses`` are the counter readings around these rows, to
    be looked up at other times as well; the columns of both are the thrusters.
    """

    time_s: Array  # (n,)
    rate_rad_s: Array  # (n, 3)
    wheel_rad_s: Array  # (n, W)
    counter_time_s: Array  # (m,)
    on_time_s: Array  # (m, K)
    pulses: Array  # (m, K)

    def on_time_at(self, time_s: Array) -> Array:
        """Commanded on-time (n, K) at the last reading before or at each time."""
        return self.on_time_s[self.reading(time_s)]

    def pulses_at(self, time_s: Array) -> Array:
        """Pulses (n, K) at the last reading before or at each time."""
        return self.pulses[self.reading(time_s)]

    def reading(self, time_s: Array) -> NDArray[np.intp]:
        """Place of the last reading before or at each time."""
        place = np.searchsorted(self.counter_time_s, time_s + SAME_S, side="right") - 1
        return np.maximum(place, 0)


@dataclass(frozen=True)
class ExtraColumn:
    """A scalar column of an effect: its name and its values (n,) at the rows.

    ``over_trapezoids`` is its integral over that by trapezoids, from row to row: of a swing of
    frequency f and rows Δ apart tan(π f Δ)/(π f Δ), of all that is slow one.
    """

    name: str
    values: Callable[[RowContext], Array]
    over_trapezoids: float = 1.0


@dataclass(frozen=True)
class Sampling:
    """How telemetry is turned into columns.

    ``pulse_reference_s`` are the τ_delay, τ_rise, τ_fall at which pulses are exact;
    ``guard_s`` is how long after its end a pulse may still deliver momentum, ``duration_s`` the
    time of the last row. ``corner_rad`` is what a trapezoid of wheel rates may miss of a turn, in
    rad of the wheel, ``corner_rad_s`` the second difference of wheel rates that is no noise.
    ``reference_noise`` are noise levels, by name, of about the right size: all hypotheses of an
    event have the same measure of flat motion (:mod:`cassini_bayes.balance.flat_motion`). Those of
    ``noise_to_see`` are taken from the event where it shows them (:mod:`.channel_noise`).
    ``widths_s`` are what pulses of the event are like, all as likely, ``unsure_s`` how well the
    on-time of a firing is known (:class:`.PulseBasis`), and
    ``gaps_s`` the times after which close ones follow (without, a control cycle), ``paired_s`` the
    widths of pulses, means over firings, all as likely (without, pulses of steady thrust). With a
    ``block_s``, rows are means over blocks of that length of those at readings of the counters,
    ``block_rows`` of them usually, whatever is still being delivered then (:mod:`.late`).
    ``levels`` are roundings of counters that are unknowns.
    """

    pulse_shape: PulseShape
    pulse_reference_s: tuple[float, float, float]
    guard_s: float
    couples: tuple[tuple[int, ...], ...]  # thrusters (places) that only ever fire together
    duration_s: float
    extra: tuple[ExtraColumn, ...] = ()
    control_cycle_s: float = 0.0  # pulses start with control cycles
    corner_rad: float = np.inf
    corner_rad_s: float = np.inf
    reference_noise: tuple[tuple[str, float], ...] = ()
    noise_to_see: tuple[str, ...] = ()
    widths_s: tuple[float, ...] = ()
    unsure_s: float = 0.0
    gaps_s: tuple[float, ...] = ()
    paired_s: tuple[float, ...] = (STEADY_S,)
    block_s: float = 0.0
    block_rows: float = 0.0
    levels: LongLevels = field(default=NO_LEVELS, compare=False)

    @property
    def close_gaps_s(self) -> Array:
        """Times (m,) after which close pulses follow, all as likely."""
        return np.array(self.gaps_s or (self.control_cycle_s,))

    @cached_property
    def pair_s2(self) -> float:
        """Variance of what a pair of pulses loses, at the reference and the usual share, s²."""
        gaps = self.close_gaps_s
        cut, fall = self.cut_tail_s(self.pulse_reference_s), self.pulse_reference_s[2]
        given = (np.array([value]) for value in (cut, fall, USUAL_SHARE))
        lost = lost_tails(gaps, self.control_cycle_s, *given)
        return max(float(lost.variance_s2[0]), LEAST_PAIR_S2)

    def cut_tail_s(
        self, tau_s: tuple[ArrayLike, ArrayLike, ArrayLike], offset_s: ArrayLike = 0.0
    ) -> Array:
        """On-time (n,), or one of numbers, s, that a pulse loses whose successor begins as it ends.

        The tail of a long one, times the thrust that the first pulse has reached and the one that
        the second reaches: (τ_f − τ_r) (1 − exp(−Δ₁/τ_r)) (1 − exp(−Δ₂/τ_r)) of a first-order
        valve. Both are taken at their mean over the widths of pairs.

        Parameters
        ----------
        tau_s
            τ_delay, τ_rise, τ_fall, each (n,) or a number.
        offset_s
            (n,) or a number, by how much pulses last longer than commanded.
        """
        return np.asarray(self.pulse_shape.tail_s(*tau_s) * self._reached(tau_s, offset_s) ** 2)

    def mean_pulse_s(
        self, tau_s: tuple[ArrayLike, ArrayLike, ArrayLike], offset_s: ArrayLike = 0.0
    ) -> Array:
        """Mean effective time, s, of the event's pulses; parameters as of :meth:`cut_tail_s`."""
        delay, rise, fall = (np.asarray(value)[..., None] for value in tau_s)
        offset = np.asarray(offset_s)[..., None]
        each = self.pulse_shape.longer_time(self.paired_s, offset, delay, rise, fall)
        return np.asarray(each.mean(axis=-1))

    def cut_by_width(self, width_s: Array) -> Array:
        """What pairs of these widths (…) lose over those of the event's, at the reference: ρ²/ρ̄².

        ρ is the thrust that a pulse reaches, ρ̄ its mean over ``paired_s``.
        """
        own = self.pulse_shape.reached(width_s, *self.pulse_reference_s)
        mean = float(self._reached(self.pulse_reference_s)) ** 2
        return np.asarray(own**2 / mean) if mean > 0.0 else np.ones_like(own)

    def _reached(
        self, tau_s: tuple[ArrayLike, ArrayLike, ArrayLike], offset_s: ArrayLike = 0.0
    ) -> Array:
        """Mean thrust, over the steady one, that the event's pulses reach."""
        delay, rise, fall = (np.asarray(value)[..., None] for value in tau_s)
        lasts = np.maximum(np.asarray(self.paired_s) + np.asarray(offset_s)[..., None], 0.0)
        return np.asarray(self.pulse_shape.reached(lasts, delay, rise, fall).mean(axis=-1))

    @cached_property
    def pulses(self) -> PulseBasis:
        """Columns and weights of pulses."""
        reference = self.pulse_reference_s
        return PulseBasis(self.pulse_shape, reference, self.widths_s, self.unsure_s)


class LostTails(NamedTuple):
    """On-time that a pair of pulses loses by a cut tail: mean (n,), s, and variance (n,), s²."""

    mean_s: Array
    variance_s2: Array


def lost_tails(
    gaps_s: Array,
    cycle_s: float,
    tail_s: Array,
    fall_s: Array,
    share: Array,
    offset_s: Array | float = 0.0,
) -> LostTails:
    """What a pair within a second loses, that is close with the probability s.

    A valve that opens again after a gap loses x = exp(−gap/τ_f) of what it loses without one
    (:meth:`.Sampling.cut_tail_s`). A close pair has one of the gaps (m,)
    seen, any other one that is half a control cycle or more longer, up to a second, all as likely.
    A pulse that goes on for longer, by an offset, shortens the gap, and what overlaps is lost as
    well, y = offset − gap. Means and variances are those over all gaps. Gaps, the cycle and time
    constants are in s; ``tail_s`` (what is lost without a gap), τ_f, s and the offset are (n,).
    """
    fall, usual = np.maximum(fall_s, LEAST_FALL_S)[:, None], gaps_s + 0.5 * cycle_s
    tail, offset = tail_s[:, None], np.reshape(offset_s, (-1, 1))
    left, overlap = np.maximum(gaps_s - offset, 0.0), np.maximum(offset - gaps_s, 0.0)
    lost = tail * np.exp(-left / fall) + overlap
    usual = usual[usual < ALIKE_S]
    first, last = np.maximum(usual - offset, 0.0), np.maximum(ALIKE_S - offset, 0.0)
    most, least = np.maximum(offset - usual, 0.0), np.maximum(offset - ALIKE_S, 0.0)

    def later(power: int) -> Array:
        """Mean (n,) over the other gaps of the power of what is lost: tail x, or tail + y."""
        tau, next_power = fall / power, power + 1
        cut = tail**power * tau * (np.exp(-first / tau) - np.exp(-last / tau))
        covered = ((tail + most) ** next_power - (tail + least) ** next_power) / next_power
        return np.asarray(((cut + covered) / (ALIKE_S - usual)).sum(axis=1) / len(gaps_s))

    mean = share * lost.mean(axis=1) + (1.0 - share) * later(1)
    square = share * (lost**2).mean(axis=1) + (1.0 - share) * later(2)
    return LostTails(mean, np.maximum(square - mean**2, 0.0))
