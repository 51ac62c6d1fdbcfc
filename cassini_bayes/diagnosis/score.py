"""Held-out scores side by side: what one hypothesis gains over another, and whether it counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array

WITHIN: Final = 1.6449  # standard deviations of a normal that hold 90 % of it
LEAST_PIECES: Final = 3
"""Held out: the standard error of a sum over two of them has one degree of freedom (judgement)."""
STANDARD_ERRORS: Final = 2.0
"""By which a gain has to be above zero: 2.5 % false gains if differences were normal."""
WORSE: Final = 1.02
"""Ratio of held-out RMSEs beyond which residuals are worse: two standard errors of the RMSE of some
5,000 white values, which a few biases of 1,200 rows about three axes have."""
SURE_NATS: Final = 20.0
"""A gain of unlike events, of which one may have nearly all: chance has it once in e^20 flights
(docs/topics/criticism.md §5)."""
SMALLER: Final = 0.9
"""Ratio of held-out RMSEs that it takes then: two standard errors of the RMSE of 200 values."""
LOST_NATS: Final = 3.0
"""By which an event may be predicted worse then: a true model loses as much of one in twenty."""


@dataclass(frozen=True)
class HeldOut:
    """Events or figures held out in turn, each predicted from the others by one hypothesis.

    ``log_scores`` (E,) are log Z(all) − log Z(others), nats. ``rmse`` is that of what predictions
    miss by, in the unit of the case, ``coverage_90`` the share within central 90 % intervals
    (None: not known).
    ``residual`` and ``half_width`` of these intervals are kept where there are few (E, U).
    """

    log_scores: Array
    rmse: float
    coverage_90: float | None
    residual: Array | None = None
    half_width: Array | None = None

    @property
    def elpd(self) -> float:
        """Sum of the log scores."""
        return summed(self.log_scores)[0]

    @property
    def elpd_se(self) -> float:
        """Its standard error over events."""
        return summed(self.log_scores)[1]

    def gain_over(self, other: HeldOut) -> Gain:
        """What this hypothesis gains over another."""
        differences = self.log_scores - other.log_scores
        return Gain(*summed(differences), self.rmse / other.rmse, float(differences.min()))


@dataclass(frozen=True)
class Gain:
    """Sum of differences of log scores, nats, its standard error, and the ratio of the RMSEs.

    ``least`` is the smallest difference, nats: of the event that is predicted worst.
    """

    nats: float
    standard_error: float
    rmse_ratio: float
    least: float

    @property
    def verdict(self) -> str:
        """``gain`` or ``no gain``.

        It takes log scores better by more than two standard errors *and* residuals no larger than
        before: a model may score better by wider error bars alone, and that extends nothing. Where
        events are unlike and one has nearly all of it, no standard error is small. Then it takes
        residuals clearly smaller, a sum that chance does not have, and no event that loses.
        """
        is_even = self.nats > STANDARD_ERRORS * self.standard_error and self.rmse_ratio <= WORSE
        is_sure = self.nats > SURE_NATS and self.least > -LOST_NATS and self.rmse_ratio < SMALLER
        return "gain" if is_even or is_sure else "no gain"


def summed(scores: Array) -> tuple[float, float]:
    """Sum of scores or their differences (E,), and its standard error from their scatter."""
    return float(scores.sum()), float(np.sqrt(len(scores)) * scores.std(ddof=1))
