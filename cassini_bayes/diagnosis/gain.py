"""What naming a cause gains on events of the momentum balance that were held out.

Leave one event out: its log score given the others is log Z(all) − log Z(others), by Laplace's
approximation. Telemetry's rows are predicted with everything shared fitted to the other events; an
event's own initial momentum comes from its first rows. What a totals row misses by is the balance
of its momentum, r = ΔH − D F − T τ, with thrusts F, inertias and the rest drawn from the posterior
of the others; on-times are the row's own. From which event on a cause acts is told by the others as
well: evidences are sums over beginnings, and an event on whose side of the onset they leave a doubt
is predicted by the mean of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.balance.linearised import Linear
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.case import UNKNOWN, Weighed
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import (
    Hypothesis,
    compact,
    extend,
    none_hypothesis,
    unknown_hypothesis,
)
from cassini_bayes.diagnosis.innovations import linearise
from cassini_bayes.diagnosis.modes import Mode, maximise, mode_near
from cassini_bayes.diagnosis.onsets import without_event
from cassini_bayes.diagnosis.score import LEAST_PIECES, WITHIN, HeldOut
from cassini_bayes.effects.effect import Effect, onsets
from cassini_bayes.model.posterior import collapse
from cassini_bayes.model.thrusts import draw_thrusts
from cassini_bayes.sampling.warmstart import lower_factor

FIRST_SHARE: Final = 0.1
"""Of an event's rows, which give its initial momentum: judgement, enough to average its noise."""
DRAWS: Final = 400  # that predict a totals row: their mean is good to a twentieth of their spread


def held_out(
    events: Events, weighed: Weighed[Hypothesis], rng: np.random.Generator, log: Log = silent
) -> HeldOut | None:
    """Telemetry events or totals rows held out in turn; None for few of them and for a mix.

    ``rng`` is for the posterior draws that predict totals rows.
    """
    if not events.rows and len(events.telemetry) >= LEAST_PIECES:
        return held_out_telemetry(events, weighed, log)
    if not events.telemetry and len(events.rows) >= LEAST_PIECES:
        return held_out_totals(events, weighed, rng, log)
    return None


@dataclass(frozen=True)
class Taught:
    """One way in which a hypothesis begins, by all events but one.

    ``score`` is the log of its prior share times its evidence by these events, ``hypothesis`` and
    ``mode`` are those of its fit to them. ``whole`` is it on all events, ``centre`` (d,) its mode
    there.
    """

    score: float
    hypothesis: Hypothesis
    mode: Mode
    whole: Hypothesis
    centre: Array


def taught(events: Events, weighed: Weighed[Hypothesis], event: str) -> list[Taught]:
    """Every way in which a hypothesis may begin, fitted to the events but one.

    Beginnings that differ only in whether the cause acts in that event share a fit.
    """
    others = events.without(event)
    if not weighed.beginnings:
        hypothesis, mode = fitted_to(others, weighed)
        own = weighed.hypothesis
        return [Taught(mode.log_evidence, hypothesis, mode, own, weighed.mode.point)]
    order = events.in_order
    shares = events.catalogue.odds.of_onsets(len(order))
    fits: dict[int, tuple[Hypothesis, Mode]] = {}
    result = []
    for first, member in without_event(weighed, order, event):
        if id(member) not in fits:
            fits[id(member)] = fitted_to(others, member)
        hypothesis, mode = fits[id(member)]
        whole = member.hypothesis
        if whole.effects[-1].acts_in(event) != (event in order[first:]):
            *before, last = whole.effects
            onset = (None, *onsets(order))[first]
            whole = built(events, member.name, (*before, replace(last, onset=onset)))
        score = mode.log_evidence + float(np.log(shares[first]))
        result.append(Taught(score, hypothesis, mode, whole, member.mode.point))
    return result


def by_all(events: Events, weighed: Weighed[Hypothesis]) -> float:
    """Log evidence by all events, whole curvatures taken where they are not, over beginnings."""
    if not weighed.beginnings:
        mode = weighed.mode
        return mode.log_evidence if mode.is_whole else fitted_to(events, weighed)[1].log_evidence
    order = events.in_order
    shares = dict(zip(("", *order[1:]), events.catalogue.odds.of_onsets(len(order)), strict=True))
    each = [by_all(events, way) + np.log(shares[name]) for name, _, way in weighed.searched]
    return float(logsumexp(each))


def built(events: Events, name: str, effects: Sequence[Effect]) -> Hypothesis:
    """A hypothesis of a name on some events, with some effects."""
    needed = events.with_columns_of(effects)
    full = (unknown_hypothesis if name == UNKNOWN else none_hypothesis)(needed)
    return compact(extend(full, effects) if effects else full)


def fitted_to(events: Events, weighed: Weighed[Hypothesis]) -> tuple[Hypothesis, Mode]:
    """A weighed hypothesis and its mode on other events, such as those with one left out."""
    hypothesis = built(events, weighed.name, weighed.hypothesis.effects)
    density = hypothesis.log_density
    start = carried_over(weighed.mode, weighed.hypothesis, hypothesis)
    point = maximise(density, start.point, start.factor)
    return hypothesis, mode_near(density, point, start.factor)


def carried_over(mode: Mode, old: Hypothesis, new: Hypothesis) -> Mode:
    """A mode in the coordinates of a hypothesis on other events, its new ones at their prior."""
    before = list(old.model.space.names)
    both = [i for i, name in enumerate(new.model.space.names) if name in before]
    places = [before.index(new.model.space.names[i]) for i in both]
    point, factor = np.zeros(new.dimension), np.eye(new.dimension)
    point[both] = mode.point[places]
    factor[np.ix_(both, both)] = lower_factor(mode.factor[places])
    return Mode(point, factor, float("nan"))


