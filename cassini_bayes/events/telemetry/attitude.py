"""Checks of attitudes: unit norm, one sign throughout, no jumps."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.telemetry.block import Block
from cassini_bayes.events.telemetry.columns import Layout
from cassini_bayes.events.telemetry.mends import Mends

NORM_TOLERANCE: Final = 1e-3
"""A unit quaternion with three decimals is off by less; more is no rounding."""
ROUNDING: Final = 1e-6
JUMP_ALLOWANCE_RAD: Final = 0.05


class Attitudes:
    """Quaternions made unit, each with the sign that continues the one before."""

    def __init__(self, layout: Layout, mends: Mends, highest_rate_rad_s: float) -> None:
        self._columns = list(layout.channels["attitude"])
        self._time = layout.channels["time"][0]
        self._mends = mends
        self._last: tuple[float, Array] | None = None  # as the file has it
        self._sign = 1.0
        self._highest_rate_rad_s = highest_rate_rad_s

    def checked(self, block: Block) -> Array:
        """Unit quaternions (n, 4), NaN where not sampled; (n, 0) without the channel."""
        values = np.ascontiguousarray(block.cells[self._columns].T)
        if not self._columns:
            return values
        sampled = np.flatnonzero(~np.isnan(values[:, 0]))
        if sampled.size == 0:
            return values
        quaternions = values if sampled.size == len(values) else values[sampled]
        norm = np.sqrt(np.einsum("ij,ij->i", quaternions, quaternions))
        self._check_norm(block, sampled, norm)
        quaternions = quaternions / norm[:, None]
        quaternions = self._signed(block, sampled, quaternions)
        values[sampled] = quaternions
        return values

    def _check_norm(self, block: Block, rows: NDArray[np.int64], norm: Array) -> None:
        error = np.abs(norm - 1.0)
        wrong = np.flatnonzero(error > NORM_TOLERANCE)
        if wrong.size:
            raise block.refuse(
                int(rows[wrong[0]]),
                self._columns[0],
                f"a unit quaternion (norm within {NORM_TOLERANCE:g} of 1)",
                "check that q1 to q4 are the Euler parameters, scalar last, and their decimals",
                f"norm {norm[wrong[0]]:.6g}",
            )
        rough = np.flatnonzero(error > ROUNDING)
        if rough.size:
            said = f"a quaternion was divided by its norm, off by more than {ROUNDING:g}"
            self._mends.add("norm", "q1", block.lines[rows[rough]], said)

    def _signed(self, block: Block, rows: NDArray[np.int64], quaternions: Array) -> Array:
        time = block.cells[self._time][rows]
        start, first = self._last or (float(time[0]), quaternions[0])
        before = np.concatenate([first[None], quaternions[:-1]])
        dot = np.einsum("ij,ij->i", quaternions, before)
        self._check_jumps(block, rows, np.abs(dot), np.diff(time, prepend=start))
        self._last = (float(time[-1]), quaternions[-1].copy())
        flipped = np.flatnonzero(dot < 0.0)
        if flipped.size:
            said = "the quaternion changed its sign, which is the same attitude; undone"
            self._mends.add("sign_flip", "q1", block.lines[rows[flipped]], said)
        elif self._sign > 0.0:
            return quaternions
        signs = self._sign * np.cumprod(np.where(dot < 0.0, -1.0, 1.0))
        self._sign = float(signs[-1])
        return quaternions * signs[:, None]

    def _check_jumps(
        self, block: Block, rows: NDArray[np.int64], cosine: Array, step_s: Array
    ) -> None:
        allowed = self._highest_rate_rad_s * step_s + JUMP_ALLOWANCE_RAD
        suspect = np.flatnonzero(cosine < np.cos(np.minimum(0.5 * allowed, 0.5 * np.pi)))
        if suspect.size:
            i = int(suspect[0])
            angle = 2.0 * float(np.arccos(min(1.0, cosine[i])))
            raise block.refuse(
                int(rows[i]),
                self._columns[0],
                f"an attitude within {allowed[i]:.3g} rad of the one before",
                "check q1 to q4 of this row (all of one attitude, scalar last), or empty them",
                f"a turn of {angle:.3g} rad in {step_s[i]:.4g} s",
            )
