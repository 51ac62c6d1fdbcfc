"""Losses of thrust that set in at an unknown event: their evidence by rank-one updates.

A failing thruster k loses a share s of its branch's common level from event o on, s half normal.
Given the walked parameters everything else is linear-Gaussian, so with V the pattern of a loss,
log L(s) = log L(0) + bᵀs − ½ sᵀCs, where b and C follow from what the events leave for the levels.
``docs/topics/mission.md`` §4 has the formulae.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import log_ndtr, logsumexp, ndtri_exp

from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.model.mission.model import BranchAt

NODES: Final = np.polynomial.legendre.leggauss(16)
_NEAR: Final = 12.0  # nats from the likeliest hypothesis within which pairs are kept
_MOST_PAIRS: Final = 150
_FIRST: Final = 25  # losses that a pair may start from
_LOOKED_AT: Final = 16  # draws at which pairs are looked for


@dataclass(frozen=True)
class LossPrior:
    """Beliefs on failing thrusters: how probable one is, and how much it loses."""

    probability: float  # that one thruster of a branch fails during the mission
    scale: float  # of the half normal of the share that is lost


@dataclass(frozen=True)
class LossTerms:
    """b and C of every loss (k, o) of one branch, at n points; o counts the branch's events.

    b (n, O, K); C is split into ``total`` (n, O, K, K), what all events after an onset say
    together, less the part ``spent`` (n, O, K, q) that the shared coefficients take up.
    """

    linear: Array
    total: Array
    spent: Array

    @property
    def square(self) -> Array:
        """Diagonal of C, (n, O, K)."""
        own = np.diagonal(self.total, axis1=-2, axis2=-1)
        return np.asarray(own - (self.spent**2).sum(-1))

    def cross(self, first: Places, second: Places) -> Array:
        """C between losses given as (o, k) rows (m, 2), (n, m)."""
        (o, k), (p, j) = first.T, second.T
        both = self.total[:, np.maximum(o, p), k, j]
        # one coefficient after the other: all at once would need q times the memory
        for spent in np.moveaxis(self.spent, -1, 0):
            both -= spent[:, o, k] * spent[:, p, j]
        return np.asarray(both)

    @classmethod
    def joined(cls, parts: Sequence[LossTerms]) -> LossTerms:
        """The terms of several lots of points, in their order."""
        linear, total, spent = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("linear", "total", "spent")
        )
        return cls(linear, total, spent)

    def at(self, places: Places | slice) -> LossTerms:
        """The same at some of the points."""
        return LossTerms(self.linear[places], self.total[places], self.spent[places])


def loss_terms(branch: BranchAt) -> LossTerms:
    """b and C of every loss; an event's pattern is −u × the common level from the onset on."""
    left, design = branch.left, branch.prior.shared
    lost = -branch.thrusts.common_n * branch.scale[..., None]  # (n, E, 1)
    by_shared = left.matrix @ design  # (n, E, K, q)
    factor, shift = branch.collapsed.shared_factor, branch.collapsed.shared_shift
    upper = np.swapaxes(factor, -1, -2)
    mean = np.linalg.solve(upper, shift[..., None])[..., 0]
    residual = left.vector - (by_shared @ mean[:, None, :, None])[..., 0]
    across = _from_onset(lost[..., None] * by_shared)
    n, onsets, thrusters, q = across.shape
    flat = np.swapaxes(across.reshape(n, -1, q), -1, -2)
    spent = np.swapaxes(np.linalg.solve(factor, flat), -1, -2)
    return LossTerms(
        linear=_from_onset(lost * residual),
        total=_from_onset(lost[..., None] ** 2 * left.matrix),
        spent=np.asarray(spent.reshape(n, onsets, thrusters, q)),
    )


def _from_onset(values: Array) -> Array:
    """Sums over the events from each one on: (n, E, …) → (n, E, …)."""
    return np.asarray(np.flip(np.cumsum(np.flip(values, 1), axis=1), 1))


