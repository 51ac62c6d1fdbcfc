"""What naming a cause gains, on data that were held out.

Leave one event out: its log score given the others is log Z(all) − log Z(others). Its rows are
predicted with everything shared fitted to the other events; its own initial momentum comes from its
first rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.diagnosis.evidence import Weighed
from cassini_bayes.diagnosis.extended import (
    Case,
    Hypothesis,
    compact,
    extend,
    none_hypothesis,
    unknown_hypothesis,
)
from cassini_bayes.diagnosis.innovations import Linear, linearise
from cassini_bayes.diagnosis.modes import Mode, climb, settled
from cassini_bayes.diagnosis.naming import Verdict
from cassini_bayes.diagnosis.oscillation import case_of
from cassini_bayes.effects.catalogue import Catalogue
from cassini_bayes.sampling.warmstart import lower_factor

Array = NDArray[np.float64]
FIRST_SHARE: Final = 0.1  # of an event's rows, which give its initial momentum
WITHIN: Final = 1.6449
LEAST_EVENTS: Final = 3


@dataclass(frozen=True)
class HeldOut:
    """Scores of the events held out: log score per event, residual, and interval coverage."""

    log_scores: Array  # (E,)
    rmse_n_m_s: float
    coverage_90: float

    @property
    def elpd(self) -> float:
        """Sum of the log scores."""
        return float(self.log_scores.sum())

    @property
    def elpd_se(self) -> float:
        """Its standard error over events."""
        n = len(self.log_scores)
        return float(np.sqrt(n) * self.log_scores.std(ddof=1)) if n > 1 else float("nan")


def fitted_to(case: Case, catalogue: Catalogue, weighed: Weighed) -> tuple[Hypothesis, Mode]:
    """A weighed hypothesis and its mode on another case, such as one with an event left out."""
    needed = case_of(case, weighed.hypothesis)
    if weighed.name == "unknown":
        full = unknown_hypothesis(case, catalogue)
    else:
        full = none_hypothesis(needed, catalogue)
    effects = weighed.hypothesis.effects
    hypothesis = compact(extend(full, effects, needed) if effects else full)
    density = hypothesis.log_density
    start = carried(weighed.mode, weighed.hypothesis, hypothesis)
    return hypothesis, settled(density, climb(density, start.point, start.factor), start.factor)


def carried(mode: Mode, old: Hypothesis, new: Hypothesis) -> Mode:
    """A mode in the coordinates of a hypothesis on other events, its new ones at their prior."""
    before = list(old.model.space.names)
    both = [i for i, name in enumerate(new.model.space.names) if name in before]
    places = [before.index(new.model.space.names[i]) for i in both]
    point, factor = np.zeros(new.dimension), np.eye(new.dimension)
    point[both] = mode.point[places]
    factor[np.ix_(both, both)] = lower_factor(mode.factor[places])
    return Mode(point, factor, float("nan"))


def held_out(
    verdict: Verdict,
    weighed: Weighed,
    say: Callable[[str], None] | None = None,
) -> HeldOut:
    """Every telemetry event of the verdict's case held out in turn."""
    events = [source.id for source in verdict.case.sources]
    whole = weighed.mode
    if not whole.is_whole:
        _, whole = fitted_to(verdict.case, verdict.catalogue, weighed)

    def score(event: str) -> float:
        others = verdict.case.without(event)
        _, mode = fitted_to(others, verdict.catalogue, weighed)
        if say is not None:
            say(f"{weighed.name}: {event} held out")
        return whole.log_evidence - mode.log_evidence

    scores = np.array([score(event) for event in events])
    case = case_of(verdict.case, weighed.hypothesis)
    linear, _, factors = linearise(case, weighed.hypothesis, weighed.mode.point)
    centre = -weighed.mode.point
    residuals, inside = [], []
    for place in range(len(events)):
        white, spread = predicted_rows(linear, place, centre)
        residuals.append((white.reshape(-1, 3) @ factors[place].T).ravel())
        inside.append(np.abs(white) < WITHIN * spread)
    return HeldOut(
        scores,
        float(
            np.sqrt(
                np.concatenate(residuals) @ np.concatenate(residuals) / sum(map(len, residuals))
            )
        ),
        float(np.concatenate(inside).mean()),
    )


def predicted_rows(linear: Linear, place: int, centre: Array) -> tuple[Array, Array]:
    """Whitened residuals (m,) of a held-out event's rows and their standard deviations.

    ``centre`` is the prior mean of the walked parameters as a departure from the point about which
    the model is linear.
    """
    ends = 3 * np.cumsum([0, *linear.rows])
    own = slice(int(ends[place]), int(ends[place + 1]))
    first = max(3, int(FIRST_SHARE * linear.rows[place])) * 3
    used = np.ones(len(linear.target), dtype=bool)
    used[own.start + first : own.stop] = False
    columns, target = linear.columns[used], linear.target[used]
    mean = np.zeros(len(linear.precision))
    mean[: len(centre)] = centre
    precision = columns.T @ columns + np.diag(linear.precision)
    answer = np.linalg.solve(precision, columns.T @ target + linear.precision * mean)
    hidden = slice(own.start + first, own.stop)
    new = linear.columns[hidden]
    covariance = np.linalg.inv(precision)
    spread = np.sqrt(1.0 + np.einsum("mp,pq,mq->m", new, covariance, new))
    return linear.target[hidden] - new @ answer, spread
