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
from scipy.special import log_ndtr, logsumexp, ndtr, ndtri_exp, owens_t

from cassini_bayes.computing.arrays import Array, Places, picked
from cassini_bayes.errors import InputError
from cassini_bayes.model.mission.model import BranchAt
from cassini_bayes.priors.reader import Priors

LOSS_SHARE: Final = "thrust_loss_share"
FAILING: Final = "failing_probability"
NODES: Final = np.polynomial.legendre.leggauss(16)
_SMALL: Final = 1e-8  # probability below which rounding takes a share of it
_NEAR: Final = 12.0  # nats from the likeliest hypothesis within which pairs are kept
_MOST_PAIRS: Final = 150  # pairs that are weighed, those with the highest bounds (judgement)
_FIRST: Final = 25  # losses that a pair may start from
_SCREENING_DRAWS: Final = 16  # draws at which pairs are looked for


@dataclass(frozen=True)
class LossPrior:
    """Beliefs on failing thrusters: how probable one is, and how much it loses."""

    probability: float  # that one thruster of a branch fails during the mission
    scale: float  # of the half normal of the share that is lost


def loss_prior(priors: Priors) -> LossPrior:
    """Beliefs on failing thrusters from a priors file.

    Raises
    ------
    InputError
        One is missing; a share that is lost that is no half normal from 0, which the evidence of a
        loss is worked out for; a probability that is no number between 0 and 1, both excluded.
    """
    priors.require((LOSS_SHARE, FAILING), "a mission")
    share, failing = (priors.parameters[name] for name in (LOSS_SHARE, FAILING))
    own = share.distribution
    if own is None or (own.name, own.loc, own.support) != ("halfnorm", 0.0, (0.0, np.inf)):
        raise InputError(
            f"{priors.path}: parameters.{LOSS_SHARE}.dist",
            "halfnorm from 0 without bounds: the evidence of a loss is worked out for it",
            f"fixed = {share.fixed!r}" if own is None else repr(own),
            'write dist = "halfnorm" and a scale; 0.15 says that losses of 10 to 25 % are usual',
        )
    if failing.fixed is None or not 0.0 < failing.fixed < 1.0:
        raise InputError(
            f"{priors.path}: parameters.{FAILING}.fixed",
            "a fixed probability above 0 and below 1",
            repr(failing.distribution if failing.fixed is None else failing.fixed),
            "fix it, e.g. at 0.1; a small one, e.g. 1e-6, stands for thrusters that do not fail",
        )
    return LossPrior(failing.fixed, own.scale)


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
        variance = np.diagonal(self.total, axis1=-2, axis2=-1)
        return np.asarray(variance - (self.spent**2).sum(-1))

    def cross(self, first: Places, second: Places) -> Array:
        """C between losses given as (o, k) rows (m, 2), (n, m)."""
        (o, k), (p, j) = first.T, second.T
        both = self.total[:, np.maximum(o, p), k, j]
        # one coefficient after the other: all at once would need q times the memory
        for spent in np.moveaxis(self.spent, -1, 0):
            both -= spent[:, o, k] * spent[:, p, j]
        return np.asarray(both)


def loss_terms(branch: BranchAt) -> LossTerms:
    """b and C of every loss; an event's pattern is −u × the common level from the onset on."""
    own, left, levels = branch.thrusts, branch.left, branch.levels
    square = branch.scale[..., None, None] ** 2 * left.matrix
    steady = _from_onset(square)
    yearly = _from_onset(own.years[:, None, None] * square)
    across = own.onto_shared(steady, yearly)
    n, onsets, thrusters, q = across.shape
    spent = across.reshape(n, -1, q) @ np.swapaxes(-own.common_n * levels.inverse, -1, -2)
    return LossTerms(
        linear=_from_onset(-own.common_n * branch.scale[..., None] * _residual(branch)),
        total=own.common_n**2 * steady,
        spent=spent.reshape(n, onsets, thrusters, q),
    )


def _residual(branch: BranchAt) -> Array:
    """What is left of each event's linear term, (n, E, K), with coefficients at their mean."""
    mean = branch.scale[..., None] * branch.thrusts.levels_at(branch.levels.mean)
    left = branch.left
    return np.asarray(left.vector - (left.matrix @ mean[..., None])[..., 0])


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

    Four times the Gaussian integral times the probability that both are positive.
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
    both = log_both_positive(
        means[..., 0] * np.sqrt(determinant / second),
        means[..., 1] * np.sqrt(determinant / first),
        -cross / np.sqrt(first * second),
    )
    return np.asarray(np.log(4.0) + height + both)


