"""The table of a kind of effect: its targets, the inputs that show it, the priors of its size."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import nearest

TARGETS: Final = ("none", "thruster", "wheel", "tilting wheel", "axis", "element")
INPUTS: Final = ("telemetry", "totals", "on_times", "estimates")
ROLES: Final = ("value", "departure")
SYMBOLS: Final = (
    "1", "kg", "g", "m", "mm", "s", "min", "h", "rad", "deg", "N", "Pa", "kPa", "bar", "K", "W",
    "J", "A", "V", "Hz", "rpm",
)  # fmt: skip
"""Of units, each of which may have a power behind it."""
KEYS: Final = ("targets", "inputs", "source", "parameters", "form_error")
PARAMETER_KEYS: Final = ("role", "dist", "times_prior", "low", "high", "unit")


@dataclass(frozen=True)
class ParameterTable:
    """One parameter: its key, where ``{target}`` may stand, and the prior of it.

    A departure counts from the baseline's parameter of the same name. ``times_prior`` gives a
    normal about zero with that many of the baseline's prior standard deviations; None where
    ``keywords`` say all.
    """

    where: str
    key: str
    is_departure: bool
    dist: str
    keywords: Mapping[str, Any]
    times_prior: float | None
    low: float | None
    high: float | None
    unit: str


@dataclass(frozen=True)
class Table:
    """The table of a kind: ``where`` it stands, what it says.

    ``form_error`` is the standard deviation, by size and as a share of it, of what the form of the
    effect leaves out.
    """

    where: str
    targets: str
    inputs: tuple[str, ...]
    source: str
    parameters: tuple[ParameterTable, ...]
    form_error: Mapping[str, float]


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file of effects.

    Raises
    ------
    InputError
        It cannot be read or is no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(
            str(path), "a file of effects (TOML)", str(error), "mend the file"
        ) from None


def read_table(document: Mapping[str, Any], where: str) -> Table:
    """Check the table of a kind; ``where`` is its file, and its dotted key there if it has one.

    Raises
    ------
    InputError
        A missing or unknown key, target, input, role or unit: file and dotted key are named.
    """
    check_keys(document, KEYS, where)
    for key in KEYS[:4]:
        if key not in document:
            raise InputError(f"{where}.{key}", "a value", "nothing", "add it")
    _check_one_of(f"{where}.targets", document["targets"], TARGETS)
    inputs = document["inputs"]
    if not isinstance(inputs, list):
        raise InputError(
            f"{where}.inputs", "a list of inputs", repr(inputs), f"out of {', '.join(INPUTS)}"
        )
    for name in inputs:
        _check_one_of(f"{where}.inputs", name, INPUTS)
    parameters = _table(document["parameters"], f"{where}.parameters")
    if not parameters:
        raise InputError(f"{where}.parameters", "at least one parameter", "none", "add its size")
    return Table(
        where,
        document["targets"],
        tuple(inputs),
        document["source"],
        tuple(_parameter(row, key, f"{where}.parameters.{key}") for key, row in parameters.items()),
        _table(document.get("form_error", {}), f"{where}.form_error"),
    )


def _parameter(table: Any, key: str, where: str) -> ParameterTable:
    row = _table(table, where)
    _check_one_of(f"{where}.role", row.get("role"), ROLES)
    for needed in ("dist", "unit"):
        if not isinstance(row.get(needed), str):
            raise InputError(f"{where}.{needed}", "a text", repr(row.get(needed)), "add it")
    check_unit(f"{where}.unit", row["unit"])
    return ParameterTable(
        where,
        key,
        row["role"] == "departure",
        row["dist"],
        {k: v for k, v in row.items() if k not in PARAMETER_KEYS},
        row.get("times_prior"),
        row.get("low"),
        row.get("high"),
        row["unit"],
    )


def check_unit(where: str, unit: str) -> None:
    """Refuse what is no product of symbols of units: ``N m s``, ``rad/s``, ``kg m2``, ``1``.

    Raises
    ------
    InputError
        A symbol that is none.
    """
    for part in unit.replace("/", " ").split() or [unit]:
        symbol = re.sub(r"(?<=[A-Za-z])-?\d+(\.\d+)?$", "", part)
        if symbol not in SYMBOLS:
            raise InputError(
                where, "symbols of units as in 'N m', 'rad/s', 'kg m2'", repr(unit),
                nearest(symbol, SYMBOLS),
            )  # fmt: skip


def _check_one_of(where: str, value: object, known: Collection[str]) -> None:
    if value not in known:
        raise InputError(
            where, f"one of {', '.join(known)}", repr(value), nearest(str(value), known)
        )


def check_keys(table: object, known: Collection[str], where: str) -> None:
    """Refuse keys of a table that are not known, and what is no table.

    Raises
    ------
    InputError
        With the nearest known key.
    """
    for key in _table(table, where):
        if key not in known:
            raise InputError(
                f"{where}.{key}",
                f"one of {', '.join(known)}",
                "an unknown key",
                nearest(key, known),
            )


def _table(value: object, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(where, "a table", repr(value), "write one")
    return value