def log_bayes_single(linear: Array, square: Array, scale: float) -> Array:
    """Log Bayes factor of one loss with a half-normal prior, from b and C.

    2 ∫₀^∞ N(s; 0, σ²) exp(b s − ½ C s²) ds.
    """
    precise = 1.0 + scale**2 * square
    mean = linear * scale / np.sqrt(precise)
    return np.asarray(np.log(2.0) - 0.5 * np.log(precise) + 0.5 * mean**2 + log_ndtr(mean))


def log_bayes_pair(linear: Array, square: Array, cross: Array, scale: float) -> Array:
    """The same of two losses together: linear and square (..., 2), cross (...).

    Four times the Gaussian integral times the probability that both are positive, whose second
    factor is averaged over quantiles of the first loss.
    """
    first, second = square[..., 0] + scale**-2, square[..., 1] + scale**-2
    determinant = first * second - cross**2
    means = np.stack(
        [
            (second * linear[..., 0] - cross * linear[..., 1]) / determinant,
            (first * linear[..., 1] - cross * linear[..., 0]) / determinant,
        ],
        axis=-1,
    )
    height = 0.5 * (means * linear).sum(-1) - 0.5 * np.log(determinant) - 2.0 * np.log(scale)
    sd = np.sqrt(second / determinant)
    above = log_ndtr(means[..., 0] / sd)
    # s1 at quantiles of its truncated normal; given it, s2 is normal with precision ``second``
    levels, weights = 0.5 * (1.0 + NODES[0]), 0.5 * NODES[1]
    tail = ndtri_exp(above[..., None] + np.log(levels))
    beyond = -sd[..., None] * tail  # s1 less its mean
    given = means[..., 1, None] - cross[..., None] / second[..., None] * beyond
    positive = log_ndtr(given * np.sqrt(second)[..., None])
    return np.asarray(np.log(4.0) + height + above + logsumexp(positive, b=weights, axis=-1))


@dataclass(frozen=True)
class Loss:
    """Which thruster of a branch loses thrust, and from which of the branch's events on."""

    thruster: int
    onset: int


Hypothesis = tuple[Loss, ...]
"""Losses that a hypothesis has: none, one or two, of different thrusters."""


@dataclass(frozen=True)
class Hypotheses:
    """Hypotheses on one branch with the log Bayes factors (n, H) against no loss at n points."""

    which: tuple[Hypothesis, ...]
    log_prior: Array  # (H,)
    log_bayes: Array  # (n, H)


def log_bayes(terms: LossTerms, hypothesis: Hypothesis, scale: float) -> Array:
    """Log Bayes factor (n,) of one hypothesis against no loss."""
    if not hypothesis:
        return np.zeros(len(terms.linear))
    o, k = (
        np.array([getattr(loss, name) for loss in hypothesis]) for name in ("onset", "thruster")
    )
    linear, square = terms.linear[:, o, k], terms.square[:, o, k]
    if len(hypothesis) == 1:
        return log_bayes_single(linear[:, 0], square[:, 0], scale)
    places = np.stack([o, k], axis=-1)
    cross = terms.cross(places[:1], places[1:])[:, 0]
    return log_bayes_pair(linear, square, cross, scale)


