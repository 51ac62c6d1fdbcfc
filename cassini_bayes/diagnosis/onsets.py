"""From which event on a cause acts: which beginnings can matter, and their sum.

A cause acts in all events or from a later one on. Every beginning is a hypothesis of its own with
its share of the cause's prior probability (``throughout`` of ``effects/causes.toml``); the cause's
evidence is their sum (docs/topics/criticism.md §1). Few of them can matter. About the baseline's
mode rows are linear: with X their columns, P the prior's precision, G = XᵀX + P, m the prior's
mean, and M_e what an effect of some size adds to event e, an effect from event o on has

    A = Σ Xₑᵀ Mₑ,   b = Σ Mₑᵀ yₑ − Aᵀ G⁻¹ (Xᵀ y + P m),   I = Σ Mₑᵀ Mₑ − Aᵀ G⁻¹ A,   e ≥ o,

and gains ½ bᵀ (I + S)⁻¹ b at its best size, S what the prior has against the columns' sizes: sums
over e ≥ o are cumulative, so all beginnings of all causes cost one pass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.special import logsumexp, ndtr, ndtri

from cassini_bayes.balance.linearised import Linear
from cassini_bayes.balance.part_columns import ColumnsByPart, PartColumns, spread
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import Beginning, H, Weighed
from cassini_bayes.diagnosis.events import Events, turns_only_about, untold_axes
from cassini_bayes.diagnosis.hypotheses import Hypothesis, extend
from cassini_bayes.diagnosis.innovations import effect_columns, innovations
from cassini_bayes.effects.effect import Effect, Remainder, onsets
from cassini_bayes.effects.registry import Odds
from cassini_bayes.model.mission.losses import log_bayes_single

Candidate = Weighed[Hypothesis]
SIZES: Final = (-1.2, 1.0)
"""Standard normals at which the columns of an effect are taken: one on each side of nothing, and
both on the one side where it has one."""
HALF_NORMAL: Final = tuple(float(ndtri(0.5 + 0.5 * ndtr(abs(size)))) for size in SIZES)
"""Scales of a half normal that the longer of two columns of an effect with one side is at."""
LEAST_GAIN: Final = 5.0
"""Nats of a beginning that is searched for: what gains less is as its linear model says (as
``search.NEAR_GAIN``)."""
NOTHING: Final = 1e-9  # nats of a cause that does nothing in any event of the rest
BEHIND_NATS: Final = 10.0  # of the best, as for draws: less is a probability below 5e-5
BEHIND_SHARE: Final = 0.15
"""Of the best gain more, by which linear gains may be off: judgement. Where the best turns out to
gain less than that, more beginnings are searched for (:meth:`Beginnings.missed`)."""
MOST: Final = 24  # beginnings searched for at once: judgement, half as many as there are causes
STEP: Final = 1e-3  # standard normals, for slopes, as in innovations


@dataclass(frozen=True)
class Beginnings:
    """Some causes (C,) and the events (E,) that they may begin with, in order of time.

    ``gains`` (C, E) are what they gain by their linear model, at their best, from every event on,
    and ``factors`` (C, E) its log Bayes factors against none of them, nats. Those of ``throughout``
    cannot begin later.
    """

    effects: tuple[Effect, ...]
    order: tuple[str, ...]
    odds: Odds
    gains: Array
    factors: Array
    throughout: tuple[Effect, ...] = ()

    @classmethod
    def of_information(
        cls,
        effects: Sequence[Effect],
        order: Sequence[str],
        odds: Odds,
        information: Callable[[Sequence[Effect]], Sequence[tuple[Array, Array]]],
    ) -> Beginnings:
        """Beginnings by what effects at :func:`sizes_tried` are told from every event on.

        ``information`` (as :func:`information_from_each`) is asked of those that have a choice.
        """
        choose = tuple(effect for effect in effects if not effect.kind.throughout)
        if len(order) < 2 or odds.throughout == 1.0 or not choose:
            nothing = np.zeros((len(effects), 1))
            return cls(tuple(effects), tuple(order[:1]), odds, nothing, nothing)
        matrices = information(choose)
        ends = np.cumsum([0, *(len(sizes_tried(effect)) for effect in choose)])
        own = [
            [(matrix[a:c, a:c], vector[a:c]) for matrix, vector in matrices]
            for a, c in pairwise(ends)
        ]
        gains = np.array([[_gain(*one) for one in each] for each in own])
        factors = np.array([[log_bayes(*one) for one in each] for each in own])
        throughout = tuple(effect for effect in effects if effect.kind.throughout)
        return cls(choose, tuple(order), odds, gains, factors, throughout)

    @classmethod
    def of(
        cls,
        full: Hypothesis,
        z: Array,
        remainder: Remainder | None,
        effects: Sequence[Effect],
        events: Events,
    ) -> Beginnings:
        """Beginnings of causes beside a hypothesis with the mode z (d,), and what it leaves."""
        order = events.in_order

        def information(choose: Sequence[Effect]) -> list[tuple[Array, Array]]:
            linear = None if remainder is None else remainder.linear
            return linear_model(full, z, linear, choose, order)

        found = cls.of_information(effects, order, events.catalogue.odds, information)
        return found._told_by(events)

    def _told_by(self, events: Events) -> Beginnings:
        """Without beginnings from which on slews alone do not turn about an axis of the cause.

        They are told by noise (:func:`.events.untold_axes`): gains of nothing, as of a cause that
        does nothing any more.
        """
        told = np.ones(self.gains.shape, dtype=bool)
        for o in range(1, len(self.order)):
            after = [event for event in events.telemetry if event.id in self.order[o:]]
            untold = untold_axes(after)
            told[:, o] = [not turns_only_about(effect, untold) for effect in self.effects]
        gains, factors = (np.where(told, own, 0.0) for own in (self.gains, self.factors))
        return replace(self, gains=gains, factors=factors)

    def likely(self, least: float = -np.inf) -> list[Effect]:
        """Causes throughout, and from such events on as may come near the best.

        Those whose log Bayes factor is below ``least`` throughout are left out, unless a later
        beginning is among these, or they can have none. ``least`` is not above zero: where there is
        no choice of beginnings, factors are zero.
        """
        due = self._due(float(self.gains.max(initial=0.0)))
        kept = {c for c, _ in due} | {*np.flatnonzero(self.factors[:, 0] >= least).tolist()}
        first = [self._from(c, 0) for c in sorted(kept)]
        return [*first, *self.throughout, *self._later(due)]

    def missed(self, gained: float) -> list[Effect]:
        """Further ones, where the best has gained less than its linear model says (nats)."""
        before = self._due(float(self.gains.max(initial=0.0)))
        return self._later([place for place in self._due(gained) if place not in before])

    def _due(self, best: float) -> list[tuple[int, int]]:
        later, throughout = self.gains[:, 1:], self.gains[:, :1]
        bar = best - BEHIND_NATS - BEHIND_SHARE * max(best, 0.0)
        near = (later > max(bar, LEAST_GAIN)) & (later > throughout - BEHIND_NATS)
        best_first = np.argsort(-later[near], kind="stable")[:MOST]
        return [(int(c), int(o) + 1) for c, o in np.argwhere(near)[best_first]]

    def _later(self, places: Sequence[tuple[int, int]]) -> list[Effect]:
        return [self._from(c, o) for c, o in places]

    def _from(self, c: int, o: int) -> Effect:
        """A cause from an event on, with its share of the prior probability."""
        effect, share = self.effects[c], self.odds.of_onsets(len(self.order))[o]
        onset = (None, *onsets(self.order))[o]
        probability = share * effect.prior_probability
        return replace(effect, onset=onset, prior_probability=probability)

    def summed(self, weighed: Sequence[Weighed[Any]], beside: float) -> list[Weighed[Any]]:
        """Hypotheses in order, the beginnings of each cause as one.

        ``beside`` is the log evidence of what they are beside, nats. What was not searched for and
        gains little has the evidence that the linear model gives it, corrected as that throughout
        is; what gains more was too far behind to be searched for. From an event on in which it
        does nothing any more, a cause is none.
        """
        if len(self.order) < 2:
            return list(weighed)
        place = {effect.name: c for c, effect in enumerate(self.effects)}
        by_cause: dict[str, list[Weighed[Any]]] = {}
        for candidate in weighed:
            by_cause.setdefault(
                candidate.hypothesis.causes[-1] if candidate.is_cause else candidate.name, []
            ).append(candidate)
        return [
            self._sum(mode, place[cause], beside) if cause in place else mode[0]
            for cause, mode in by_cause.items()
        ]

    def _sum(self, own: Sequence[Weighed[Any]], c: int, beside: float) -> Weighed[Any]:
        by_event = {begins_with(weighed): weighed for weighed in own}
        throughout, shares = by_event[""], self.odds.of_onsets(len(self.order))
        events, scores = ("", *self.order[1:]), []
        prior = throughout.hypothesis.prior_probability / shares[0]
        factors, off = self.factors[c], throughout.net_evidence - beside - self.factors[c, 0]
        for o, (event, share) in enumerate(zip(events, shares, strict=True)):
            if event in by_event:
                scores.append(by_event[event].score)
            elif abs(factors[o]) <= NOTHING and self.gains[c, o] <= NOTHING:
                scores.append(-np.inf)
            elif self.gains[c, o] < LEAST_GAIN:
                # the linear model is as wrong as throughout where it says as much
                alike = float(np.clip(factors[o] / factors[0], 0.0, 1.0)) if factors[0] else 0.0
                scores.append(beside + float(factors[o]) + alike * off + np.log(share * prior))
            else:
                scores.append(-np.inf)
        total = float(logsumexp(scores))
        best = max(own, key=lambda weighed: weighed.score)
        return replace(
            best,
            hypothesis=replace(best.hypothesis, prior_probability=prior),
            summed=total - float(np.log(prior)) - best.net_evidence,
            beginnings=tuple(
                Beginning(event, float(np.exp(score - total)), by_event.get(event))
                for event, score in zip(events, scores, strict=True)
            ),
        )


def without_event(
    weighed: Weighed[H], order: Sequence[str], event: str
) -> list[tuple[int, Weighed[H]]]:
    """Places in time from which on a cause may act by all events but one, and the cause by these.

    Beginnings that differ only in whether it acts in that event are one to the others, which cannot
    tell them apart; where they do not see it at all it may act throughout as well.
    """
    acting = [frozenset(order[first:]) - {event} for first in range(len(order))]
    place = {name: first for first, name in enumerate(("", *order[1:]))}
    members = {acting[place[name]]: way for name, _, way in weighed.searched}
    throughout = weighed.beginnings[0].weighed
    if frozenset() in members and throughout is not None:
        members.setdefault(acting[0], throughout)
    return [(first, members[seen]) for first, seen in enumerate(acting) if seen in members]


def begins_with(weighed: Weighed[Any]) -> str:
    """Id of the event that the last effect of a hypothesis begins with; empty throughout."""
    onset = weighed.hypothesis.effects[-1].onset
    return "" if onset is None else onset.event


def gains_about(
    full: Hypothesis, z: Array, causes: Sequence[Candidate], events: Events
) -> list[float]:
    """Log Bayes factors of causes against none, nats, by their linear models about a point z (d,).

    ``full`` is the hypothesis without them, with all columns.
    """
    effects = [cause.hypothesis.effects[-1] for cause in causes]
    linear = innovations(full, z).linear if events.telemetry else None
    matrix, vector = linear_model(full, z, linear, effects, events.in_order)[0]
    ends = np.cumsum([0, *(len(sizes_tried(effect)) for effect in effects)])
    return [log_bayes(matrix[a:c, a:c], vector[a:c]) for a, c in pairwise(ends)]


def linear_model(
    full: Hypothesis,
    z: Array,
    linear: Linear | None,
    effects: Sequence[Effect],
    order: Sequence[str],
) -> list[tuple[Array, Array]]:
    """I and b of some causes, at :func:`sizes_tried` each, from every event on.

    Parameters
    ----------
    full
        The hypothesis without them, with all columns, of which z (d,) is the mode.
    linear
        Its telemetry rows about z, with what counters leave open; None without telemetry.
    effects
        The causes.
    order
        Ids of its events in order of time.
    """
    extended = [(extend(full, [effect]), sizes_tried(effect)) for effect in effects]
    added = effect_columns(full, z, extended)
    if full.model.totals:
        linear, of_rows = _with_totals(full, z, extended, linear)
        added = [*of_rows, *added]
    assert linear is not None  # there are events
    place = {name: i for i, name in enumerate(full.model.event_ids)}
    in_time = [place[name] for name in order]
    mean = np.zeros(len(linear.precision))
    mean[: len(z)] = -z
    return information_from_each(
        [linear.columns.parts[i] for i in in_time],
        [linear.target[linear.parts[i]] for i in in_time],
        [added[i] for i in in_time],
        linear.precision,
        mean,
    )


def information_from_each(
    columns: Sequence[PartColumns],
    target: Sequence[Array],
    added: Sequence[Array],
    precision: Array,
    mean: Array,
) -> list[tuple[Array, Array]]:
    """I (S, S) and b (S,) of effects that act from every event on.

    Parameters
    ----------
    columns, target
        Whitened columns, of p, and target (m_e,) of every event, in order of time.
    added
        What effects add to the target, (m_e, S).
    precision, mean
        Of the unknowns' prior, (p,).
    """
    every = ColumnsByPart(tuple(columns), len(mean))
    factor = cho_factor(every.gram() + np.diag(precision), lower=True)
    fitted = cho_solve(factor, every.along(np.concatenate(target)) + precision * mean)
    size = added[0].shape[1]
    across, square, along = np.zeros((len(mean), size)), np.zeros((size, size)), np.zeros(size)
    matrices = []
    for own, y, effect in zip(columns[::-1], target[::-1], added[::-1], strict=True):
        across = across + spread(effect.T @ own.values, own.places, len(mean)).T
        square, along = square + effect.T @ effect, along + effect.T @ y
        matrix = square - across.T @ cho_solve(factor, across)
        matrices.append((matrix, along - across.T @ fitted))
    return matrices[::-1]


def sizes_tried(effect: Effect) -> Array:
    """Values (s, k) of an effect's coordinates: along each of them."""
    return np.concatenate([size * np.eye(len(effect.parameters)) for size in SIZES])


