"""What physics leaves of an event's rows and motion, whatever mistake is undone in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.events.plausibility.cells import TAIL_S
from cassini_bayes.events.plausibility.departures import WIDTHS, Correction, Nominal
from cassini_bayes.events.plausibility.momentum import Momentum, MomentumFit, momentum_of
from cassini_bayes.events.plausibility.rows import Motion, Rows, at_times
from cassini_bayes.events.plausibility.turning import BY_CHANCE, INSTRUMENTS, Turning, turning_of

CHANCE_SIGMAS: Final = 4.0
"""Of the χ² of turns, whose noise is itself measured on some forty steps."""
MOST_OF_ROWS: Final = 0.3
"""Of the rows: fewer are not asked for their noise (judgement)."""
SELDOM_QUIET: Final = 0.25
"""Of the rows, between firings: where more are, others do not decide. Biases of a craft with cycles
of 0.2 s, which had been refused, have 0.08 to 0.21 (tests/events/test_plausibility.py)."""
LEAST_QUIET: Final = 30  # rows between firings that are judged by themselves (judgement)
QUIET_SPAN: Final = 0.5  # of the event, that they have to span


@dataclass(frozen=True, eq=False)
class Evidence:
    """An event's rows and motion, and what physics leaves of them."""

    nominal: Nominal
    motion: Motion | None
    rows: Rows | None
    along: Array | None = None  # (3,) of :func:`momentum_of`
    most_noise: float = np.inf  # of a row in N m s, if something is known of it
    swing_hz: float = 0.0  # of a boom that may oscillate; 0: of none

    @cached_property
    def turning(self) -> Turning | None:
        """Turns against rates."""
        if self.motion is None:
            return None
        return turning_of(self.motion, *self._given_rad_s)

    @property
    def _given_rad_s(self) -> tuple[Array, Array] | tuple[()]:
        """Rates of the body by the wheels alone (n, 3), and by thrusters either way (2, n, 3).

        Empty where nothing fires.
        """
        rows, motion, nominal = self.rows, self.motion, self.nominal
        if rows is None or motion is None or not np.any(np.ptp(rows.pulses, axis=0) > 0.0):
            return ()
        momentum = -nominal.of_wheels(rows.wheel_rpm)
        thrust_s = nominal.thrust_s(rows)
        quickens = np.linalg.solve(nominal.inertia, nominal.torques)
        wheels, *fired = (
            at_times(motion.time_s, rows.time_s, np.asarray(each, dtype=np.float64))
            for each in (
                np.linalg.solve(nominal.inertia, momentum.T).T,
                thrust_s @ np.maximum(quickens, 0.0).T,
                thrust_s @ np.minimum(quickens, 0.0).T,
            )
        )
        return wheels, np.stack(fired)

    @cached_property
    def momentum(self) -> Momentum | None:
        """Columns of the balance."""
        if self.rows is None:
            return None
        found = momentum_of(self.rows, self.nominal, self.along, self.swing_hz, self._bias_rad_s)
        return replace(found, most_noise=self.most_noise)

    @property
    def _bias_rad_s(self) -> Array | None:
        """Of body rates: no more than the catalogue's, and no more than turns of attitude leave."""
        turning = self.turning
        return None if turning is None else np.minimum(turning.bias_rad_s, WIDTHS["bias"])

    @cached_property
    def as_recorded(self) -> Correction:
        """Nothing corrected."""
        return Correction.nothing(self.nominal)

    def balance(self, correction: Correction | None = None) -> MomentumFit | None:
        """The momentum balance with a correction."""
        if self.momentum is None:
            return None
        return self.momentum.fit(self.nominal, correction or self.as_recorded)

    def excess(self, correction: Correction | None = None) -> float:
        """What it costs to close that balance; 0 without one."""
        fit = self.balance(correction)
        return 0.0 if fit is None else fit.excess

    def excess_across(self, axis: Array) -> float:
        """What it costs where nothing is known along a body axis (3,)."""
        return replace(self, along=axis).excess()

    def turned(self, rate: Array | None = None, axes: Sequence[int] = (0, 1, 2)) -> float:
        """What turns say against rates, beyond what chance makes of it: by size, by alignment."""
        if self.turning is None:
            return 0.0
        rate = np.eye(3) if rate is None else rate
        moments = INSTRUMENTS * len(axes)
        chance = moments + CHANCE_SIGMAS * np.sqrt(2.0 * moments)
        sizes = self.turning.misfit(rate, axes) - float(chance)
        return max(sizes, self.turning.misaligned(rate, axes) - BY_CHANCE, 0.0)

    def misfit(self, correction: Correction | None = None, turned: float | None = None) -> float:
        """Misfit of motion and momentum; ``turned``: that of motion, where it is known already."""
        correction = correction or self.as_recorded
        turned = self.turned(correction.rate) if turned is None else turned
        return self.excess(correction) + turned


def with_swing(evidence: Evidence) -> Evidence:
    """The same with a boom that may swing, at the frequency at which most stays open."""
    if evidence.momentum is None or evidence.rows is None:
        return evidence
    line = evidence.momentum.swing_hz(evidence.nominal, evidence.rows.time_s)
    return replace(evidence, swing_hz=line)


def without_cut_pulses(evidence: Evidence) -> Evidence:
    """The same without rows amid a pulse, if enough stay: the next has on-time of no new pulse.

    Such a row counts the pulse, and its tail with it, and has neither the rest of it nor the tail.
    """
    rows = evidence.rows
    if rows is None:
        return evidence
    gained, begun = np.diff(rows.on_time_s, axis=0), np.diff(rows.pulses, axis=0)
    whole = np.append(~np.any((gained > 0.0) & (begun == 0.0), axis=1), True)
    if whole.all() or whole.mean() < MOST_OF_ROWS:
        return evidence
    return replace(evidence, rows=rows.only(whole))


def between_firings(evidence: Evidence) -> Evidence:
    """The same without rows before or after which something fired, if enough stay.

    Rows in step with the control cycle may all lack the tails of what fired just before. More than
    the tails of a couple stay open by something else.
    """
    rows, balance = evidence.rows, evidence.balance()
    if rows is None or balance is None:
        return evidence
    couple = 2.0 * np.linalg.norm(evidence.nominal.torques, axis=0).max(initial=0.0)
    if balance.open_nms > TAIL_S * couple:
        return evidence
    counters = np.concatenate([rows.on_time_s, rows.pulses], axis=1)
    fires = np.any(np.diff(counters, axis=0) != 0.0, axis=1)
    quiet = ~np.r_[True, fires] & ~np.r_[fires, True]
    if quiet.mean() > SELDOM_QUIET or quiet.sum() < LEAST_QUIET:
        return evidence
    if np.ptp(rows.time_s[quiet]) < QUIET_SPAN * np.ptp(rows.time_s):
        return evidence
    return replace(evidence, rows=rows.only(quiet))
