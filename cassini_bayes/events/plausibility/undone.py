"""Mistakes of wheels and counters that are linear in the recorded channels, each undone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.plausibility.departures import (
    Correction,
    Nominal,
    exchanged,
    exchanges_of,
)
from cassini_bayes.events.plausibility.momentum import is_resting, largest_jumps
from cassini_bayes.events.plausibility.rows import Rows
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

ORDER_PRICE: Final = 2.0  # a first-order nat for one of many orders
FREE_PRICE: Final = 12.0  # a free size: some six nats of Occam's factor
WHEEL_UNITS: Final = {
    "rad/s": 1.0 / RAD_S_PER_RPM,
    "deg/s": 1.0 / 6.0,
    "rev/s": 60.0,
    "rev/min turned to rad/s twice": RAD_S_PER_RPM,
}
LEAST_FACTOR_STEP: Final = 0.15
"""A free factor closer to 1 is a departure, no mistake: three widths of `wheel_inertia`'s prior."""
LEAST_FACTOR: Final = 1e-3
"""Of a wheel: with less the column says nothing."""


@dataclass(frozen=True, eq=False)
class Undone:
    """A mistake, what it looks like, how to mend the file, and what undoes it.

    ``what`` holds ``{factor}`` where a factor is free.
    """

    mistake: str
    what: str
    fix: str
    correction: Correction
    price: float = 0.0

    @property
    def is_unit(self) -> bool:
        """Whether all wheels are scaled."""
        return self.mistake == "wheel-unit"

    def sized(self, factor: float) -> Undone | None:
        """With a free factor put into words; None where it is as good as 1, or as 0."""
        if not self.correction.wheel_factor:
            return self
        if abs(factor - 1.0) <= LEAST_FACTOR_STEP or abs(factor) <= LEAST_FACTOR:
            return None
        return replace(self, what=self.what.format(factor=factor))


def of_wheels(
    nothing: Correction, nominal: Nominal, wheels: Sequence[int], rows: Rows
) -> Iterator[Undone]:
    """Orders, signs and units of wheels; a factor, a constant error or a jump of each.

    ``nothing`` corrects nothing; a wheel jumps where it jumps most in ``rows``. One that rests, and
    shows few values (:func:`.momentum.is_resting`), has no factor: what changes is its rounding.
    """
    count, jumps_s = len(wheels), rows.time_s[largest_jumps(rows.wheel_rpm)]
    rests = is_resting(rows.wheel_rpm)
    columns = [f"{name}_rpm" for name in nominal.wheel_names]
    every = ", ".join(columns)
    fix = f"correct which columns are {every}, or wheels in event.toml"
    for order, what in other_orders(wheels):
        # column j of the file holds the wheel that stands at order[j]
        matrix = np.zeros((count, count))
        matrix[list(order), range(count)] = 1.0
        yield Undone("wheel-order", what, fix, replace(nothing, wheel=matrix), ORDER_PRICE)
    fix = "give wheel rates about the wheels' own axes as the spacecraft file has them"
    for signs, turned in other_signs(wheels):
        named = "all wheels" if len(turned) == count else f"wheels {turned}"
        what = f"rates of {named} of the opposite sign"
        yield Undone("wheel-sign", what, fix, replace(nothing, wheel=np.diag(signs)), ORDER_PRICE)
    fix = f"convert {every} to rev/min"
    for unit, factor in WHEEL_UNITS.items():
        what = f"wheel rates that look like {unit} (times {factor:.4g})"
        yield Undone("wheel-unit", what, fix, replace(nothing, wheel=factor * np.eye(count)))
    for w, (number, column) in enumerate(zip(wheels, columns, strict=True)):
        rate = f"a rate of wheel {number}"
        if not rests[w]:
            scaled = replace(nothing, wheel_factor=(w,))
            what = f"{rate} that has to be multiplied by {{factor:.4g}}"
            fix = f"check the unit and scale of {column}"
            yield Undone("wheel-factor", what, fix, scaled, FREE_PRICE)
        moved = replace(nothing, offset=nominal.spins[:, [w]])
        what = f"{rate} with a constant error"
        yield Undone("wheel-offset", what, f"check the zero of {column}", moved, FREE_PRICE)
        jumped = replace(nothing, wheel_jump=(w,))
        what = f"{what} from {jumps_s[w]:.10g} s on"
        yield Undone("wheel-offset", what, f"check {column} at that time", jumped, FREE_PRICE)


def other_orders(wheels: Sequence[int]) -> Iterator[tuple[tuple[int, ...], str]]:
    """Every other order of the wheels, and what columns that have it look like."""
    for order in permutations(range(len(wheels))):
        if order != tuple(range(len(wheels))):
            names = [wheels[i] for i in order]
            yield order, f"columns of wheels {list(wheels)} that look like those of wheels {names}"


def other_signs(wheels: Sequence[int]) -> Iterator[tuple[Array, list[int]]]:
    """Every choice of signs (W,) but that of the file, and the wheels that it turns around."""
    for signs in product((1.0, -1.0), repeat=len(wheels)):
        turned = [w for w, sign in zip(wheels, signs, strict=True) if sign < 0.0]
        if turned:
            yield np.array(signs), turned


def of_late_wheels(nothing: Correction) -> Undone:
    """All wheels early or late, to first order: what a search for the time begins with."""
    fix = "bring all channels to the same clock"
    return Undone("wheel-time", "wheel rates", fix, replace(nothing, wheel_lag=True), FREE_PRICE)


def of_counters(
    nothing: Correction, nominal: Nominal, thrusters: Sequence[str]
) -> Iterator[Undone]:
    """Counters of two thrusters exchanged, or of two pairs that push alike."""
    for both in exchanges_of(nominal) if thrusters else ():
        names = " and ".join(f"{thrusters[a]} with {thrusters[b]}" for a, b in both)
        yield Undone(
            "thruster-order",
            f"counters of thrusters exchanged, {names}",
            "correct the names of the on_time_… and pulses_… columns",
            replace(nothing, thruster=exchanged(np.eye(len(thrusters)), both)),
            ORDER_PRICE * (1 + len(both)),
        )
