"""Mistakes that telemetry may hold, each undone and scored by the misfit that it leaves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations, product
from typing import Final, TypeVar

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.events.plausibility.attitudes import CONVENTIONS
from cassini_bayes.events.plausibility.cells import TAIL_S
from cassini_bayes.events.plausibility.momentum import (
    WIDTHS,
    Correction,
    Momentum,
    MomentumFit,
    Nominal,
    momentum_of,
)
from cassini_bayes.events.plausibility.rows import LEAST_ROWS, Motion, Rows
from cassini_bayes.events.plausibility.turning import BY_CHANCE, INSTRUMENTS, Turning, turning_of
from cassini_bayes.events.plausibility.undone import (
    FREE_PRICE,
    LEAST_FACTOR_STEP,
    ORDER_PRICE,
    Undone,
    of_counters,
    of_late_wheels,
    of_wheels,
)
from cassini_bayes.events.plausibility.verdict import (
    AS_GOOD,
    EXPLAINED,
    LEAST_GAIN,
    MOST_NAMED,
    PHYSICS,
    SUSPECT,
    Explanation,
)
from cassini_bayes.events.telemetry.rows import SAME_TIME_S
from cassini_bayes.events.totals import SHORTEST_PULSE_S

SILENT: Final = 1.5
"""Factor of misfits: without one axis of three, noise-free ones are two thirds as large."""
LEAST_STILL: Final = 0.4
"""Of the event: how long a channel has to stand still before it is asked whether it is stuck:
longer than wheels keep their rates at the end of a bias (judgement)."""
RATE_UNITS: Final = {
    "deg/s": np.pi / 180.0,
    "mrad/s": 1e-3,
    "µrad/s": 1e-6,
    "arcsec/s": np.pi / 648_000.0,
    "rad/s turned from deg/s twice": 180.0 / np.pi,
}
ON_TIME_UNITS: Final = {"ms": 1e-3, "min": 60.0}
TIME_UNITS: Final = {"ms": 1e-3, "min": 60.0, "h": 3600.0, "d": 86_400.0, "µs": 1e-6}
LATE_S: Final = (2.0, 5.0, 8.0, 12.0, 20.0, 32.0, 50.0, 75.0)
"""Delays that are tried first, each some 1.6 times the one before (judgement): the best is refined
from half of it to 1.8 of it, beyond both neighbours."""
CHANCE_SIGMAS: Final = 4.0
"""Of the χ² of turns, whose noise is itself measured on some forty steps."""
PHYSICAL_LAG_S: Final = 2.5
"""Of counters: the bound of the catalogue's time_offset, which is the diagnosis's to name."""
AXES: Final = "xyz"
MOST_OF_ROWS: Final = 0.3
"""Of the rows: fewer are not asked for their noise (judgement)."""
SELDOM_QUIET: Final = 0.25
"""Of the rows, between firings: where more are, others do not decide. Biases of a craft with cycles
of 0.2 s, which had been refused, have 0.08 to 0.21 (tests/events/test_plausibility.py)."""
LEAST_QUIET: Final = 30  # rows between firings that are judged by themselves (judgement)
QUIET_SPAN: Final = 0.5  # of the event, that they have to span
SAME_NOISE: Final = 1.5
"""Of the noise that moved counters leave (docs/topics/plausibility.md): by trial."""
AnyRows = TypeVar("AnyRows", bound=Motion)
WRONG_TURNS: Final = 10.0
"""Misfit of turns and rates below which nothing is wrong with rates or the unit of time: 125 honest
events had 7 at most, 32 with a gyro scale of 2 % in slews (docs/topics/plausibility.md)."""
MOST_SHIFTS: Final = 16  # on a finer grid about the best: to a row, or an eighth of the delay
BESIDE: Final = 1.4
"""Factor between a unit of wheel rates and what it has to fit better than: units are further
apart (the nearest two, deg/s and rev/min turned twice, by 1.59)."""
SHARPER: Final = 5.0
"""Misfit that these have to leave beyond it: half of what tells two mistakes apart (AS_GOOD). With
none, a unit that takes the wheels out of the balance would be named."""
MOST_FACTOR: Final = 5.0
"""Of body rates: where instruments are weak, a factor of 0.03 may fit by chance (by trial)."""
RATE_FIX: Final = "give rate_…_rad_s about the body axes, in rad/s"
LIKELIER: Final = 18.0
"""Twice the logarithm of a ratio of evidences, nine nats: honest events gain 11 at most."""


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
        """Rates (n, 3) of the body by the wheels alone and by thrusters alone, where these fire."""
        rows, motion, nominal = self.rows, self.motion, self.nominal
        if rows is None or motion is None or not np.any(np.ptp(rows.pulses, axis=0) > 0.0):
            return ()
        thrust_s = nominal.thrust_s(rows)
        momenta = -nominal.of_wheels(rows.wheel_rpm), thrust_s @ nominal.torques.T
        rates = (np.linalg.solve(nominal.inertia, each.T).T for each in momenta)
        wheels, fired = (
            _between(motion.time_s, rows.time_s, np.asarray(each, dtype=np.float64))
            for each in rates
        )
        return wheels, fired

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


def with_noise_of_lags(evidence: Evidence) -> Evidence:
    """The same with no more noise than counters leave that come late or early.

    Firings at the wrong time look like noise, and in much noise everything fits.
    """
    shift = _shift_of_counters(evidence)
    if shift is None:
        return evidence
    noises, enough = [np.inf], MOST_OF_ROWS * len(shift.rows.time_s)
    for late_s in shift.lags_s():
        moved = shift.moved(shift.rows, late_s)[1]
        if abs(late_s) > PHYSICAL_LAG_S and len(moved.time_s) >= enough:
            momentum = momentum_of(moved, evidence.nominal)
            noises.append(momentum.noise(evidence.nominal, evidence.as_recorded))
    return replace(evidence, most_noise=SAME_NOISE * min(noises))


def explanations(
    evidence: Evidence, wheels: Sequence[int], thrusters: Sequence[str]
) -> Iterator[Explanation]:
    """Every mistake, undone at its best."""
    found = [
        *_of_wheels(evidence, wheels),
        *_of_silent_channels(evidence, wheels),
        *_of_thrusters(evidence, thrusters),
        *_of_rates(evidence),
        *_of_attitudes(evidence),
        *_of_units_of_time(evidence),
        *_of_physical_lags(evidence),
    ]
    yield from found
    # the search for a shift takes longest, and its price may rule it out beforehand
    if min((each.score for each in found), default=np.inf) + AS_GOOD >= FREE_PRICE:
        yield from _of_shifts(evidence, evidence.misfit())


def _of_wheels(evidence: Evidence, wheels: Sequence[int]) -> Iterator[Explanation]:
    if evidence.rows is None:
        return
    for each in of_wheels(evidence.as_recorded, evidence.nominal, wheels, evidence.rows):
        yield from _scored(evidence, each)


def _scored(evidence: Evidence, undone: Undone) -> Iterator[Explanation]:
    """An explanation by what misfit it leaves; none where a free factor is as good as 1."""
    fit = evidence.balance(undone.correction)
    assert fit is not None
    if undone.is_unit and not _is_sharp(evidence, undone.correction, fit.excess):
        return
    sized = undone.sized(float(fit.factors[0]) if len(fit.factors) else 1.0)
    if sized is not None:
        left = fit.excess + evidence.turned()
        yield Explanation(sized.mistake, sized.what, sized.fix, left, sized.price)


def _is_sharp(evidence: Evidence, correction: Correction, excess: float) -> bool:
    """Whether a unit that makes wheel rates smaller fits better than factors nearby do.

    Small enough a factor takes the wheels out of the balance; then all small ones fit alike.
    """
    wheel = correction.wheel
    if np.trace(wheel) >= len(wheel):
        return True
    nearby = (replace(correction, wheel=k * wheel) for k in (1.0 / BESIDE, BESIDE))
    beside = [evidence.balance(each) for each in nearby]
    return all(fit is not None and fit.excess > excess + SHARPER for fit in beside)


@dataclass(frozen=True, eq=False)
class Likelier:
    """A mistake of wheels or counters by how much likelier than physics it makes an event.

    ``gain`` is twice the logarithm of the ratio of the evidences, less its price.
    """

    undone: Undone
    gain: float


def by_evidence(
    evidence: Evidence, wheels: Sequence[int], thrusters: Sequence[str]
) -> list[Likelier]:
    """Mistakes of wheels and counters, the likeliest first.

    The torque that wanders is as large as the event itself says. Units are left out: in another
    unit the noise of the wheels has another size, and the evidence is not that of the same data.
    """
    rows, momentum, nominal = evidence.rows, evidence.momentum, evidence.nominal
    if rows is None or momentum is None:
        return []
    nothing = evidence.as_recorded
    undone = [
        *(each for each in of_wheels(nothing, nominal, wheels, rows) if not each.is_unit),
        *of_counters(nothing, nominal, thrusters),
        of_late_wheels(nothing),
    ]
    gains, sizes = momentum.gains(nominal, [each.correction for each in undone])
    found = []
    for each, gain, size in zip(undone, gains.tolist(), sizes.tolist(), strict=True):
        sized = each.sized(1.0 + size)
        if sized is not None:
            found.append(Likelier(sized, gain - sized.price))
    return sorted(found, key=lambda each: -each.gain)


def likeliest(
    evidence: Evidence, wheels: Sequence[int], thrusters: Sequence[str]
) -> tuple[Explanation, ...]:
    """What makes an event much likelier than physics does, with a swing and lags as physics.

    Empty if nothing does, or if even then more is left than of an honest event.
    """
    found = by_evidence(evidence, wheels, thrusters)
    if not _are_likely(found) or evidence.turned() > WRONG_TURNS:
        return ()  # where rates or attitudes are wrong the balance says nothing of wheels
    for with_more in (with_swing, _with_physical_lag):
        found = by_evidence(with_more(evidence), wheels, thrusters)
        if not _are_likely(found):
            return ()
    if found[0].undone.correction.wheel_lag:
        return _late_wheels(evidence, found[0].undone)
    close = [each.undone for each in found if each.gain > found[0].gain - AS_GOOD]
    explained = [
        one
        for undone in close
        if not undone.correction.wheel_lag
        for one in _scored(evidence, undone)
    ]
    # what is likelier must also close the balance: quick firing leaves more than any mistake here
    recorded = evidence.misfit()
    if thrusters:
        most = min(SUSPECT, recorded - 0.5 * LIKELIER)
    else:
        most = max(SUSPECT, min(recorded - LIKELIER, 2.0 * SUSPECT))
    return tuple(each for each in explained if each.left <= most)[:MOST_NAMED]


def _are_likely(found: Sequence[Likelier]) -> bool:
    return bool(found) and found[0].gain >= LIKELIER


def likelier_rates(evidence: Evidence) -> tuple[Explanation, ...]:
    """A factor of body rates that makes turns much likelier; empty if none does."""
    turning = evidence.turning
    if turning is None:
        return ()
    recorded, found = turning.misfit(np.eye(3)), []
    for what, matrix, factor in _rate_factors(turning):
        if MOST_FACTOR**-1 < factor < MOST_FACTOR:
            gain = recorded - turning.misfit(matrix) - FREE_PRICE
            left = evidence.turned(matrix)
            found.append((gain, Explanation("rate-factor", what, RATE_FIX, left, FREE_PRICE)))
    gain, best = max(found, key=lambda each: each[0], default=(0.0, None))
    return () if best is None or gain < LIKELIER or best.left > WRONG_TURNS else (best,)


def with_scaled_rates(evidence: Evidence, best: Sequence[Explanation]) -> tuple[Explanation, ...]:
    """The best explanations, and doubled or halved body rates where they explain as much.

    Momentum does not speak of the size of rates, whose noise changes with them, but what looks like
    a wheel of another size may be rates of another size: then both are said.
    """
    if not best or best[0].mistake not in _LIKE_SCALED_RATES:
        return tuple(best)
    nothing, found = evidence.as_recorded, list(best)
    for factor in (0.5, 2.0):
        left = evidence.misfit(replace(nothing, rate=factor * np.eye(3)))
        if left <= best[0].left + AS_GOOD:
            what = f"body rates that have to be multiplied by some {factor:g}"
            found.append(Explanation("rate-factor", what, RATE_FIX, left, best[0].price))
    return tuple(sorted(found, key=lambda each: each.score))


_LIKE_SCALED_RATES: Final = ("wheel-factor", "wheel-unit")


def _late_wheels(evidence: Evidence, undone: Undone) -> tuple[Explanation, ...]:
    """Wheels that come late by as much as makes the event likeliest."""
    rows, motion = evidence.rows, evidence.motion
    assert rows is not None
    assert motion is not None
    shift = _Shift(evidence, rows, motion, "wheel-time")
    late = max(shift.lags_s(), key=shift.raises, default=0.0)
    if abs(late) <= PHYSICAL_LAG_S or shift.raises(late) < LIKELIER + FREE_PRICE:
        return ()
    what = f"{undone.what} that come some {abs(late):.3g} s {_late_or_early(late)}"
    left = evidence.misfit() * shift.share(late)
    return (Explanation(undone.mistake, what, undone.fix, left, undone.price),)


def _with_physical_lag(evidence: Evidence) -> Evidence:
    """The same with counters as late or early as leaves least, within the catalogue's bound."""
    shift = _shift_of_counters(evidence)
    if shift is None:
        return evidence
    late = max(shift.physical_lags_s(), key=shift.gain, default=0.0)
    if not late or shift.gain(late) <= FREE_PRICE:
        return evidence
    return replace(evidence, rows=shift.moved(shift.rows, late)[1])


