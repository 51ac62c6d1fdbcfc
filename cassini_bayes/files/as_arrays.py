"""Results as named arrays, and back: dataclasses, tuples, numbers, text and plain records.

What a file holds is read back as the kind that the caller says it is: no file names a type.
"""

from __future__ import annotations

import json
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]
_SCALARS: Final = (bool, int, float, str)
_RECORDS: Final = (dict, list)


def arrays_of(value: object, name: str = "value") -> Arrays:
    """A result as named arrays; ``None`` is none.

    Parameters
    ----------
    value
        A dataclass, a tuple, an array, a number, a text, a record of plain JSON types, or None; and
        dataclasses and tuples of such.

    Raises
    ------
    TypeError
        Anything else.
    """
    if value is None:
        return {}
    if is_dataclass(value):
        parts = {field.name: getattr(value, field.name) for field in fields(value)}
        return _joined(name, parts)
    if isinstance(value, tuple):
        return _joined(name, {str(place): part for place, part in enumerate(value)})
    if isinstance(value, _RECORDS):
        return {name: np.asarray(json.dumps(value))}
    if isinstance(value, (*_SCALARS, np.ndarray, np.generic)):
        return {name: np.asarray(value)}
    raise TypeError(f"{name}: no arrays stand for {type(value).__name__}")


def value_of(kind: Any, arrays: Mapping[str, NDArray[np.generic]], name: str = "value") -> Any:
    """The result of a kind that :func:`arrays_of` has made arrays of.

    Parameters
    ----------
    kind
        Its type as an annotation has it: a dataclass, ``tuple[…]``, ``float``, ``list``, an array,
        or one of these or None; of ``tuple[kind, ...]`` there are as many as there are arrays of.

    Raises
    ------
    KeyError
        An array that the kind has is missing.
    """
    if get_origin(kind) in (Union, types.UnionType):
        rest = [one for one in get_args(kind) if one is not type(None)]
        present = any(key == name or key.startswith(f"{name}.") for key in arrays)
        return value_of(rest[0], arrays, name) if present else None
    if get_origin(kind) is tuple:
        kinds = get_args(kind)
        if kinds[-1] is Ellipsis:
            inside = [key for key in arrays if key.startswith(f"{name}.")]
            kinds = kinds[:1] * len({key[len(name) + 1 :].partition(".")[0] for key in inside})
        return tuple(value_of(one, arrays, f"{name}.{i}") for i, one in enumerate(kinds))
    if is_dataclass(kind) and isinstance(kind, type):
        hints = get_type_hints(kind)
        return kind(
            **{f.name: value_of(hints[f.name], arrays, f"{name}.{f.name}") for f in fields(kind)}
        )
    if (get_origin(kind) or kind) in _RECORDS:
        return json.loads(str(arrays[name]))
    return arrays[name].item() if kind in _SCALARS else arrays[name]


def _joined(name: str, parts: Mapping[str, object]) -> Arrays:
    result: Arrays = {}
    for key, part in parts.items():
        result |= arrays_of(part, f"{name}.{key}")
    return result
