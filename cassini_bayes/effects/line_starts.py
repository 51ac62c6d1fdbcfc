"""How the free oscillation of an appendage starts in events: alike in all, or in each its own.

Where an event begins with the same command at rest, its appendage starts alike each time; where
what came before still rings, nothing ties one event's phase and amplitude to another's. Which of
the two holds is not known: half of the probability each. Of a line with its own starts the fit has
one cosine and sine, those of the event that swings most, by which the others' are turned and scaled
as the search found them (:func:`turns`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cassini_bayes.balance.linearised import InnovationRows
from cassini_bayes.computing.arrays import Array, Places


@dataclass(frozen=True)
class LineStarts:
    """Which of P free oscillations the rows of an event have, and its turns: (n,) places."""

    of_rows: tuple[int, ...]

    @property
    def count(self) -> int:
        """P."""
        return max(self.of_rows) + 1

    def series(self, place: int) -> Places:
        """Places (5,), among 2 P + 3, of a free oscillation's cosine and sine, and driven rates."""
        free = 2 * self.count
        return np.array([2 * place, 2 * place + 1, free, free + 1, free + 2])


def starts_of(rows: Sequence[InnovationRows]) -> LineStarts:
    """A free oscillation of its own in every event: in its rows, and in its turns.

    Turns are in the order of the events, as rows are.
    """
    places, seen = [], {False: 0, True: 0}
    for event in rows:
        of_turns = event.turns is not None
        places.append(seen[of_turns])
        seen[of_turns] += 1
    return LineStarts(tuple(places))


def in_common(count: int, swings: int) -> Array:
    """Series (2 P + 3, 2 S + 3) of S free oscillations by those of P: all of them, or one."""
    if swings == count:
        return np.eye(2 * count + 3)
    columns = np.zeros((2 * count + 3, 5))
    columns[:-3:2, 0] = columns[1:-3:2, 1] = 1.0
    columns[-3:, 2:] = np.eye(3)
    return columns


def turns(swings: Array) -> Array:
    """What turns (P,) and scales one oscillation to P others, as complex numbers of mean square 1.

    ``swings`` (2 P,) are their cosines c and sines s; that of the largest c + i s is real.
    """
    each = swings[::2] + 1j * swings[1::2]
    largest = each[np.abs(each).argmax()]
    if largest == 0.0:
        return np.ones(len(each), dtype=complex)
    scale = np.sqrt(np.mean(np.abs(each) ** 2))
    return np.asarray(each / (scale * largest / np.abs(largest)))


def turned(turn: Array) -> Array:
    """Sizes (2 P + 1, 3) of P oscillations and of a share, by those of one that turns (P,) turn."""
    sizes = np.zeros((2 * len(turn) + 1, 3))
    sizes[:-1:2, 0], sizes[:-1:2, 1] = turn.real, -turn.imag
    sizes[1::2, 0], sizes[1::2, 1] = turn.imag, turn.real
    sizes[-1, 2] = 1.0
    return sizes
