"""Tables 3.a to 3.h of paper 001: eight wheel biases of 2009 and 2010, cell by cell.

Every table compares four columns: ``ideal`` (ground software, rectangular pulses), ``calibrated``
(ground software adjusted to flight), ``fsds`` (closed-loop simulation) and ``flight``; ``abs_diff``
and ``pct_abs_diff`` compare ``flight`` with ``calibrated``. Figures printed once for the whole
table (thrust, wheel rates, duration) have the column ``all_columns``.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from cassini_bayes.errors import InputError
from cassini_bayes.published.printed import Printed, csv_rows, package_text, parse_printed

WHEELS: Final = (1, 2, 4)
Z_THRUSTERS: Final = ("z1", "z2", "z3", "z4")
Y_PAIRS: Final = ("y1_y3", "y2_y4")
VALUE_COLUMNS: Final = ("ideal", "calibrated", "fsds", "flight")
COLUMNS: Final = ("all_columns", *VALUE_COLUMNS, "abs_diff", "pct_abs_diff")

_UNITS: Final[Mapping[str, str]] = MappingProxyType(
    {"thrust": "N"}
    | {f"rwa{n}_rate_{what}": "rpm" for what in ("initial", "final", "size") for n in WHEELS}
    | {"duration": "s"}
    | {f"on_time_{name}": "s" for name in (*Y_PAIRS, *Z_THRUSTERS, "z_total")}
    | {f"pulses_{name}": "count" for name in (*Y_PAIRS, *Z_THRUSTERS)}
    | {f"delta_v_{name}": "mm/s" for name in ("x", "y", "z", "magnitude")}
    | {"hydrazine": "g"}
)
ROWS: Final = tuple(_UNITS)
ON_TIME_ROWS: Final = tuple(f"on_time_{name}" for name in (*Y_PAIRS, *Z_THRUSTERS))
COMPARED_ROWS: Final = tuple(
    row for row in ROWS if row.startswith(("on_time", "pulses", "delta_v", "hydrazine"))
)

_TABLE_HEADER: Final = ("event", "table", "row", "unit", *COLUMNS)
_EVENT_HEADER: Final = ("event", "table", "title_date", "header_date", "day_of_year")


@dataclass(frozen=True)
class WheelBiasTable:
    """One of Tables 3.a–3.h.

    ``cells`` maps (row, column) to the printed figure; cells printed as a dash are absent. Units
    by row: thrust N, rates rpm, duration and on-times s, pulses count, ΔV mm/s, hydrazine g. The
    on-time of a Y pair is the on-time of *each* thruster of the pair. ``title_date`` and
    ``header_date`` are the two places where the date is printed.
    """

    event: str
    table: str
    title_date: datetime.date
    header_date: datetime.date
    day_of_year: int
    cells: Mapping[tuple[str, str], Printed]

    def get(self, row: str, column: str) -> Printed | None:
        """Return the printed figure, or None where the table has a dash."""
        return self.cells.get((row, column))

    def cell(self, row: str, column: str) -> Printed:
        """Return the printed figure; InputError where the table has a dash."""
        result = self.cells.get((row, column))
        if result is None:
            raise InputError(
                f"Table {self.table}: {row}, {column}", "a figure", "a dash", "use another column"
            )
        return result


def _is_exact(row: str, column: str, text: str) -> bool:
    """Whether a figure was not rounded.

    Pulses of simulation and flight are counted; those of the ground software are rounded. A bare
    0 among decimals (3.b, Z2, ideal) is a thruster that was not used at all.
    """
    counted = row.startswith("pulses") and column in ("fsds", "flight")
    return counted or (
        text == "0" and _UNITS[row] in ("s", "mm/s", "g") and column in VALUE_COLUMNS
    )


def parse_wheel_bias_tables(table_csv: str, event_csv: str) -> tuple[WheelBiasTable, ...]:
    """Build the tables from the two CSV texts, in the order of the event file.

    Raises
    ------
    InputError
        When a header, a row name, a unit, an event or a number is not as it should be, or a row is
        missing or doubled.
    """
    where = "tables_3a_3h.csv"
    cells: dict[str, dict[tuple[str, str], Printed]] = {}
    seen: dict[str, list[str]] = {}
    for line, row in enumerate(csv_rows(table_csv, _TABLE_HEADER, where=where), start=2):
        event, name = row["event"], row["row"]
        if _UNITS.get(name) != row["unit"]:
            raise InputError(
                f"{where}: line {line}",
                f"a row of the tables with its unit ({', '.join(_UNITS)})",
                f"{name} [{row['unit']}]",
                "restore the row",
            )
        seen.setdefault(event, []).append(name)
        for column in COLUMNS:
            if row[column]:
                cells.setdefault(event, {})[name, column] = parse_printed(
                    row[column],
                    where=f"{where}: line {line}, {column}",
                    exact=_is_exact(name, column, row[column]),
                )
    tables = []
    for row in csv_rows(event_csv, _EVENT_HEADER, where="events_3a_3h.csv"):
        event = row["event"]
        if seen.get(event) != list(ROWS):
            raise InputError(
                f"{where}: event {event}",
                f"the {len(ROWS)} rows of the table, in order",
                ", ".join(seen.get(event, [])) or "none",
                "restore the rows",
            )
        tables.append(
            WheelBiasTable(
                event=event,
                table=row["table"],
                title_date=datetime.date.fromisoformat(row["title_date"]),
                header_date=datetime.date.fromisoformat(row["header_date"]),
                day_of_year=int(row["day_of_year"]),
                cells=MappingProxyType(cells[event]),
            )
        )
    return tuple(tables)


def wheel_bias_tables() -> tuple[WheelBiasTable, ...]:
    """Tables 3.a–3.h of paper 001, in order of date."""
    return parse_wheel_bias_tables(
        package_text("tables_3a_3h.csv"), package_text("events_3a_3h.csv")
    )
