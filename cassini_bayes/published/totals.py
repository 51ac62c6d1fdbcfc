"""Tables 3.a to 3.h of paper 001 as totals-only events, the package's own format.

One row per event and source. What the tables do not print stays empty: the ideal column has no
pulse counts, and wheel 3, which was not prime, has no rates. The day is printed, the hour is not:
epochs are at 00:00 UTC of the day.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from decimal import Decimal
from io import StringIO
from types import MappingProxyType
from typing import Final

from cassini_bayes.published.mass import table_mass
from cassini_bayes.published.wheel_bias import WHEELS, Z_THRUSTERS, WheelBiasTable

# source of the totals format → column of the tables
SOURCES: Final[Mapping[str, str]] = MappingProxyType(
    {"flight": "flight", "fsds": "fsds", "gsw_ideal": "ideal", "gsw": "calibrated"}
)
# thruster → row of the tables: both thrusters of a Y pair fire for the time and the number of
# pulses printed for the pair
_THRUSTER_ROW: Final[Mapping[str, str]] = MappingProxyType(
    {name: name for name in Z_THRUSTERS}
    | {"y1": "y1_y3", "y2": "y2_y4", "y3": "y1_y3", "y4": "y2_y4"}
)
_ALL_WHEELS: Final = (1, 2, 3, 4)
AXES: Final = ("x", "y", "z")

TOTALS_COLUMNS: Final = (
    "id",
    "epoch",
    "branch",
    "wheels",
    *(f"rwa{n}_rpm_start" for n in _ALL_WHEELS),
    *(f"rwa{n}_rpm_end" for n in _ALL_WHEELS),
    "duration_s",
    *(f"on_time_{name}_s" for name in _THRUSTER_ROW),
    *(f"pulses_{name}" for name in _THRUSTER_ROW),
    *(f"delta_v_{axis}_m_s" for axis in AXES),
    "hydrazine_g",
    "mass_kg",
    "thrust_predicted_n",
    "delta_v_source",
    "source",
)


def _text(table: WheelBiasTable, row: str, column: str, *, exponent: int = 0) -> str:
    """Printed figure times 10^exponent, neither losing nor adding digits; empty for a dash."""
    result = table.get(row, column)
    return "" if result is None else format(result.decimal.scaleb(exponent), "f")


def totals_row(table: WheelBiasTable, source: str) -> dict[str, str]:
    """One event and source as a row of the totals format; ΔV from mm/s to m/s.

    The branch is B: the tables date from after the swap of 2009-03-12 (paper 001 section II).
    """
    column = SOURCES[source]
    mass = Decimal(table_mass(table).mass_kg).quantize(Decimal("0.1"))
    row = {
        "id": table.event,
        "epoch": f"{table.header_date.isoformat()}T00:00:00Z",
        "branch": "B",
        "wheels": " ".join(str(n) for n in WHEELS),
        "duration_s": _text(table, "duration", "all_columns"),
        "hydrazine_g": _text(table, "hydrazine", column),
        "mass_kg": str(mass),
        "thrust_predicted_n": _text(table, "thrust", "all_columns"),
        "delta_v_source": "computed",
        "source": source,
    }
    for n in WHEELS:
        row[f"rwa{n}_rpm_start"] = _text(table, f"rwa{n}_rate_initial", "all_columns")
        row[f"rwa{n}_rpm_end"] = _text(table, f"rwa{n}_rate_final", "all_columns")
    for name, pair in _THRUSTER_ROW.items():
        row[f"on_time_{name}_s"] = _text(table, f"on_time_{pair}", column)
        row[f"pulses_{name}"] = _text(table, f"pulses_{pair}", column)
    for axis in AXES:
        row[f"delta_v_{axis}_m_s"] = _text(table, f"delta_v_{axis}", column, exponent=-3)
    return row


def totals_csv(tables: Sequence[WheelBiasTable]) -> str:
    """Render the text of ``flight_2009_2010.csv``: by event, then flight, fsds, gsw_ideal, gsw."""
    out = StringIO()
    writer = csv.DictWriter(out, TOTALS_COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(totals_row(table, source) for table in tables for source in SOURCES)
    return out.getvalue()
