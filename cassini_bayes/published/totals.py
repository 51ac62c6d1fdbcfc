"""Tables 3.a to 3.h of paper 001 as totals-only events, the package's own format.

One row per event and source. What the tables do not print stays empty: the ideal column has no
pulse counts, and wheel 3, which was not prime, has no rates. The day is printed, the hour is not:
epochs are at 00:00 UTC of the day.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from functools import partial
from types import MappingProxyType
from typing import Final

from cassini_bayes.files.tables import rows_csv
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


def _text(table: WheelBiasTable, row: str, *, column: str, exponent: int = 0) -> str:
    """Printed figure times 10^exponent, neither losing nor adding digits; empty for a dash."""
    result = table.get(row, column)
    return "" if result is None else format(result.decimal.scaleb(exponent), "f")


def totals_row(table: WheelBiasTable, source: str) -> dict[str, str]:
    """One event and source as a row of the totals format; ΔV from mm/s to m/s.

    The branch is B: the tables date from after the swap of 2009-03-12 (paper 001 section II).
    """
    column = SOURCES[source]
    once, printed = (
        partial(_text, table, column="all_columns"),
        partial(_text, table, column=column),
    )
    return {
        "id": table.event,
        "epoch": f"{table.header_date.isoformat()}T00:00:00Z",
        "branch": "B",
        "wheels": " ".join(str(n) for n in WHEELS),
        **{f"rwa{n}_rpm_start": once(f"rwa{n}_rate_initial") for n in _ALL_WHEELS},
        **{f"rwa{n}_rpm_end": once(f"rwa{n}_rate_final") for n in _ALL_WHEELS},
        "duration_s": once("duration"),
        **{f"on_time_{k}_s": printed(f"on_time_{row}") for k, row in _THRUSTER_ROW.items()},
        **{f"pulses_{k}": printed(f"pulses_{row}") for k, row in _THRUSTER_ROW.items()},
        **{f"delta_v_{a}_m_s": printed(f"delta_v_{a}", exponent=-3) for a in "xyz"},
        "hydrazine_g": printed("hydrazine"),
        "mass_kg": str(Decimal(table_mass(table).mass_kg).quantize(Decimal("0.1"))),
        "thrust_predicted_n": once("thrust"),
        "delta_v_source": "computed",
        "source": source,
    }


def totals_csv(tables: Sequence[WheelBiasTable]) -> str:
    """Render the text of ``flight_2009_2010.csv``: by event, then flight, fsds, gsw_ideal, gsw."""
    rows = [totals_row(table, source) for table in tables for source in SOURCES]
    return rows_csv([rows[0], *(row.values() for row in rows)])
