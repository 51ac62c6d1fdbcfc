"""A table's own arithmetic: one record per re-computed cell, and the rule for a contradiction."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from cassini_bayes.published.printed import TIE_TOLERANCE, Interval, Printed


@dataclass(frozen=True)
class Check:
    """One printed figure against the same figure computed from other printed ones.

    Attributes
    ----------
    source, event, row, column
        The cell: e.g. ``001 Table 3.a``, ``2009-08-22-bias``, ``on_time_z1``, ``pct_abs_diff``.
    rule
        The relation that was applied.
    printed
        Values that the printed figure stands for.
    recomputed
        Values that the unrounded operands allow.
    nominal_printed, nominal_recomputed
        The printed figure, and the same from the printed operands taken as exact.
    """

    source: str
    event: str
    row: str
    column: str
    rule: str
    printed: Interval
    recomputed: Interval
    nominal_printed: float
    nominal_recomputed: float

    @property
    def contradicts(self) -> bool:
        """No unrounded operands consistent with print give the printed figure."""
        return not self.printed.meets(self.recomputed)

    @property
    def can_fail(self) -> bool:
        """Whether some printed figure would have been a contradiction (bounded interval)."""
        return math.isfinite(self.recomputed.low) and math.isfinite(self.recomputed.high)

    @property
    def matches_printed_operands(self) -> bool:
        """The printed operands, taken as exact, round to the printed figure (ties either way)."""
        low, high = self.printed.low - TIE_TOLERANCE, self.printed.high + TIE_TOLERANCE
        return low <= self.nominal_recomputed <= high


@dataclass(frozen=True)
class Contradiction:
    """A printed cell that contradicts the cells it was computed from."""

    source: str
    event: str
    row: str
    column: str
    rule: str
    printed: float
    recomputed_low: float
    recomputed_high: float


def check_cell(
    cell: Printed,
    recomputed: Interval,
    nominal: float,
    *,
    source: str,
    row: str,
    column: str,
    rule: str,
    event: str = "",
) -> Check:
    """Compare a printed cell with a recomputed interval and a nominal recomputed value."""
    return Check(source, event, row, column, rule, cell.interval, recomputed, cell.value, nominal)


def contradictions(checks: Iterable[Check]) -> tuple[Contradiction, ...]:
    """Contradicting cells, in the order of the checks."""
    return tuple(
        Contradiction(
            check.source,
            check.event,
            check.row,
            check.column,
            check.rule,
            check.nominal_printed,
            check.recomputed.low,
            check.recomputed.high,
        )
        for check in checks
        if check.contradicts
    )


def absolute(interval: Interval) -> Interval:
    """Values of |x|."""
    if interval.low >= 0.0:
        return interval
    if interval.high <= 0.0:
        return -interval
    return Interval(0.0, max(-interval.low, interval.high))


def at_least_zero(interval: Interval) -> Interval:
    """Restrict to values that are not negative."""
    return Interval(max(interval.low, 0.0), max(interval.high, 0.0))


def norm(components: Iterable[Interval]) -> Interval:
    """Length of a vector with independent components."""
    bounds = [absolute(component) for component in components]
    return Interval(
        math.sqrt(sum(b.low**2 for b in bounds)), math.sqrt(sum(b.high**2 for b in bounds))
    )


Point = tuple[float, float]


def _clip(polygon: list[Point], a: float, b: float, c: float) -> list[Point]:
    """Part of a convex polygon with a x + b y ≤ c."""
    kept: list[Point] = []
    for (x0, y0), (x1, y1) in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        d0, d1 = a * x0 + b * y0 - c, a * x1 + b * y1 - c
        if d0 <= TIE_TOLERANCE:
            kept.append((x0, y0))
        if (d0 < -TIE_TOLERANCE and d1 > TIE_TOLERANCE) or (
            d0 > TIE_TOLERANCE and d1 < -TIE_TOLERANCE
        ):
            t = d0 / (d0 - d1)
            kept.append((x0 + t * (x1 - x0), y0 + t * (y1 - y0)))
    return kept


def percent_difference(
    reference: Interval, other: Interval, difference: Interval
) -> Interval | None:
    """Values of 100 |r − o| / |r| given r, o and a third printed figure |r − o|.

    r, o must satisfy all three roundings at once: a rectangle cut by two strips. The quotient is
    monotone along every line on which r keeps its sign, so its extremes are at corners. None where
    the three figures exclude each other, unbounded where r may be zero.
    """
    if reference.high < 0.0:
        reference, other = -reference, -other
    if reference.low <= TIE_TOLERANCE:
        return Interval(0.0, math.inf)
    corners = [
        (reference.low, other.low),
        (reference.high, other.low),
        (reference.high, other.high),
        (reference.low, other.high),
    ]
    values = []
    for sign in (1.0, -1.0):
        polygon = _clip(corners, sign, -sign, difference.high)
        polygon = _clip(polygon, -sign, sign, -max(difference.low, 0.0))
        values += [100.0 * abs(r - o) / r for r, o in polygon]
    return Interval(min(values), max(values)) if values else None
