"""Reading a spacecraft file, every value checked at the door."""

from __future__ import annotations

import hashlib
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cassini_bayes.checks import nearest
from cassini_bayes.errors import InputError
from cassini_bayes.parameters import BLOCKS, ParameterSpec
from cassini_bayes.spacecraft.description import (
    AXIS_DEMANDS,
    BranchGeometry,
    Spacecraft,
    Thruster,
    Wheel,
)

UNIT_TOLERANCE = 1e-6


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _ParameterTable(_Table):
    unit: str = Field(min_length=1)
    block: str
    meaning: str = Field(min_length=1)


class _WheelTable(_Table):
    number: int = Field(ge=1)
    name: str = Field(pattern=r"^[a-z][a-z0-9]*$")
    axis: tuple[float, float, float]
    inertia: str
    tilt: tuple[str, str] | None = None


class _ThrusterTable(_Table):
    name: str = Field(pattern=r"^[a-z][a-z0-9]*$")
    branches: list[str] = Field(min_length=1)
    position: tuple[float | str, float | str, float | str]
    direction: tuple[float, float, float]


class _File(_Table):
    name: str = Field(min_length=1)
    branches: list[str] = Field(min_length=1)
    parameters: dict[str, _ParameterTable]
    wheel: list[_WheelTable] = Field(min_length=1)
    thruster: list[_ThrusterTable] = Field(min_length=1)
    axis_pairs: dict[str, list[str]]


def load_spacecraft(reference: str | Path) -> Spacecraft:
    """Read a spacecraft: the name of a built-in one, or the path of a TOML file.

    Raises
    ------
    InputError
        Names the file, the dotted key, what was expected and found, and the nearest valid name.
    """
    path = Path(reference)
    built_in = resources.files(__package__).joinpath(f"{reference}.toml")
    if path.suffix != ".toml":
        if not built_in.is_file():
            names = [
                entry.name.removesuffix(".toml")
                for entry in resources.files(__package__).iterdir()
                if entry.name.endswith(".toml")
            ]
            raise InputError(
                "spacecraft",
                f"a built-in spacecraft ({', '.join(names)}) or the path of a .toml file",
                repr(str(reference)),
                nearest(str(reference), names),
            )
        return _build(_parse(built_in.read_bytes(), f"{reference}.toml"), f"{reference}.toml")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(
            str(path), "a spacecraft file", error.strerror or str(error), "check the path"
        ) from error
    return _build(_parse(content, str(path)), str(path))


