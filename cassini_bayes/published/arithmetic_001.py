"""The arithmetic of Tables 3.a to 3.h of paper 001, re-done with the rounding of every operand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf, nan

from cassini_bayes.published.checks import (
    Check,
    Source,
    absolute,
    at_least_zero,
    norm,
    percent_difference,
)
from cassini_bayes.published.constants import Constants
from cassini_bayes.published.mass import acceleration
from cassini_bayes.published.printed import Interval, Operand, exactly
from cassini_bayes.published.wheel_bias import (
    COMPARED_ROWS,
    ON_TIME_ROWS,
    VALUE_COLUMNS,
    WHEELS,
    Z_THRUSTERS,
    WheelBiasTable,
)

PAPER = "001"


def _source(table: WheelBiasTable) -> Source:
    return Source(f"{PAPER} Table {table.table}", table.event)


def _operand(table: WheelBiasTable, row: str, column: str) -> Operand:
    """A cell in arithmetic; times, counts and masses are never negative."""
    operand = table.cell(row, column).operand
    signed = row.startswith("delta_v") and column in VALUE_COLUMNS
    return operand if signed else at_least_zero(operand)


def date_checks(table: WheelBiasTable) -> Iterator[Check]:
    """Day of year of the header's date, and the date of the title against that of the header."""
    day = exactly(float(table.header_date.timetuple().tm_yday))
    printed = exactly(float(table.day_of_year))
    yield _source(table).check("day of year of the date", printed, day, "day_of_year", "header")
    title, header = (
        exactly(float(date.toordinal())) for date in (table.title_date, table.header_date)
    )
    yield _source(table).check("title date = header date", title, header, "date", "title")


def rate_checks(table: WheelBiasTable) -> Iterator[Check]:
    """Size of the rate change = final − initial rate, per wheel."""
    for n in WHEELS:
        size, first, last = (
            table.cell(f"rwa{n}_rate_{what}", "all_columns")
            for what in ("size", "initial", "final")
        )
        change, row = last.operand - first.operand, f"rwa{n}_rate_size"
        yield _source(table).check("size = final − initial", size, change, row, "all_columns")


def total_checks(table: WheelBiasTable) -> Iterator[Check]:
    """Total Z on-time = sum of the four; |ΔV| = length of the vector; in every column."""
    source = _source(table)
    for column in VALUE_COLUMNS:
        parts = (_operand(table, f"on_time_{name}", column) for name in Z_THRUSTERS)
        vector = (table.cell(f"delta_v_{axis}", column).operand for axis in "xyz")
        for row, computed, rule in (
            ("on_time_z_total", sum(parts, exactly(0.0)), "total = Z1 + Z2 + Z3 + Z4"),
            ("delta_v_magnitude", norm(vector), "magnitude = √(x² + y² + z²)"),
        ):
            yield source.check(rule, table.cell(row, column), computed, row, column)


def difference_checks(table: WheelBiasTable) -> Iterator[Check]:
    """|flight − calibrated| and its share of the flight figure, in every compared row.

    A dash in the percent column stands for more than 100 %: that is what both dashes have in
    common, and no printed percentage exceeds 100.
    """
    source = _source(table)
    for row in COMPARED_ROWS:
        flight, software = (_operand(table, row, column) for column in ("flight", "calibrated"))
        difference, column = absolute(flight - software), "abs_diff"
        printed = table.cell(row, column)
        yield source.check("|flight − calibrated|", printed, difference, row, column)
        share = percent_difference(
            flight.interval, software.interval, _operand(table, row, column).interval
        )
        if share is None:  # the difference itself contradicts; its share has no meaning then
            continue
        percent = table.get(row, "pct_abs_diff") or Operand(Interval(100.0, inf), 100.0)
        nominal = 100.0 * difference.nominal / abs(flight.nominal) if flight.nominal else nan
        rule = "100 |flight − calibrated| / |flight|"
        yield source.check(rule, percent, Operand(share, nominal), row, "pct_abs_diff")


def delta_v_checks(table: WheelBiasTable) -> Iterator[Check]:
    """ΔVz of the calibrated column from its on-times with the F/M of the ideal column (eq. 22)."""
    on_time = table.cell("on_time_z_total", "calibrated").operand
    speed = table.cell("delta_v_z", "calibrated")
    rule = "ΔVz = −(F/M of the ideal column) × total Z on-time"
    computed = -(acceleration(table, "ideal") * on_time).scaled(1e3)
    yield _source(table).check(rule, speed, computed, "delta_v_z", "calibrated")


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
        cells = [_operand(table, row, "abs_diff") for table in tables for row in names]
        mean = sum(cells, exactly(0.0)).scaled(1.0 / len(cells))
        printed, column = constants.number("paper_001_skill", name), "mean over the eight events"
        yield Source(f"{PAPER} text").check(
            "mean |flight − calibrated|", printed, mean, name, column
        )


def wheel_bias_checks(tables: Sequence[WheelBiasTable], constants: Constants) -> tuple[Check, ...]:
    """All checks of paper 001."""
    parts = (date_checks, rate_checks, total_checks, difference_checks, delta_v_checks)
    of_tables = (check for table in tables for part in parts for check in part(table))
    return (*of_tables, *skill_checks(tables, constants))
