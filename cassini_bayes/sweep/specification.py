"""Sweep files: which priors to change, by how much, and what to watch (TOML)."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import nearest

EVENTS: Final = "events"  # the group of cells that leave an event out


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class GroupTable(_Table):
    """``[[group]]``: parameters whose priors are changed together."""

    name: str = Field(min_length=1)
    parameters: list[str] = Field(min_length=1)


class GridTable(_Table):
    """``[grid]``: what is done to every group; an empty list leaves a kind out."""

    widths: list[float] = [0.25, 0.5, 2.0, 4.0]
    shifts: list[float] = [-1.0, 1.0]
    families: list[Literal["normal", "student-t", "uniform"]] = ["normal", "student-t", "uniform"]
    events: bool = True


class SweepFile(_Table):
    """A sweep file with every default filled in.

    ``quantities`` are scalars as in summary.csv, with ``*`` for any part of a name; without
    ``blocks`` and ``group`` every prior block of the model is swept.
    """

    quantities: list[str] = Field(["thrust_level_n"], min_length=1)
    blocks: list[str] = []
    group: list[GroupTable] = []
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
    try:
        table = tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except FileNotFoundError as error:
        names = [entry.name for entry in path.parent.glob("*.toml")]
        raise InputError(
            str(path), "a sweep file", "no such file", nearest(path.name, names)
        ) from error
    except OSError as error:
        raise InputError(
            str(path), "a sweep file", error.strerror or str(error), "name a readable TOML file"
        ) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(str(path), "valid TOML in UTF-8", str(error), "mend that line") from error
    return check_sweep(table, str(path))


def check_sweep(table: dict[str, Any], where: str) -> SweepFile:
    """Validate a sweep table, rewriting the first error as an :class:`InputError`."""
    try:
        sweep = SweepFile.model_validate(table)
    except ValidationError as error:
        first = min(error.errors(), key=lambda found: found["type"] != "extra_forbidden")
        raise _refusal(where, first["type"], first["loc"], first["msg"], first.get("input")) from (
            error
        )
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
    for i, width in enumerate(grid.widths):
        if not 0.0 < width < float("inf"):
            raise InputError(
                f"{where}.widths[{i}]", "a factor above 0", repr(width), "e.g. 0.5 or 2.0"
            )
    for i, shift in enumerate(grid.shifts):
        if not abs(shift) < float("inf"):
            raise InputError(
                f"{where}.shifts[{i}]",
                "a shift in prior standard deviations",
                repr(shift),
                "e.g. -1.0 or 1.0",
            )


_OWNERS: Final[dict[str, type[_Table]]] = {"grid": GridTable, "group": GroupTable}
_EXPECTED: Final = {
    "string_type": "a text",
    "list_type": "a list",
    "model_type": "a table",
    "too_short": "a list of at least one",
    "string_too_short": "a text that is not empty",
}


def _refusal(
    where: str, kind: str, place: tuple[int | str, ...], message: str, value: object
) -> InputError:
    key = ".".join(str(part) for part in place)
    if kind == "extra_forbidden":
        owner = SweepFile if len(place) == 1 else _OWNERS[str(place[0])]
        names = list(owner.model_fields)
        return InputError(
            f"{where}: {key}",
            f"one of {', '.join(names)}",
            "an unknown key",
            nearest(str(place[-1]), names),
        )
    if kind == "missing":
        return InputError(f"{where}: {key}", "a value", "nothing", f"add {key} = …")
    expected = _EXPECTED.get(kind) or message.removeprefix("Input should be ")
    return InputError(f"{where}: {key}", expected, repr(value), f"change {key}")
