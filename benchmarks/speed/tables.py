"""Rows of finished parts, and Markdown tables of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

Row = dict[str, Any]
Found = Mapping[str, Any]


def rows_of(found: Found, beginning: str) -> list[Row]:
    """Rows of all finished parts whose names begin like this."""
    return [
        row for name, part in found.items() if name.startswith(beginning) for row in part["rows"]
    ]


def table(header: Iterable[str], lines: Iterable[Iterable[str]]) -> str:
    """Markdown table."""
    names = list(header)
    text = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    return "\n".join(text + ["| " + " | ".join(line) + " |" for line in lines])
