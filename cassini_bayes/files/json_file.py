"""JSON that this package wrote, read back: one way to a value, bounded before it is parsed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.bounds import check_bounds
from cassini_bayes.files.reading import read_bytes, text_of

MOST_BYTES: Final = 64 << 20


def read_json(path: Path, what: str) -> dict[str, Any]:
    """The object of a JSON file; ``what`` it should be is for messages.

    Raises
    ------
    InputError
        The file cannot be read or is too large, or as :func:`json_of`.
    """
    return json_of(read_bytes(path, what, MOST_BYTES), str(path), what)


def json_of(content: bytes, where: str, what: str) -> dict[str, Any]:
    """The object that some bytes of JSON stand for.

    Raises
    ------
    InputError
        No UTF-8, no JSON, nested too deep, or no object.
    """
    text = text_of(content, where)
    check_bounds(text, where)
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(where, "valid JSON", str(error), "write the file again") from None
    if not isinstance(value, dict):
        raise InputError(where, what, "JSON that is no object", "write the file again")
    return value
