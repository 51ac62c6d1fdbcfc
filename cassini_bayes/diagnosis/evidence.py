"""Evidence of causes: Laplace's for all, importance sampling for those near the best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from cassini_bayes.computing.log import Log
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.modes import LogDensity, Mode, mode_from
from cassini_bayes.diagnosis.search import (
    UNSURE_NATS,
    ModeSearch,
    has_moved,
    higher_of,
    search_from_starts,
    with_whole_curvature,
)
from cassini_bayes.diagnosis.stages import SERIAL, StageRunner
from cassini_bayes.sampling.warmstart import (
    TRUSTED_K,
    ImportanceDraws,
    Proposal,
    importance,
    refined,
)

Candidate = Weighed[Hypothesis]
LEAST_EFFICIENCY: Final = 0.1
"""Of importance draws, below which the curvature is taken anew: 20 effective draws of 200 leave the
evidence 0.2 nats unsure."""
LEAST_HIGHER: Final = 1.0  # nats, of another mode: less is within what Laplace's evidence lacks
FEW_DRAWS: Final = 200
"""Of every cause near the best: an evidence good to 0.05 nats at an efficiency of 0.7, where a
probability of a few percent is all that is asked."""
FIRST: Final = 2  # searched at once, so that two processes have work
DRAWN: Final = tuple[Mode, Proposal, ImportanceDraws]
DOF: Final = 8.0
"""Of the Student-t proposal: judgement, tails wide enough for ridges that bend against draws that
are lost where they do not."""
MARGIN_NATS: Final = 30.0
"""Behind the best, what is not searched further: its probability is below 1e-13, and with what
searches may still lack (``search.LACKING_NATS``) no rank within ten nats changes."""
MOVED_NATS: Final = 10.0
"""By which Laplace's evidence is held to be unsure where nuisances went far
(docs/topics/criticism.md §1): judgement, so that importance draws decide whatever is within ten
nats of the best."""


def by_laplace(hypothesis: Hypothesis, mode: Mode) -> Candidate:
    """A hypothesis with Laplace's evidence at its mode."""
    return Weighed(hypothesis, mode, mode.log_evidence)


def weigh_extensions(
    hypotheses: Sequence[Hypothesis],
    searches: Sequence[ModeSearch],
    base: Mode,
    log: Log,
    workers: StageRunner = SERIAL,
    floor: float = -np.inf,
) -> list[Candidate]:
    """Extensions of one baseline by Laplace evidence.

    ``searches`` are their Newton steps beside the baseline's mode (:func:`search.newton_search`).
    Longer and longer searches follow, each for those whose search has not ended and that could
    still come to ``floor`` and within thirty nats of the best. The best are searched for before the
    others. What is out of reach keeps what it has.
    """
    if not hypotheses:
        return []
    ended = list(searches)
    longer: tuple[tuple[str, Callable[[int], ModeSearch]], ...] = (
        (
            "searched further",
            lambda i: higher_of(search_from_starts(hypotheses[i], base), ended[i], base),
        ),
        (
            "searched along all axes",
            lambda i: ModeSearch(with_whole_curvature(hypotheses[i], ended[i].mode)),
        ),
    )
    for what, search in longer:
        due = worth_continuing(ended, floor)
        if due:
            log(f"{len(due)} causes {what}")
        for part in (due[:FIRST], due[FIRST:]):
            still = [i for i in worth_continuing(ended, floor) if i in part]
            each = [partial(search, i) for i in still]
            results = workers.results(f"causes {what}", each, ModeSearch)
            for i, result in zip(still, results, strict=True):
                ended[i] = result
    weighed = [by_laplace(h, at.mode) for h, at in zip(hypotheses, ended, strict=True)]
    return [
        replace(w, unsure=MOVED_NATS if has_moved(w.mode, base) else min(at.lacking, UNSURE_NATS))
        for w, at in zip(weighed, ended, strict=True)
    ]


