"""What was mended while telemetry was read: nothing is changed without saying so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from cassini_bayes.computing.arrays import Places

MendKind = Literal[
    "nan", "duplicate_row", "sign_flip", "norm", "counter_wrap", "foreign_zero", "late_start"
]


@dataclass(frozen=True)
class Mend:
    """One kind of repair in one column: where it was first and last needed, how often, in words."""

    kind: MendKind
    column: str
    first_row: int
    last_row: int
    count: int
    sentence: str


class Mends:
    """Collects repairs while the chunks of one event are read; ask for them at the end."""

    def __init__(self) -> None:
        self._found: dict[tuple[MendKind, str], Mend] = {}

    def add(
        self,
        kind: MendKind,
        column: str,
        rows: Sequence[int] | Places,
        sentence: str,
        count: int | None = None,
    ) -> None:
        """Count repairs of one kind in one column, on top of earlier ones.

        ``rows`` are those that needed it, first to last; ``count`` says of how many only these are.
        """
        first, count = int(rows[0]), len(rows) if count is None else count
        earlier = self._found.get((kind, column))
        if earlier is not None:
            first, count, sentence = earlier.first_row, earlier.count + count, earlier.sentence
        self._found[kind, column] = Mend(kind, column, first, int(rows[-1]), count, sentence)

    @property
    def found(self) -> tuple[Mend, ...]:
        """All repairs so far, in the order in which they were first needed."""
        return tuple(self._found.values())

    def lines(self) -> tuple[str, ...]:
        """One line of text per repair, for reports."""
        return tuple(
            f"{m.column}: {m.sentence} ({m.count}×, {_rows(m.first_row, m.last_row)})"
            for m in self.found
        )


def _rows(first: int, last: int) -> str:
    return f"row {first}" if first == last else f"rows {first} to {last}"
