"""CSV text and plain rows of tables; in CSV, what a name holds is text, also to a spreadsheet."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    import pandas as pd

_FORMULA: Final = ("=", "+", "-", "@", "\t", "\n")


def inert(cell: Any) -> Any:
    """A cell; text that a spreadsheet would run as a formula is led by an apostrophe."""
    return f"'{cell}" if isinstance(cell, str) and _is_formula(cell) else cell


def _is_formula(cell: str) -> bool:
    if not cell.startswith(_FORMULA):
        return False
    try:
        float(cell)
    except ValueError:
        return True
    return False  # a number of its own sign


def frame_csv(frame: pd.DataFrame, index: bool = False, digits: int | None = None) -> str:
    """A data frame as CSV; ``digits`` of floats, None for all."""
    inert_frame = frame.rename(index=inert, columns=inert)
    for place, kind in enumerate(inert_frame.dtypes):
        if kind.kind not in "biufM":
            inert_frame.isetitem(place, inert_frame.iloc[:, place].map(inert))
    style = None if digits is None else f"%.{digits}g"
    return str(inert_frame.to_csv(index=index, float_format=style))


def rows_csv(rows: Iterable[Iterable[object]]) -> str:
    """Rows of cells as CSV, the header first."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([inert(cell) for cell in row] for row in rows)
    return text.getvalue()


def finite(value: Any) -> Any:
    """Plain JSON types of nested tables and lists; numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def frame_records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a data frame as plain JSON types; what is not finite becomes null."""
    return [finite(row) for row in frame.to_dict(orient="records")]
