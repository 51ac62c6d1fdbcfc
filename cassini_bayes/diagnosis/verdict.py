"""Naming: probability of every cause, what cannot be told apart, a second cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.case import NONE, UNKNOWN, Case, H, Ranking, Weighed
from cassini_bayes.diagnosis.stages import SERIAL, StageRunner

SECOND_CAUSE_NATS: Final = 4.0
"""A second cause has to gain: the largest spurious gain in 34 searches of a study before this
package was 2.2 nats."""
CONFOUNDED_NATS: Final = 3.0
"""Causes whose evidence is nearer are one group: odds of 20, the usual bound of strong evidence
(Kass and Raftery 1995)."""
ALIKE_NATS: Final = 5.0
"""And those nearer than this whose best fits are within three nats: a steady torque of three sizes
fits what a leak does to 0.5 nats and loses some 3.5 by its prior alone
(docs/topics/criticism.md §4)."""


@dataclass(frozen=True)
class Verdict(Ranking[H]):
    """Everything weighed, with a second cause where there is one.

    ``pairs`` are the best cause together with each other one that was weighed, ``pair`` the best of
    them where its second cause earned its place, ``equal_seconds`` the seconds that gain as much.
    """

    pairs: tuple[Weighed[H], ...] = ()
    pair: Weighed[H] | None = None
    equal_seconds: tuple[str, ...] = ()

    @property
    def none(self) -> Weighed[H]:
        """The baseline."""
        return self.named(NONE)

    @property
    def unknown(self) -> Weighed[H]:
        """The baseline with a discrepancy."""
        return self.named(UNKNOWN)

    @property
    def best(self) -> Weighed[H]:
        """The most probable hypothesis."""
        return self.weighed[0]

    @property
    def best_cause(self) -> Weighed[H] | None:
        """The most probable real cause: what a second one is looked for beside."""
        return next((w for w in self.weighed if w.is_cause), None)

    @property
    def extended(self) -> Weighed[H]:
        """The model to go on with: the pair, or the most probable hypothesis."""
        return self.best if self.pair is None else self.pair

    @property
    def is_discrepant(self) -> bool:
        """Whether the baseline is less likely than all else together."""
        return self.probabilities[NONE] < 0.5

    def log_bayes_factor(self, weighed: Weighed[H]) -> float:
        """Log evidence against ``none``, nats."""
        return float(weighed.net_evidence - self.none.log_evidence)

    def confounded_with(self, name: str) -> tuple[str, ...]:
        """Real causes that :func:`is_indistinguishable` finds beside a named one."""
        cause = self.named(name)
        others = (w for w in self.weighed if w.is_cause and w.name != name)
        return tuple(w.name for w in others if cause.is_cause and is_indistinguishable(w, cause))


def is_indistinguishable(one: Weighed[H], other: Weighed[H]) -> bool:
    """Whether the data cannot tell two causes apart.

    Evidence within three nats; or within five where the best fits are within three, so that most
    of the difference is what more parameters cost.
    """
    apart = abs(one.net_evidence - other.net_evidence)
    return apart < CONFOUNDED_NATS or (
        apart < ALIKE_NATS and abs(one.mode.fit - other.mode.fit) < CONFOUNDED_NATS
    )


def ranked(weighed: Sequence[Weighed[H]]) -> Verdict[H]:
    """Hypotheses by their probabilities, most probable first."""
    scores = np.array([w.score for w in weighed])
    order = np.argsort(-scores, kind="stable")
    total = float(logsumexp(scores))
    return Verdict(tuple(weighed[i] for i in order), scores[order] - total)


def normalised(scores: Mapping[str, float]) -> dict[str, float]:
    """Probabilities of hypotheses by their logs of evidence times prior, most probable first."""
    total = float(logsumexp(list(scores.values())))
    shares = {name: float(np.exp(score - total)) for name, score in scores.items()}
    return dict(sorted(shares.items(), key=lambda pair: -pair[1]))


def weigh(
    case: Case[H],
    rng: np.random.Generator,
    *,
    pairs: bool = True,
    log: Log = silent,
    workers: StageRunner = SERIAL,
) -> Verdict[H]:
    """Weigh ``none``, ``unknown`` and every cause of a case.

    Parameters
    ----------
    case
        The data with their hypotheses.
    rng
        For the importance draws.
    pairs
        Whether to look for a second cause.
    log
        Told how far it got.
    workers
        Share out the causes; the verdict does not depend on them.
    """
    verdict = ranked(case.weigh(rng, log, workers))
    first = verdict.best_cause
    if not pairs or first is None or verdict.best is verdict.none:
        return verdict
    log(f"looking for a second cause beside {first.name}")
    return with_second_cause(case, verdict, first, rng, workers)


def with_second_cause(
    case: Case[H],
    verdict: Verdict[H],
    first: Weighed[H],
    rng: np.random.Generator,
    workers: StageRunner = SERIAL,
) -> Verdict[H]:
    """The verdict with the best pair, if its second cause earns its place, and seconds like it.

    It has to gain four nats over the first cause alone; where ``unknown`` is more probable than any
    cause, the pair has to be more probable than ``unknown`` as well.
    """
    least = first.net_evidence + SECOND_CAUSE_NATS
    verdict = replace(verdict, pairs=tuple(case.pairs(first, least, rng, workers)))
    best = max(verdict.pairs, key=lambda w: w.net_evidence, default=None)
    if best is None or best.net_evidence < least:
        return verdict
    pair = case.confirmed(best, rng)
    if pair.net_evidence < least:  # few draws had it a little higher
        return verdict
    if not verdict.best.is_cause and pair.score < verdict.best.score:
        return verdict
    # what stood beside the first cause is named now
    plain = ranked([w.without_forms for w in verdict.weighed])
    verdict = replace(verdict, weighed=plain.weighed, log_probabilities=plain.log_probabilities)
    alike = [w for w in verdict.pairs if w is not best and is_indistinguishable(w, best)]
    return replace(verdict, pair=pair, equal_seconds=tuple(w.hypothesis.causes[-1] for w in alike))
