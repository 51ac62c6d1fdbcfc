"""Printed figures: the digits on paper, and the interval of values they stand for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from importlib import resources

from cassini_bayes.errors import InputError
from cassini_bayes.files.cells import cells_of

# Intervals meet when their gap is below this: the figures have at most seven digits, double
# rounding stays under 1e-12, and a tie (0.125 printed as 0.12 or 0.13) must count as consistent.
TIE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Interval:
    """Closed interval [low, high]; either end may be infinite."""

    low: float
    high: float

    def __post_init__(self) -> None:
        """Refuse NaN and ends in the wrong order."""
        if math.isnan(self.low) or math.isnan(self.high) or self.low > self.high + TIE_TOLERANCE:
            raise InputError(
                "interval", "low ≤ high", f"[{self.low}, {self.high}]", "order the two ends"
            )

    @property
    def middle(self) -> float:
        """Mean of both ends."""
        return 0.5 * (self.low + self.high)

    @property
    def half_width(self) -> float:
        """Half the distance between the ends."""
        return 0.5 * (self.high - self.low)

    def meets(self, other: Interval) -> bool:
        """Whether some value lies in both intervals (ends included)."""
        return self.low <= other.high + TIE_TOLERANCE and other.low <= self.high + TIE_TOLERANCE

    def intersect(self, other: Interval) -> Interval:
        """Return the values that lie in both intervals; InputError where there are none."""
        return Interval(max(self.low, other.low), min(self.high, other.high))

    def __neg__(self) -> Interval:
        """Values with the opposite sign."""
        return Interval(-self.high, -self.low)

    def __add__(self, other: Interval) -> Interval:
        """Sum of two independent values."""
        return Interval(self.low + other.low, self.high + other.high)

    def __sub__(self, other: Interval) -> Interval:
        """Difference of two independent values."""
        return Interval(self.low - other.high, self.high - other.low)

    def __mul__(self, other: Interval) -> Interval:
        """Product of two independent values."""
        products = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        return Interval(min(products), max(products))

    def __truediv__(self, other: Interval) -> Interval:
        """Quotient of two independent values; unbounded where the divisor may be zero."""
        if other.low <= 0.0 <= other.high:
            return Interval(-math.inf, math.inf)
        return self * Interval(1.0 / other.high, 1.0 / other.low)

    def scaled(self, factor: float) -> Interval:
        """Multiply by a number known exactly."""
        return self * Interval(factor, factor)


@dataclass(frozen=True)
class Operand:
    """A figure in arithmetic: values that it may stand for, and the digits taken as exact."""

    interval: Interval
    nominal: float

    def __neg__(self) -> Operand:
        """The opposite figure."""
        return Operand(-self.interval, -self.nominal)

    def __add__(self, other: Operand) -> Operand:
        """Sum of two independent figures."""
        return Operand(self.interval + other.interval, self.nominal + other.nominal)

    def __sub__(self, other: Operand) -> Operand:
        """Difference of two independent figures."""
        return Operand(self.interval - other.interval, self.nominal - other.nominal)

    def __mul__(self, other: Operand) -> Operand:
        """Product of two independent figures."""
        return Operand(self.interval * other.interval, self.nominal * other.nominal)

    def __truediv__(self, other: Operand) -> Operand:
        """Quotient of two independent figures."""
        return Operand(self.interval / other.interval, self.nominal / other.nominal)

    def scaled(self, factor: float) -> Operand:
        """Multiply by a number known exactly."""
        return Operand(self.interval.scaled(factor), factor * self.nominal)


def exactly(value: float) -> Operand:
    """A number known exactly."""
    return Operand(Interval(value, value), value)


@dataclass(frozen=True)
class Printed:
    """A figure as printed.

    Attributes
    ----------
    text
        The digits on paper, sign included.
    step
        Unit of the last printed digit; 0 where the figure is exact.
    """

    text: str
    step: float

    @property
    def decimal(self) -> Decimal:
        """Value as an exact decimal."""
        return Decimal(self.text)

    @property
    def value(self) -> float:
        """Value as a float."""
        return float(self.decimal)

    @property
    def interval(self) -> Interval:
        """Unrounded values that print like this, both ends included."""
        return Interval(self.value - self.step / 2, self.value + self.step / 2)

    @property
    def operand(self) -> Operand:
        """The figure in arithmetic."""
        return Operand(self.interval, self.value)


def parse_printed(text: str, *, where: str, exact: bool = False) -> Printed:
    """Read one printed figure.

    The rounding step is one unit of the last digit. ``exact`` marks figures that were not rounded
    (counts of pulses in telemetry, thruster time constants). A bare ``0`` in a column of decimals
    is exact too, which the caller knows.

    Raises
    ------
    InputError
        When the text is not a decimal number.
    """
    try:
        number = Decimal(text)
    except InvalidOperation as error:
        raise InputError(where, "a decimal number", repr(text), "write it as printed") from error
    exponent = number.as_tuple().exponent
    if not isinstance(exponent, int):
        raise InputError(where, "a finite number", repr(text), "write it as printed")
    return Printed(text, 0.0 if exact else float(Decimal(1).scaleb(min(exponent, 0))))


def package_text(name: str) -> str:
    """Text of a data file of this package (UTF-8)."""
    return (resources.files("cassini_bayes.published") / name).read_text(encoding="utf-8")


def csv_rows(text: str, columns: Sequence[str], *, where: str) -> tuple[dict[str, str], ...]:
    """Rows of a CSV text as mappings from column to text.

    Raises
    ------
    InputError
        When the header is not ``columns`` or a row has another number of cells.
    """
    lines = cells_of(where, text)
    _, header = next(lines, (1, []))
    if header != list(columns):
        raise InputError(
            f"{where}: header", ",".join(columns), ",".join(header), "restore the header row"
        )
    rows = []
    for number, cells in lines:
        if len(cells) != len(header):
            raise InputError(
                f"{where}: line {number}",
                f"{len(header)} cells",
                str(len(cells)),
                "restore the missing commas",
            )
        rows.append(dict(zip(header, cells, strict=True)))
    return tuple(rows)
