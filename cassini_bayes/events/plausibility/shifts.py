"""Channels that come late or early: by how much, and what is left of the misfit then."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Final, TypeVar

import numpy as np

from cassini_bayes.computing.cached import cached_property
from cassini_bayes.events.plausibility.evidence import MOST_OF_ROWS, Evidence
from cassini_bayes.events.plausibility.momentum import momentum_of
from cassini_bayes.events.plausibility.rows import LEAST_ROWS, Motion, Rows, at_times
from cassini_bayes.events.plausibility.undone import FREE_PRICE
from cassini_bayes.events.plausibility.verdict import EXPLAINED, LEAST_GAIN, PHYSICS, Explanation
from cassini_bayes.events.telemetry.rows import SAME_TIME_S

LATE_S: Final = (2.0, 5.0, 8.0, 12.0, 20.0, 32.0, 50.0, 75.0)
"""Delays that are tried first, each some 1.6 times the one before (judgement): the best is refined
from half of it to 1.8 of it, beyond both neighbours."""
PHYSICAL_LAG_S: Final = 2.5
"""Of counters: the bound of the catalogue's time_offset, which is the diagnosis's to name."""
SAME_NOISE: Final = 1.5
"""Of the noise that moved counters leave (docs/topics/plausibility.md): by trial."""
AnyRows = TypeVar("AnyRows", bound=Motion)
MOST_SHIFTS: Final = 16  # on a finer grid about the best: to a row, or an eighth of the delay


def with_noise_of_lags(evidence: Evidence) -> Evidence:
    """The same with no more noise than counters leave that come late or early.

    Firings at the wrong time look like noise, and in much noise everything fits.
    """
    shift = shift_of_counters(evidence)
    if shift is None:
        return evidence
    noises, enough = [np.inf], MOST_OF_ROWS * len(shift.rows.time_s)
    for late_s in shift.lags_s():
        moved = shift.moved(shift.rows, late_s)[1]
        if abs(late_s) > PHYSICAL_LAG_S and len(moved.time_s) >= enough:
            momentum = momentum_of(moved, evidence.nominal)
            noises.append(momentum.noise(evidence.nominal, evidence.as_recorded))
    return replace(evidence, most_noise=SAME_NOISE * min(noises))


def with_physical_lag(evidence: Evidence) -> Evidence:
    """The same with counters as late or early as leaves least, within the catalogue's bound."""
    shift = shift_of_counters(evidence)
    if shift is None:
        return evidence
    late = max(shift.physical_lags_s(), key=shift.gain, default=0.0)
    if not late or shift.gain(late) <= FREE_PRICE:
        return evidence
    return replace(evidence, rows=shift.moved(shift.rows, late)[1])


def of_shifts(evidence: Evidence, misfit: float) -> Iterator[Explanation]:
    """A channel that comes late or early, by as much as leaves least.

    A shift knows nothing of the ends, and fewer rows have less misfit: what it leaves is compared
    with what the same rows leave as they are.
    """
    rows, motion = evidence.rows, evidence.motion
    if rows is None or motion is None:
        return
    turned = evidence.turned()
    as_is: dict[float, float] = {}
    still: dict[float, float] = {}
    for name, what in _SHIFTED.items():
        of_motion = name in _OF_MOTION
        if of_motion and not turned:
            continue  # attitudes and rates are of one clock
        if not of_motion and turned > EXPLAINED * misfit:
            continue  # that is left whatever wheels and counters do
        if name == "counter-time" and not evidence.nominal.torques.shape[1]:
            continue
        shift = Shift(evidence, rows, motion, name, as_is, still)
        grid = {late: shift.share(late) for late in shift.lags_s()}
        if not grid:
            return  # rows further apart than any shift that is asked about
        near = min(grid, key=lambda late: grid[late])
        step_s = max(shift.row_s, 2.0 * abs(near) / MOST_SHIFTS)
        for late in np.arange(0.5, 1.8, step_s / abs(near)) * near:
            whole = float(np.round(late / step_s) * step_s)
            if whole not in grid:
                grid[whole] = shift.share(whole)
        late = min(grid, key=lambda late: grid[late])
        if shift.gain(late) < LEAST_GAIN + FREE_PRICE:
            continue
        if abs(late) <= PHYSICAL_LAG_S and name != "counter-time":
            continue  # a boom's oscillation, too, looks like that
        # a lag is found to a row; so much of it may be rounding
        physical = name == "counter-time" and abs(late) <= PHYSICAL_LAG_S + shift.row_s
        mistake, fix = PHYSICS if physical else name, "bring all channels to the same clock"
        what = f"{what} that come {abs(late):.3g} s {late_or_early(late)}"
        yield Explanation(mistake, what, fix, misfit * grid[late], FREE_PRICE)


def late_or_early(late_s: float) -> str:
    """In words."""
    return "late" if late_s > 0.0 else "early"


def of_physical_lags(evidence: Evidence) -> Iterator[Explanation]:
    """Counters as late or early as the catalogue has them: no mistake.

    The balance holds a lag to first order, which is not enough where pulses come quickly.
    """
    shift = shift_of_counters(evidence)
    if shift is None:
        return
    misfit = evidence.misfit()
    for late in shift.physical_lags_s():
        what = f"counters that come {late:.3g} s late"
        yield Explanation(PHYSICS, what, "", misfit * shift.share(late), FREE_PRICE)


_SHIFTED: Final = {
    "wheel-time": "wheel rates",
    "rate-time": "body rates",
    "counter-time": "counters",
    "attitude-time": "attitudes",
}
_OF_MOTION: Final = ("rate-time", "attitude-time")


