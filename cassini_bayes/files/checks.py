"""Small checks that every reader of user input makes at the door."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterable
from datetime import UTC, datetime
from numbers import Integral
from typing import Final

from cassini_bayes.errors import InputError

LONGEST_NUMBER: Final = 400  # characters
LARGEST_SEED: Final = 2**63 - 1  # what TOML and NetCDF can hold
DEFAULT_SEED: Final = 1  # of commands that draw, where nobody chose another
_NUMBER: Final = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)


def closest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The known name most like ``name``; None when none is alike by at least ``cutoff``.

    One of the same letters in another order comes first: exchanged letters are the usual slip.
    """
    close = difflib.get_close_matches(name, list(known), n=3, cutoff=cutoff)
    exchanged = [other for other in close if sorted(other) == sorted(name)]
    return next(iter([*exchanged, *close]), None)


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint for an unknown name: the closest known one, or all of them when none is close."""
    choices = list(known)
    close = closest(name, choices)
    return f"did you mean {close!r}?" if close else f"known: {', '.join(choices) or 'none'}"


def choose(name: str, listed: Iterable[str]) -> str:
    """A hint for a name that is none of those a message lists already: the closest, if one is."""
    close = closest(name, listed)
    return f"did you mean {close!r}?" if close else "choose one of them"


def check_known(
    where: str,
    name: object,
    known: Collection[str],
    expected: str | None = None,
    got: str | None = None,
) -> None:
    """Refuse a name that is none of those known, with a hint at the nearest.

    Raises
    ------
    InputError
        It is not; ``expected`` says what would be, the known names by default, and ``got`` what it
        is, the name itself by default.
    """
    if name in known:
        return
    wanted = expected or f"one of {', '.join(known) or 'none'}"
    hint = choose if expected is None and known else nearest
    raise InputError(where, wanted, got or repr(name), hint(str(name), known))


def check_seed(seed: object, where: str = "seed") -> int:
    """The seed as a plain number, which records can hold; NumPy's whole numbers are taken.

    Raises
    ------
    InputError
        No whole number, or one below 0 or above ``LARGEST_SEED``.
    """
    if (
        isinstance(seed, bool)
        or not isinstance(seed, Integral)
        or not 0 <= int(seed) <= LARGEST_SEED
    ):
        expected = f"a whole number from 0 to {LARGEST_SEED}"
        raise InputError(where, expected, repr(seed), "choose another seed")
    return int(seed)


def finite_number(where: str, value: object, unit: str = "") -> float:
    """``value`` as a float.

    Raises
    ------
    InputError
        When it is no number (booleans and strings are none), NaN or infinite.
    """
    wanted = f"a finite number{f' in {unit}' if unit else ''}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(where, wanted, repr(value), "write a plain number, without quotes")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(where, wanted, str(number), "give a finite value, or leave the key out")
    return number


def parse_number(text: str) -> float | None:
    """The finite number that plain digits spell (``-1118``, ``4.28e-5``); None for other text."""
    if len(text) > LONGEST_NUMBER or not _NUMBER.fullmatch(text):
        return None
    number = float(text)
    return number if math.isfinite(number) else None


def in_utc(time: str | datetime) -> datetime | None:
    """A time, or its ISO 8601 text, in UTC, which is also taken where no zone is named.

    None for other text, and for a zone that leads beyond the years 1 to 9999.
    """
    try:
        result = datetime.fromisoformat(time) if isinstance(time, str) else time
        return result.replace(tzinfo=UTC) if result.tzinfo is None else result.astimezone(UTC)
    except (ValueError, OverflowError):
        return None
