"""Evidence of every cause: Laplace for all, importance sampling for those near the best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.processes import in_processes
from cassini_bayes.diagnosis.extended import Hypothesis
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.diagnosis.search import (
    UNSURE_NATS,
    Sought,
    extended_mode,
    has_moved,
    higher,
    renewed,
)
from cassini_bayes.sampling.warmstart import ImportanceDraws, Proposal, importance, refined

Array = NDArray[np.float64]
LEAST_EFFICIENCY: Final = 0.1
TRUSTED_K: Final = 0.7
FEW_DRAWS: Final = 200
FIRST: Final = 2  # searched at once, so that two processes have work
DOF: Final = 8.0
MARGIN_NATS: Final = 30.0
MOVED_NATS: Final = 10.0
Say = Callable[[str], None]


@dataclass(frozen=True)
class Weighed:
    """A hypothesis with its evidence, and posterior draws where it was sampled."""

    hypothesis: Hypothesis
    mode: Mode
    log_evidence: float
    log_evidence_se: float
    z: Array | None = None  # (n, d)
    log_weights: Array | None = None
    pareto_k: float = float("nan")
    proposal: Proposal | None = None  # that the draws came from
    unsure: float = 0.0  # nats by which Laplace's evidence may be short

    @property
    def name(self) -> str:
        """Name of the cause."""
        return self.hypothesis.name

    @property
    def net_evidence(self) -> float:
        """Log evidence less what a search before the fit cost (nats)."""
        return self.log_evidence - self.hypothesis.log_penalty


def by_laplace(hypothesis: Hypothesis, mode: Mode) -> Weighed:
    """A hypothesis with Laplace's evidence at its mode."""
    return Weighed(hypothesis, mode, mode.log_evidence, float("nan"))


def weigh_beside(
    hypotheses: Sequence[Hypothesis],
    found: Sequence[Sought],
    base: Mode,
    say: Say,
    workers: int = 1,
    floor: float = -np.inf,
) -> list[Weighed]:
    """Extensions of one baseline by Laplace evidence.

    ``found`` are their Newton steps beside the baseline's mode (:func:`search.near_mode`). Longer
    and longer searches follow, each for those whose search has not ended and that could still come
    to ``floor`` and within thirty nats of the best. The best are searched for before the others.
    What is out of reach keeps what it has.
    """
    if not hypotheses:
        return []
    longer: tuple[tuple[str, Callable[[int], Sought]], ...] = (
        ("searched further", lambda i: higher(extended_mode(hypotheses[i], base), found[i], base)),
        ("searched along all axes", lambda i: Sought(renewed(hypotheses[i], found[i].mode))),
    )
    for what, search in longer:
        due = hopeful(found, floor)
        if due:
            say(f"{len(due)} causes {what}")
        for part in (due[:FIRST], due[FIRST:]):
            still = [i for i in hopeful(found, floor) if i in part]
            anew = dict(zip(still, in_processes(search, still, workers), strict=True))
            found = [anew.get(i, own) for i, own in enumerate(found)]
    weighed = [by_laplace(own, at.mode) for own, at in zip(hypotheses, found, strict=True)]
    return [
        replace(w, unsure=MOVED_NATS if has_moved(w.mode, base) else min(at.reach, UNSURE_NATS))
        for w, at in zip(weighed, found, strict=True)
    ]


def hopeful(found: Sequence[Sought], floor: float) -> list[int]:
    """Those whose search has not ended and that could be of use, the best first.

    Of use is what comes to ``floor`` and within thirty nats of the best.
    """
    least = max(floor, *(own.mode.log_evidence - MARGIN_NATS for own in found))
    reached = [own.mode.log_evidence + own.reach for own in found]
    due = [i for i, own in enumerate(found) if own.reach > UNSURE_NATS and reached[i] > least]
    return sorted(due, key=lambda i: -found[i].mode.log_evidence)


def sampled(weighed: Weighed, rng: np.random.Generator, draws: int = FEW_DRAWS) -> Weighed:
    """The evidence by importance sampling from the Laplace approximation.

    Where that was poor the curvature is taken anew, and refined by the draws themselves if that
    helps. What was sampled before is sampled again from the proposal found then.
    """
    return _with_draws(weighed, *_draw(weighed, rng, draws))


def _draw(
    weighed: Weighed, rng: np.random.Generator, draws: int
) -> tuple[Mode, Proposal, ImportanceDraws]:
    density, mode = weighed.hypothesis.log_density, weighed.mode
    if weighed.proposal is not None:
        return mode, weighed.proposal, importance(density, weighed.proposal, rng, draws)
    proposal = Proposal(mode.point, mode.factor, DOF)
    found = importance(density, proposal, rng, draws)
    if _is_poor(found) and not mode.is_whole:
        mode = renewed(weighed.hypothesis, mode)
        proposal = Proposal(mode.point, mode.factor, DOF)
        found = importance(density, proposal, rng, draws)
    if _is_poor(found):
        turned = refined(proposal, found)
        again = importance(density, turned, rng, 2 * draws)
        if again.efficiency > found.efficiency:
            proposal, found = turned, again
    return mode, proposal, found


def _is_poor(draws: ImportanceDraws) -> bool:
    """Few effective draws, or weights of a tail that leaves out some of the evidence."""
    return draws.efficiency < LEAST_EFFICIENCY or draws.pareto_k > TRUSTED_K


def _with_draws(
    weighed: Weighed, mode: Mode, proposal: Proposal, draws: ImportanceDraws
) -> Weighed:
    return replace(
        weighed,
        mode=mode,
        proposal=proposal,
        unsure=0.0,
        log_evidence=draws.log_evidence,
        log_evidence_se=draws.log_evidence_se,
        z=draws.z,
        log_weights=draws.log_weights,
        pareto_k=draws.pareto_k,
    )


def drawn(
    weighed: Sequence[Weighed],
    which: Sequence[int],
    draws: int,
    rng: np.random.Generator,
    workers: int,
) -> list[Weighed]:
    """Those named (places) with importance draws, each with a generator of its own."""
    own = dict(zip(which, rng.spawn(len(which)), strict=True))
    # what is unsure may take long: it goes first, so that the work is shared out evenly
    order = sorted(which, key=lambda i: -weighed[i].unsure)
    found = in_processes(lambda i: _draw(weighed[i], own[i], draws), order, workers)
    anew = dict(zip(order, found, strict=True))
    return [_with_draws(w, *anew[i]) if i in anew else w for i, w in enumerate(weighed)]


def score(weighed: Weighed) -> float:
    """Log of evidence times prior probability, what a search cost taken off."""
    return weighed.net_evidence + float(np.log(weighed.hypothesis.prior_probability))