def _of_silent_channels(evidence: Evidence, wheels: Sequence[int]) -> Iterator[Explanation]:
    """A wheel or a body rate that stands still may be anything: the rest has to fit."""
    rows, nominal = evidence.rows, evidence.nominal
    if rows is None:
        return
    long_s = LEAST_STILL * (rows.time_s[-1] - rows.time_s[0])
    for w, number in enumerate(wheels):
        column = rows.wheel_rpm[:, w]
        repeated = [
            other
            for place, other in enumerate(nominal.wheel_names)
            if place != w and np.array_equal(column, rows.wheel_rpm[:, place])
        ]
        stood_s = _stood_still_s(rows.time_s, column)
        if repeated:
            what = f"repeats {repeated[0]}_rpm"
        elif stood_s > long_s:
            what = f"stands still for {stood_s:.4g} s"
        else:
            continue
        what = f"a column {nominal.wheel_names[w]}_rpm that {what}"
        fix = f"give the rate of wheel {number}"
        excess = SILENT * evidence.excess_across(nominal.spins[:, w])
        if _lies_along(evidence, nominal.spins[:, w], excess):
            left = excess + evidence.turned()
            yield Explanation("wheel-silent", what, fix, left, ORDER_PRICE)
    for axis in range(3):
        stood_s = _stood_still_s(rows.time_s, rows.rate_rad_s[:, axis])
        if stood_s > long_s:
            others = [a for a in range(3) if a != axis]
            excess = evidence.excess_across(nominal.inertia[:, axis])
            left = SILENT * (excess + evidence.turned(axes=others))
            what = f"a column rate_{AXES[axis]}_rad_s that stands still for {stood_s:.4g} s"
            fix = "give the body rate about that axis"
            yield Explanation("rate-silent", what, fix, left, ORDER_PRICE)


