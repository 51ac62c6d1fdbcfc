"""Mistakes that make an event much likelier, where the misfit alone does not speak of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cassini_bayes.events.plausibility.evidence import Evidence, with_swing
from cassini_bayes.events.plausibility.hypotheses import (
    RATE_FIX,
    WRONG_TURNS,
    rate_factors,
    scored,
)
from cassini_bayes.events.plausibility.shifts import (
    PHYSICAL_LAG_S,
    Shift,
    late_or_early,
    with_physical_lag,
)
from cassini_bayes.events.plausibility.undone import (
    FREE_PRICE,
    Undone,
    of_counters,
    of_late_wheels,
    of_wheels,
)
from cassini_bayes.events.plausibility.verdict import AS_GOOD, MOST_NAMED, SUSPECT, Explanation

MOST_FACTOR: Final = 5.0
"""Of body rates: where instruments are weak, a factor of 0.03 may fit by chance (by trial)."""
LIKELIER: Final = 18.0
"""Twice the logarithm of a ratio of evidences, nine nats: honest events gain 11 at most."""


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
    for with_more in (with_swing, with_physical_lag):
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
        for one in scored(evidence, undone)
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
    for what, matrix, factor in rate_factors(turning):
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
    shift = Shift(evidence, rows, motion, "wheel-time")
    late = max(shift.lags_s(), key=shift.raises, default=0.0)
    if abs(late) <= PHYSICAL_LAG_S or shift.raises(late) < LIKELIER + FREE_PRICE:
        return ()
    what = f"{undone.what} that come some {abs(late):.3g} s {late_or_early(late)}"
    left = evidence.misfit() * shift.share(late)
    return (Explanation(undone.mistake, what, undone.fix, left, undone.price),)
