"""Compiled functions: numba with its cache on disk, or without where none can be kept.

Numba's cache notices a change in the file of a function, but not in another file that the function
calls into: compiled functions that call each other are in one file. Nor can it read what it kept of
a function once a class of its arguments has lost its name: then the function gets a new one, too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])

# numpy's division: checks for zero would cost a third of the time; nogil: other threads may work
# meanwhile
OPTIONS: Final[dict[str, Any]] = {"error_model": "numpy", "nogil": True}
SUMS: Final[dict[str, Any]] = {**OPTIONS, "fastmath": {"reassoc", "contract"}}


def compiled(function: Function) -> Function:
    """The function compiled as it is written, on its first call with arguments of a kind."""
    return _compiled(function, OPTIONS)


def compiled_sums(function: Function) -> Function:
    """The function compiled with sums in whatever order is fastest."""
    return _compiled(function, SUMS)


def _compiled(function: Function, options: dict[str, Any]) -> Function:
    try:
        return cast(Function, njit(cache=True, **options)(function))
    except RuntimeError:  # no folder where compiled code may be kept: compile in every process
        return cast(Function, njit(**options)(function))
