"""Posterior draws of a mission: importance draws of what is walked, updated by new events.

Everything linear is integrated out, so the walked parameters are few and near normal: a Laplace
proposal, refined by its own draws, serves (:mod:`cassini_bayes.sampling.warmstart`), and its
Pareto k̂ says whether the result is one. The best hypothesis on losses takes part, so the draws
are those of a mission whose failing thrusters are known to fail.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.model.mission.losses import (
    Hypothesis,
    LossPrior,
    chosen,
    index_of_hypothesis,
    log_bayes,
    log_bayes_of,
    log_prior_of,
    loss_terms,
    near_hypotheses,
)
from cassini_bayes.model.mission.model import BranchAt, MissionModel
from cassini_bayes.priors.quantiles import standard_normal_log_density
from cassini_bayes.sampling.warmstart import (
    PROPOSAL_DOF,
    TRUSTED_K,
    ImportanceDraws,
    LogDensity,
    Proposal,
    find_mode,
    importance,
    laplace,
    pareto_k,
    refined,
)

LEAST_DRAWS: Final = 100.0
"""Effective draws that a result needs."""
PASSES: Final = 4  # at the hypotheses, each with draws of its own
_PILOTS: Final = 6
_KEPT: Final = 100  # points whose densities one file keeps
_WORTH_KEEPING_S: Final = 0.1  # what takes less is worked out again as fast as it is read

StoreOf = Callable[[str], CheckpointStore | None]
References = Mapping[str, Hypothesis]
"""Branch → losses that the draws of a fit take as given."""


@dataclass(frozen=True)
class Losses:
    """What is believed of one branch's losses: hypotheses, and their posterior probability."""

    branch: str
    which: tuple[Hypothesis, ...]
    log_prior: Array  # (H,)
    probability: Array  # (H,)
    reference: int
    log_ratio: Array  # (n, H) of the Bayes factors against the reference, at the fit's draws

    def failing(self, thrusters: int) -> Array:
        """Posterior probability (K,) that each thruster has lost thrust."""
        result = np.zeros(thrusters)
        for hypothesis, probability in zip(self.which, self.probability, strict=True):
            for loss in hypothesis:
                result[loss.thruster] += probability
        return result

    def onsets(self, thruster: int, events: int) -> Array:
        """Posterior probability (E,) of each onset of a thruster, given that it fails."""
        result = np.zeros(events)
        for hypothesis, probability in zip(self.which, self.probability, strict=True):
            for loss in hypothesis:
                if loss.thruster == thruster:
                    result[loss.onset] += probability
        total = result.sum()
        return result / total if total > 0 else result

    @property
    def log_weight(self) -> Array:
        """Log of what all hypotheses together have over the reference at each draw, (n,)."""
        return np.asarray(logsumexp(self.log_prior + self.log_ratio, axis=1))

    def draw_at(self, places: Places, rng: np.random.Generator) -> list[Hypothesis]:
        """A hypothesis at each of some of the fit's draws, with its probability there."""
        log_joint = (self.log_prior + self.log_ratio)[places]
        edges = np.cumsum(np.exp(log_joint - log_joint.max(1, keepdims=True)), axis=1)
        levels = rng.uniform(size=(len(places), 1)) * edges[:, -1:]
        return [self.which[i] for i in (edges < levels).sum(1)]

    @property
    def best(self) -> Hypothesis:
        """The likeliest onsets of the likeliest set of failing thrusters."""
        sets: dict[frozenset[int], float] = {}
        members = [frozenset(loss.thruster for loss in losses) for losses in self.which]
        for member, probability in zip(members, self.probability, strict=True):
            sets[member] = sets.get(member, 0.0) + float(probability)
        likeliest = max(sets, key=lambda member: sets[member])
        equal = [i for i, member in enumerate(members) if member == likeliest]
        return self.which[max(equal, key=lambda i: float(self.probability[i]))]


@dataclass(frozen=True)
class EarlierDraws:
    """What a fit hands on to the same mission with further events.

    Equally weighted draws z (n, d) of the parameters ``names`` given the reference losses of each
    branch, and the density (n,) they were drawn from: what new events are weighed against.
    """

    names: tuple[str, ...]
    z: Array
    log_density: Array
    references: References
    log_evidence: float  # given the references
    log_evidence_se: float


@dataclass(frozen=True)
class MissionFit(EarlierDraws):
    """A fitted mission: its draws, what they were made of, and what is believed of losses."""

    model: MissionModel
    prior: LossPrior
    pareto_k: float
    efficiency: float
    losses: tuple[Losses, ...]  # of every branch

    @property
    def converged(self) -> bool:
        """Whether the importance draws can be trusted."""
        return self.pareto_k < TRUSTED_K

    @property
    def log_evidence_total(self) -> float:
        """Log evidence of the mission over all hypotheses on losses.

        A hypothesis's posterior probability is its prior times its evidence over the whole.
        """
        total = self.log_evidence
        for losses in self.losses:
            reference = losses.reference
            total += float(losses.log_prior[reference] - np.log(losses.probability[reference]))
        return total


