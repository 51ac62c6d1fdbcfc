"""From momentum to thruster pairs: which pair fires how long for a given momentum change.

The controller answers a demand about an axis with a pair of thrusters (paper 001 Table 2). A
momentum that grows steadily in one direction is met by one pair per axis, but a pair's torque also
has components about the other axes (the centre of mass is not between the thrusters), which other
pairs have to take out: of the eight choices of one pair per axis exactly one gives on-times that
are not negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.spacecraft import Spacecraft, pair_indicator

_CHOICES: Final = np.array([[sx, 2 + sy, 4 + sz] for sx, sy, sz in product((0, 1), repeat=3)])


@dataclass(frozen=True)
class PairLayout:
    """Pairs of a branch and how two axes share four thrusters, in thruster order.

    Attributes
    ----------
    pairs
        (6, K) indicator of the thrusters fired for +a, −a of the three axes, body order.
    ring_axes, couple_axis
        The two axes whose pairs share four thrusters, and the one with thrusters of its own.
    ring
        Indices of the four thrusters (sign a, sign b): [0, 0] answers +a and +b.
    units
        Groups of thrusters with one printed on-time, as tuples of thruster indices: the minus and
        the plus pair of the couple axis, then the ring's thrusters in file order.
    cycle_s
        Period of the controller, s.
    """

    pairs: Array
    ring_axes: tuple[int, int]
    couple_axis: int
    ring: NDArray[np.int64]
    units: tuple[tuple[int, ...], ...]
    cycle_s: float


def pair_layout(spacecraft: Spacecraft, branch: str) -> PairLayout:
    """Work the layout out of the spacecraft's axis pairs.

    Raises
    ------
    InputError
        Not two axes that share four thrusters in a ring and a third with thrusters of its own.
    """
    pairs = pair_indicator(spacecraft, branch)
    for couple in (2, 1, 0):
        a, b = (axis for axis in range(3) if axis != couple)
        shared = [
            [np.flatnonzero(pairs[2 * a + i] * pairs[2 * b + j]) for j in (0, 1)] for i in (0, 1)
        ]
        summed = pairs[2 * couple] + pairs[2 * couple + 1]
        ring = pairs[2 * a] + pairs[2 * a + 1]
        if (
            all(len(cell) == 1 for row in shared for cell in row)
            and not (summed * ring).any()
            and ring.sum() == 4
        ):
            minus, plus = (tuple(np.flatnonzero(pairs[2 * couple + s]).tolist()) for s in (1, 0))
            singles = tuple((int(k),) for k in np.flatnonzero(ring))
            return PairLayout(
                pairs=pairs,
                ring_axes=(a, b),
                couple_axis=couple,
                ring=np.array([[cell[0] for cell in row] for row in shared]),
                units=(minus, plus, *singles),
                cycle_s=spacecraft.control_cycle_s,
            )
    raise InputError(
        f"spacecraft {spacecraft.name}: axis_pairs (branch {branch})",
        "two axes that share four thrusters and one with thrusters of its own",
        "another layout",
        "prediction knows this layout only (docs/topics/prediction.md)",
    )


@dataclass(frozen=True)
class PairSolver:
    """Torques of the pairs at a batch of draws, and the inverse of every choice of three pairs."""

    each: Array  # (n, 3, K) of every thruster per second of commanded on-time: N m
    torque: Array  # (n, 3, 6) N m per second of commanded on-time per second: N m
    inverse: Array  # (n, 8, 3, 3)

    def on_times(self, impulse: Array) -> Array:
        """Pair on-times (n, S, 6) ≥ 0 that deliver the impulses (n, S, 3) N m s one-sidedly."""
        n, pieces = impulse.shape[:2]
        flat = self.inverse.reshape(n, 24, 3) @ np.swapaxes(impulse, -1, -2)
        trial = flat.reshape(n, 8, 3, pieces)
        best = trial.min(2).argmax(1)  # the choice without a negative on-time
        chosen = np.take_along_axis(trial, best[:, None, None, :], axis=1)[:, 0]
        result = np.zeros((n, 6, pieces))
        np.put_along_axis(result, np.moveaxis(_CHOICES[best], -1, 1), chosen, axis=1)
        return np.maximum(np.swapaxes(result, -1, -2), 0.0)


def pair_solver(arms: Array, force_n: Array, pairs: Array) -> PairSolver:
    """Solver for lever arms (n, 3, K) m and force per commanded second (n, K) N."""
    each = np.asarray(arms * force_n[:, None, :])
    torque = np.asarray(each @ pairs.T)
    inverse = np.linalg.inv(np.stack([torque[:, :, choice] for choice in _CHOICES], axis=1))
    return PairSolver(each, torque, np.asarray(inverse))