def log_both_positive(h: Array, k: Array, correlation: Array) -> Array:
    """Log probability that two normals with means h, k and standard deviation 1 are both positive.

    By Owen's T function (Owen 1956), good to 1e-16 in the probability; where that is small, by
    sixteen quantiles of the first one given that it is positive, good to a hundredth of a nat.
    """
    root = np.sqrt(1.0 - correlation**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        across = owens_t(h, (k - correlation * h) / (h * root))
        across += owens_t(k, (h - correlation * k) / (k * root))
    apart = (h * k < 0.0) | ((h * k == 0.0) & (h + k < 0.0))
    probability = np.asarray(0.5 * (ndtr(h) + ndtr(k)) - across - 0.5 * apart)
    result = np.log(np.maximum(probability, _SMALL))
    small = ~(probability > _SMALL)
    if small.any():
        h, k, correlation, root = (np.asarray(v)[small][:, None] for v in (h, k, correlation, root))
        levels, weights = 0.5 * (1.0 + NODES[0]), 0.5 * NODES[1]
        beyond = -ndtri_exp(log_ndtr(h) + np.log(levels))  # the first one less its mean
        given = log_ndtr((k + correlation * beyond) / root)
        result[small] = log_ndtr(h)[:, 0] + logsumexp(given, b=weights, axis=-1)
    return np.asarray(result)


@dataclass(frozen=True)
class Loss:
    """Which thruster of a branch loses thrust, and from which of the branch's events on."""

    thruster: int
    onset: int


Hypothesis = tuple[Loss, ...]
"""Losses that a hypothesis has: none, one or two, of different thrusters."""


def log_bayes(branch: BranchAt, hypothesis: Hypothesis, scale: float) -> Array:
    """Log Bayes factor (n,) of one hypothesis against no loss, from its own b and C alone."""
    n, events = branch.scale.shape
    if not hypothesis:
        return np.zeros(n)
    own, residual = branch.thrusts, _residual(branch)
    linear, columns, spent = [], [], []
    for loss in hypothesis:
        begun = np.where(np.arange(events) >= loss.onset, -own.common_n * branch.scale, 0.0)
        column = begun[..., None] * branch.left.matrix[..., loss.thruster]
        across = own.onto_shared(
            (branch.scale[:, None] @ column)[:, 0],
            ((own.years * branch.scale)[:, None] @ column)[:, 0],
        )
        linear.append((begun * residual[..., loss.thruster]).sum(1))
        columns.append((begun, column))
        spent.append((branch.levels.inverse @ across[..., None])[..., 0])

    def square(i: int, j: int) -> Array:
        (begun, _), (_, column) = columns[i], columns[j]
        total = (begun * column[..., hypothesis[i].thruster]).sum(1)
        return np.asarray(total - (spent[i] * spent[j]).sum(-1))

    if len(hypothesis) == 1:
        return log_bayes_single(linear[0], square(0, 0), scale)
    squares = np.stack([square(0, 0), square(1, 1)], axis=-1)
    return log_bayes_pair(np.stack(linear, axis=-1), squares, square(0, 1), scale)


def near_hypotheses(
    terms: LossTerms, prior: LossPrior, include: Hypothesis = ()
) -> tuple[Hypothesis, ...]:
    """No loss, every single loss, the pairs that come near the best of them, and ``include``.

    A pair is considered if one of its members is among the best single losses, and kept if an upper
    bound of its probability is within 12 nats of the likeliest hypothesis.
    """
    _, onsets, thrusters = terms.linear.shape
    if onsets < 2:
        return ((),)
    o, k = (grid.ravel() for grid in np.mgrid[1:onsets, 0:thrusters])
    all_losses = np.stack([o, k], axis=-1)
    linear, square = terms.linear[:, o, k], terms.square[:, o, k]
    single = log_bayes_single(linear, square, prior.scale)
    best = np.argsort(-single.mean(0))[:_FIRST]
    left, right = (grid.ravel() for grid in np.meshgrid(best, np.arange(len(o)), indexing="ij"))
    rank = np.full(len(o), len(o))
    rank[best] = np.arange(len(best))
    new = (k[left] != k[right]) & (rank[left] < rank[right])
    left, right = left[new], right[new]
    few = slice(0, _SCREENING_DRAWS)
    bound = _pair_bound(
        np.stack([linear[few, left], linear[few, right]], axis=-1),
        np.stack([square[few, left], square[few, right]], axis=-1),
        picked(terms, few).cross(all_losses[left], all_losses[right]),
        prior.scale,
    ).mean(0)
    # what a second loss costs beforehand decides how near a pair has to come
    once = np.log(prior.probability) - np.log1p(-prior.probability) - np.log(onsets - 1.0)
    likeliest = max(0.0, once + single.mean(0).max(), 2.0 * once + bound.max(initial=-np.inf))
    near = np.argsort(-bound)[:_MOST_PAIRS]
    near = near[2.0 * once + bound[near] > likeliest - _NEAR]
    which: list[Hypothesis] = [()]
    losses = [Loss(int(b), int(a)) for a, b in all_losses]
    which += [(loss,) for loss in losses]
    which += [(losses[i], losses[j]) for i, j in zip(left[near], right[near], strict=True)]
    if frozenset(include) not in map(frozenset, which):
        which.append(include)
    return tuple(which)


def log_prior_of(which: Sequence[Hypothesis], prior: LossPrior, shape: tuple[int, int]) -> Array:
    """Log prior probability (H,) of hypotheses on a branch of ``shape`` (events, thrusters)."""
    events, thrusters = shape
    counts = np.array([len(hypothesis) for hypothesis in which])
    fails = np.log(prior.probability) - np.log(max(events - 1.0, 1.0))
    return np.asarray(counts * fails + (thrusters - counts) * np.log1p(-prior.probability))


def log_bayes_of(terms: LossTerms, which: Sequence[Hypothesis], scale: float) -> Array:
    """Log Bayes factors (n, H) of hypotheses against no loss."""
    result = np.zeros((len(terms.linear), len(which)))
    counts = np.array([len(hypothesis) for hypothesis in which])
    for size in (1, 2):
        members = np.flatnonzero(counts == size)
        if not len(members):
            continue
        places = np.array([[(s.onset, s.thruster) for s in which[int(i)]] for i in members])
        o, k = places[..., 0], places[..., 1]
        linear, square = terms.linear[:, o, k], terms.square[:, o, k]
        if size == 1:
            result[:, members] = log_bayes_single(linear[..., 0], square[..., 0], scale)
        else:
            cross = terms.cross(places[:, 0], places[:, 1])
            result[:, members] = log_bayes_pair(linear, square, cross, scale)
    return result


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


def prior_losses(
    prior: LossPrior, shape: tuple[int, int, int], rng: np.random.Generator
) -> DrawnLosses:
    """Losses before any data, for ``shape`` = (draws n, events E, thrusters K)."""
    n, events, thrusters = shape
    order = np.where(rng.uniform(size=(n, thrusters)) < prior.probability, 0.0, 1.0)
    thruster = np.argsort(order + rng.uniform(size=order.shape), axis=1)[:, :2]
    fails = (np.take_along_axis(order, thruster, axis=1) == 0.0) & (events > 1)
    share = np.where(fails, np.abs(prior.scale * rng.standard_normal((n, 2))), 0.0)
    return DrawnLosses(thruster, rng.integers(1, max(events, 2), (n, 2)), share)


def draw_thrusts_given(
    branch: BranchAt, losses: DrawnLosses, rng: np.random.Generator
) -> tuple[Array, Array]:
    """One draw of the shared coefficients (n, q) and the events' thrusts (n, E, K) given losses."""
    thrusts, levels, scale = branch.thrusts, branch.levels, branch.scale[..., None]
    lost = losses.lost(branch.scale.shape[1], len(thrusts.thrusters))
    pattern = -thrusts.common_n * scale * lost
    left = scale * (branch.left.matrix @ pattern[..., None])[..., 0]
    moved = thrusts.onto_shared(left.sum(1), (thrusts.years[:, None] * left).sum(1))
    shift = levels.shift - (levels.inverse @ moved[..., None])[..., 0]
    white = shift + rng.standard_normal(shift.shape)
    shared = (white[:, None] @ levels.inverse)[:, 0]
    mean = branch.offset_n + scale * thrusts.levels_at(shared) + pattern
    return np.asarray(shared), thrusts.reference_n[:, None] + _with_departures(branch, mean, rng)


def _with_departures(branch: BranchAt, mean: Array, rng: np.random.Generator) -> Array:
    """Thrusts less the reference, (n, E, K), each event's departures drawn about their mean."""
    thrusts = branch.thrusts.departures
    information = branch.information.about(mean)
    across = thrusts.T @ information.matrix @ thrusts
    factor = np.linalg.cholesky(across + np.eye(thrusts.shape[1]))
    linear = np.linalg.solve(factor, (information.vector @ thrusts)[..., None])[..., 0]
    white = linear + rng.standard_normal(linear.shape)
    drawn = np.linalg.solve(np.swapaxes(factor, -1, -2), white[..., None])[..., 0]
    return np.asarray(mean + drawn @ thrusts.T)


def chosen(log_prior: Array, log_ratio: Array) -> Array:
    """Posterior probability (H,) of hypotheses from draws under a reference one.

    ``log_ratio`` (n, H) are their Bayes factors against it: Z_h / Z_ref is the mean over the draws.
    """
    total = log_prior + logsumexp(log_ratio, axis=0) - np.log(len(log_ratio))
    return np.asarray(np.exp(total - logsumexp(total)))


def index_of_hypothesis(which: Sequence[Hypothesis], hypothesis: Hypothesis) -> int:
    """Number of a hypothesis, its losses in either order."""
    wanted = frozenset(hypothesis)
    return next(i for i, losses in enumerate(which) if frozenset(losses) == wanted)
