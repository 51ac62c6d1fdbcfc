"""TOML: one way to a table, bounded before it is parsed."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.bounds import check_bounds
from cassini_bayes.files.reading import read_bytes, text_of

MOST_BYTES: Final = 1 << 20  # a hundred times the longest priors file
_WHOLE: Final = range(-(2**63), 2**63)  # what TOML promises


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Tables of a TOML file; ``what`` it should be is for messages.

    Raises
    ------
    InputError
        As :func:`toml_bytes` and :func:`toml_of`.
    """
    return toml_of(toml_bytes(path, what), str(path))


def toml_bytes(path: Path, what: str) -> bytes:
    """Bytes of a TOML file, for a reader that keeps their digest.

    Raises
    ------
    InputError
        The file cannot be read, or is larger than :data:`MOST_BYTES`.
    """
    return read_bytes(path, what, MOST_BYTES)


def toml_of(
    content: bytes, where: str, parse_float: Callable[[str], Any] = float
) -> dict[str, Any]:
    """Tables of TOML text; ``parse_float`` makes what stands for a decimal number.

    Raises
    ------
    InputError
        No UTF-8, no TOML, nested too deep, a whole number beyond 64 bits or a null character (no
        path or name has one): the line or key is named.
    """
    text = text_of(content, where)
    check_bounds(text, where)
    try:
        tables = tomllib.loads(text, parse_float=parse_float)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, "valid TOML", str(error), "mend that line") from None
    for key, value in _values(tables):
        if isinstance(value, int) and value not in _WHOLE:
            raise InputError(
                f"{where}: {key}",
                "a whole number of 64 bits",
                str(value),
                "write fewer digits, or a decimal number like 1e30",
            )
        if isinstance(value, str) and "\0" in value:
            raise InputError(
                f"{where}: {key}", "text without null characters", repr(value), "mend that line"
            )
    return tables


def _values(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """What stands in tables and lists at any depth, each with its dotted key."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _values(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for place, inner in enumerate(value, start=1):
            yield from _values(inner, f"{key}[{place}]")
    else:
        yield key, value