def held_out_telemetry(events: Events, weighed: Weighed[Hypothesis], log: Log = silent) -> HeldOut:
    """Every telemetry event held out in turn."""
    whole = by_all(events, weighed)
    known: dict[tuple[str, ...], tuple[Linear, list[Array]]] = {}
    scores, residuals, inside = [], [], []
    for place, event in enumerate(events.telemetry):
        ways = taught(events, weighed, event.id)
        log(f"{weighed.name}: {event.id} held out")
        scores.append(whole - float(logsumexp([way.score for way in ways])))
        predicted = []
        for way in ways:
            begins = tuple(str(effect.onset) for effect in way.whole.effects)
            if begins not in known:
                known[begins] = linearise(way.whole, way.centre)
            linear, factors = known[begins]
            predicted.append((*predicted_rows(linear, place, -way.centre), factors[place]))
        white, spread, factor = averaged(ways, predicted)
        residuals.append((white.reshape(-1, 3) @ factor.T).ravel())
        inside.append(np.abs(white) < WITHIN * spread)
    together = np.concatenate(residuals)
    rmse = float(np.sqrt(together @ together / len(together)))
    return HeldOut(np.array(scores), rmse, float(np.concatenate(inside).mean()))


def averaged(
    ways: Sequence[Taught], predicted: Sequence[tuple[Array, Array, Array]]
) -> tuple[Array, Array, Array]:
    """Residuals (m,) and their deviations, whitened by the likeliest way's factor (3, 3).

    A mixture's mean is that of the means, its variance that of the means more than the mean of the
    variances.
    """
    scores = np.array([way.score for way in ways])
    shares = np.exp(scores - logsumexp(scores))
    factor = predicted[int(shares.argmax())][2]
    means, variances = [], []
    for white, spread, own in predicted:
        turn = np.linalg.solve(factor, own)
        means.append((white.reshape(-1, 3) @ turn.T).ravel())
        variances.append((spread.reshape(-1, 3) ** 2 @ (turn.T**2)).ravel())
    mean = shares @ np.array(means)
    variance = shares @ (np.array(variances) + (np.array(means) - mean) ** 2)
    return mean, np.sqrt(variance), factor


def predicted_rows(linear: Linear, place: int, centre: Array) -> tuple[Array, Array]:
    """Whitened residuals (m,) of a held-out event's rows and their standard deviations.

    ``centre`` is the prior mean of the walked parameters as a departure from the point about which
    the model is linear.
    """
    rows = linear.parts[place]
    first = max(3, int(FIRST_SHARE * linear.rows[place])) * 3
    hidden = slice(rows.start + first, rows.stop)
    used = np.ones(len(linear.target), dtype=bool)
    used[hidden] = False
    columns, target = linear.columns[used], linear.target[used]
    mean = np.zeros(len(linear.precision))
    mean[: len(centre)] = centre
    precision = columns.T @ columns + np.diag(linear.precision)
    fitted = np.linalg.solve(precision, columns.T @ target + linear.precision * mean)
    new = linear.columns[hidden]
    covariance = np.linalg.inv(precision)
    spread = np.sqrt(1.0 + np.einsum("mp,pq,mq->m", new, covariance, new))
    return linear.target[hidden] - new @ fitted, spread


def held_out_totals(
    events: Events, weighed: Weighed[Hypothesis], rng: np.random.Generator, log: Log = silent
) -> HeldOut:
    """Every totals row held out in turn."""
    whole = by_all(events, weighed)
    scores, residuals, inside = [], [], []
    for place, row in enumerate(events.rows):
        log(f"{weighed.name}: {row.id} held out")
        ways = taught(events, weighed, row.id)
        scores.append(whole - float(logsumexp([way.score for way in ways])))
        each = [predicted_balance(w.whole, place, w.hypothesis, w.mode, rng) for w in ways]
        residual, sd, _ = averaged(ways, [(mean, spread, np.eye(3)) for mean, spread in each])
        residuals.append(residual)
        inside.append(np.abs(residual) < WITHIN * sd)
    return HeldOut(
        np.array(scores),
        float(np.sqrt((np.array(residuals) ** 2).mean())),
        float(np.mean(inside)),
    )


def predicted_balance(
    whole: Hypothesis, place: int, others: Hypothesis, mode: Mode, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Mean and standard deviation (3,) about body axes of a row's balance, N m s.

    The mean is over posterior draws of the model fitted to the others; the deviation has theirs,
    the row's own thrust departures, torque and noise.
    """
    z = mode.point + rng.standard_normal((DRAWS, len(mode.point))) @ mode.factor.T
    prior = others.model.thrust_prior
    level = draw_thrusts(prior, collapse(others.model, z).thrusts, rng).level_n
    points, term = whole.model.points(z), whole.model.totals_rows
    system, factor = term.at(points).system, term.thrust_factor(points)
    if factor is not None:
        level = factor[:, place] * level
    design = system.design[:, place, :3]
    residual = system.target[:, place, :3] - (design @ level[..., None])[..., 0]
    noise = system.covariance[:, place, :3, :3] + system.torque_covariance[place, :3, :3]
    thrusts = design @ prior.departures
    spread = np.einsum("nii->ni", noise) + (thrusts**2).sum(-1)
    return residual.mean(0), np.sqrt(residual.var(0) + spread.mean(0))