def _parse(content: bytes, where: str) -> tuple[_File, str]:
    try:
        table = tomllib.loads(content.decode("utf-8-sig").replace("\r\n", "\n"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(where, "valid TOML in UTF-8", str(error), "mend that place") from error
    try:
        return _File.model_validate(table), hashlib.sha256(content).hexdigest()
    except ValidationError as error:
        raise _as_input_error(error, table, where) from error


def _as_input_error(error: ValidationError, table: dict[str, Any], where: str) -> InputError:
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    place = f"{where}: {key}"
    if first["type"] == "extra_forbidden":
        tables: dict[str, type[_Table]] = {
            "parameters": _ParameterTable,
            "wheel": _WheelTable,
            "thruster": _ThrusterTable,
        }
        owner = tables.get(str(first["loc"][0]), _File) if len(first["loc"]) > 1 else _File
        return InputError(
            place,
            f"one of {', '.join(owner.model_fields)}",
            "an unknown key",
            nearest(str(first["loc"][-1]), owner.model_fields),
        )
    if first["type"] == "missing":
        return InputError(place, "a value", "nothing", f"add {first['loc'][-1]} = …")
    return InputError(place, first["msg"], repr(first.get("input")), f"change {key}")


def _build(parsed: tuple[_File, str], where: str) -> Spacecraft:
    file, digest = parsed
    specs = tuple(_spec(name, table, where) for name, table in file.parameters.items())
    known = {spec.name for spec in specs}
    _unique([wheel.name for wheel in file.wheel], f"{where}: wheel.name")
    _unique([str(wheel.number) for wheel in file.wheel], f"{where}: wheel.number")
    _unique([thruster.name for thruster in file.thruster], f"{where}: thruster.name")
    wheels = tuple(_wheel(table, known, where) for table in file.wheel)
    thrusters = tuple(_thruster(table, known, file.branches, where) for table in file.thruster)
    names = [thruster.name for thruster in thrusters]
    for demand in (*AXIS_DEMANDS, *file.axis_pairs):
        place = f"{where}: axis_pairs.{demand}"
        if demand not in AXIS_DEMANDS:
            raise InputError(
                place, f"one of {', '.join(AXIS_DEMANDS)}", repr(demand), nearest(demand, AXIS_DEMANDS)
            )
        for name in file.axis_pairs.get(demand, [""]):
            if name not in names:
                raise InputError(
                    place, "names of thrusters", repr(name) if name else "nothing", nearest(name, names)
                )
    geometry = {}
    for branch in file.branches:
        members = tuple(thruster for thruster in thrusters if branch in thruster.branches)
        if not members:
            raise InputError(
                f"{where}: branches",
                "a thruster on every branch",
                f"none on {branch!r}",
                "add the branch to its thrusters, or drop it",
            )
        for demand in AXIS_DEMANDS:
            if not {thruster.name for thruster in members} & set(file.axis_pairs[demand]):
                raise InputError(
                    f"{where}: axis_pairs.{demand}",
                    f"a thruster of branch {branch!r}",
                    str(file.axis_pairs[demand]),
                    "name the thrusters that answer this demand on that branch",
                )
        geometry[branch] = BranchGeometry.of(members)
    return Spacecraft(
        name=file.name,
        wheels=wheels,
        thrusters=thrusters,
        branches=tuple(file.branches),
        axis_pairs={demand: tuple(file.axis_pairs[demand]) for demand in AXIS_DEMANDS},
        parameters=specs,
        geometry=geometry,
        digest=digest,
    )


def _spec(name: str, table: _ParameterTable, where: str) -> ParameterSpec:
    if table.block not in BLOCKS:
        raise InputError(
            f"{where}: parameters.{name}.block",
            f"one of {', '.join(BLOCKS)}",
            repr(table.block),
            nearest(table.block, BLOCKS),
        )
    return ParameterSpec(name, table.unit, table.block, table.meaning)


def _unique(names: list[str], place: str) -> None:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(place, "each one once", f"{name!r} twice", "rename one of them")


def _known(name: str, known: set[str], place: str) -> str:
    if name not in known:
        raise InputError(
            place,
            "a parameter declared under [parameters]",
            repr(name),
            nearest(name, sorted(known)),
        )
    return name


def _unit_vector(values: tuple[float, float, float], place: str) -> NDArray[np.float64]:
    vector = np.array(values, dtype=np.float64)
    norm = float(np.linalg.norm(vector))
    if not abs(norm - 1.0) < UNIT_TOLERANCE:
        raise InputError(
            place, "a unit vector", f"norm {norm:.9g}", "divide it by its norm (9 digits are enough)"
        )
    vector /= norm
    vector.setflags(write=False)
    return vector


def _wheel(table: _WheelTable, known: set[str], where: str) -> Wheel:
    place = f"{where}: wheel {table.name}"
    axis = _unit_vector(table.axis, f"{place}.axis")
    tilt = table.tilt
    if tilt is not None:
        tilt = (_known(tilt[0], known, f"{place}.tilt"), _known(tilt[1], known, f"{place}.tilt"))
        if abs(axis[2]) > 1.0 - UNIT_TOLERANCE:
            raise InputError(
                f"{place}.tilt",
                "a spin axis that is not along Z (the tilt axes are built from ẑ × axis)",
                f"axis {table.axis}",
                "leave out tilt for this wheel",
            )
    inertia = _known(table.inertia, known, f"{place}.inertia")
    return Wheel(table.number, table.name, axis, inertia, tilt)


def _thruster(
    table: _ThrusterTable, known: set[str], branches: list[str], where: str
) -> Thruster:
    place = f"{where}: thruster {table.name}"
    for branch in table.branches:
        if branch not in branches:
            raise InputError(
                f"{place}.branches", f"out of {branches}", repr(branch), nearest(branch, branches)
            )
    entries: list[float | tuple[float, str]] = []
    for entry in table.position:
        if isinstance(entry, str):
            sign = -1.0 if entry.startswith("-") else 1.0
            entries.append((sign, _known(entry.lstrip("+-"), known, f"{place}.position")))
        else:
            entries.append(float(entry))
    direction = _unit_vector(table.direction, f"{place}.direction")
    return Thruster(table.name, tuple(table.branches), tuple(entries), direction)
