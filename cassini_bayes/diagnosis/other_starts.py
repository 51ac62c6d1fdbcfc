"""Causes searched once more from elsewhere than the baseline's mode, where that comes higher.

Where the baseline is bent a search beside its mode may end in a valley. Three other places are
worth a search: the centre of the prior, the mode of the best cause, and that of the best one's
other beginnings. A cause takes what is found there if its evidence is higher, and else keeps what
it has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import Weighed, Work
from cassini_bayes.diagnosis.evidence import LEAST_HIGHER, by_laplace
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.modes import Mode, find_mode, mode_from
from cassini_bayes.diagnosis.onsets import begins_with
from cassini_bayes.diagnosis.search import NEAR_GAIN, NEAR_STARTS, starts
from cassini_bayes.diagnosis.stages import SERIAL, StageRunner

Candidate = Weighed[Hypothesis]
FAR_FROM_PRIOR: Final = 5.0
"""Prior standard deviations of the baseline's parameters: with an inertia of half its value (ten of
them) no search from the baseline's mode found the cause, 28,000 nats better
(docs/topics/criticism.md §1). Five is judgement: a search from the centre takes as long as all
others."""
TOGETHER: Final = 4  # causes searched from the centre at once: two for each of two processes
GAINED_ALIKE: Final = 0.1
"""Of what the best gains: causes nearer than that may be the same one seen from another side
(judgement), and are searched alike."""
MOST_FROM_CENTRE: Final = 16
"""Causes searched from the centre: judgement, a quarter of those that there are. By their linear
models there, a leak of 50 standard deviations came first (docs/topics/criticism.md §1)."""
MOST_BESTS: Final = 3
"""Causes in turn whose mode the others are searched from: judgement, one is enough where there are
two valleys."""


def is_far_from_prior(nuisances: Array) -> bool:
    """Whether the baseline's parameters (d,) are where no prior has them."""
    return bool(np.abs(nuisances).max() > FAR_FROM_PRIOR)


def is_mended(causes: Sequence[Candidate], unknown: Mode) -> bool:
    """Whether the best cause beats ``unknown`` and leaves the baseline's parameters near theirs.

    How large the cause itself is does not matter.
    """
    best = max(causes, key=lambda cause: cause.log_evidence)
    beside = best.mode.point[: best.hypothesis.sizes.start]
    return best.log_evidence > unknown.log_evidence and not is_far_from_prior(beside)


def from_centre(
    causes: Sequence[Candidate], gains: Sequence[float], unknown: Mode, workers: StageRunner
) -> list[Candidate]:
    """Causes searched from the centre of the prior, the best first, until one mends the baseline.

    ``gains`` are those of their linear models about the centre (nats). Causes go in parts of at
    most :data:`TOGETHER` that gain nearly alike, so that what the data cannot tell apart is
    searched alike.
    """
    found = list(causes)
    order = sorted(range(len(found)), key=lambda i: -gains[i])[:MOST_FROM_CENTRE]
    while order:
        least = gains[order[0]] - GAINED_ALIKE * max(gains[order[0]], 0.0)
        part = [i for i in order[:TOGETHER] if gains[i] >= least]
        order = order[len(part) :]
        each = {i: partial(_from_centre, causes[i]) for i in part}
        found = _with_higher(found, each, "searches from the centre of the prior", workers)
        if is_mended(found, unknown):
            break
    return found


def from_best(
    causes: Sequence[Candidate], base: Mode, workers: StageRunner = SERIAL
) -> list[Candidate]:
    """Causes searched with the nuisances of the best one, where they are likelier there.

    A leak, with a tail-off that is longer than the prior has it, ended ninety nats behind a steady
    torque that is like it. One batch of sizes tells. Causes that gain next to nothing beside the
    baseline ``base`` are left.
    """
    found, d = list(causes), len(base.point)
    least, seen = base.log_evidence + NEAR_GAIN, set[int]()
    for _ in range(MOST_BESTS):
        best = max(range(len(found)), key=lambda i: found[i].log_evidence, default=-1)
        if best < 0 or best in seen or found[best].log_evidence < least:
            break
        seen.add(best)
        nuisances = found[best].mode.point[:d]
        others = [i for i, c in enumerate(found) if i != best and c.log_evidence > least]
        each = {i: partial(_from_nuisances, found[i], nuisances) for i in others}
        found = _with_higher(found, each, "searches from the best cause", workers)
    return found


def from_best_beginning(causes: Sequence[Candidate], workers: StageRunner) -> list[Candidate]:
    """Other beginnings of the best cause searched from its mode.

    Beginnings of one cause are alike, so that the mode of one is near that of another; and the
    likeliest of a cause that ended in a valley would be that of fewer events.
    """
    best = max(causes, key=lambda own: own.net_evidence, default=None)
    if best is None or not begins_with(best):
        return list(causes)
    others = [i for i, own in enumerate(causes) if own.name == best.name and own is not best]
    each = {i: partial(mode_from, causes[i].hypothesis.log_density, best.mode) for i in others}
    return _with_higher(causes, each, "", workers)


def _with_higher(
    causes: Sequence[Candidate], searches: Mapping[int, Work], what: str, workers: StageRunner
) -> list[Candidate]:
    """The causes, those whose search (by place) ended at more evidence as it has them."""
    found = list(causes)
    modes = workers.results(what, list(searches.values()), Mode | None)
    for i, mode in zip(searches, modes, strict=True):
        if mode is not None and mode.log_evidence > found[i].log_evidence:
            found[i] = by_laplace(found[i].hypothesis, mode)
    return found


def _from_centre(weighed: Candidate) -> Mode:
    """The mode of a search that does not begin where the baseline was bent to.

    It begins with no effect or with one of the size found so far, whatever is likelier: one that is
    far larger than its prior expects is too far from none.
    """
    hypothesis = weighed.hypothesis
    tried = np.zeros((2, hypothesis.dimension))
    tried[1, hypothesis.sizes] = weighed.mode.point[hypothesis.sizes]
    start = tried[int(hypothesis.log_density(tried).argmax())]
    return find_mode(hypothesis.log_density, hypothesis.dimension, start)


def _from_nuisances(weighed: Candidate, nuisances: Array) -> Mode | None:
    """The mode of a search from some nuisances (d,), if the cause is likelier there than now."""
    density, own = weighed.hypothesis.log_density, weighed.mode
    sizes = own.point[len(nuisances) :]
    tried = np.vstack([sizes, starts(len(sizes), NEAR_STARTS)])
    points = np.column_stack([np.tile(nuisances, (len(tried), 1)), tried])
    values = density(points)
    if not np.nanmax(values) > own.value + LEAST_HIGHER:
        return None
    return mode_from(density, replace(own, point=points[int(np.nanargmax(values))]))
