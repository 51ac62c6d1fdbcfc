"""What the readers of telemetry files have in common."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

from cassini_bayes.events.telemetry.block import EVERYTHING, Block, Selection
from cassini_bayes.events.telemetry.mends import Mends


class Table(Protocol):
    """An open table of telemetry: names of its columns, where they stand, what a row is called."""

    @property
    def header(self) -> tuple[str, ...]:
        """Names of the columns."""

    @property
    def header_place(self) -> str:
        """Where they stand, for messages."""

    @property
    def refused(self) -> Mapping[str, str]:
        """Columns that cannot be read as numbers or dates, and why."""

    @property
    def unit(self) -> str:
        """``line`` or ``row``, whatever rows are counted in."""

    def blocks(self, rows: int, mends: Mends, selection: Selection = EVERYTHING) -> Iterator[Block]:
        """Yield the rows in file order, at most ``rows`` at a time."""
