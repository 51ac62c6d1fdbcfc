"""What a diagnosis works on: hypotheses that were weighed, and a case that can weigh its own.

There are three cases: the momentum balance of telemetry and totals
(:mod:`cassini_bayes.diagnosis.balance_case`), on-times (:mod:`.on_time_case`) and printed estimates
of thrust (:mod:`.estimate_case`). :mod:`cassini_bayes.diagnosis.diagnosis` asks each the same.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Generic, Protocol, TypeVar

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.diagnosis.score import HeldOut
from cassini_bayes.diagnosis.stages import StageRunner
from cassini_bayes.effects.effect import Remainder, SearchResult
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.errors import InputError
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.sampling.warmstart import Proposal

Work = Callable[[], Any]
Fits = tuple[Mode, ...]
"""Modes of the ways in which a hypothesis may begin, by some of the events."""
NONE: Final = "none"
UNKNOWN: Final = "unknown"
LEAST_SHARE: Final = 1e-3
"""Probability of a beginning below which it changes no digit of a size or a score."""


class Hypothesis(Protocol):
    """What may be true."""

    @property
    def name(self) -> str:
        """``none``, ``unknown``, or one or two causes joined by a plus sign."""

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes."""

    @property
    def prior_probability(self) -> float:
        """Before the data."""

    @property
    def log_penalty(self) -> float:
        """What a search before the fit cost, nats."""


H = TypeVar("H", bound=Hypothesis)


@dataclass(frozen=True)
class Beginning(Generic[H]):
    """A cause that acts from an event on, with the probability of that, given the cause.

    ``event`` is empty where it acts throughout. ``weighed`` is the cause from there on, by itself;
    None where only its linear score was looked at.
    """

    event: str
    probability: float
    weighed: Weighed[H] | None


@dataclass(frozen=True)
class Weighed(Generic[H]):
    """A hypothesis with its evidence, and posterior draws where it was sampled.

    ``z`` (n, d) are draws with ``log_weights`` (n,), normalised. ``unsure`` is by how many nats the
    evidence may be short where it is Laplace's. ``remainder`` is what the hypothesis leaves of
    telemetry, where that was looked at. A cause that may begin with several events has
    ``beginnings``: it stands here as it begins most likely, and the sum over all of them, with
    their prior probabilities, adds ``summed`` (nats) to its log evidence. So do further forms of
    ``unknown``: ``forms`` are their names with their shares of its evidence, the first the one that
    stands here. ``withheld`` (nats) is what another reckoning takes off (:mod:`.second_reckoning`).
    """

    hypothesis: H
    mode: Mode
    log_evidence: float
    log_evidence_se: float = float("nan")
    z: Array | None = None
    log_weights: Array | None = None
    pareto_k: float = float("nan")
    proposal: Proposal | None = None  # that the draws came from
    unsure: float = 0.0
    remainder: Remainder | None = None
    beginnings: tuple[Beginning[H], ...] = ()
    summed: float = 0.0
    withheld: float = 0.0
    forms: tuple[tuple[str, float], ...] = ()

    @property
    def searched(self) -> tuple[tuple[str, float, Weighed[H]], ...]:
        """Events of its beginnings that have some probability, with that and the cause from there.

        Only those that were searched for.
        """
        return tuple(
            (beginning.event, beginning.probability, beginning.weighed)
            for beginning in self.beginnings
            if beginning.weighed is not None and beginning.probability > LEAST_SHARE
        )

    @property
    def begins(self) -> Beginning[H] | None:
        """The likeliest of its beginnings that were searched for; None where there is no choice."""
        likely = (beginning for beginning in self.beginnings if beginning.weighed is not None)
        return max(likely, key=lambda own: own.probability, default=None)

    @property
    def name(self) -> str:
        """Name of the hypothesis."""
        return self.hypothesis.name

    @property
    def is_cause(self) -> bool:
        """Whether it is a cause and neither ``none`` nor ``unknown``."""
        return bool(self.hypothesis.causes)

    @property
    def without_forms(self) -> Weighed[H]:
        """As it stands here, without further forms of ``unknown``."""
        return replace(self, summed=0.0, forms=()) if self.forms else self

    @property
    def own_evidence(self) -> float:
        """Log evidence of what stands here alone, less what a search before the fit cost."""
        return self.log_evidence - self.hypothesis.log_penalty

    @property
    def net_evidence(self) -> float:
        """That over all beginnings and forms, less what a second reckoning takes off."""
        return self.own_evidence + self.summed - self.withheld

    @property
    def score(self) -> float:
        """Log of evidence times prior probability, what a search cost taken off."""
        return self.net_evidence + float(np.log(self.hypothesis.prior_probability))

    @property
    def effective_draws(self) -> float:
        """Draws of equal weight that are worth as much; NaN where it was not sampled."""
        if self.log_weights is None:
            return float("nan")
        return 1.0 / float((np.exp(self.log_weights) ** 2).sum())


