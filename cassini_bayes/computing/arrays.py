"""Types of arrays, and values that hold some: dataclasses, mappings and tuples of arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Places = NDArray[np.int64]
Flags = NDArray[np.bool_]
Value = TypeVar("Value")


def mapped(function: Callable[..., Any], *values: Any) -> Any:
    """A value whose arrays are a function's of those at the same place of values of one form.

    What is no array, and holds none, is that of the first value.
    """
    first = values[0]
    if isinstance(first, np.ndarray):
        return function(*values)
    if isinstance(first, Mapping):
        return {key: mapped(function, *(value[key] for value in values)) for key in first}
    if isinstance(first, tuple):
        return tuple(mapped(function, *each) for each in zip(*values, strict=True))
    if is_dataclass(first) and not isinstance(first, type):
        names = [field.name for field in fields(first) if field.init]
        parts = {name: [getattr(value, name) for value in values] for name in names}
        return replace(first, **{name: mapped(function, *own) for name, own in parts.items()})
    return first


def picked(value: Value, places: Any) -> Value:
    """The same at some places of every array: indices, flags or slices."""
    result: Value = mapped(lambda array: array[places], value)
    return result


def joined(parts: Sequence[Value], axis: int = 0) -> Value:
    """Values of one form as one, their arrays side by side along an axis."""
    if len(parts) == 1:
        return parts[0]
    result: Value = mapped(lambda *arrays: np.concatenate(arrays, axis=axis), *parts)
    return result
