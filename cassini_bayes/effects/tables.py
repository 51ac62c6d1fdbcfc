"""The table of a kind of effect: its targets, the inputs that show it, the priors of its size."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known, finite_number, nearest
from cassini_bayes.priors.distributions import Distribution

TARGETS: Final = (
    *("none", "thruster", "wheel", "tilting wheel", "articulated wheel"),
    *("axis", "element"),
)
INPUTS: Final = ("telemetry", "totals", "on_times", "estimates")
ROLES: Final = ("value", "departure")
SYMBOLS: Final = (
    "1", "kg", "g", "m", "mm", "s", "min", "h", "rad", "deg", "N", "Pa", "kPa", "bar", "K", "W",
    "J", "A", "V", "Hz", "rpm",
)  # fmt: skip
"""Of units, each of which may have a power behind it."""
KEYS: Final = ("targets", "inputs", "source", "parameters", "form_error", "late_form_error")
CHANGEABLE: Final = KEYS[1:]
"""By another table: targets are what the code of a kind is written for."""
_NAME: Final = re.compile(r"[A-Za-z](?:\w|\{target\})*", re.ASCII)
_PART: Final = re.compile(r"""\s*(?:"([^"]*)"|'([^']*)'|([\w-]+))\s*\.?""", re.ASCII)
_HEADER: Final = re.compile(r"\s*\[([^\[\]]+)\]")
_ASSIGNMENT: Final = re.compile(r"""((?:\s*(?:"[^"]*"|'[^']*'|[\w-]+)\s*\.?)+)=""")


@dataclass(frozen=True)
class Place:
    """Where something stands in a TOML file; as text its file, line and dotted key."""

    path: Path
    keys: tuple[str, ...] = ()

    def __truediv__(self, key: str) -> Place:
        return Place(self.path, (*self.keys, key))

    def __str__(self) -> str:
        try:
            line = line_of(self.path.read_text(encoding="utf-8"), self.keys)
        except (OSError, ValueError):
            line = None
        file = str(self.path) if line is None else f"{self.path}, line {line}"
        return ": ".join([file, *([".".join(self.keys)] if self.keys else [])])


def line_of(text: str, keys: tuple[str, ...]) -> int | None:
    """Line of a dotted key of a TOML text, or of the nearest table around it that is there."""
    table: tuple[str, ...] = ()
    nearest_line, depth = None, 0
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            place = table = _parts(header[1])
        elif assignment := _ASSIGNMENT.match(line):
            place = (*table, *_parts(assignment[1]))
        else:
            continue
        if keys and place[: len(keys)] == keys:
            return number
        if place == keys[: len(place)] and len(place) > depth:
            nearest_line, depth = number, len(place)
    return nearest_line


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(next(filter(None, parts), "") for parts in _PART.findall(dotted))


PARAMETER_KEYS: Final = ("role", "dist", "times_prior", "low", "high", "unit")


@dataclass(frozen=True)
class ParameterTable:
    """One parameter: its key, where ``{target}`` may stand, and the prior of it.

    A departure counts from the baseline's parameter of the same name; one of a wheel's
    (``WHEEL_KEYS``) from what the spacecraft file calls it. Its prior may be given as so many of
    the baseline's prior standard deviations: of a normal about zero, within bounds.
    """

    where: Place
    key: str
    is_departure: bool
    prior: Distribution | float
    low: float | None
    high: float | None
    unit: str


@dataclass(frozen=True)
class Table:
    """The table of a kind: ``where`` it was read, and its content.

    ``form_error`` is the standard deviation, by size and as a share of it, of what the form of the
    effect leaves out, ``late_form_error`` of what it leaves out more where rows have late pulses.
    """

    where: Place
    targets: str
    inputs: tuple[str, ...]
    source: str
    parameters: tuple[ParameterTable, ...]
    form_error: Mapping[str, float]
    late_form_error: Mapping[str, float]


