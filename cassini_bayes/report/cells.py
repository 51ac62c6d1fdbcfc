"""Tables as the page shows them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from cassini_bayes.report.plots.quantities import MISSING, number

MN: Final = 1e3  # mN per N
PERCENT_SD: Final = 10.0  # percentages are shown without decimals


@dataclass(frozen=True)
class Cell:
    """One cell: its text, and a style class (``flag``, ``muted`` or none)."""

    text: str
    style: str = ""


@dataclass(frozen=True)
class Table:
    """A table as the page shows it; the first ``heads`` columns name the row."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    heads: int = 1
    title: str = ""


def or_missing(value: float, style: str) -> str:
    """``value`` in a format, or a dash where it is not finite."""
    return format(float(value), style) if math.isfinite(float(value)) else MISSING


def percent(share: float) -> str:
    """A share as a whole percentage."""
    return f"{number(100 * share, PERCENT_SD)} %" if math.isfinite(share) else MISSING