def _lies_along(evidence: Evidence, axis: Array, excess: float) -> bool:
    """Whether what is wrong with the momentum is along an axis (3,), across which ``excess`` is.

    Any axis less is a third of the rows less, and something of a misfit goes with it. Both axes at
    right angles have to leave more, by as much as a mistake has to explain.
    """
    others = np.linalg.svd(axis[None])[2][1:]
    return min(evidence.excess_across(other) for other in others) >= excess + LEAST_GAIN


def _stood_still_s(time_s: Array, values: Array) -> float:
    """The longest time over which a value never changes."""
    changes = np.flatnonzero(np.diff(values)) + 1
    edges = np.concatenate([[0], changes, [len(values) - 1]])
    return float(np.diff(time_s[edges]).max())


def _of_thrusters(evidence: Evidence, thrusters: Sequence[str]) -> Iterator[Explanation]:
    if evidence.momentum is None or not thrusters:
        return
    nothing, still = evidence.as_recorded, evidence.turned()
    for unit, factor in on_time_units(evidence.rows).items():
        what, fix = f"on-times that look like {unit}", "give on_time_…_s in seconds"
        left = evidence.excess(replace(nothing, on_time=factor)) + still
        yield Explanation("on-time-unit", what, fix, left)
    for each in of_counters(nothing, evidence.nominal, thrusters):
        yield from _scored(evidence, each)


