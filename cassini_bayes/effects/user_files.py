"""Effects that a user brings: a Python file like those of this package, checked at every call.

The file is run. It is only ever one that was named on the command line. Whatever is wrong with it
is one line with the file and the place in it.
"""

from __future__ import annotations

import importlib.util
import inspect
import json
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import wraps
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, Final

import numpy as np

from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.statistics import ExtraColumn, RowContext, Samples
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.controller import Fired
from cassini_bayes.effects.effect import Kind, SearchResult
from cassini_bayes.effects.printed import Printed
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import finite_number

Shape = tuple[int, ...]
_NAME: Final = re.compile(r"[A-Za-z]\w*", re.ASCII)
_TAKEN: Final = ("none", "unknown")  # what a diagnosis weighs beside causes
ARGUMENTS: Final[Mapping[str, tuple[str, ...]]] = {
    "change": ("physics", "parameters", "values", "setting"),
    "columns": ("thrusters",),
    "search": ("remainder", "priors"),
    "report": ("values", "setting"),
    "drawn": ("setting", "rng", "n"),
    "left_open": ("fired", "rows", "values", "setting"),
    "fire": ("controller", "values"),
    "doubt": ("printed", "width"),
    "says": ("sizes", "target"),
    "simulate": ("plan", "target", "values"),
}

RESULTS: Final[Mapping[str, type]] = {
    "change": Physics,
    **dict.fromkeys(("report", "drawn", "doubt"), dict),
    "columns": tuple,
    "fire": Fired,
    "says": str,
}
"""Types of what functions return; that of a simulation is its argument's."""
_SETTLED: Final = tuple(name for name in vars(SearchResult) if not name.startswith("_"))
"""What others read of what a search settled."""


class _Source(SourceFileLoader):
    """Runs a file as it is now: no bytecode of an earlier edit, and none left beside it."""

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002 - importlib names it
        return self.source_to_code(self.get_data(self.path), self.path)


def load_module(path: Path) -> ModuleType:
    """Run a Python file.

    Raises
    ------
    InputError
        There is none, or it fails: the line is named.
    """
    name = f"effect_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, loader=_Source(name, str(path)))
    if not path.is_file() or spec is None or spec.loader is None:
        raise InputError(str(path), "a Python file", "none", "name one that is there")
    if not _NAME.fullmatch(path.stem) or path.stem in _TAKEN:
        raise InputError(
            str(path),
            "a name of letters, digits and _",
            path.stem,
            "rename it",
        )
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # a dataclass looks up its annotations there
    try:
        with _faults_told(path, "a Python file that can be run"):
            spec.loader.exec_module(module)
    except InputError:
        del sys.modules[name]
        raise
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
            str(path), "KIND = Kind(...)", repr(kind), "make it as docs/how-to/own-effect.md does"
        )
    if kind.name != path.stem:
        raise InputError(
            f"{_kind_line(path)}: KIND.name",
            repr(path.stem),
            repr(kind.name),
            "name the file after it",
        )
    _check_figures(path, kind)
    hooks: dict[str, Any] = {
        name: guarded(path, name, hook, kind.reported)
        for name in ARGUMENTS
        if (hook := getattr(kind, name, None)) is not None
    }
    return replace(kind, **hooks)


def _check_figures(path: Path, kind: Kind) -> None:
    """What of a kind is no function."""
    for name, expected, form, holds in (
        ("reported", "a tuple of texts", tuple, _is_text),
        ("known_to", "steps by size", Mapping, _is_step),
        ("separation", "texts by kind", Mapping, _is_text),
    ):
        given: Any = getattr(kind, name)  # a user may have given anything
        values = given.values() if isinstance(given, Mapping) else given
        if not isinstance(given, form) or not all(map(holds, values)):
            where = f"{_kind_line(path)}: KIND.{name}"
            raise InputError(where, expected, repr(given), "write such")


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_step(value: object) -> bool:
    return value is None or (isinstance(value, int | float) and value >= 0)


