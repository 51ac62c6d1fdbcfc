"""Time systems of telemetry: cells of a time column in seconds since the event's epoch.

Times are UTC without leap seconds, as clocks on the ground show them: an event that spans one is
refused by its rows, whose times repeat.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from fractions import Fraction
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.block import TextReader
from cassini_bayes.files.checks import in_utc

TimeSystem = Literal[
    "elapsed", "iso8601", "unix", "julian_date", "modified_julian_date", "matlab_datenum"
]
ZEROS: Final[Mapping[str, tuple[datetime, Fraction]]] = MappingProxyType(
    {
        "unix": (datetime(1970, 1, 1, tzinfo=UTC), Fraction(0)),
        "modified_julian_date": (datetime(1858, 11, 17, tzinfo=UTC), Fraction(0)),
        "julian_date": (datetime(1858, 11, 17, tzinfo=UTC), Fraction(4800001, 2)),
        "matlab_datenum": (datetime(1970, 1, 1, tzinfo=UTC), Fraction(719529)),
    }
)
"""A date in every system that counts from a fixed one, and what its count is then.

Of Julian dates that is 2400000.5 days at the zero of the modified ones.
"""
DAYS: Final = ("julian_date", "modified_julian_date", "matlab_datenum")
"""Systems that count days; the others count seconds unless a unit is given."""
_MICROSECOND: Final = timedelta(microseconds=1)
_DAY_OF_YEAR: Final = re.compile(r"(\d{4})-(\d{3})(?=[T ]|$)", re.ASCII)


@dataclass(frozen=True)
class Line:
    """A number x of a file as ``factor · (x − origin) + offset``.

    The origin is a whole number near the first x: times that count from long ago lose no digits.
    """

    factor: float
    offset: float
    origin: float = 0.0

    def of(self, values: Array) -> Array:
        """The numbers, converted."""
        with np.errstate(over="ignore"):  # of a damaged cell: what is not finite is refused
            return (values - self.origin) * self.factor + self.offset


def line_of_clock(
    system: str,
    unit_s: float,
    scale: float,
    offset: float,
    began: datetime | None,
    epoch: datetime,
) -> Line:
    """From a count x of a clock to seconds since the epoch of the event.

    The clock shows ``scale · x + offset`` units of ``unit_s`` seconds.

    Parameters
    ----------
    system
        Any of :data:`TimeSystem` but ``iso8601``.
    began
        When the count ``elapsed`` was 0; the event's epoch by default.
    """
    zero, reading = ZEROS.get(system, (began or epoch, Fraction(0)))
    seconds, slope = Fraction(unit_s), Fraction(scale)
    late = Fraction((epoch - zero) // _MICROSECOND, 10**6)  # from the zero to the epoch
    # seconds since the epoch: (slope x + offset − reading) seconds − late
    origin = Fraction(round((late / seconds + reading - Fraction(offset)) / slope))
    rest = (slope * origin + Fraction(offset) - reading) * seconds - late
    return Line(float(slope * seconds), float(rest), float(origin))


def reader_of_dates(epoch: datetime) -> TextReader:
    """A reader of ISO 8601 times: seconds since the epoch.

    Dates may count days of the year, ``2010-044T12:00:00.5``; a time without a zone is UTC.
    """

    def read(text: str, where: str) -> float:
        time = in_utc(_DAY_OF_YEAR.sub(_of_the_year, text))
        if time is None:
            raise InputError(
                where,
                "an ISO 8601 time, UTC",
                ascii(text[:40]),
                "write it like 2010-02-13T12:00:00.5Z, or correct time_system in the channel map",
            )
        return (time - epoch) / timedelta(seconds=1)

    return read


def seconds_of(values: NDArray[Any], read: TextReader, where: str) -> Array:
    """Times of an array of dates or of text, NaN where there is none.

    Raises
    ------
    InputError
        Another kind of array, or text that is no time.
    """
    if values.dtype.kind == "M":
        # whole nanoseconds: a float of some 1e9 s has none
        zero = read("1970-01-01", where)
        whole = np.int64(np.floor(zero))
        counts = values.astype("datetime64[ns]").astype(np.int64) + whole * 1_000_000_000
        return np.where(np.isnat(values), np.nan, counts / 1e9 + (zero - whole))
    if values.dtype.kind not in "OU":
        raise InputError(
            where, "dates or their text", f"numbers ({values.dtype})", "correct time_system"
        )
    return np.array([_seconds_of_cell(cell, read, where) for cell in values.tolist()])


def _seconds_of_cell(cell: object, read: TextReader, where: str) -> float:
    if cell is None or (isinstance(cell, float) and np.isnan(cell)):
        return float("nan")
    if not isinstance(cell, str):
        raise InputError(where, "dates as text", type(cell).__name__, "write them as text")
    return read(cell.strip(), where) if cell else float("nan")


def _of_the_year(found: re.Match[str]) -> str:
    """``2010-044`` as ``2010-02-13``; a day that the year has not stays as it is."""
    year, day = int(found[1]), int(found[2])
    if not 1 <= year < 9999 or not 1 <= day <= 366:
        return found[0]
    day_of = date(year, 1, 1) + timedelta(days=day - 1)
    return day_of.isoformat() if day_of.year == year else found[0]