def on_time_units(rows: Rows | None) -> dict[str, float]:
    """Units that recorded on-times may be in, and their seconds.

    Momentum alone does not tell: tails of pulses could take the place of on-times. But no counter
    gains more than the time that passes, and no pulse is shorter than a valve allows.
    """
    if rows is None:
        return {}
    span_s = float(rows.time_s[-1] - rows.time_s[0])
    gained = rows.on_time_s[-1] - rows.on_time_s[0]
    return impossible_units(gained, rows.pulses[-1] - rows.pulses[0], span_s)


def impossible_units(on_time_s: Array, pulses: Array, span_s: float) -> dict[str, float]:
    """Units, in seconds, of on-times (K,) that cannot be seconds: of so many pulses in a time."""
    units = {}
    if float(on_time_s.max(initial=0.0)) > span_s:
        units["ms"] = ON_TIME_UNITS["ms"]
    if are_too_short(on_time_s, pulses):
        units["min"] = ON_TIME_UNITS["min"]
    return units


def are_too_short(on_time_s: Array, pulses: Array) -> bool:
    """Whether on-times (K,) of so many pulses are shorter than a valve allows: in a longer unit."""
    return 0.0 < float(on_time_s.sum()) < SHORTEST_PULSE_S * float(pulses.sum())