def over_beginnings(weighed: Weighed[H], change: Callable[[Weighed[H], float], float]) -> float:
    """Change (nats) of a cause's evidence, summed over its beginnings, from that of each.

    ``change`` gets one of them and its probability given the cause. Those that were not searched
    for keep theirs.
    """
    if not weighed.beginnings:
        return change(weighed, 1.0)
    kept = max(1.0 - sum(share for _, share, _ in weighed.searched), LEAST_SHARE**2)
    changes = [np.log(share) + change(way, share) for _, share, way in weighed.searched]
    return float(logsumexp([np.log(kept), *changes]))


@dataclass(frozen=True)
class Discrepancies:
    """What tests say of the baseline and of the extended model, for the record.

    ``more`` are further fields of the record, ``detail`` is what the case's own figures and tables
    need; None where it has none.
    """

    symptoms: Sequence[Mapping[str, Any]] = ()
    closure: Sequence[Mapping[str, Any]] = ()
    more: Mapping[str, Any] = field(default_factory=dict)
    detail: Any = field(default=None, repr=False)


@dataclass(frozen=True)
class Size:
    """Posterior mean, standard deviation and 90 % interval of one size of a cause."""

    mean: float
    sd: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class Ranking(Generic[H]):
    """Everything weighed, most probable first, with probabilities that add up to one."""

    weighed: tuple[Weighed[H], ...]
    log_probabilities: Array

    @property
    def probabilities(self) -> dict[str, float]:
        """Posterior probability of every hypothesis by name."""
        values = np.exp(self.log_probabilities)
        return {w.name: float(p) for w, p in zip(self.weighed, values, strict=True)}

    def named(self, name: str) -> Weighed[H]:
        """The hypothesis of a name."""
        return next(w for w in self.weighed if w.name == name)