def _kind_line(path: Path) -> str:
    """The file and the line in which its kind begins."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    begins = [number for number, line in enumerate(lines, 1) if line.startswith("KIND")]
    return f"{path}, line {begins[-1]}" if begins else str(path)


def _hook_line(path: Path, hook: Any) -> str:
    """The file and the line in which a function begins."""
    code = getattr(hook, "__code__", None)
    return str(path) if code is None else f"{path}, line {code.co_firstlineno}"


def guarded(path: Path, name: str, hook: Any, reported: tuple[str, ...] = ()) -> Callable[..., Any]:
    """A function of a user's file, whose faults are one line, and whose result is checked.

    A report has to give the sizes that its kind says are ``reported``, and draws no others.

    Raises
    ------
    InputError
        It is no function of the arguments that it will get.
    """
    wanted = f"{name}({', '.join(ARGUMENTS[name])})"
    try:
        inspect.signature(hook).bind(*ARGUMENTS[name])
    except (TypeError, ValueError) as error:
        where = _hook_line(path, hook)
        raise InputError(where, wanted, str(error), "take these arguments") from None

    @wraps(hook)
    def call(*given: Any) -> Any:
        with _faults_told(path, f"{wanted} that returns", but=InputError):
            result = hook(*given)
        where = f"{_hook_line(path, hook)}: {name}"
        result = _checked(path, where, name, result, given)
        if _has_other_sizes(name, result, reported):
            expected = f"the sizes that KIND.reported names, {sorted(reported)}"
            raise InputError(where, expected, str(sorted(map(str, result))), "return these")
        return result

    return call


def _has_other_sizes(name: str, result: Any, reported: tuple[str, ...]) -> bool:
    """Whether a report gives not all sizes, or it or draws any that are not reported."""
    if name == "report":
        return set(result) != set(reported)
    return name == "drawn" and bool(reported) and not set(result) <= set(reported)


@contextmanager
def _faults_told(
    path: Path, expected: str, but: type[Exception] | tuple[()] = ()
) -> Iterator[None]:
    """One line for whatever a user's file raises meanwhile; ``but`` goes through as it is."""
    try:
        yield
    except but:
        raise
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a user's file may do anything
        raise _fault(path, expected, error) from None


def _fault(path: Path, expected: str, error: BaseException) -> InputError:
    """An exception in a user's file as one line."""
    whole, frames = path.resolve(), traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if Path(frame.filename).resolve() == whole]
    if isinstance(error, SyntaxError) and Path(error.filename or "").resolve() == whole:
        lines.append(error.lineno)
    where = f"{path}, line {lines[-1]}" if lines else str(path)
    message = " ".join(str(error).split())
    return InputError(where, expected, f"{type(error).__name__}: {message}", "mend that line")


def _checked(path: Path, where: str, name: str, result: Any, given: tuple[Any, ...]) -> Any:
    """A result of the form that it has to have."""
    wanted = type(given[0]) if name == "simulate" else RESULTS.get(name)
    if wanted is not None:
        _check_type(where, result, wanted)
    if wanted is Physics:
        _check_physics(where, result, given[0], given[2])
    elif name == "columns":
        return tuple(_checked_column(path, where, column, given[0]) for column in result)
    elif name == "search":
        return None if result is None else _checked_search(path, where, result)
    elif name == "left_open":
        columns, variances = _pair(where, result)
        _check_shape(f"{where}: columns", columns, (len(given[1].time_s), 3, len(variances)))
    elif name in ("report", "drawn"):
        n = given[2] if name == "drawn" else len(next(iter(given[0].values())))
        return {key: _sizes(f"{where}: {key}", value, n) for key, value in result.items()}
    elif name == "doubt":
        for key, value in result.items():
            _check_type(f"{where}: {key}", value, Printed)
    return result


def _sizes(where: str, value: Any, n: int) -> Array:
    """One finite size for every draw (n,): a single number is that of all."""
    _check_numbers(where, value, (n,))
    return np.broadcast_to(np.asarray(value, dtype=np.float64), (n,))


def _check_type(where: str, result: object, wanted: type) -> None:
    if not isinstance(result, wanted):
        raise InputError(where, f"a {wanted.__name__}", type(result).__name__, "return one")


def _pair(where: str, result: Any) -> tuple[Any, Any]:
    if not isinstance(result, tuple) or len(result) != 2:
        raise InputError(where, "two arrays", type(result).__name__, "return both")
    return result


def _check_physics(
    where: str, result: Physics, given: Physics, values: Mapping[str, Array]
) -> None:
    """Every quantity that was changed has the shape of one for every point, and finite values."""
    points = len(next(iter(values.values())))
    axes, wheels, thrusters = (3,), given.wheel_inertia_kg_m2.shape[-1:], given.arms_m.shape[-1:]
    tails: Mapping[str, Shape] = {
        "inertia_kg_m2": (3, 3),
        "wheel_axes": (3, *wheels),
        "wheel_inertia_kg_m2": wheels,
        "arms_m": (3, *thrusters),
        **dict.fromkeys(("close_share", "pair_factor", "late_factor", "open_factor"), ()),
        "thrust_factor": thrusters,
        "impulse_offset_s": thrusters,
        "steady_torque_n_m": axes,
        "rate_bias_rad_s": axes,
        "rate_scale": axes,
    }
    for field in fields(Physics):
        value = getattr(result, field.name)
        if value is not getattr(given, field.name) and field.name in tails:
            _check_numbers(f"{where}: {field.name}", value, (points, *tails[field.name]))
    tau_s: Any = result.tau_s  # a user may have given anything
    if tau_s is not given.tau_s:
        if not isinstance(tau_s, tuple) or len(tau_s) != 3:
            got = type(tau_s).__name__
            raise InputError(f"{where}: tau_s", "three arrays", got, "return delay, rise and fall")
        for name, tau in zip(("delay", "rise", "fall"), tau_s, strict=True):
            _check_numbers(f"{where}: tau_s ({name})", tau, (points,))
    for name, weight in result.extra.items():
        if given.extra.get(name) is not weight:
            tail = () if "@" in name else axes
            _check_numbers(f"{where}: extra[{name!r}]", weight, (points, *tail))


