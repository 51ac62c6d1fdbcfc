"""Every printed thrust, and the pressures that go with some, in order of time.

Thrusts are of three kinds: ``measurement`` (estimated from flight data), ``prediction`` (of the
propulsion team or the ground software, from an equation of tank pressure) and ``flight_software``
(a constant on board, which stays until somebody updates it: a stale step, no measurement).
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal, get_args

from cassini_bayes.errors import InputError
from cassini_bayes.published.printed import Printed
from cassini_bayes.published.tables import (
    Row,
    ThrustComparison,
    a_branch_thrusts,
    b_branch_thrusts,
    bias_thrusts,
    day_of,
    records,
)
from cassini_bayes.published.wheel_bias import wheel_bias_tables

Kind = Literal["measurement", "prediction", "flight_software"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
FILE: Final = "anchors.csv"
COLUMNS: Final = ("date", "branch", "quantity", "value", "unit", "kind", "paper", "place")
SWAP: Final = datetime.date(2009, 3, 12)
PAPER_003: Final = datetime.date(2012, 7, 1)
"""Middle of 2012, "current day" of paper 003, printed in August."""
BIASES_YEAR: Final = 2005
"""Of paper 000 Table 2: the head says 2004, the text after December 2004."""


@dataclass(frozen=True)
class Anchor:
    """A printed figure of a date: ``quantity`` is thrust, pressure, thrust_ratio or tail_off.

    ``thruster`` is empty where the figure stands for a branch.
    """

    date: datetime.date
    branch: str
    quantity: str
    value: Printed
    unit: str
    kind: Kind
    paper: str
    place: str
    thruster: str = ""


def text_anchors(text: str | None = None) -> tuple[Anchor, ...]:
    """What stands in the papers' text: ``anchors.csv``, or a text in its place.

    Raises
    ------
    InputError
        A wrong header, figure or kind.
    """

    def build(row: Row) -> Anchor:
        kind = next((known for known in KINDS if known == row["kind"]), None)
        if kind is None:
            raise InputError(f"{FILE}: kind", ", ".join(KINDS), repr(row["kind"]), "mend it")
        date, value = datetime.date.fromisoformat(row["date"]), row.figure("value")
        figure = (date, row["branch"], row["quantity"], value, row["unit"])
        return Anchor(*figure, kind, row["paper"], row["place"])

    return records(FILE, text, COLUMNS, build)


def anchors() -> tuple[Anchor, ...]:
    """All of them: those of the text, and the thrusts of paper 000, 001 and 003's tables."""
    of_tables = (*_of_paper_000(), *_of_paper_001(), *_of_paper_003())
    return tuple(sorted((*text_anchors(), *of_tables), key=lambda anchor: anchor.date))


def thrust_anchors(kind: Kind) -> tuple[Anchor, ...]:
    """Thrusts of one kind, in order of time."""
    return tuple(a for a in anchors() if a.quantity == "thrust" and a.kind == kind)


def _of_paper_000() -> Iterator[Anchor]:
    for row in bias_thrusts():
        day, place = day_of(BIASES_YEAR, row.day_of_year), f"Table 2, day {row.day_of_year}"
        of_kinds: tuple[tuple[Printed, Kind, str], ...] = (
            (row.predicted_n, "prediction", "predicted"),
            (row.adjusted_tau_decay_65_ms_n, "measurement", "tail-off of 65 ms"),
            (row.adjusted_tau_decay_40_ms_n, "measurement", "tail-off of 40 ms"),
        )
        for value, kind, what in of_kinds:
            yield Anchor(day, "A", "thrust", value, "N", kind, "000", f"{place}, {what}")


def _of_paper_001() -> Iterator[Anchor]:
    for table in wheel_bias_tables():
        value = table.cell("thrust", "all_columns")
        place = f"Table {table.table}"
        yield Anchor(table.title_date, "B", "thrust", value, "N", "prediction", "001", place)


def _of_paper_003() -> Iterator[Anchor]:
    branches: tuple[tuple[datetime.date, str, str, tuple[ThrustComparison, ...], Kind, str], ...]
    branches = (
        (SWAP, "A", "Table 1", a_branch_thrusts(), "measurement", "navigation"),
        (PAPER_003, "B", "Table 2", b_branch_thrusts(), "flight_software", "flight software"),
    )
    for day, branch, table, rows, kind, source in branches:
        thrust = (day, branch, "thrust")
        for row in rows:
            name, own = row.thruster.removesuffix(branch.lower()), row.this_study_n
            yield Anchor(*thrust, own, "N", "measurement", "003", table, name)
            if row.other_n is not None:
                place = f"{table}, {source}"
                yield Anchor(*thrust, row.other_n, "N", kind, "003", place, name)
