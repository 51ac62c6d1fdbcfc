"""Where searches for the mode of a density begin, in standard coordinates of the priors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array

ODD: Final = 4.0
"""Prior standard deviations: with thirty parameters one flight in five hundred has one beyond."""


@dataclass(frozen=True)
class Starts:
    """Points (s, d) at which searches begin, and (r, d) to begin at as well where these fail.

    A density may have two modes, and the lower one of them is mostly bought by something odd: a
    parameter at the end of what its prior believes. So searches begin at ``spare`` as well where
    the best of the others has one.
    """

    points: Array
    spare: Array

    @classmethod
    def of(cls, points: Array) -> Starts:
        """Points (s, d) alone."""
        return cls(points, points[:0])

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return int(self.points.shape[1])

    def beside(self, mode: Array) -> Array:
        """Points (r, d) to search from beside those that led to a mode (d,): none, or the spare."""
        return self.spare if np.abs(mode).max(initial=0.0) > ODD else self.spare[:0]