def weigh(terms: LossTerms, prior: LossPrior, include: Hypothesis = ()) -> Hypotheses:
    """No loss, every single loss, the pairs that come near the best of them, and ``include``.

    A pair is looked at if one of its members is among the best single losses, and kept if an upper
    bound of its probability is within 12 nats of the likeliest hypothesis.
    """
    n, onsets, thrusters = terms.linear.shape
    if onsets < 2:
        return Hypotheses(((),), np.zeros(1), np.zeros((n, 1)))
    o, k = (grid.ravel() for grid in np.mgrid[1:onsets, 0:thrusters])
    all_losses = np.stack([o, k], axis=-1)
    linear, square = terms.linear[:, o, k], terms.square[:, o, k]
    single = log_bayes_single(linear, square, prior.scale)
    spread = np.log(onsets - 1.0)
    fails, works = np.log(prior.probability), np.log1p(-prior.probability)
    best = np.argsort(-single.mean(0))[:_FIRST]
    left, right = (grid.ravel() for grid in np.meshgrid(best, np.arange(len(o)), indexing="ij"))
    rank = np.full(len(o), len(o))
    rank[best] = np.arange(len(best))
    new = (k[left] != k[right]) & (rank[left] < rank[right])
    left, right = left[new], right[new]
    few = slice(0, _LOOKED_AT)
    bound = _pair_bound(
        np.stack([linear[few, left], linear[few, right]], axis=-1),
        np.stack([square[few, left], square[few, right]], axis=-1),
        terms.at(few).cross(all_losses[left], all_losses[right]),
        prior.scale,
    ).mean(0)
    # what a second loss costs beforehand decides how near a pair has to come
    once, twice = fails - works - spread, 2.0 * (fails - works - spread)
    likeliest = max(0.0, once + single.mean(0).max(), twice + bound.max(initial=-np.inf))
    near = np.argsort(-bound)[:_MOST_PAIRS]
    near = near[twice + bound[near] > likeliest - _NEAR]
    left, right = left[near], right[near]
    pair = log_bayes_pair(
        np.stack([linear[:, left], linear[:, right]], axis=-1),
        np.stack([square[:, left], square[:, right]], axis=-1),
        terms.cross(all_losses[left], all_losses[right]),
        prior.scale,
    )
    which: list[Hypothesis] = [()]
    losses = [Loss(int(b), int(a)) for a, b in all_losses]
    which += [(loss,) for loss in losses]
    which += [(losses[i], losses[j]) for i, j in zip(left, right, strict=True)]
    if frozenset(include) not in map(frozenset, which):
        which.append(include)
        pair = np.concatenate([pair, log_bayes(terms, include, prior.scale)[:, None]], axis=1)
    counts = np.array([len(hypothesis) for hypothesis in which])
    log_prior = counts * (fails - spread) + (thrusters - counts) * works
    return Hypotheses(
        tuple(which), log_prior, np.concatenate([np.zeros((n, 1)), single, pair], axis=1)
    )


def _pair_bound(linear: Array, square: Array, cross: Array, scale: float) -> Array:
    """Upper bound of :func:`log_bayes_pair`: both are positive no more often than either is."""
    first, second = square[..., 0] + scale**-2, square[..., 1] + scale**-2
    determinant = first * second - cross**2
    a = second * linear[..., 0] - cross * linear[..., 1]
    b = first * linear[..., 1] - cross * linear[..., 0]
    height = 0.5 * (linear[..., 0] * a + linear[..., 1] * b) / determinant
    height += np.log(4.0) - 0.5 * np.log(determinant) - 2.0 * np.log(scale)
    least = np.minimum(a / np.sqrt(second * determinant), b / np.sqrt(first * determinant))
    return np.asarray(height + log_ndtr(least))


@dataclass(frozen=True)
class DrawnLosses:
    """Up to two losses of every draw: thruster, onset and share (n, 2); the share of none is 0."""

    thruster: Places
    onset: Places
    share: Array

    def lost(self, events: int, thrusters: int) -> Array:
        """Share lost so far of every thruster in every event, (n, E, K)."""
        lost = np.zeros((len(self.share), events, thrusters))
        rows, after = np.arange(len(self.share)), np.arange(events)
        for i in range(self.share.shape[1]):
            begun = after >= self.onset[:, [i]]
            lost[rows, :, self.thruster[:, i]] += np.where(begun, self.share[:, [i]], 0.0)
        return lost