class Case(ABC, Generic[H]):
    """Data, and hypotheses on them.

    ``rng`` is used for nothing else; ``workers`` share out the work and keep what is finished, on
    which no result depends.
    """

    unit: str
    """Of residuals, as it ends the names of fields."""

    @property
    @abstractmethod
    def event_ids(self) -> tuple[str, ...]:
        """Names of what was observed."""

    @property
    def findings(self) -> Sequence[str]:
        """What has to be said of the data: mistakes accepted, what fits nothing known."""
        return ()

    @abstractmethod
    def weigh(self, rng: np.random.Generator, log: Log, workers: StageRunner) -> list[Weighed[H]]:
        """Evidence of ``none``, ``unknown`` and every cause."""

    @abstractmethod
    def scores_at(
        self, width: float, verdict: Ranking[H], rng: np.random.Generator
    ) -> Mapping[str, float]:
        """Log of evidence times prior probability with all priors of effects wider by a factor."""

    def by_width(self, verdict: Ranking[H], rng: np.random.Generator) -> list[dict[str, Any]]:
        """Probabilities and sizes at many widths at once, for a page; none where draws lack."""
        del verdict, rng
        return []

    @property
    @abstractmethod
    def kinds(self) -> Kinds:
        """The effects that there are, which put their sizes in words."""

    @property
    def digests(self) -> Mapping[str, str]:
        """SHA-256 of what was read beyond the files that a caller named."""
        return {}

    @abstractmethod
    def size_draws(
        self, weighed: Weighed[H], rng: np.random.Generator
    ) -> tuple[dict[str, Array], Array]:
        """Draws (n,) of every size of a cause by key, and their weights (n,)."""

    @abstractmethod
    def sizes(self, weighed: Weighed[H], rng: np.random.Generator) -> Mapping[str, Size]:
        """Sizes of a cause by key."""

    def settled(self, weighed: Weighed[H]) -> Sequence[SearchResult]:
        """What searches before its fit have settled."""
        del weighed
        return ()

    def refit(
        self,
        weighed: Weighed[H],
        folder: Path,
        seed: int,
        log: Log = silent,
        store: CheckpointStore | None = None,
    ) -> pd.DataFrame:
        """Sample the model of a hypothesis with emcee (:mod:`.refit`).

        Raises
        ------
        InputError
            The case has no such model; the folder cannot be written.
        """
        del weighed, folder, seed, log, store
        raise InputError("--then-fit", "telemetry or totals", "data of another kind", "drop it")

    def fits_to_hold_out(
        self, weighed: Weighed[H], log: Log = silent
    ) -> Sequence[Callable[[], Fits]]:
        """Pieces of work whose results :meth:`held_out` takes, where these are most of it."""
        del weighed, log
        return ()

    @abstractmethod
    def held_out(
        self,
        weighed: Weighed[H],
        rng: np.random.Generator,
        log: Log = silent,
        fits: Sequence[Fits] | None = None,
    ) -> HeldOut | None:
        """Scores of everything left out in turn; None where there is too little.

        ``fits`` are the results of :meth:`fits_to_hold_out`, worked out here if they are not given.
        """

    @abstractmethod
    def rmse(self, weighed: Weighed[H]) -> float | None:
        """Root mean square of what a hypothesis leaves, where it was :meth:`examined`."""

    def curves(self, unknown: Weighed[H], rng: np.random.Generator) -> Sequence[Any]:
        """What ``unknown`` makes of the data against time, for figures and tables."""
        del unknown, rng
        return ()

    def drafts(self, weighed: Weighed[H]) -> Sequence[Any]:
        """Effects proposed from what ``unknown`` or a cause leaves, the best first.

        Each has a ``record``.
        """
        del weighed
        return ()

    def visible(self, none: Weighed[H], cause: Weighed[H]) -> dict[str, Any] | None:
        """From which size on a cause would have been named; None of what has no one size."""
        del none, cause
        return None

    @abstractmethod
    def separation(self, one: str, other: str) -> str:
        """The measurement that would tell two causes apart."""

    def pairs(
        self, first: Weighed[H], least: float, rng: np.random.Generator, workers: StageRunner
    ) -> list[Weighed[H]]:
        """The best cause together with every other; ``least`` is the evidence that counts."""
        del first, least, rng, workers
        return []

    def confirmed(self, pair: Weighed[H], rng: np.random.Generator) -> Weighed[H]:
        """The best pair weighed with more draws."""
        del rng
        return pair

    def at_edge(self, weighed: Weighed[H]) -> Sequence[str]:
        """Which sizes of a hypothesis are as large as any that is weighed, in words."""
        del weighed
        return ()

    def examined(self, weighed: Weighed[H]) -> Weighed[H]:
        """A hypothesis with what it leaves of telemetry, where there is any."""
        return weighed

    def p_value(self, weighed: Weighed[H], rng: np.random.Generator) -> float | None:
        """Probability, if a hypothesis is true, of data as unlike it as these."""
        del weighed, rng
        return None

    def show(
        self, baseline: Weighed[H], extended: Weighed[H], rng: np.random.Generator
    ) -> Discrepancies:
        """Tests of what two hypotheses leave."""
        del baseline, extended, rng
        return Discrepancies()
