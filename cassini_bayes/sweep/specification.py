"""Sweep files: which priors to change, by how much, and what to watch (TOML)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field

from cassini_bayes.errors import InputError
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.files.validated import Table, validated

MOST_WIDTH: Final = 1_000.0  # beyond it a prior has no effect that a float can hold
MOST_SHIFT: Final = 100.0
EVENTS: Final = "events"  # the group of cells that leave an event out


Family = Literal["normal", "student-t", "uniform"]


class GroupTable(Table):
    """``[[group]]``: parameters whose priors are changed together."""

    name: str = Field(min_length=1)
    parameters: list[str] = Field(min_length=1)


class GridTable(Table):
    """``[grid]``: what is done to every group; an empty list leaves a kind out."""

    widths: list[float] = Field([0.25, 0.5, 2.0, 4.0])
    shifts: list[float] = Field([-1.0, 1.0])
    families: list[Family] = Field(["normal", "student-t", "uniform"])
    events: bool = True


class SweepFile(Table):
    """A sweep file with every default filled in.

    ``quantities`` are scalars as in summary.csv, with ``*`` for any part of a name; without
    ``blocks`` and ``group`` every prior block of the model is swept.
    """

    quantities: list[str] = Field(["thrust_level_n"], min_length=1)
    blocks: list[str] = Field([])
    group: list[GroupTable] = Field([])
    grid: GridTable = GridTable()
    refit: Literal["auto", "always", "never"] = "auto"
    draws: int = Field(4_000, ge=1_000)
    seed: int = Field(6, ge=0)


def read_sweep_file(path: Path) -> SweepFile:
    """Read and check a sweep file.

    Raises
    ------
    InputError
        Missing file, TOML syntax, unknown key (with the nearest one), wrong type or range.
    """
    return check_sweep(read_toml(path, "a sweep file"), str(path))


def check_sweep(table: dict[str, Any], where: str) -> SweepFile:
    """Check the table of a sweep file."""
    sweep = validated(SweepFile, table, where)
    _refuse_repeated(sweep, where)
    _check_amounts(sweep.grid, f"{where}: grid")
    return sweep


def _refuse_repeated(sweep: SweepFile, where: str) -> None:
    """Refuse names that stand twice: the cells of one would replace those of the other."""
    names = [EVENTS, *sweep.blocks, *(group.name for group in sweep.group)]
    for i, name in enumerate(names):
        if name in names[:i]:
            got = "the name kept for leaving events out" if name == EVENTS else "twice"
            raise InputError(
                f"{where}: blocks and group",
                "names that differ from each other",
                f"{name!r}, {got}",
                "drop it, or give the group another name",
            )
    for table in sweep.group:
        for i, name in enumerate(table.parameters):
            if name in table.parameters[:i]:
                raise InputError(
                    f"{where}: group {table.name}", "each parameter once", repr(name), "drop one"
                )


def _check_amounts(grid: GridTable, where: str) -> None:
    for i, width in enumerate(grid.widths, start=1):
        if not 1.0 / MOST_WIDTH <= width <= MOST_WIDTH:
            raise InputError(
                f"{where}.widths[{i}]",
                f"a factor above 0, {1.0 / MOST_WIDTH:g} to {MOST_WIDTH:g}",
                repr(width),
                "e.g. 0.5 or 2.0",
            )
    for i, shift in enumerate(grid.shifts, start=1):
        if not abs(shift) <= MOST_SHIFT:
            raise InputError(
                f"{where}.shifts[{i}]",
                f"a shift in prior standard deviations, {MOST_SHIFT:g} at most",
                repr(shift),
                "e.g. -1.0 or 1.0",
            )