def draw_losses(
    terms: LossTerms, which: Sequence[Hypothesis], scale: float, rng: np.random.Generator
) -> DrawnLosses:
    """Sizes of the losses of every point's hypothesis: twenty Gibbs sweeps, one loss exactly."""
    n = len(which)
    onset, thruster = np.zeros((n, 2), dtype=np.int64), np.zeros((n, 2), dtype=np.int64)
    there = np.zeros((n, 2), dtype=bool)
    for row, losses in enumerate(which):
        for i, loss in enumerate(losses):
            onset[row, i], thruster[row, i], there[row, i] = loss.onset, loss.thruster, True
    rows = np.arange(n)[:, None]
    linear = terms.linear[rows, onset, thruster]
    precision = terms.square[rows, onset, thruster] + scale**-2
    spent = terms.spent[rows, onset, thruster]
    cross = terms.total[np.arange(n), onset.max(1), thruster[:, 0], thruster[:, 1]] - (
        spent[:, 0] * spent[:, 1]
    ).sum(-1)
    share = np.where(there, np.maximum(linear / precision, 0.0), 0.0)
    for _ in range(20):
        for i, other in ((0, 1), (1, 0)):
            mean = (linear[:, i] - cross * share[:, other]) / precision[:, i]
            drawn = _positive_normal(mean, precision[:, i] ** -0.5, rng)
            share[:, i] = np.where(there[:, i], drawn, 0.0)
    return DrawnLosses(thruster, onset, share)


def _positive_normal(mean: Array, sd: Array, rng: np.random.Generator) -> Array:
    """Draws from normals that are cut at 0, by the logarithm of their upper tails."""
    log_level = np.log(rng.uniform(size=mean.shape)) + log_ndtr(mean / sd)
    return np.asarray(np.maximum(mean - sd * ndtri_exp(log_level), 0.0))


def draw_thrusts_given(
    branch: BranchAt, losses: DrawnLosses, rng: np.random.Generator
) -> tuple[Array, Array]:
    """One draw of the shared coefficients (n, q) and the events' thrusts (n, E, K) given losses."""
    thrusts, collapsed = branch.thrusts, branch.collapsed
    lost = losses.lost(branch.scale.shape[1], len(thrusts.thrusters))
    pattern = -thrusts.common_n * branch.scale[..., None] * lost
    left = (branch.left.matrix @ pattern[..., None])[..., 0]
    moved = (np.swapaxes(branch.prior.shared, -1, -2) @ left[..., None])[..., 0].sum(1)
    shift = (
        collapsed.shared_shift - np.linalg.solve(collapsed.shared_factor, moved[..., None])[..., 0]
    )
    upper = np.swapaxes(collapsed.shared_factor, -1, -2)
    white = shift + rng.standard_normal(shift.shape)
    shared = np.linalg.solve(upper, white[..., None])[..., 0]
    mean = branch.offset_n + (branch.prior.shared @ shared[:, None, :, None])[..., 0] + pattern
    return np.asarray(shared), thrusts.reference_n[:, None] + _with_departures(branch, mean, rng)


def _with_departures(branch: BranchAt, mean: Array, rng: np.random.Generator) -> Array:
    """Thrusts less the reference, (n, E, K), each event's departures drawn about their mean."""
    own = branch.thrusts.own
    information = branch.information.about(mean)
    across = own.T @ information.matrix @ own
    factor = np.linalg.cholesky(across + np.eye(own.shape[1]))
    linear = np.linalg.solve(factor, (information.vector @ own)[..., None])[..., 0]
    white = linear + rng.standard_normal(linear.shape)
    drawn = np.linalg.solve(np.swapaxes(factor, -1, -2), white[..., None])[..., 0]
    return np.asarray(mean + drawn @ own.T)


def chosen(hypotheses: Hypotheses, reference: int) -> Array:
    """Posterior probability (H,) of the hypotheses from draws under the ``reference`` one.

    Z_h / Z_ref is the mean over those draws of the ratio of Bayes factors.
    """
    ratio = hypotheses.log_bayes - hypotheses.log_bayes[:, [reference]]
    log_evidence = logsumexp(ratio, axis=0) - np.log(len(ratio))
    total = hypotheses.log_prior + log_evidence
    return np.asarray(np.exp(total - logsumexp(total)))


def place_of(hypotheses: Hypotheses, hypothesis: Sequence[Loss]) -> int:
    """Number of a hypothesis, its losses in either order."""
    wanted = frozenset(hypothesis)
    return next(i for i, losses in enumerate(hypotheses.which) if frozenset(losses) == wanted)
