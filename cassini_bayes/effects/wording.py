"""Sizes of an effect in words: rounded by their uncertainty, in the unit that engineers use.

Every kind may say what its sizes mean (``says`` of :class:`.Kind`): "Z3 delivers 74 ± 4 % of its
thrust". One that does not is said by the keys and units of its table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, floor, isfinite, log10
from typing import Final, Protocol

TWO_DIGITS: Final = 35
"""Leading two digits of an error up to which both are printed, one beyond: the rule of the Particle
Data Group (Review of Particle Physics, introduction, "Rounding")."""
INTERVAL: Final = "90 % HDI"


def decimals_of(sd: float) -> int:
    """Decimal places to which a value with this error is printed; negative left of the point."""
    if not isfinite(sd) or sd <= 0.0:
        return 3
    place = floor(log10(sd))
    leading = round(sd / 10.0 ** (place - 1))
    return 1 - place if leading <= TWO_DIGITS else -place


def rounded(value: float, decimals: int) -> str:
    """A value to some decimal places, with a true minus sign and no minus zero."""
    whole = round(value, decimals) + 0.0
    return f"{whole:,.{max(decimals, 0)}f}".replace("-", "−")


@dataclass(frozen=True)
class Stated:
    """One size to put into words: posterior mean, standard deviation, ends of the shortest 90 %."""

    mean: float
    sd: float
    low: float
    high: float
    unit: str = ""

    def said(self, unit: str | None = None, factor: float = 1.0) -> str:
        """In words, such as ``74 ± 4 % (90 % HDI 66 to 80 %)``.

        Parameters
        ----------
        unit
            That is said; that of the table by default.
        factor
            From the table's unit to that one.
        """
        name = self.unit if unit is None else unit
        behind = f" {name}" if name not in ("", "1") else ""
        decimals = decimals_of(self.sd * factor)
        mean, sd, low, high = (
            rounded(value * factor, decimals) for value in (self.mean, self.sd, self.low, self.high)
        )
        return f"{mean} ± {sd}{behind} ({INTERVAL} {low} to {high}{behind})"


@dataclass(frozen=True)
class AtLeast:
    """A size from which something would have been seen, as a departure from no effect.

    ``null`` is the value without an effect, ``size`` how far from it, ``sides`` the signs that the
    prior allows. A departure is one from the parameter of that name in the priors file.
    """

    null: float
    size: float
    sides: tuple[float, ...]
    unit: str = ""
    is_departure: bool = False

    def said(self, unit: str | None = None, factor: float = 1.0) -> str:
        """In words, such as ``96 % or less``; unit and factor as for :meth:`Stated.said`.

        The size is rounded away from no effect, so that what is said is not less than what is seen.
        """
        name = self.unit if unit is None else unit
        behind = f" {name}" if name not in ("", "1") else ""
        size = self.size * abs(factor)
        decimals = decimals_of(size)
        size = ceil(size * 10.0**decimals - 1e-9) / 10.0**decimals
        if self.is_departure:
            return f"{rounded(size, decimals)}{behind} or more off its prior mean"
        less, more = (rounded(self.null * factor + sign * size, decimals) for sign in (-1.0, 1.0))
        if len(self.sides) == 1:
            return f"{more}{behind} or more" if self.sides[0] > 0.0 else f"{less}{behind} or less"
        if self.null == 0.0:
            return f"±{more}{behind} or more"
        return f"at most {less} or at least {more}{behind}"


class Worded(Protocol):
    """A size that can be said."""

    def said(self, unit: str | None = None, factor: float = 1.0) -> str:
        """In words, in a unit and with the factor from the table's unit to it."""


Sizes = Mapping[str, Worded]


@dataclass(frozen=True)
class Clause:
    """Words of a kind: what its sizes on a target mean.

    In the text ``{0}``, ``{1}`` … are the sizes in the order of the table, or as they are reported,
    ``{target}`` is the target and ``{TARGET}`` the same in capitals. ``units`` are those that the
    sizes are said in (None: as the table has it), with factors from the table's; sizes beyond them
    are not said.
    """

    text: str
    units: tuple[tuple[str | None, float], ...]

    def __call__(self, sizes: Sizes, target: str) -> str:
        """The clause, without a full stop."""
        said = [size.said(*unit) for size, unit in zip(sizes.values(), self.units, strict=False)]
        return self.text.format(*said, target=target, TARGET=target.upper())


def by_keys(name: str, sizes: Sizes) -> str:
    """An effect without words of its own: its name, keys and units."""
    said = ", ".join(f"{key} = {size.said()}" for key, size in sizes.items())
    return f"{name} acts with {said}" if said else f"{name} acts"