def worth_continuing(searches: Sequence[ModeSearch], floor: float) -> list[int]:
    """Places of those whose search has not ended and that could be of use, the best first.

    Of use is what comes to ``floor`` and within thirty nats of the best.
    """
    least = max(floor, *(s.mode.log_evidence - MARGIN_NATS for s in searches))
    reached = [s.mode.log_evidence + s.lacking for s in searches]
    due = [i for i, s in enumerate(searches) if s.lacking > UNSURE_NATS and reached[i] > least]
    return sorted(due, key=lambda i: -searches[i].mode.log_evidence)


def importance_sampled(
    weighed: Candidate, rng: np.random.Generator, draws: int = FEW_DRAWS
) -> Candidate:
    """The evidence by importance sampling from the Laplace approximation.

    Where that was poor the curvature is taken anew, a higher mode is looked for at the draw of most
    weight, and the proposal is refined by the draws themselves if that helps. What was sampled
    before is sampled again from the proposal found then.
    """
    return _with_draws(weighed, *_draw(weighed, rng, draws))


def _draw(
    weighed: Candidate, rng: np.random.Generator, draws: int
) -> tuple[Mode, Proposal, ImportanceDraws]:
    density, mode = weighed.hypothesis.log_density, weighed.mode
    if weighed.proposal is not None:
        return mode, weighed.proposal, importance(density, weighed.proposal, rng, draws)
    proposal = Proposal(mode.point, mode.factor, DOF)
    sampled = importance(density, proposal, rng, draws)
    if _is_poor(sampled) and not mode.is_whole:
        mode = with_whole_curvature(weighed.hypothesis, mode)
        proposal = Proposal(mode.point, mode.factor, DOF)
        sampled = importance(density, proposal, rng, draws)
    if _is_poor(sampled) and (higher := _higher_mode(density, mode, sampled)) is not None:
        mode, proposal = higher, Proposal(higher.point, higher.factor, DOF)
        sampled = importance(density, proposal, rng, draws)
    if _is_poor(sampled):
        turned = refined(proposal, sampled)
        again = importance(density, turned, rng, 2 * draws)
        if again.efficiency > sampled.efficiency:
            proposal, sampled = turned, again
    return mode, proposal, sampled


def _higher_mode(density: LogDensity, mode: Mode, draws: ImportanceDraws) -> Mode | None:
    """A mode of more evidence near the draw of most weight, if there is one.

    The search may have ended at the lesser of two: then the few draws that reach the other one have
    all the weight.
    """
    heaviest = draws.z[int(draws.log_weights.argmax())]
    found = mode_from(density, replace(mode, point=heaviest))
    return found if found.log_evidence > mode.log_evidence + LEAST_HIGHER else None


def _is_poor(draws: ImportanceDraws) -> bool:
    """Few effective draws, or weights of a tail that leaves out some of the evidence."""
    return draws.efficiency < LEAST_EFFICIENCY or draws.pareto_k > TRUSTED_K


def _with_draws(
    weighed: Candidate, mode: Mode, proposal: Proposal, draws: ImportanceDraws
) -> Candidate:
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


def with_draws(
    weighed: Sequence[Candidate],
    which: Sequence[int],
    draws: int,
    rng: np.random.Generator,
    workers: StageRunner,
) -> list[Candidate]:
    """Those named (places) with importance draws, each with a generator of its own."""
    generators = dict(zip(which, rng.spawn(len(which)), strict=True))
    # what is unsure may take long: it goes first, so that the work is shared out evenly
    order = sorted(which, key=lambda i: -weighed[i].unsure)
    each = [partial(_draw, weighed[i], generators[i], draws) for i in order]
    sampled = workers.results(f"{draws} importance draws", each, DRAWN)
    results = dict(zip(order, sampled, strict=True))
    return [_with_draws(w, *results[i]) if i in results else w for i, w in enumerate(weighed)]
