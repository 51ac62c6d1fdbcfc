"""Reading a spacecraft file, every value checked at the door."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known
from cassini_bayes.files.toml_file import toml_bytes, toml_of
from cassini_bayes.files.validated import Table, validated
from cassini_bayes.spacecraft.description import (
    AXIS_DEMANDS,
    CONTROL_CYCLE_S,
    HIGHEST_RATE_RAD_S,
    HIGHEST_WHEEL_RPM,
    PLANNED_WHEEL_RPM,
    BranchGeometry,
    Platform,
    Spacecraft,
    Thruster,
    Wheel,
)
from cassini_bayes.spacecraft.parameters import BLOCKS, ParameterSpec, generic_parameters

UNIT_TOLERANCE: Final = 1e-6
"""A direction within this of norm one is normalised; any other is an error."""

_OPPOSITE: Final = dict(zip("+-", "-+", strict=True))


def _names_a_file(branch: str) -> str:
    """Refuse what cannot be part of a file's name: figures and tables are named by branch."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", branch):
        raise ValueError("a name of letters, digits, '_', '.' and '-', the first no sign")
    return branch


_Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9]*$")]
_ParameterName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
_Branch = Annotated[str, AfterValidator(_names_a_file)]
_Triple = Annotated[list[float], Field(min_length=3, max_length=3)]


class _ParameterTable(Table):
    unit: str = Field(min_length=1)
    block: str
    meaning: str = Field(min_length=1)


class _ArticulationTable(Table):
    parameter: str
    about: _Triple
    axis_at_rad: float


class _WheelTable(Table):
    number: int = Field(ge=1)
    name: _Name
    axis: _Triple
    inertia: str
    tilt: Annotated[list[str], Field(min_length=2, max_length=2)] | None = None
    articulation: _ArticulationTable | None = None


class _ThrusterTable(Table):
    name: _Name
    branches: list[str] = Field(min_length=1)
    position: Annotated[list[float | str], Field(min_length=3, max_length=3)]
    direction: _Triple


class _File(Table):
    name: str = Field(min_length=1)
    branches: list[_Branch] = Field(min_length=1)
    parameters: dict[_ParameterName, _ParameterTable]
    wheel: list[_WheelTable] = Field(min_length=1)
    thruster: list[_ThrusterTable] = Field(min_length=1)
    axis_pairs: dict[str, list[str]]
    control_cycle_s: Annotated[float, Field(gt=0.0, le=60.0)] = CONTROL_CYCLE_S
    highest_rate_rad_s: Annotated[float, Field(gt=0.0, le=10.0)] = HIGHEST_RATE_RAD_S
    highest_wheel_rpm: Annotated[float, Field(gt=0.0, le=1e6)] = HIGHEST_WHEEL_RPM
    planned_wheel_rpm: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None


def load_spacecraft(reference: str | Path, where: str = "spacecraft") -> Spacecraft:
    """Read a spacecraft: the name of a built-in one, or the path of a TOML file.

    ``where`` is the key of the file that names it, for messages.

    Checked: every key and type; unit vectors (a norm within 1e-6 of one is normalised away); names
    that occur once; parameters that are declared, in the unit of their use, and hide none of
    :func:`cassini_bayes.spacecraft.parameters.generic_parameters`; axis pairs of known thrusters on
    every branch, none of which serves both senses of an axis. Whether a pair turns the right way
    depends on values: :func:`cassini_bayes.spacecraft.check_axis_pairs`.

    Raises
    ------
    InputError
        Names the file, the dotted key, what was expected and found, and the nearest valid name.
    """
    if Path(reference).suffix == ".toml":
        content = toml_bytes(Path(reference), "a spacecraft file")
        return _build(content, str(reference))
    files = resources.files(__package__)
    names = [e.name.removesuffix(".toml") for e in files.iterdir() if e.name.endswith(".toml")]
    expected = f"a built-in spacecraft ({', '.join(names)}) or the path of a .toml file"
    check_known(where, str(reference), names, expected)
    content = files.joinpath(f"{reference}.toml").read_bytes()
    return _build(content, f"{reference}.toml")