def target(model: MissionModel, references: References, prior: LossPrior) -> LogDensity:
    """Log posterior density in z of a mission whose branches have these losses."""

    def log_density(z: Array) -> Array:
        result = []
        for rows in model.batches(len(z)):
            branches, total = model.at(z[rows])
            for branch in branches:
                losses = references[branch.thrusts.branch]
                total = total + branch.levels.log_likelihood
                total = total + log_bayes(branch, losses, prior.scale)
            result.append(total)
        return np.asarray(np.concatenate(result) + model.space.log_prior_terms(z).sum(-1))

    return log_density


@dataclass(frozen=True)
class Remembered:
    """A density that is worked out once at every point.

    Values are kept in files too: a killed fit works out only what is missing.
    """

    log_density: LogDensity
    store: CheckpointStore | None
    known: dict[bytes, float] = field(default_factory=dict)

    def __call__(self, z: Array) -> Array:
        """Values at z (n, d)."""
        keys = [row.tobytes() for row in z]
        new = {key: i for i, key in enumerate(keys) if key not in self.known}
        if new:
            values = self._worked_out(z[list(new.values())])
            self.known.update(zip(new, values.tolist(), strict=True))
        return np.array([self.known[key] for key in keys])

    def _worked_out(self, z: Array) -> Array:
        if self.store is None:
            return self.log_density(z)
        starts = range(0, len(z), _KEPT)
        return np.concatenate([self._kept(self.store, z[i : i + _KEPT]) for i in starts])

    def _kept(self, store: CheckpointStore, z: Array) -> Array:
        name = f"density_{hashlib.sha256(z.tobytes()).hexdigest()[:24]}"
        kept = store.load(name)
        if kept is not None:
            return np.asarray(kept["values"], dtype=np.float64)
        began = time.monotonic()
        values = self.log_density(z)
        if time.monotonic() - began > _WORTH_KEEPING_S:
            store.save(name, {"values": values})
        return values


def fit_mission(
    model: MissionModel,
    prior: LossPrior,
    rng: np.random.Generator,
    *,
    draws: int,
    proposals: int,
    earlier: EarlierDraws | None = None,
    store_of: StoreOf = lambda _: None,
    log: Log = silent,
) -> MissionFit:
    """Draws of a mission, its likeliest losses found on the way.

    Parameters
    ----------
    draws, proposals
        Equally weighted draws that are kept, and importance draws that they come from.
    earlier
        Of the same mission with fewer events. Its draws are weighed anew: the target is
        that of the whole mission, so the result is the same as without it.
    store_of
        Where values of the density given some references are kept.

    Notes
    -----
    Losses are weighed at draws that take the likeliest ones as given, from none on, until these
    stay the likeliest. All other hypotheses follow by ratios of evidence at the same draws.
    """
    references: References = {branch.branch: () for branch in model.branches}
    result: ImportanceDraws | None = None
    proposal: Proposal | None = None
    if earlier is not None:
        references = {**references, **earlier.references}
        density = Remembered(target(model, references, prior), store_of(repr(references)))
        result = _reweighted(earlier, model, density, rng)
        proposal = moments(result)
        result = result if trusted(result) else None
    for look in range(PASSES):
        density = Remembered(target(model, references, prior), store_of(repr(references)))
        log(f"draws with {describe(model, references)}")
        start = proposal or _prior_proposal(model.space.dimension)
        if result is None:
            result, proposal = _importance(density, start, rng, proposals)
        z = result.resample(rng, draws)
        losses = weighed_losses(model, prior, z, references)
        best = {one.branch: one.best for one in losses}
        if look == PASSES - 1 or all(set(best[b]) == set(references[b]) for b in best):
            break
        references, result = best, None
    assert result is not None  # the loop ends with draws
    return MissionFit(
        model.space.names,
        z,
        density(z),
        references,
        result.log_evidence,
        result.log_evidence_se,
        model,
        prior,
        result.pareto_k,
        result.efficiency,
        losses,
    )


def trusted(found: ImportanceDraws) -> bool:
    """Whether importance draws are a result."""
    return found.pareto_k < TRUSTED_K and found.efficiency * len(found.z) > LEAST_DRAWS


def _importance(
    density: LogDensity, proposal: Proposal, rng: np.random.Generator, n: int
) -> tuple[ImportanceDraws, Proposal]:
    """Importance draws; the proposal is refined by them until they can be trusted.

    One that does not come near gives way to the Laplace proposal of the mode next to it.
    """
    result = importance(density, proposal, rng, n)
    for look in range(_PILOTS):
        if trusted(result):
            break
        if look == 0 and result.efficiency * n < LEAST_DRAWS / 4:
            mode = find_mode(density, proposal.location)
            proposal = Proposal(*laplace(density, mode), PROPOSAL_DOF)
        else:
            proposal = refined(proposal, result)
        result = importance(density, proposal, rng, n)
    return result, proposal