def _of_rates(evidence: Evidence) -> Iterator[Explanation]:
    turning, nothing = evidence.turning, evidence.as_recorded
    if turning is None:
        return
    known = evidence.turned() > WRONG_TURNS
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.diag(signs)[:, list(order)]
        plain = order == (0, 1, 2)
        if plain and min(signs) > 0.0:
            continue
        turned = evidence.turned(matrix)
        # motion speaks against it: momentum need not be asked
        if turned > (0.5 * evidence.turned() if known else WRONG_TURNS):
            continue
        # column j of the file holds what belongs in row i where matrix[i, j] is set
        held = "".join(
            f"{'-' if matrix[:, j].sum() < 0.0 else ''}{AXES[int(np.argmax(np.abs(matrix[:, j])))]}"
            for j in range(3)
        )
        mistake = "rate-sign" if plain else "rate-axes"
        what = f"columns of body rates x, y, z that look like {held}"
        left = evidence.misfit(replace(nothing, rate=matrix))
        yield Explanation(mistake, what, RATE_FIX, left, ORDER_PRICE)
    # momentum alone does not speak of sizes: another factor changes the rates' noise with them
    if not known:
        return
    for unit, factor in RATE_UNITS.items():
        what = f"body rates that look like {unit} (times {factor:.4g})"
        left = evidence.misfit(replace(nothing, rate=factor * np.eye(3)))
        yield Explanation("rate-unit", what, RATE_FIX, left)
    for what, matrix, _ in _rate_factors(turning):
        left = evidence.misfit(replace(nothing, rate=matrix))
        yield Explanation("rate-factor", what, RATE_FIX, left, FREE_PRICE)


def _rate_factors(turning: Turning) -> Iterator[tuple[str, Array, float]]:
    """Body rates that need a factor in words, as a matrix (3, 3), and the one that fits best."""
    for axes in ((0, 1, 2), (0,), (1,), (2,)):
        factor = turning.factor(axes)
        if not np.isfinite(factor) or abs(factor - 1.0) < 0.5 * LEAST_FACTOR_STEP:
            continue
        matrix = np.eye(3)
        matrix[list(axes), list(axes)] = factor
        about = "" if len(axes) == 3 else f" about {AXES[axes[0]]}"
        yield f"body rates{about} that have to be multiplied by {factor:.4g}", matrix, factor


