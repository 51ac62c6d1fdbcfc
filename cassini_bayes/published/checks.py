"""A table's own arithmetic: one record per re-computed cell, and the rule for a contradiction."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from cassini_bayes.published.printed import TIE_TOLERANCE, Interval, Operand, Printed


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
        The printed figure with the values that it stands for.
    recomputed
        The same of the printed operands: what their unrounded values allow, and what the printed
        ones give.
    """

    source: str
    event: str
    row: str
    column: str
    rule: str
    printed: Operand
    recomputed: Operand

    @property
    def contradicts(self) -> bool:
        """No unrounded operands consistent with print give the printed figure."""
        return not self.printed.interval.meets(self.recomputed.interval)

    @property
    def can_fail(self) -> bool:
        """Whether some printed figure would have been a contradiction (bounded interval)."""
        return math.isfinite(self.recomputed.interval.half_width)

    @property
    def matches_printed_operands(self) -> bool:
        """The printed operands, taken as exact, round to the printed figure (ties either way)."""
        low, high = self.printed.interval.low, self.printed.interval.high
        return low - TIE_TOLERANCE <= self.recomputed.nominal <= high + TIE_TOLERANCE


@dataclass(frozen=True)
class Source:
    """Where printed cells stand: paper and table, and the event of those that have one."""

    name: str
    event: str = ""

    def check(
        self, rule: str, printed: Printed | Operand, recomputed: Operand, row: str, column: str = ""
    ) -> Check:
        """A printed cell against what a rule makes of others."""
        cell = printed.operand if isinstance(printed, Printed) else printed
        return Check(self.name, self.event, row, column, rule, cell, recomputed)


def contradictions(checks: Iterable[Check]) -> tuple[Check, ...]:
    """Those of cells that contradict the cells they were computed from, in their order."""
    return tuple(check for check in checks if check.contradicts)


def absolute(operand: Operand) -> Operand:
    """Values of |x|."""
    low, high = operand.interval.low, operand.interval.high
    least = 0.0 if low < 0.0 < high else min(abs(low), abs(high))
    return Operand(Interval(least, max(abs(low), abs(high))), abs(operand.nominal))


def at_least_zero(operand: Operand) -> Operand:
    """Restrict to values that are not negative."""
    low, high = operand.interval.low, operand.interval.high
    return replace(operand, interval=Interval(max(low, 0.0), max(high, 0.0)))


def norm(components: Iterable[Operand]) -> Operand:
    """Length of a vector with independent components."""
    sizes = [absolute(component) for component in components]
    low = math.hypot(*(size.interval.low for size in sizes))
    high = math.hypot(*(size.interval.high for size in sizes))
    return Operand(Interval(low, high), math.hypot(*(size.nominal for size in sizes)))


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
