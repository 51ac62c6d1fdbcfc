"""Where a long calculation says how far it has got: a function of one line of text."""

from __future__ import annotations

from collections.abc import Callable

Log = Callable[[str], None]


def silent(text: str) -> None:
    """Log nothing."""
    del text