def _gain(matrix: Array, vector: Array) -> float:
    """½ bᵀ (I + S)⁻¹ b of several parameters; of one, that of its best size, which keeps its sign.

    Columns are those of sizes z: so many of them cost ½ z² each by the prior, S = diag z². What the
    events hardly tell would else gain by sizes that nobody believes.
    """
    believed = np.repeat(np.square(SIZES), len(vector) // len(SIZES))
    if len(vector) == len(SIZES):
        along = np.diagonal(matrix) + believed
        return float((0.5 * np.maximum(vector, 0.0) ** 2 / along).max())
    return float(0.5 * vector @ np.linalg.solve(matrix + np.diag(believed), vector))


def log_bayes(matrix: Array, vector: Array) -> float:
    """Log Bayes factor of an effect against none, nats, its sizes normal or half normal.

    A size has one side where its two columns point the same way: the longer one is then so many
    scales of a half normal. Else a scale is the difference of both over that of the standard
    normals.
    """
    k = len(vector) // len(SIZES)
    per_scale, sided = np.zeros((len(vector), k)), np.zeros(k, dtype=bool)
    for i in range(k):
        low, high = i, k + i
        sided[i] = matrix[low, high] > 0.0
        if sided[i]:
            longer = max(low, high, key=lambda place: matrix[place, place])
            per_scale[longer, i] = 1.0 / HALF_NORMAL[longer == high]
        else:
            per_scale[[low, high], i] = np.array([-1.0, 1.0]) / (SIZES[1] - SIZES[0])
    inner, along = per_scale.T @ matrix @ per_scale, per_scale.T @ vector
    if k == 1 and sided[0]:
        return float(log_bayes_single(along[0], np.maximum(inner[0, 0], 0.0), 1.0))
    values, vectors = np.linalg.eigh(inner)
    grown = 1.0 + np.maximum(values, 0.0)
    return float(0.5 * ((vectors.T @ along) ** 2 / grown - np.log(grown)).sum())


def _with_totals(
    full: Hypothesis,
    z: Array,
    extended: Sequence[tuple[Hypothesis, Array]],
    telemetry: Linear | None,
) -> tuple[Linear, list[Array]]:
    """The rows with those of totals before them, and what effects add to these, (3, S) each."""
    model, d = full.model, len(z)
    prior, term = model.thrust_prior, model.totals_rows
    points = np.vstack([z, z + STEP * np.eye(d), z - STEP * np.eye(d)])
    located = model.points(points)
    system, factor = term.at(located).system, term.thrust_factor(located)
    left = _unexplained(full, points)
    slopes = (left[1 + d :] - left[1 : 1 + d]) / (2.0 * STEP)
    effects = np.concatenate(
        [
            left[0]
            - _unexplained(hypothesis, np.column_stack([np.tile(z, (len(values), 1)), values]))
            for hypothesis, values in extended
        ]
    )
    targets, shared, departures, added = [], [], [], []
    for row in range(len(term.rows)):
        noise = (system.covariance[0, row] + system.torque_covariance[row])[:3, :3]
        inverse = np.linalg.inv(np.linalg.cholesky(noise))
        design = system.design[0, row, :3]
        levels = prior.scaled(None if factor is None else factor[0, row]).shared
        targets.append(inverse @ left[0, row])
        shared.append(inverse @ np.column_stack([slopes[:, row].T, design @ levels]))
        departures.append(inverse @ design @ prior.departures)
        added.append(inverse @ effects[:, row].T)
    width, by_event = shared[0].shape[1], block_diag(*departures)
    rows = np.concatenate([np.concatenate(shared), by_event], axis=1)
    of_totals = ColumnsByPart.of(rows, [3] * len(targets))
    if telemetry is None:
        return Linear(np.concatenate(targets), of_totals, np.ones(rows.shape[1])), added
    # what totals have of their own comes after all that telemetry has
    known = len(telemetry.precision)
    place = np.r_[0:width, known : known + by_event.shape[1]]
    moved = [PartColumns(place[own.places], own.values) for own in of_totals.parts]
    parts = (*moved, *telemetry.columns.parts)
    return Linear(
        np.concatenate([*targets, telemetry.target]),
        ColumnsByPart(parts, known + by_event.shape[1]),
        np.concatenate([telemetry.precision, np.ones(by_event.shape[1])]),
    ), added


def _unexplained(hypothesis: Hypothesis, points: Array) -> Array:
    """Momentum (n, E, 3) of totals rows that the mean thrusts at points (n, d) do not explain."""
    model, term = hypothesis.model, hypothesis.model.totals_rows
    located = model.points(points)
    system, factor = term.at(located).system, term.thrust_factor(located)
    thrust = located.mean_levels_n[:, None] * (1.0 if factor is None else factor)
    return np.asarray((system.target - (system.design @ thrust[..., None])[..., 0])[..., :3])