def _check_numbers(where: str, value: Any, wanted: Shape) -> None:
    """Finite numbers of a shape."""
    _check_shape(where, value, wanted)
    if not np.isfinite(value).all():
        raise InputError(
            where, "finite values", "NaN or infinity", "mend it, or bound the parameter"
        )


def _check_shape(where: str, value: Any, wanted: Shape) -> None:
    """Real numbers of a shape that broadcasts to the one wanted."""
    try:
        array = np.asarray(value)
    except ValueError:  # ragged lists
        array = np.array(None)
    if array.dtype.kind not in "fiub":
        raise InputError(where, f"real numbers {wanted}", repr(value)[:60], "return an array")
    shape = array.shape
    try:
        fits = np.broadcast_shapes(shape, wanted) == wanted
    except ValueError:
        fits = False
    if not fits:
        raise InputError(where, f"an array {wanted}", f"one of shape {shape}", "mend its shape")


def _checked_search(path: Path, where: str, result: Any) -> Any:
    """What a search settled, its functions checked at every call as those of a kind are."""
    settled = {name: _settled(path, where, result, name) for name in _SETTLED}
    for name in ("log_gain", "log_looks"):
        finite_number(f"{where}: {name}", settled[name])
    _check_type(f"{where}: said", settled["said"], str)
    for name in ("prior_scales", "record"):
        _check_type(f"{where}: {name}", settled[name], Mapping)
    for key, scale in settled["prior_scales"].items():
        place = f"{where}: prior_scales[{key!r}]"
        if finite_number(place, scale) <= 0.0:
            raise InputError(place, "a factor above 0", repr(scale), "mend it, or leave it out")
    try:
        json.dumps(dict(settled["record"]))
    except (TypeError, ValueError) as error:
        expected, fix = "texts and plain numbers", "turn arrays into lists of numbers"
        raise InputError(f"{where}: record", expected, str(error), fix) from None

    def columns(samples: Samples) -> tuple[ExtraColumn, ...]:
        made = _called(path, "columns(samples)", settled["columns"], samples)
        _check_type(f"{where}: columns", made, tuple)
        return tuple(_checked_column(path, where, column, ()) for column in made)

    def log_start_of(samples: Samples) -> float:
        cost = _called(path, "log_start_of(samples)", settled["log_start_of"], samples)
        return finite_number(f"{where}: log_start_of", cost)

    try:
        for name, checked in (("columns", columns), ("log_start_of", log_start_of)):
            object.__setattr__(result, name, checked)  # frozen or not, it has to be this one
    except (AttributeError, TypeError):
        expected = "an object whose functions can be replaced by checked ones"
        fix = "make it a dataclass without slots, that inherits from SearchResult"
        raise InputError(where, expected, repr(result)[:60], fix) from None
    return result


def _settled(path: Path, where: str, result: Any, name: str) -> Any:
    """One attribute of what a search settled."""
    try:
        with _faults_told(path, f"{name} of what a search settled", but=AttributeError):
            return getattr(result, name)
    except AttributeError:
        fix = "give it one, or inherit from SearchResult"
        raise InputError(where, f"a result with {name}", repr(result)[:60], fix) from None


def _called(path: Path, wanted: str, function: Any, samples: Samples) -> Any:
    with _faults_told(path, f"{wanted} that returns"):
        return function(samples)


def _checked_column(
    path: Path, where: str, column: object, thrusters: Sequence[str]
) -> ExtraColumn:
    """A column whose values are one finite number for every row."""
    if not isinstance(column, ExtraColumn):
        raise InputError(where, "ExtraColumn(name, function)", repr(column), "return these")
    _, at, thruster = column.name.partition("@")
    if at and thruster not in thrusters:
        raise InputError(
            f"{where}: {column.name}",
            f"a thruster behind @, one of {', '.join(thrusters) or 'none'}",
            repr(thruster),
            "name one that was given",
        )

    def values(context: RowContext) -> Array:
        with _faults_told(path, f"values of column {column.name}"):
            array = np.asarray(column.values(context), dtype=np.float64)
        _check_shape(f"{where}: {column.name}", array, (len(context.time_s),))
        if not np.isfinite(array).all():
            raise InputError(f"{where}: {column.name}", "finite values", "NaN", "mend the column")
        return array

    return replace(column, values=values)
