"""Names and places of the columns of the momentum balance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics.pulse_columns import PULSE_COLUMNS
from cassini_bayes.balance.statistics.sampling import Sampling
from cassini_bayes.balance.statistics.walk import walk_cosines
from cassini_bayes.computing.cached import cached_property

AXES = "xyz"
CUT_PARTS = 4  # of an event, whose cut tails are independent of each other
# Per couple: pairs that may be close, and of every part the nominal variance of its steps, over
# that of a pair: of cut tails and of unlike pulses.
CUT_COLUMNS = 1 + CUT_PARTS


@dataclass(frozen=True)
class Layout:
    """Names and places of the columns: vector columns first, scalar columns after them."""

    wheels: tuple[int, ...]
    thrusters: tuple[str, ...]
    couples: tuple[tuple[int, ...], ...]
    cosines: int  # of torque noise that are unknowns
    levels: tuple[int, ...] = ()  # couples of roundings that are unknowns
    extra: tuple[str, ...] = ()

    @cached_property
    def vector(self) -> tuple[str, ...]:
        """Names of the vector columns."""
        walks = (f"walk:{order}" for order in range(1, 1 + self.cosines))
        steady = [f"{what}:{axis}" for what in ("initial", "torque", *walks) for axis in AXES]
        fired = [
            f"thrust:{name}:{axis}:{column}"
            for name in self.thrusters
            for axis in AXES
            for column in PULSE_COLUMNS
        ]
        return (*steady, *fired)

    @cached_property
    def scalar(self) -> tuple[str, ...]:
        """Names of the scalar columns."""
        return (
            *(f"rate:{axis}" for axis in AXES),
            "one",
            *(f"wheel:{number}" for number in self.wheels),
            *(f"turn:{axis}" for axis in AXES),
            *(
                f"cut:{self.thrusters[couple[0]]}:{part}"
                for couple in self.couples
                for part in ("mean", *range(CUT_PARTS))
            ),
            *(
                f"level:{self.thrusters[self.couples[couple][0]]}:{place}"
                for place, couple in enumerate(self.levels)
            ),
            *self.extra,
        )

    @property
    def size(self) -> int:
        """Number of columns A per axis."""
        return len(self.vector) + len(self.scalar)

    @property
    def initial(self) -> slice:
        """The three columns of the initial momentum."""
        return slice(0, 3)

    @property
    def torque(self) -> slice:
        """The three columns of a steady torque."""
        return slice(3, 6)

    @property
    def walk(self) -> slice:
        """What the slowest cosines of a random walk gained, (D, 3 axes) in this order."""
        return slice(self.torque.stop, self.torque.stop + 3 * self.cosines)

    @property
    def fired(self) -> slice:
        """Columns of the thrusters, (K, 3 axes, C pulse columns) in this order."""
        return slice(self.walk.stop, len(self.vector))

    @property
    def rate(self) -> slice:
        """The three body rates."""
        return slice(len(self.vector), len(self.vector) + 3)

    @property
    def one(self) -> int:
        """The constant."""
        return len(self.vector) + 3

    @property
    def wheel(self) -> slice:
        """The wheel rates."""
        return slice(len(self.vector) + 4, len(self.vector) + 4 + len(self.wheels))

    @property
    def turn(self) -> slice:
        """The turns of the attitude, in integrated columns alone."""
        return slice(self.wheel.stop, self.wheel.stop + 3)

    @property
    def cut(self) -> slice:
        """Cut tails and unlike pulses, :data:`CUT_COLUMNS` per couple."""
        return slice(self.turn.stop, self.turn.stop + CUT_COLUMNS * len(self.couples))

    @property
    def level(self) -> slice:
        """Roundings of counters that are unknowns."""
        return slice(self.cut.stop, self.cut.stop + len(self.levels))

    @property
    def extra_place(self) -> slice:
        """Columns that effects brought."""
        return slice(self.level.stop, self.size)


def layout_of(wheels: Sequence[int], thrusters: Sequence[str], sampling: Sampling) -> Layout:
    """The columns of an event with these wheels and thrusters."""
    count = walk_cosines(sampling.duration_s)
    return Layout(tuple(wheels), tuple(thrusters), sampling.couples, count)


def couple_of(place: int, layout: Layout) -> int:
    """Number of the couple that a thruster belongs to."""
    return next(g for g, couple in enumerate(layout.couples) if place in couple)


def couples_from(numbers: NDArray[np.int64]) -> tuple[tuple[int, ...], ...]:
    """Couples from the number of each thruster's couple: the inverse of :func:`couple_of`."""
    return tuple(
        tuple(int(place) for place in np.flatnonzero(numbers == g))
        for g in range(int(numbers.max(initial=-1)) + 1)
    )
