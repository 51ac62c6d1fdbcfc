"""Numbers as an engineer writes them: sensible digits, readable units, short names."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cassini_bayes.priors import quantiles

INTERVAL: Final = "90 % highest-density interval"
INTERVAL_SHORT: Final = "90 % HDI"
MISSING: Final = "–"
NORMAL_90: Final = quantiles.NORMAL_90
NORMAL_INTERVAL: Final = "90 % interval (mean ± 1.645 standard deviations)"

_SUPERSCRIPTS: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_PREFIXES: Final = {1: "m", 2: "µ", 3: "n"}
_TAKES_PREFIX: Final = ("m", "s", "N", "rad", "rad/s", "m/s")
_SMALLEST_UNSCALED: Final = 0.1  # a value below it gets a prefix: 0.0123 N m is 12.3 mN m
_MOST_DECIMALS: Final = 5  # beyond which a number is written with a power of ten


@dataclass(frozen=True)
class Scale:
    """How a quantity is shown: ``shown = value × factor``, in ``unit``."""

    factor: float
    unit: str


def readable_unit(unit: str) -> str:
    """A unit for people: ``kg m2`` → ``kg m²``, ``1`` → ``–``."""
    if unit in ("1", ""):
        return MISSING
    return " ".join(
        part[0] + part[1:].translate(_SUPERSCRIPTS) if part[0].isalpha() else part
        for part in unit.split(" ")
    )


def display_scale(unit: str, *magnitudes: float) -> Scale:
    """A prefix (m, µ, n) for a quantity whose values, of these magnitudes, are all below 0.1.

    Units that take no prefix gracefully (kg m², dimensionless) stay as they are.
    """
    largest = max((abs(m) for m in magnitudes if math.isfinite(m)), default=0.0)
    shown = readable_unit(unit)
    if largest <= 0.0 or largest >= _SMALLEST_UNSCALED or unit.split(" ")[0] not in _TAKES_PREFIX:
        return Scale(1.0, shown)
    step = min(math.ceil(-math.log10(largest) / 3.0 - 1e-9), max(_PREFIXES))
    return Scale(1e3**step, _PREFIXES[step] + shown)


def decimals_for(sd: float) -> int:
    """Decimal places that give ``sd`` two significant digits (0 for large ones)."""
    if not math.isfinite(sd) or sd <= 0.0:
        return _MOST_DECIMALS - 2
    rounded = float(f"{sd:.1e}")  # 0.0996 is shown as 0.10
    return max(0, 1 - math.floor(math.log10(rounded)))


def number(value: float, sd: float) -> str:
    """``value`` with the digits that its standard deviation ``sd`` supports.

    Anything needing more than five decimals is written with a power of ten.
    """
    if not math.isfinite(value):
        return MISSING
    places = decimals_for(sd)
    if places > _MOST_DECIMALS:
        exponent = math.floor(math.log10(max(abs(value), sd)))
        power = f"10{str(exponent).translate(_SUPERSCRIPTS)}"
        return f"{_signed(value / 10.0**exponent, max(0, places + exponent))} × {power}"
    return _signed(value, places)


def _signed(value: float, places: int) -> str:
    text = f"{value:.{places}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")  # no negative zero
    return text.replace("-", "−")


def plus_minus(mean: float, sd: float) -> str:
    """``mean ± sd``, the standard deviation with two significant digits."""
    if not math.isfinite(mean):
        return MISSING
    return f"{number(mean, sd)} ± {number(sd, sd)}" if math.isfinite(sd) else number(mean, sd)


def interval(low: float, high: float) -> str:
    """``low … high`` with the digits that the interval's width supports."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return MISSING
    sd = (high - low) / (2.0 * NORMAL_90)
    return f"{number(low, sd)} … {number(high, sd)}"


def short_name(name: str, unit: str) -> str:
    """A parameter's name without the unit it ends with: ``cm_x_m`` in m → ``cm_x``."""
    suffix = unit.lower().replace("-1", "").replace("/", "_").replace(" ", "_")
    return name.removesuffix(f"_{suffix}")


def wrapped_name(name: str, longest: int = 13) -> str:
    """A long name on two lines, broken at the underscore nearest its middle."""
    breaks = [i for i, letter in enumerate(name) if letter == "_" and 0 < i < len(name) - 1]
    if len(name) <= longest or not breaks:
        return name
    middle = min(breaks, key=lambda i: abs(i - len(name) / 2.0))
    return f"{name[:middle]}\n{name[middle:]}"


def short_events(events: Sequence[str], longest: int = 14) -> list[str]:
    """Event ids without what all of them end with: ``2009-08-22-bias`` → ``2009-08-22``.

    Where they are still too long, also without what all of them begin with; then the middle is left
    out. Ids that differ have labels that differ.
    """
    words = [re.split(r"(?<=[-_ ])", event) for event in events]
    words = _without_common(words, last=True)
    if any(len("".join(w)) > longest for w in words):
        words = _without_common(words, last=False)
    labels = ["".join(w).rstrip("-_ ") for w in words]
    cut = [shortened(label, longest) for label in labels]
    return cut if len(set(cut)) == len(set(events)) else labels


def _without_common(words: list[list[str]], *, last: bool) -> list[list[str]]:
    """Without the words that all of several lists end, or begin, with; one stays of each."""
    end = -1 if last else 0
    while len(words) > 1 and min(map(len, words)) > 1 and len({w[end] for w in words}) == 1:
        words = [w[:-1] if last else w[1:] for w in words]
    return words


def shortened(name: str, longest: int) -> str:
    """A name without its middle where it is too long."""
    if len(name) <= longest:
        return name
    front = (longest - 1) // 2
    return f"{name[:front]}…{name[len(name) - (longest - 1 - front) :]}"


def observed_name(quantity: str) -> str:
    """``thrust[all events,z1]`` → ``z1 level``; other quantities keep their name."""
    if quantity.startswith("thrust[all events,"):
        return f"{quantity.removeprefix('thrust[all events,').rstrip(']')} level"
    return quantity