@dataclass(frozen=True, eq=False)
class Shift:
    """One channel moved in time: misfits of the rows that it still knows.

    ``as_is`` are misfits of rows as they are, by what a shift takes off their ends: the same for
    all channels but counters, which are not known in between. ``still`` are those of motion alone,
    which wheels and counters have no part in.
    """

    evidence: Evidence
    rows: Rows
    motion: Motion
    name: str
    as_is: dict[float, float] = field(default_factory=dict)
    still: dict[float, float] = field(default_factory=dict)
    known: dict[float, tuple[float, float]] = field(default_factory=dict)

    @cached_property
    def row_s(self) -> float:
        """Time from row to row."""
        return float(np.median(np.diff(self.motion.time_s)))

    def lags_s(self) -> list[float]:
        """Lags to begin with, in whole rows: between two of them counters are seldom known."""
        rows = sorted({round(late / self.row_s) for late in LATE_S} - {0})
        return [self.row_s * n for n in (*(-n for n in rows), *rows)]

    def physical_lags_s(self) -> list[float]:
        """Whole rows that counters may be late by."""
        number = int(PHYSICAL_LAG_S / self.row_s)
        return [self.row_s * n for n in range(-number, number + 1) if n]

    def share(self, late_s: float) -> float:
        """What the shift leaves of the misfit of the same rows; 1 where none is."""
        before, after = self._misfits(late_s)
        return after / before if before > 0.0 else 1.0

    def gain(self, late_s: float) -> float:
        """Misfit that it removes."""
        before, after = self._misfits(late_s)
        return before - after

    def raises(self, late_s: float) -> float:
        """By how much it raises the evidence of the rows that it knows, as 2 log."""
        nominal, nothing = self.evidence.nominal, self.evidence.as_recorded
        as_is, shifted = self.moved(self.rows, late_s)
        if len(as_is.time_s) < LEAST_ROWS:
            return -np.inf
        rows, moved = (replace(self.evidence, rows=each).momentum for each in (as_is, shifted))
        assert rows is not None
        assert moved is not None
        noise = min(each.noise(nominal, nothing) for each in (rows, moved))
        return rows.evidence(nominal, noise) - moved.evidence(nominal, noise)

    def _misfits(self, late_s: float) -> tuple[float, float]:
        """Of rows that the shift knows: as they are, and with the channel moved back."""
        if late_s not in self.known:
            rows, moved = self.moved(self.rows, late_s)
            motion = self.moved(self.motion, late_s)
            if len(rows.time_s) < LEAST_ROWS:
                return 0.0, 0.0
            pairs = [
                replace(self.evidence, rows=r, motion=m)
                for r, m in zip((rows, moved), motion, strict=True)
            ]
            off_s = abs(late_s)
            if off_s not in self.still:
                self.still[off_s] = pairs[0].turned()
            before = self._as_is(pairs[0], off_s)
            turned = None if self.name in _OF_MOTION else self.still[off_s]
            self.known[late_s] = before, pairs[1].misfit(turned=turned)
        return self.known[late_s]

    def _as_is(self, evidence: Evidence, off_s: float) -> float:
        """Misfit of rows that are not moved, worked out once for all channels."""
        if self.name == "counter-time":
            return evidence.misfit(turned=self.still[off_s])
        if off_s not in self.as_is:
            self.as_is[off_s] = evidence.misfit(turned=self.still[off_s])
        return self.as_is[off_s]

    def moved(self, rows: AnyRows, late_s: float) -> tuple[AnyRows, AnyRows]:
        """Rows that the shift knows, as they are and had the channel not come late."""
        rows = _within(rows, abs(late_s))
        at, source = rows.time_s + late_s, self.motion
        if self.name == "rate-time":
            rates = at_times(at, source.time_s, source.rate_rad_s)
            return rows, replace(rows, rate_rad_s=rates)
        if self.name == "attitude-time":
            attitude = at_times(at, source.time_s, source.attitude)
            attitude = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
            return rows, replace(rows, attitude=attitude)
        if not isinstance(rows, Rows):
            return rows, rows
        whole = self.rows
        if self.name == "wheel-time":
            return rows, replace(rows, wheel_rpm=at_times(at, whole.time_s, whole.wheel_rpm))
        # counters are known where they were read, and between equal readings
        after = np.clip(np.searchsorted(whole.time_s, at - SAME_TIME_S), 1, len(whole.time_s) - 1)
        counters = np.concatenate([whole.on_time_s, whole.pulses], axis=1)
        exact = np.abs(whole.time_s[after] - at) < SAME_TIME_S
        known = exact | (counters[after] == counters[after - 1]).all(axis=1)
        moved = replace(rows, on_time_s=whole.on_time_s[after], pulses=whole.pulses[after])
        return rows.only(known), moved.only(known)


def shift_of_counters(evidence: Evidence) -> Shift | None:
    """Counters moved in time; None where there are none, or no motion to time them by."""
    rows, motion = evidence.rows, evidence.motion
    if rows is None or motion is None or not evidence.nominal.torques.shape[1]:
        return None
    return Shift(evidence, rows, motion, "counter-time")


def _within(rows: AnyRows, margin_s: float) -> AnyRows:
    """Rows away from both ends, where a shift knows nothing."""
    time = rows.time_s
    if not len(time):
        return rows
    return rows.only((time >= time[0] + margin_s) & (time <= time[-1] - margin_s))
