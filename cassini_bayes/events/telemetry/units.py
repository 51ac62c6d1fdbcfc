"""Units of foreign columns, read by pint, as factors to the units of telemetry."""

from __future__ import annotations

import re
from functools import cache
from typing import Any, Final

from cassini_bayes.errors import InputError

LONGEST: Final = 60  # characters of a unit
# Names, products, quotients and small powers: nothing that a parser could take long over.
_UNIT: Final = re.compile(
    r"(?:1|[A-Za-zµμ°_%][\w°]*)(?:\s*(?:\*\*|\^)\s*-?\d)?"
    r"(?:\s*[*/·]\s*(?:1|[A-Za-zµμ°_%]\w*)(?:\s*(?:\*\*|\^)\s*-?\d)?"
    r"|\s+[A-Za-zµμ°_%]\w*(?:\s*(?:\*\*|\^)\s*-?\d)?)*"
)
EXAMPLES: Final = {
    "s": ("s", "ms", "us", "min", "day"),
    "rad/s": ("rad/s", "deg/s", "mrad/s", "arcsec/s"),
    "rpm": ("rpm", "rad/s", "deg/s", "rev/s"),
    "m/s": ("m/s", "mm/s", "cm/s"),
    "kPa": ("kPa", "Pa", "bar", "psi"),
    "count": ("count", "1"),
    "1": ("1",),
}
"""Units that a channel may have, by the one that it gets; the documentation's table."""


def factor_to(unit: str, wanted: str, where: str) -> float:
    """What a number in ``unit`` is multiplied by to be in ``wanted``.

    An angle counts: ``Hz`` is no unit of a body rate, as it may be turns or radians per second.

    Raises
    ------
    InputError
        No unit, or one of another quantity.
    """
    if unit == wanted or (wanted == "count" and unit == "1"):
        return 1.0
    registry, examples = _registry(), EXAMPLES[wanted]
    text, result = unit.strip(), None
    if len(text) <= LONGEST and _UNIT.fullmatch(text):
        try:
            result = registry.get_root_units(registry.Unit(text))
        except (AttributeError, ValueError, TypeError, ArithmeticError):  # pint's own are such
            result = None
    if result is None:
        raise InputError(
            where, "a unit that pint knows", repr(unit), f"write it like {', '.join(examples)}"
        )
    factor, root = result
    scale, expected = registry.get_root_units(registry.Unit(wanted))
    if root != expected:
        raise InputError(
            where,
            f"a unit that turns into {wanted}, such as {', '.join(examples)}",
            f"{unit!r}, which is {root}",
            "write the unit that the column has",
        )
    return float(factor) / float(scale)


@cache
def _registry() -> Any:
    """Pint's units, which take a moment to be read, and two that engineers write."""
    import pint

    registry: Any = pint.UnitRegistry()
    registry.define("rev = revolution")
    registry.define("dps = degree / second")
    return registry