def read_table(document: Mapping[str, Any], where: Place) -> Table:
    """Check the table of a kind, which stands at ``where``.

    Raises
    ------
    InputError
        A missing or unknown key, target, input, role or unit, or a prior that is none: file, line
        and dotted key are named.
    """
    check_keys(document, KEYS, where)
    for key in KEYS[:4]:
        if key not in document:
            raise InputError(str(where / key), "a value", "nothing", "add it")
    _check_one_of(where / "targets", document["targets"], TARGETS)
    _check_text(where / "source", document["source"])
    inputs = document["inputs"]
    if not isinstance(inputs, list):
        raise InputError(
            str(where / "inputs"), "a list of inputs", repr(inputs), f"out of {', '.join(INPUTS)}"
        )
    for name in inputs:
        _check_one_of(where / "inputs", name, INPUTS)
    place = where / "parameters"
    parameters = _table(document["parameters"], place)
    if not parameters:
        raise InputError(str(place), "at least one parameter", "none", "add its size")
    return Table(
        where,
        document["targets"],
        tuple(inputs),
        document["source"],
        tuple(_parameter(row, key, place / key) for key, row in parameters.items()),
        _table(document.get("form_error", {}), where / "form_error"),
        _table(document.get("late_form_error", {}), where / "late_form_error"),
    )


def _parameter(table: Any, key: str, where: Place) -> ParameterTable:
    row = _table(table, where)
    if not _NAME.fullmatch(key):
        raise InputError(
            str(where), "a name of letters, digits and _, {target} in it", repr(key), "rename it"
        )
    _check_one_of(where / "role", row.get("role"), ROLES)
    for needed in ("dist", "unit"):
        _check_text(where / needed, row.get(needed))
    _check_unit(where / "unit", row["unit"])
    low, high = row.get("low"), row.get("high")
    if "times_prior" in row:
        prior: Distribution | float = _times_prior(row, where)
    else:
        keywords = {k: v for k, v in row.items() if k not in PARAMETER_KEYS}
        prior = Distribution(row["dist"], keywords, low, high, where=str(where))
    departure = row["role"] == "departure"
    return ParameterTable(where, key, departure, prior, low, high, row["unit"])


def _times_prior(row: Mapping[str, Any], where: Place) -> float:
    """A multiple of a prior's width: of a departure, normal, in place of all other keywords."""
    times = finite_number(str(where / "times_prior"), row["times_prior"])
    others = sorted(set(row) - set(PARAMETER_KEYS))
    if times <= 0 or others or row["role"] != "departure" or row["dist"] != "norm":
        raise InputError(
            str(where / "times_prior"),
            'a positive number, with role = "departure", dist = "norm" and no other keyword',
            f"{times:g} with {row['role']}, {', '.join([row['dist'], *others])}",
            "give loc and scale in its place, or mend these",
        )
    return times


def _check_text(where: Place, value: object) -> None:
    if not isinstance(value, str):
        raise InputError(str(where), "a text", repr(value), "write it in quotes")


def _check_unit(where: Place, unit: str) -> None:
    """Refuse what is no product of symbols of units: ``N m s``, ``rad/s``, ``kg m2``, ``1``."""
    for part in unit.replace("/", " ").split() or [unit]:
        symbol = re.sub(r"(?<=[A-Za-z])-?\d+(\.\d+)?$", "", part)
        if symbol not in SYMBOLS:
            raise InputError(
                str(where), "symbols of units as in 'N m', 'rad/s', 'kg m2'", repr(unit),
                nearest(symbol, SYMBOLS),
            )  # fmt: skip


def _check_one_of(where: Place, value: object, known: Collection[str]) -> None:
    if value not in known:  # the line of a place is looked for only then
        check_known(str(where), value, known)


def check_keys(table: object, known: Collection[str], where: Place) -> None:
    """Refuse keys of a table that are not known, and what is no table.

    Raises
    ------
    InputError
        With the nearest known key.
    """
    for key in _table(table, where):
        if key not in known:
            raise InputError(
                str(where / key),
                f"one of {', '.join(known)}",
                "an unknown key",
                nearest(key, known),
            )


def _table(value: object, where: Place) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(str(where), "a table", repr(value), "write one")
    return value
