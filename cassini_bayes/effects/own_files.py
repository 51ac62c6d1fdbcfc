"""Effects that a user brings: a Python file like those of this package, checked at every call.

The file is run. It is only ever one that was named on the command line. Whatever is wrong with it
is one line with the file and the place in it.
"""

from __future__ import annotations

import importlib.util
import inspect
import traceback
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np

from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.statistics import ExtraColumn, RowContext
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.controller import Fired
from cassini_bayes.effects.effect import Kind
from cassini_bayes.effects.printed import Printed
from cassini_bayes.errors import InputError

Shape = tuple[int, ...]
ARGUMENTS: Final[Mapping[str, tuple[str, ...]]] = {
    "change": ("physics", "parameters", "values", "setting"),
    "change_in_rows": ("physics", "parameters", "values", "setting"),
    "columns": ("thrusters",),
    "search": ("remainder", "priors"),
    "rate_errors": ("values", "setting"),
    "report": ("values", "setting"),
    "left_open": ("fired", "rows", "values", "setting"),
    "fire": ("controller", "values"),
    "doubt": ("printed", "width"),
    "simulate": ("plan", "target", "values"),
}


def load_module(path: Path) -> ModuleType:
    """Run a Python file.

    Raises
    ------
    InputError
        There is none, or it fails: the line is named.
    """
    spec = importlib.util.spec_from_file_location(f"effect_{path.stem}", path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise InputError(str(path), "a Python file", "none", "name one that is there")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # noqa: BLE001 - a user's file may do anything
        raise _fault(path, "a Python file that can be run", error) from None
    return module


def load_kind(path: Path) -> Kind:
    """The kind of effect of a Python file, its functions checked at every call.

    Raises
    ------
    InputError
        No such file, no ``KIND``, another name than the file's, or a function of other arguments.
    """
    kind = getattr(load_module(path), "KIND", None)
    if not isinstance(kind, Kind):
        raise InputError(
            str(path), "KIND = Kind(...)", repr(kind), "make it as docs/own-effect.md does"
        )
    if kind.name != path.stem:
        raise InputError(
            f"{path}: KIND.name", repr(path.stem), repr(kind.name), "name the file after it"
        )
    hooks: dict[str, Any] = {
        name: guarded(path, name, hook)
        for name in ARGUMENTS
        if (hook := getattr(kind, name, None)) is not None
    }
    return replace(kind, **hooks)


def guarded(path: Path, name: str, hook: Any) -> Callable[..., Any]:
    """A function of a user's file, whose faults are one line, and whose result is checked.

    Raises
    ------
    InputError
        It is no function of the arguments that it will get.
    """
    wanted = f"{name}({', '.join(ARGUMENTS[name])})"
    try:
        inspect.signature(hook).bind(*ARGUMENTS[name])
    except (TypeError, ValueError) as error:
        line = getattr(getattr(hook, "__code__", None), "co_firstlineno", None)
        where = str(path) if line is None else f"{path}, line {line}"
        raise InputError(where, wanted, str(error), "take these arguments") from None

    @wraps(hook)
    def call(*given: Any) -> Any:
        try:
            result = hook(*given)
        except InputError:
            raise
        except Exception as error:  # noqa: BLE001 - a user's file may do anything
            raise _fault(path, f"{wanted} that returns", error) from None
        return _checked(f"{path}: {name}", name, result, given)

    return call


def _fault(path: Path, expected: str, error: Exception) -> InputError:
    """An exception in a user's file as one line."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(path)]
    if isinstance(error, SyntaxError):
        lines.append(error.lineno)
    where = f"{path}, line {lines[-1]}" if lines else str(path)
    message = " ".join(str(error).split())
    return InputError(where, expected, f"{type(error).__name__}: {message}", "mend that line")


def _checked(where: str, name: str, result: Any, given: tuple[Any, ...]) -> Any:
    """A result of the form that it has to have."""
    if name in ("change", "change_in_rows"):
        _check_type(where, result, Physics)
        _check_physics(where, result, given[0], len(next(iter(given[2].values()))))
    elif name == "columns":
        _check_type(where, result, tuple)
        return tuple(_checked_column(where, column) for column in result)
    elif name == "rate_errors":
        points = len(next(iter(given[0].values())))
        for part, what in zip(_pair(where, result), ("bias", "scale"), strict=True):
            _check_shape(f"{where}: {what}", part, (points, 3))
    elif name == "left_open":
        columns, variances = _pair(where, result)
        _check_shape(f"{where}: columns", columns, (len(given[1].time_s), 3, len(variances)))
    elif name == "simulate":
        _check_type(where, result, type(given[0]))
    elif name == "fire":
        _check_type(where, result, Fired)
    elif name in ("report", "doubt"):
        _check_type(where, result, dict)
        for key, value in result.items() if name == "doubt" else ():
            _check_type(f"{where}: {key}", value, Printed)
    return result


def _check_type(where: str, result: object, wanted: type) -> None:
    if not isinstance(result, wanted):
        raise InputError(where, f"a {wanted.__name__}", type(result).__name__, "return one")


def _pair(where: str, result: Any) -> tuple[Any, Any]:
    if not isinstance(result, tuple) or len(result) != 2:
        raise InputError(where, "two arrays", type(result).__name__, "return both")
    return result


def _check_physics(where: str, result: Physics, given: Physics, points: int) -> None:
    """Every quantity that was changed has the shape of one for every point."""
    axes, wheels, thrusters = (3,), given.wheel_inertia_kg_m2.shape[-1:], given.arms_m.shape[-1:]
    tails: Mapping[str, Shape] = {
        "inertia_kg_m2": (3, 3),
        "wheel_axes": (3, *wheels),
        "wheel_inertia_kg_m2": wheels,
        "arms_m": (3, *thrusters),
        "thrust_factor": thrusters,
        "impulse_offset_s": thrusters,
        "steady_torque_n_m": axes,
        "rate_bias_rad_s": axes,
        "rate_scale": axes,
    }
    for field in fields(Physics):
        value = getattr(result, field.name)
        if value is not getattr(given, field.name) and field.name in tails:
            _check_shape(f"{where}: {field.name}", value, (points, *tails[field.name]))
    for name, weight in result.extra.items():
        if given.extra.get(name) is not weight:
            tail = () if "@" in name else axes
            _check_shape(f"{where}: extra[{name!r}]", weight, (points, *tail))


def _check_shape(where: str, value: Any, wanted: Shape) -> None:
    """A shape that broadcasts to the one wanted."""
    shape = np.shape(value)
    try:
        fits = np.broadcast_shapes(shape, wanted) == wanted
    except ValueError:
        fits = False
    if not fits:
        raise InputError(where, f"an array {wanted}", f"one of shape {shape}", "mend its shape")


def _checked_column(where: str, column: object) -> ExtraColumn:
    """A column whose values are one finite number for every row."""
    if not isinstance(column, ExtraColumn):
        raise InputError(where, "ExtraColumn(name, function)", repr(column), "return these")
    path = Path(where.rpartition(": ")[0])

    def values(context: RowContext) -> Array:
        try:
            array = np.asarray(column.values(context), dtype=np.float64)
        except Exception as error:  # noqa: BLE001 - a user's file may do anything
            raise _fault(path, f"values of column {column.name}", error) from None
        _check_shape(f"{where}: {column.name}", array, (len(context.time_s),))
        if not np.isfinite(array).all():
            raise InputError(f"{where}: {column.name}", "finite values", "NaN", "mend the column")
        return array

    return replace(column, values=values)
