"""Odds of losses at every interim analysis of a mission that grows, from one pool of points.

What an event says of its thrusts at given walked parameters does not change when events are added,
so a shorter mission is the first events of the longer one at the same points. Each weighs all
points that any of them has drawn, as draws of the mixture of their proposals (Cornuet et al.
2012), and adds points only where these do not serve. A fit by itself each time has the same
posterior (:func:`cassini_bayes.results.mission.fitting.fit_mission`), at many times the cost.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.mission.losses import LossPrior, log_bayes
from cassini_bayes.model.mission.model import BranchAt, MissionModel
from cassini_bayes.results.mission.fitting import (
    PASSES,
    EarlierDraws,
    Losses,
    References,
    distinct,
    embedded,
    moments,
    trusted,
    weighed_at,
)
from cassini_bayes.sampling.warmstart import ImportanceDraws, Proposal, refined, weighted

POINTS: Final = 400  # added to a pool at a time
WEIGHED: Final = 100  # draws of an analysis at which losses are weighed
_TRIES: Final = 6


@dataclass(frozen=True)
class Pool:
    """Points of the walked parameters with what all events of a mission say there."""

    model: MissionModel
    proposals: tuple[Proposal, ...]  # each of POINTS points
    z: Array  # (n, d)
    branches: tuple[BranchAt, ...]
    log_prior: Array  # (n,)
    log_mixture: Array  # (n,) density of the mixture of the proposals

    @classmethod
    def begun(cls, model: MissionModel, proposal: Proposal, rng: np.random.Generator) -> Pool:
        """A pool of the points of one proposal."""
        z = proposal.sample(rng, POINTS)
        branches = _worked_up(model, z)
        log_prior = model.space.log_prior_terms(z).sum(-1)
        return cls(model, (proposal,), z, branches, log_prior, proposal.log_density(z))

    def grown(self, proposal: Proposal, rng: np.random.Generator) -> Pool:
        """The pool with the points of one more proposal."""
        new = Pool.begun(self.model, proposal, rng)
        proposals, z = (*self.proposals, proposal), np.concatenate([self.z, new.z])
        log_each = np.stack([item.log_density(z) for item in proposals])
        branches = tuple(
            BranchAt.joined(both) for both in zip(self.branches, new.branches, strict=True)
        )
        return Pool(
            self.model,
            proposals,
            z,
            branches,
            np.concatenate([self.log_prior, new.log_prior]),
            np.asarray(logsumexp(log_each, axis=0) - np.log(len(proposals))),
        )

    def first(self, events: int) -> tuple[BranchAt, ...]:
        """Every branch with those of its events that are among the mission's first ones."""
        counts = [int((branch.thrusts.events < events).sum()) for branch in self.branches]
        return tuple(b.first(n) for b, n in zip(self.branches, counts, strict=True) if n)

    def log_density(
        self, branches: tuple[BranchAt, ...], references: References, prior: LossPrior
    ) -> Array:
        """Log posterior density (n,) of the branches' events given losses.

        Totals rows without a velocity change: what does not depend on thrusts is left out.
        """
        result = self.log_prior
        for branch in branches:
            losses = references[branch.thrusts.branch]
            result = result + branch.levels.log_likelihood + log_bayes(branch, losses, prior.scale)
        return np.asarray(result)


def _worked_up(model: MissionModel, z: Array) -> tuple[BranchAt, ...]:
    """Every branch at all points, events' own departures eliminated."""
    lots = [model.at(z[rows])[0] for rows in model.batches(len(z))]
    return tuple(BranchAt.joined(parts) for parts in zip(*lots, strict=True))


@dataclass(frozen=True)
class Analysis:
    """What is believed of losses once a mission has so many events."""

    events: int
    losses: tuple[Losses, ...]
    trusted: bool
    draws: EarlierDraws  # what a fit of further events goes on from


def analyses(
    model: MissionModel,
    prior: LossPrior,
    begun: EarlierDraws,
    counts: range,
    draws: int,
    rng: np.random.Generator,
) -> Iterator[Analysis]:
    """Looks at a mission after its first ``counts`` events, in their order.

    Parameters
    ----------
    model
        Of the whole mission.
    begun
        Draws of a fit of its first events: where the pool begins.
    draws
        Equally weighted draws that an analysis hands on.
    """
    references = {branch.branch: () for branch in model.branches} | dict(begun.references)
    z, _ = embedded(begun, model, rng)
    pool = Pool.begun(model, moments(weighted(z, np.zeros(len(z)))), rng)
    for count in counts:
        for analysis in range(PASSES):
            pool, result, log_density = _weighed(pool, count, references, prior, rng)
            branches = pool.first(count)
            places = result.places(rng, WEIGHED)
            chosen, back = distinct(places)
            lot = tuple(branch.take(places[chosen]) for branch in branches)
            losses = weighed_at([lot], prior, references, back)
            best = {one.branch: one.best for one in losses}
            settled = all(set(best[b]) == set(references[b]) for b in best)
            if settled or analysis == PASSES - 1:
                break
            references = references | best
        places = result.places(rng, draws)
        yield Analysis(
            count,
            losses,
            trusted(result),
            EarlierDraws(
                model.space.names,
                pool.z[places],
                log_density[places],
                references,
                result.log_evidence,
                result.log_evidence_se,
            ),
        )


def _weighed(
    pool: Pool,
    events: int,
    references: References,
    prior: LossPrior,
    rng: np.random.Generator,
) -> tuple[Pool, ImportanceDraws, Array]:
    """Weights of a pool's points after so many events; points are added until they can be trusted.

    Returns the pool, the weighted points, and the density (n,) they are weighted for.
    """
    for attempt in range(_TRIES):
        log_density = pool.log_density(pool.first(events), references, prior)
        result = weighted(pool.z, log_density - pool.log_mixture)
        if trusted(result) or attempt == _TRIES - 1:
            break
        pool = pool.grown(refined(pool.proposals[-1], result), rng)
    return pool, result, log_density