def _reweighted(
    earlier: EarlierDraws, model: MissionModel, density: LogDensity, rng: np.random.Generator
) -> ImportanceDraws:
    """Draws of a shorter mission with the weights that the longer one gives them."""
    z, new = embedded(earlier, model, rng)
    log_ratio = density(z) - earlier.log_density - standard_normal_log_density(z[:, new]).sum(-1)
    log_total = float(logsumexp(log_ratio))
    # the same draw twice is one draw: chains of short updates would wear out unseen
    weights = np.bincount(distinct(earlier.z)[1], weights=np.exp(log_ratio - log_total))
    efficiency = 1.0 / (len(z) * float((weights**2).sum()))
    error = np.sqrt(max(1.0 / efficiency - 1.0, 0.0) / len(z))
    return ImportanceDraws(
        z=z,
        log_weights=log_ratio - log_total,
        log_evidence=earlier.log_evidence + log_total - float(np.log(len(z))),
        log_evidence_se=float(np.hypot(error, earlier.log_evidence_se)),
        pareto_k=pareto_k(log_ratio),
        efficiency=efficiency,
    )


def embedded(
    earlier: EarlierDraws, model: MissionModel, rng: np.random.Generator
) -> tuple[Array, Places]:
    """Draws of a shorter mission as points of a longer one; parameters that only it has are new.

    These come from their priors. A mission of one branch names without the branch what every
    branch of the longer one has for itself.
    """
    names = model.space.names
    z = rng.standard_normal((len(earlier.z), len(names)))
    branches = list(earlier.references)
    prefix = f"{branches[0]}." if len(branches) == 1 else ""
    new = []
    for i, name in enumerate(names):
        before = name if name in earlier.names else name.removeprefix(prefix)
        if before in earlier.names:
            z[:, i] = earlier.z[:, earlier.names.index(before)]
        else:
            new.append(i)
    return z, np.array(new, dtype=np.int64)


def _prior_proposal(d: int) -> Proposal:
    return Proposal(np.zeros(d), np.eye(d), PROPOSAL_DOF)


def moments(found: ImportanceDraws) -> Proposal:
    """A proposal with the moments of weighted draws, as far as they are known; else the prior's."""
    return refined(_prior_proposal(found.z.shape[1]), found)


def weighed_losses(
    model: MissionModel, prior: LossPrior, z: Array, references: References
) -> tuple[Losses, ...]:
    """Posterior probabilities of every branch's hypotheses, the other branch at its reference."""
    first, back = distinct(z)
    points = z[first]
    lots = (model.at(points[rows])[0] for rows in model.batches(len(points)))
    return weighed_at(lots, prior, references, back)


def weighed_at(
    lots: Iterable[Sequence[BranchAt]], prior: LossPrior, references: References, back: Places
) -> tuple[Losses, ...]:
    """The same from lots of points that have been worked up, one lot in memory at a time.

    ``back`` (n,) are the places of the draws among the points. Hypotheses are looked for at the
    first lot.
    """
    which: dict[str, tuple[Hypothesis, ...]] = {}
    shapes: dict[str, tuple[int, int]] = {}
    ratios: dict[str, list[Array]] = {}
    for branches in lots:
        for branch in branches:
            name, terms = branch.thrusts.branch, loss_terms(branch)
            if name not in which:
                which[name] = near_hypotheses(terms, prior, references[name])
                shapes[name] = (len(branch.thrusts.events), len(branch.thrusts.thrusters))
            result = log_bayes_of(terms, which[name], prior.scale)
            reference = index_of_hypothesis(which[name], references[name])
            ratios.setdefault(name, []).append(result - result[:, [reference]])
    weighed = []
    for name, hypotheses in which.items():
        log_prior = log_prior_of(hypotheses, prior, shapes[name])
        ratio = np.concatenate(ratios.pop(name))[back]
        probability = chosen(log_prior, ratio)
        reference = index_of_hypothesis(hypotheses, references[name])
        weighed.append(Losses(name, hypotheses, log_prior, probability, reference, ratio))
    return tuple(weighed)


def distinct(rows: NDArray[Any]) -> tuple[Places, Places]:
    """Where each different one of the rows (n, …) first comes, and which of these each row is."""
    _, first, which = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return first[order], np.argsort(order)[which.ravel()]


def describe(model: MissionModel, references: References) -> str:
    """Losses in words, ``A.z3 from event 12``, or ``no loss``."""
    thrusters = {branch.branch: branch.thrusters for branch in model.branches}
    words = (
        f"{name}.{thrusters[name][loss.thruster]} from its event {loss.onset + 1}"
        for name, losses in references.items()
        for loss in losses
    )
    return ", ".join(words) or "no loss"
