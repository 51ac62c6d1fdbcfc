"""How results show themselves in a terminal or a notebook: a few lines, never pages."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import Final

import pandas as pd

from cassini_bayes.report.plots.quantities import plus_minus, readable_unit

INTERVAL_KEY: Final = "interval"
"""Attribute of every summary that says what its interval is."""
_DIGITS: Final = 4


def with_interval(table: pd.DataFrame, interval: str) -> pd.DataFrame:
    """The table with the kind of its intervals among its attributes."""
    result = table.copy()
    result.attrs[INTERVAL_KEY] = interval
    return result


def value_with_unit(mean: float, sd: float, unit: str) -> str:
    """``0.741 ± 0.043 N``: the digits that the standard deviation supports."""
    shown = readable_unit(unit)
    tail = "" if shown == "–" else f" {shown}"
    return f"{plus_minus(mean, sd)}{tail}"


def html_of(title: str, lines: Sequence[str], table: pd.DataFrame | None = None) -> str:
    """A heading, sentences and a table as HTML for a notebook; every text is escaped."""
    parts = [f"<div><strong>{html.escape(title)}</strong>"]
    parts += [f"<div>{html.escape(line)}</div>" for line in lines]
    if table is not None and len(table):
        shown = table.map(_cell)
        parts.append(str(shown.to_html(index=False, border=0)))
        if INTERVAL_KEY in table.attrs:
            parts.append(f"<div>Intervals: {html.escape(str(table.attrs[INTERVAL_KEY]))}.</div>")
    return "".join([*parts, "</div>"])


def _cell(value: object) -> object:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.{_DIGITS}g}"
    return value


def names_shown(names: Sequence[str]) -> str:
    """All of a few names; of many the first, the last and how many."""
    if len(names) <= 3:
        return ", ".join(names)
    return f"{names[0]} … {names[-1]} ({len(names)})"
