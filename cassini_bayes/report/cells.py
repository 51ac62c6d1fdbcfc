"""Tables as the page shows them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import pandas as pd

from cassini_bayes.report.plots.quantities import MISSING, Scale, interval, number, plus_minus

MN: Final = 1e3  # mN per N
PERCENT_SD: Final = 10.0  # percentages are shown without decimals


@dataclass(frozen=True)
class Cell:
    """One cell: its text, and a style class (``flag``, ``muted``, ``wrap`` or none)."""

    text: str
    style: str = ""


@dataclass(frozen=True)
class Table:
    """A table as the page shows it; the first ``heads`` columns name the row."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    heads: int = 1
    title: str = ""


Column = str | Callable[[Any], Cell | str]
"""How a row becomes a cell: the column whose text it is, or a function of the row."""


def tabulate(
    rows: pd.DataFrame | Iterable[Mapping[str, Any]],
    columns: Mapping[str, Column],
    *,
    heads: int = 1,
    title: str = "",
) -> Table:
    """Rows of a frame, or records, under headings, each with its column."""
    each = (row for _, row in rows.iterrows()) if isinstance(rows, pd.DataFrame) else rows
    cells = tuple(
        tuple(_cell(row[c] if isinstance(c, str) else c(row)) for c in columns.values())
        for row in each
    )
    return Table(tuple(columns), cells, heads, title)


def flagged(text: str, is_amiss: bool) -> Cell:
    """A cell that stands out where something is amiss."""
    return Cell(text, "flag" if is_amiss else "")


def _cell(content: object) -> Cell:
    return content if isinstance(content, Cell) else Cell(str(content))


def mean_sd(mean: str = "mean", sd: str = "sd") -> Column:
    """Two columns as ``mean ± sd``."""
    return lambda row: plus_minus(float(row[mean]), float(row[sd]))


def between(low: str = "hdi_90_low", high: str = "hdi_90_high") -> Column:
    """Two columns as ``low … high``."""
    return lambda row: interval(float(row[low]), float(row[high]))


def two_digits(column: str) -> Column:
    """A standard deviation with two significant digits."""
    return lambda row: number(float(row[column]), float(row[column]))


def formatted(column: str, style: str) -> Column:
    """A column in a format, a dash where it is not finite."""
    return lambda row: or_missing(row[column], style)


def as_percent(column: str) -> Column:
    """A share as a whole percentage."""
    return lambda row: percent(float(row[column]))


def in_units(frame: pd.DataFrame, scales: Sequence[Scale], *columns: str) -> pd.DataFrame:
    """The frame with some columns in the units of ``scales``, one a row, named in ``unit``."""
    shown = frame.assign(unit=[scale.unit for scale in scales])
    shown[list(columns)] = shown[list(columns)].mul([scale.factor for scale in scales], axis=0)
    return shown


def or_missing(value: float, style: str) -> str:
    """``value`` in a format, or a dash where it is not finite."""
    return format(float(value), style) if math.isfinite(float(value)) else MISSING


def signed(value: float, style: str = "+.1f") -> str:
    """``value`` with its sign, or a dash where it is not finite."""
    return or_missing(value, style).replace("-", "−")


def percent(share: float) -> str:
    """A share as a whole percentage."""
    return f"{number(100 * share, PERCENT_SD)} %" if math.isfinite(share) else MISSING