def check_either(where: str, has_name: bool, has_file: bool) -> None:
    """Check that a table names a built-in spacecraft, or else a file.

    Raises
    ------
    InputError
        It does both, or neither.
    """
    if has_name == has_file:
        raise InputError(
            where,
            "either name (a built-in) or file (a TOML file beside this one)",
            "both" if has_name else "neither",
            'write e.g. name = "cassini"',
        )


def _build(content: bytes, where: str) -> Spacecraft:
    file = validated(_File, toml_of(content, where), where)
    specs = {n: _spec(n, t, f"{where}: parameters.{n}") for n, t in file.parameters.items()}
    _unique(file.branches, f"{where}: branches")
    _unique((wheel.name for wheel in file.wheel), f"{where}: wheel.name")
    _unique((wheel.number for wheel in file.wheel), f"{where}: wheel.number")
    _unique((thruster.name for thruster in file.thruster), f"{where}: thruster.name")
    wheels = tuple(_wheel(t, specs, f"{where}: wheel.{t.name}") for t in file.wheel)
    thrusters = tuple(
        _thruster(t, specs, file.branches, f"{where}: thruster.{t.name}") for t in file.thruster
    )
    pairs = _axis_pairs(file, where)
    return Spacecraft(
        name=file.name,
        wheels=wheels,
        thrusters=thrusters,
        branches=tuple(file.branches),
        axis_pairs=pairs,
        parameters=tuple(specs.values()),
        geometry={b: _branch(b, thrusters, pairs, where) for b in file.branches},
        digest=hashlib.sha256(content).hexdigest(),
        control_cycle_s=file.control_cycle_s,
        highest_rate_rad_s=file.highest_rate_rad_s,
        highest_wheel_rpm=file.highest_wheel_rpm,
        planned_wheel_rpm=_planned(file, where),
    )


def _planned(file: _File, where: str) -> tuple[float, float]:
    """Sizes of wheel rates that are planned; those of Cassini, or as far as its wheels turn."""
    if file.planned_wheel_rpm is None:
        low, high = PLANNED_WHEEL_RPM
        return min(low, 0.5 * file.highest_wheel_rpm), min(high, file.highest_wheel_rpm)
    low, high = file.planned_wheel_rpm
    if not 0.0 <= low < high <= file.highest_wheel_rpm:
        raise InputError(
            f"{where}: planned_wheel_rpm",
            f"two sizes, the smaller first, within 0 and highest_wheel_rpm,"
            f" {file.highest_wheel_rpm:g} rev/min",
            f"[{low:g}, {high:g}]",
            "write e.g. [300, 2000], or raise highest_wheel_rpm",
        )
    return low, high


def _spec(name: str, table: _ParameterTable, place: str) -> ParameterSpec:
    check_known(f"{place}.block", table.block, BLOCKS)
    if name in {spec.name for spec in generic_parameters()}:
        expected, got = "a name of the spacecraft's own", f"{name!r}, which every spacecraft has"
        raise InputError(place, expected, got, "rename it, or leave it out")
    return ParameterSpec(name, table.unit, table.block, table.meaning)


def _unique(values: Iterable[object], place: str) -> None:
    seen = set()
    for value in values:
        if value in seen:
            raise InputError(place, "each one once", f"{value!r} twice", "rename or drop one")
        seen.add(value)


def _declared(name: str, specs: Mapping[str, ParameterSpec], unit: str, place: str) -> str:
    """``name``, once it is known to be a parameter of the file in the unit of its use."""
    check_known(place, name, specs, "a parameter declared under [parameters]")
    if specs[name].unit != unit:
        raise InputError(
            place,
            f"a parameter in {unit}",
            f"{name!r} in {specs[name].unit}",
            f"declare parameters.{name}.unit = {unit!r}, or use another parameter",
        )
    return name


def _unit_vector(values: list[float], place: str) -> NDArray[np.float64]:
    vector = np.array(values, dtype=np.float64)
    norm = math.hypot(*values)  # of numbers of any size
    if not abs(norm - 1.0) <= UNIT_TOLERANCE:
        raise InputError(
            place,
            f"a unit vector (norm within {UNIT_TOLERANCE:g} of 1)",
            f"norm {norm:.9g}",
            "divide the three numbers by it",
        )
    vector /= norm
    vector.setflags(write=False)
    return vector


