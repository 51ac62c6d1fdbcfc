"""What single numbers of a scenario may be, by the keys that they stand under."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import finite_number
from cassini_bayes.simulation.settings import LARGEST, SMALLEST


@dataclass(frozen=True)
class Limit:
    """What numbers have to be whose whole key matches a pattern, in words, and how to mend one."""

    keys: str
    holds: Callable[[float], bool]
    expected: str
    fix: str


def is_positive(number: float) -> bool:
    """Above 0, by more than a slip of the pen."""
    return number >= SMALLEST


def is_not_negative(number: float) -> bool:
    """0 or more."""
    return number >= 0.0


def is_share(number: float) -> bool:
    """From 0 to 1."""
    return 0.0 <= number <= 1.0


def is_angle(number: float) -> bool:
    """Within a turn, in rad."""
    return abs(number) <= 2.0 * math.pi


_ANY: Final = Limit(
    ".*", lambda x: abs(x) <= LARGEST, f"a number within ±{LARGEST:g}", "check the unit"
)


def limited(where: str, key: str, value: object, limits: Iterable[Limit]) -> float:
    """A number within what its key allows.

    Raises
    ------
    InputError
        No finite number, one that no spacecraft comes near, or one beyond a limit.
    """
    number = finite_number(where, value)
    for limit in (_ANY, *limits):
        if re.fullmatch(limit.keys, key) and not limit.holds(number):
            raise InputError(where, limit.expected, repr(value), limit.fix)
    return number