def _of_attitudes(evidence: Evidence) -> Iterator[Explanation]:
    motion, rows = evidence.motion, evidence.rows
    if motion is None:
        return
    fix = "give J2000 → body, scalar last, in q1 to q4"
    for name, ours in CONVENTIONS.items():
        other = replace(
            evidence,
            motion=replace(motion, attitude=ours(motion.attitude)),
            rows=None if rows is None else replace(rows, attitude=ours(rows.attitude)),
        )
        what = f"quaternions that look {name}"
        yield Explanation("attitude-convention", what, fix, other.misfit(), ORDER_PRICE)


def _of_units_of_time(evidence: Evidence) -> Iterator[Explanation]:
    motion, rows = evidence.motion, evidence.rows
    if motion is None or evidence.turned() < WRONG_TURNS:
        return
    for unit, factor in TIME_UNITS.items():
        other = replace(
            evidence,
            motion=replace(motion, time_s=factor * motion.time_s),
            rows=None if rows is None else replace(rows, time_s=factor * rows.time_s),
        )
        what = f"times that look like {unit}"
        yield Explanation("time-unit", what, "give time_s in seconds", other.misfit())


def _of_shifts(evidence: Evidence, misfit: float) -> Iterator[Explanation]:
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
        shift = _Shift(evidence, rows, motion, name, as_is, still)
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
        what = f"{what} that come {abs(late):.3g} s {_late_or_early(late)}"
        yield Explanation(mistake, what, fix, misfit * grid[late], FREE_PRICE)


def _late_or_early(late_s: float) -> str:
    return "late" if late_s > 0.0 else "early"


def _of_physical_lags(evidence: Evidence) -> Iterator[Explanation]:
    """Counters as late or early as the catalogue has them: no mistake.

    The balance holds a lag to first order, which is not enough where pulses come quickly.
    """
    shift = _shift_of_counters(evidence)
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
class _Shift:
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
            rates = _between(at, source.time_s, source.rate_rad_s)
            return rows, replace(rows, rate_rad_s=rates)
        if self.name == "attitude-time":
            attitude = _between(at, source.time_s, source.attitude)
            attitude = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
            return rows, replace(rows, attitude=attitude)
        if not isinstance(rows, Rows):
            return rows, rows
        whole = self.rows
        if self.name == "wheel-time":
            return rows, replace(rows, wheel_rpm=_between(at, whole.time_s, whole.wheel_rpm))
        # counters are known where they were read, and between equal readings
        after = np.clip(np.searchsorted(whole.time_s, at - SAME_TIME_S), 1, len(whole.time_s) - 1)
        counters = np.concatenate([whole.on_time_s, whole.pulses], axis=1)
        exact = np.abs(whole.time_s[after] - at) < SAME_TIME_S
        known = exact | (counters[after] == counters[after - 1]).all(axis=1)
        moved = replace(rows, on_time_s=whole.on_time_s[after], pulses=whole.pulses[after])
        return rows.only(known), moved.only(known)


def _shift_of_counters(evidence: Evidence) -> _Shift | None:
    """Counters moved in time; None where there are none, or no motion to time them by."""
    rows, motion = evidence.rows, evidence.motion
    if rows is None or motion is None or not evidence.nominal.torques.shape[1]:
        return None
    return _Shift(evidence, rows, motion, "counter-time")


def _within(rows: AnyRows, margin_s: float) -> AnyRows:
    """Rows away from both ends, where a shift knows nothing."""
    time = rows.time_s
    if not len(time):
        return rows
    return rows.only((time >= time[0] + margin_s) & (time <= time[-1] - margin_s))


def _between(at_s: Array, time_s: Array, values: Array) -> Array:
    """Values at other times, linear between rows."""
    return np.stack([np.interp(at_s, time_s, column) for column in values.T], axis=1)