def _wheel(table: _WheelTable, specs: Mapping[str, ParameterSpec], place: str) -> Wheel:
    axis = _unit_vector(table.axis, f"{place}.axis")
    inertia = _declared(table.inertia, specs, "kg m2", f"{place}.inertia")
    platform = _platform(table.articulation, specs, f"{place}.articulation")
    if table.tilt is None:
        return Wheel(table.number, table.name, axis, inertia, None, platform)
    _unique(table.tilt, f"{place}.tilt")
    u, v = (_declared(name, specs, "rad", f"{place}.tilt") for name in table.tilt)
    if abs(axis[2]) > 1.0 - UNIT_TOLERANCE:
        raise InputError(
            f"{place}.tilt",
            "a spin axis that is not along Z (the tilt axes are built from ẑ × axis)",
            f"axis {table.axis}",
            "leave out tilt for this wheel",
        )
    return Wheel(table.number, table.name, axis, inertia, (u, v), platform)


def _platform(
    table: _ArticulationTable | None, specs: Mapping[str, ParameterSpec], place: str
) -> Platform | None:
    if table is None:
        return None
    name = _declared(table.parameter, specs, "rad", f"{place}.parameter")
    return Platform(name, _unit_vector(table.about, f"{place}.about"), table.axis_at_rad)


def _thruster(
    table: _ThrusterTable, specs: Mapping[str, ParameterSpec], branches: list[str], place: str
) -> Thruster:
    _unique(table.branches, f"{place}.branches")
    for branch in table.branches:
        check_known(f"{place}.branches", branch, branches, f"out of {', '.join(branches)}")
    position = tuple(
        _coordinate(entry, specs, f"{place}.position[{i}]")
        for i, entry in enumerate(table.position, start=1)
    )
    direction = _unit_vector(table.direction, f"{place}.direction")
    return Thruster(table.name, tuple(table.branches), position, direction)


def _coordinate(
    entry: float | str, specs: Mapping[str, ParameterSpec], place: str
) -> float | tuple[float, str]:
    if not isinstance(entry, str):
        return float(entry)
    sign = -1.0 if entry.startswith("-") else 1.0
    name = entry[1:] if entry.startswith(("+", "-")) else entry
    return sign, _declared(name, specs, "m", place)


def _axis_pairs(file: _File, where: str) -> dict[str, tuple[str, ...]]:
    names = [thruster.name for thruster in file.thruster]
    for demand, pair in file.axis_pairs.items():
        place = f"{where}: axis_pairs.{demand}"
        check_known(place, demand, AXIS_DEMANDS, got="an unknown key")
        _unique(pair, place)
        for name in pair:
            check_known(place, name, names, "names of thrusters")
            if name in file.axis_pairs.get(_OPPOSITE[demand[0]] + demand[1], ()):
                expected = "thrusters that do not serve the opposite demand as well"
                raise InputError(place, expected, repr(name), "name it on one side only")
    for demand in AXIS_DEMANDS:
        if not file.axis_pairs.get(demand):
            place, fix = (
                f"{where}: axis_pairs.{demand}",
                "name the thrusters fired for this torque demand",
            )
            raise InputError(place, "names of thrusters", "nothing", fix)
    return {demand: tuple(file.axis_pairs[demand]) for demand in AXIS_DEMANDS}


def _branch(
    branch: str,
    thrusters: tuple[Thruster, ...],
    pairs: Mapping[str, tuple[str, ...]],
    where: str,
) -> BranchGeometry:
    members = tuple(thruster for thruster in thrusters if branch in thruster.branches)
    if not members:
        raise InputError(
            f"{where}: branches",
            "a thruster on every branch",
            f"none on {branch!r}",
            "add the branch to its thrusters, or drop it",
        )
    for demand, pair in pairs.items():
        if not any(thruster.name in pair for thruster in members):
            raise InputError(
                f"{where}: axis_pairs.{demand}",
                f"a thruster of branch {branch!r}",
                ", ".join(pair),
                "name the thrusters that answer this demand on that branch",
            )
    return BranchGeometry.of(members)
