"""Mistakes that telemetry may hold, each undone and scored by the misfit that it leaves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations, product
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.plausibility.attitudes import CONVENTIONS
from cassini_bayes.events.plausibility.departures import Correction
from cassini_bayes.events.plausibility.evidence import Evidence
from cassini_bayes.events.plausibility.rows import Rows
from cassini_bayes.events.plausibility.shifts import of_physical_lags, of_shifts
from cassini_bayes.events.plausibility.turning import Turning
from cassini_bayes.events.plausibility.undone import (
    FREE_PRICE,
    LEAST_FACTOR_STEP,
    ORDER_PRICE,
    Undone,
    of_counters,
    of_wheels,
)
from cassini_bayes.events.plausibility.verdict import AS_GOOD, LEAST_GAIN, Explanation
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
AXES: Final = "xyz"
WRONG_TURNS: Final = 10.0
"""Misfit of turns and rates below which nothing is wrong with rates or the unit of time: 125 honest
events had 7 at most, 32 with a gyro scale of 2 % in slews (docs/topics/plausibility.md)."""
BESIDE: Final = 1.4
"""Factor between a unit of wheel rates and what it has to fit better than: units are further
apart (the nearest two, deg/s and rev/min turned twice, by 1.59)."""
SHARPER: Final = 5.0
"""Misfit that these have to leave beyond it: half of what tells two mistakes apart (AS_GOOD). With
none, a unit that takes the wheels out of the balance would be named."""
RATE_FIX: Final = "give rate_…_rad_s about the body axes, in rad/s"


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
        *of_physical_lags(evidence),
    ]
    yield from found
    # the search for a shift takes longest, and its price may rule it out beforehand
    if min((each.score for each in found), default=np.inf) + AS_GOOD >= FREE_PRICE:
        yield from of_shifts(evidence, evidence.misfit())


def _of_wheels(evidence: Evidence, wheels: Sequence[int]) -> Iterator[Explanation]:
    if evidence.rows is None:
        return
    for each in of_wheels(evidence.as_recorded, evidence.nominal, wheels, evidence.rows):
        yield from scored(evidence, each)


def scored(evidence: Evidence, undone: Undone) -> Iterator[Explanation]:
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
        yield from scored(evidence, each)


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
    for what, matrix, _ in rate_factors(turning):
        left = evidence.misfit(replace(nothing, rate=matrix))
        yield Explanation("rate-factor", what, RATE_FIX, left, FREE_PRICE)


def rate_factors(turning: Turning) -> Iterator[tuple[str, Array, float]]:
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
