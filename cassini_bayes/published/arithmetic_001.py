"""The arithmetic of Tables 3.a to 3.h of paper 001, re-done with the rounding of every operand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cassini_bayes.published.checks import (
    Check,
    absolute,
    at_least_zero,
    check_cell,
    norm,
    percent_difference,
)
from cassini_bayes.published.constants import Constants
from cassini_bayes.published.mass import acceleration_interval
from cassini_bayes.published.printed import Interval, Printed
from cassini_bayes.published.wheel_bias import (
    COMPARED_ROWS,
    ON_TIME_ROWS,
    VALUE_COLUMNS,
    WHEELS,
    Z_THRUSTERS,
    WheelBiasTable,
)

PAPER = "001"


def _interval(table: WheelBiasTable, row: str, column: str) -> Interval:
    """Values a cell stands for; times, counts and masses are never negative."""
    interval = table.cell(row, column).interval
    signed = row.startswith("delta_v") and column in VALUE_COLUMNS
    return interval if signed else at_least_zero(interval)


def _cell_check(
    table: WheelBiasTable,
    row: str,
    column: str,
    rule: str,
    recomputed: Interval,
    nominal: float,
) -> Check:
    return check_cell(
        table.cell(row, column),
        recomputed,
        nominal,
        source=f"{PAPER} Table {table.table}",
        event=table.event,
        row=row,
        column=column,
        rule=rule,
    )


def date_checks(table: WheelBiasTable) -> Iterator[Check]:
    """Day of year of the header's date, and the date of the title against that of the header."""
    day = float(table.header_date.timetuple().tm_yday)
    exact = float(table.day_of_year)
    source = f"{PAPER} Table {table.table}"
    yield Check(
        source,
        table.event,
        "day_of_year",
        "header",
        "day of year of the date",
        Interval(exact, exact),
        Interval(day, day),
        exact,
        day,
    )
    title, header = float(table.title_date.toordinal()), float(table.header_date.toordinal())
    yield Check(
        source,
        table.event,
        "date",
        "title",
        "title date = header date",
        Interval(title, title),
        Interval(header, header),
        title,
        header,
    )


def rate_checks(table: WheelBiasTable) -> Iterator[Check]:
    """Size of the rate change = final − initial rate, per wheel."""
    for n in WHEELS:
        first = table.cell(f"rwa{n}_rate_initial", "all_columns")
        last = table.cell(f"rwa{n}_rate_final", "all_columns")
        yield _cell_check(
            table,
            f"rwa{n}_rate_size",
            "all_columns",
            "size = final − initial",
            last.interval - first.interval,
            last.value - first.value,
        )


def total_checks(table: WheelBiasTable) -> Iterator[Check]:
    """Total Z on-time = sum of the four; |ΔV| = length of the vector; in every column."""
    for column in VALUE_COLUMNS:
        parts = [table.cell(f"on_time_{name}", column) for name in Z_THRUSTERS]
        intervals = [_interval(table, f"on_time_{name}", column) for name in Z_THRUSTERS]
        yield _cell_check(
            table,
            "on_time_z_total",
            column,
            "total = Z1 + Z2 + Z3 + Z4",
            sum(intervals[1:], intervals[0]),
            sum(part.value for part in parts),
        )
        vector = [table.cell(f"delta_v_{axis}", column) for axis in ("x", "y", "z")]
        yield _cell_check(
            table,
            "delta_v_magnitude",
            column,
            "magnitude = √(x² + y² + z²)",
            norm(part.interval for part in vector),
            sum(part.value**2 for part in vector) ** 0.5,
        )


def difference_checks(table: WheelBiasTable) -> Iterator[Check]:
    """|flight − calibrated| and its share of the flight figure, in every compared row.

    A dash in the percent column stands for more than 100 %: that is what both dashes have in
    common, and no printed percentage exceeds 100.
    """
    for row in COMPARED_ROWS:
        flight, software = table.cell(row, "flight"), table.cell(row, "calibrated")
        nominal = abs(flight.value - software.value)
        bounds = _interval(table, row, "flight"), _interval(table, row, "calibrated")
        yield _cell_check(
            table,
            row,
            "abs_diff",
            "|flight − calibrated|",
            absolute(bounds[0] - bounds[1]),
            nominal,
        )
        share = percent_difference(*bounds, _interval(table, row, "abs_diff"))
        percent = table.get(row, "pct_abs_diff")
        above = Interval(100.0, float("inf"))
        if share is None:  # the difference itself contradicts; its share has no meaning then
            continue
        yield Check(
            f"{PAPER} Table {table.table}",
            table.event,
            row,
            "pct_abs_diff",
            "100 |flight − calibrated| / |flight|",
            above if percent is None else percent.interval,
            share,
            100.0 if percent is None else percent.value,
            100.0 * nominal / abs(flight.value) if flight.value else float("nan"),
        )


def delta_v_checks(table: WheelBiasTable) -> Iterator[Check]:
    """ΔVz of the calibrated column from its on-times with the F/M of the ideal column (eq. 22)."""
    acceleration = acceleration_interval(table, "ideal")
    on_time = table.cell("on_time_z_total", "calibrated")
    ideal_speed = table.cell("delta_v_z", "ideal").value
    ideal_time = table.cell("on_time_z_total", "ideal").value
    yield _cell_check(
        table,
        "delta_v_z",
        "calibrated",
        "ΔVz = −(F/M of the ideal column) × total Z on-time",
        -(acceleration * on_time.interval).scaled(1e3),
        ideal_speed / ideal_time * on_time.value,
    )


def skill_checks(tables: Sequence[WheelBiasTable], constants: Constants) -> Iterator[Check]:
    """Mean differences between flight and ground software, as quoted in the text.

    On-times: the six rows of thrusters and pairs of all tables, each with the same weight (not the
    totals, and a pair counts once); ΔV: the Z component; hydrazine.
    """
    rows: tuple[tuple[str, tuple[str, ...]], ...] = (
        ("on_time_s", ON_TIME_ROWS),
        ("delta_v_z_mm_s", ("delta_v_z",)),
        ("hydrazine_g", ("hydrazine",)),
    )
    for name, names in rows:
        cells: list[Printed] = [table.cell(row, "abs_diff") for table in tables for row in names]
        count = float(len(cells))
        yield check_cell(
            constants.number("paper_001_skill", name),
            Interval(
                sum(at_least_zero(cell.interval).low for cell in cells) / count,
                sum(cell.interval.high for cell in cells) / count,
            ),
            sum(cell.value for cell in cells) / count,
            source=f"{PAPER} text",
            row=name,
            column="mean over the eight events",
            rule="mean |flight − calibrated|",
        )


def wheel_bias_checks(tables: Sequence[WheelBiasTable], constants: Constants) -> tuple[Check, ...]:
    """All checks of paper 001."""
    result: list[Check] = []
    for table in tables:
        for part in (date_checks, rate_checks, total_checks, difference_checks, delta_v_checks):
            result.extend(part(table))
    return (*result, *skill_checks(tables, constants))
