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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.balance.linearised import Linear
from cassini_bayes.balance.part_columns import ColumnsByPart, PartColumns
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.case import UNKNOWN, Fits, Weighed
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import (
    Hypothesis,
    compact,
    extend,
    none_hypothesis,
    unknown_hypothesis,
)
from cassini_bayes.diagnosis.innovations import linearise
from cassini_bayes.diagnosis.modes import Mode, mode_from
from cassini_bayes.diagnosis.onsets import without_event
from cassini_bayes.diagnosis.rows_and_turns import with_torque_noise
from cassini_bayes.diagnosis.score import LEAST_PIECES, WITHIN, HeldOut
from cassini_bayes.effects.effect import Effect, onsets, settled_for
from cassini_bayes.model.posterior import collapse, of_events
from cassini_bayes.model.thrusts import draw_thrusts
from cassini_bayes.sampling.warmstart import lower_factor

FIRST_SHARE: Final = 0.1
"""Of an event's rows, which give its initial momentum: judgement, enough to average its noise."""
DRAWS: Final = 400  # that predict a totals row: their mean is good to a twentieth of their spread


def fits_to_hold_out(
    events: Events, weighed: Weighed[Hypothesis], log: Log = silent
) -> list[Callable[[], Fits]]:
    """Pieces of work whose results :func:`held_out` takes: fits to all events, and without each.

    They are nearly all that it costs, and none depends on another. None for few events and for a
    mix of telemetry and totals, of which nothing is held out.
    """
    if (events.rows and events.telemetry) or len(events.ids) < LEAST_PIECES:
        return []

    def without(event: str) -> Fits:
        fits = fits_without(events, weighed, event)
        log(f"{weighed.name}: {event} held out")
        return fits

    return [
        partial(fits_to_all, events, weighed),
        *(partial(without, event) for event in longest_first(events)),
    ]


def longest_first(events: Events) -> list[str]:
    """Ids of events, in the order in which fits without them are worked out.

    Without an event of many rows the mode moves far, and the fit takes long.
    """
    rows = {event.id: len(event.usable_rows.time_s) for event in events.telemetry}
    return sorted(events.ids, key=lambda name: -rows.get(name, 1))


def held_out(
    events: Events,
    weighed: Weighed[Hypothesis],
    rng: np.random.Generator,
    fits: Sequence[Fits],
) -> HeldOut | None:
    """Telemetry events or totals rows held out in turn; None where there are no fits.

    ``fits`` are the results of :func:`fits_to_hold_out`, ``rng`` is for the posterior draws that
    predict totals rows.
    """
    if not fits:
        return None
    if events.telemetry:
        return held_out_telemetry(events, weighed, fits)
    return held_out_totals(events, weighed, rng, fits)


def _by_event(events: Events, fits: Sequence[Fits]) -> dict[str, Fits]:
    """Fits without an event, by its id, from the results of :func:`fits_to_hold_out`."""
    return dict(zip(longest_first(events), fits[1:], strict=True))


@dataclass(frozen=True)
class Taught:
    """One way in which a hypothesis begins, by all events but one.

    ``score`` is the log of its prior share times its evidence by these events, ``mode`` that of its
    fit to them. ``member`` is what was fitted, with its mode on all events, ``whole`` the
    hypothesis on all events.
    """

    score: float
    mode: Mode
    member: Weighed[Hypothesis]
    whole: Hypothesis


def taught(events: Events, weighed: Weighed[Hypothesis], event: str, fits: Fits) -> list[Taught]:
    """Every way in which a hypothesis may begin, by its fits to the events but one."""
    if not weighed.beginnings:
        (mode,) = fits
        return [Taught(mode.log_evidence, mode, weighed, weighed.hypothesis)]
    ways, order = ways_without(events, weighed, event), events.in_order
    modes = dict(zip(dict.fromkeys(id(member) for _, member in ways), fits, strict=True))
    shares = events.catalogue.odds.of_onsets(len(order))
    result = []
    for first, member in ways:
        mode, whole = modes[id(member)], member.hypothesis
        if whole.effects[-1].acts_in(event) != (event in order[first:]):
            *before, last = whole.effects
            onset = (None, *onsets(order))[first]
            whole = built(events, member.name, (*before, replace(last, onset=onset)))
        score = mode.log_evidence + float(np.log(shares[first]))
        result.append(Taught(score, mode, member, whole))
    return result


def ways_without(
    events: Events, weighed: Weighed[Hypothesis], event: str
) -> list[tuple[int, Weighed[Hypothesis]]]:
    """Ways in which a hypothesis may begin by all events but one (:func:`without_event`)."""
    if not weighed.beginnings:
        return [(0, weighed)]
    return without_event(weighed, events.in_order, event)


def fits_without(events: Events, weighed: Weighed[Hypothesis], event: str) -> Fits:
    """Modes by the events but one, of every way in which a hypothesis may begin by these.

    Beginnings that differ only in whether the cause acts in that event share one.
    """
    members = {id(member): member for _, member in ways_without(events, weighed, event)}
    others = events.without(event)
    return tuple(fitted_to(others, member) for member in members.values())


def fits_to_all(events: Events, weighed: Weighed[Hypothesis]) -> Fits:
    """Modes by all events, whole curvatures taken where they are not, of every beginning."""
    ways = [way for _, _, way in weighed.searched] if weighed.beginnings else [weighed]
    return tuple(way.mode if way.mode.is_whole else fitted_to(events, way) for way in ways)


def by_all(events: Events, weighed: Weighed[Hypothesis], fits: Fits) -> float:
    """Log evidence by all events, summed over beginnings, from :func:`fits_to_all`."""
    if not weighed.beginnings:
        (mode,) = fits
        return mode.log_evidence
    order = events.in_order
    shares = dict(zip(("", *order[1:]), events.catalogue.odds.of_onsets(len(order)), strict=True))
    begins = [name for name, _, _ in weighed.searched]
    each = [m.log_evidence + np.log(shares[name]) for name, m in zip(begins, fits, strict=True)]
    return float(logsumexp(each))


def built(events: Events, name: str, effects: Sequence[Effect]) -> Hypothesis:
    """A hypothesis of a name on some events, with some effects."""
    needed = events.with_columns_of(effects)
    full = (unknown_hypothesis if name == UNKNOWN else none_hypothesis)(needed)
    return compact(extend(full, effects) if effects else full)


def on_events(events: Events, weighed: Weighed[Hypothesis]) -> Hypothesis:
    """A weighed hypothesis on some of its events, such as all but one.

    What is prepared of an event, such as its thrusts to some percent, stays what all events say:
    scores compare the same model on more and on fewer events. Made anew where the others need
    another model.
    """
    own = weighed.hypothesis
    model = of_events(own.model, events.ids)
    if model is None:
        return built(events, weighed.name, own.effects)
    return replace(own, model=model)


def fitted_to(events: Events, weighed: Weighed[Hypothesis]) -> Mode:
    """The mode of a weighed hypothesis on other events (:func:`on_events`)."""
    hypothesis = on_events(events, weighed)
    start = carried_over(weighed.mode, weighed.hypothesis, hypothesis)
    return mode_from(hypothesis.log_density, start)


def carried_over(mode: Mode, old: Hypothesis, new: Hypothesis) -> Mode:
    """A mode in the coordinates of a hypothesis on other events, its new ones at their prior."""
    before = list(old.model.space.names)
    both = [i for i, name in enumerate(new.model.space.names) if name in before]
    places = [before.index(new.model.space.names[i]) for i in both]
    point, factor = np.zeros(new.dimension), np.eye(new.dimension)
    point[both] = mode.point[places]
    factor[np.ix_(both, both)] = lower_factor(mode.factor[places])
    return Mode(point, factor, float("nan"))


def held_out_telemetry(
    events: Events, weighed: Weighed[Hypothesis], fits: Sequence[Fits]
) -> HeldOut:
    """Every telemetry event held out in turn, by the results of :func:`fits_to_hold_out`.

    A search before the fits has seen all events: what it took from one alone is paid for.
    """
    whole, without = by_all(events, weighed, fits[0]), _by_event(events, fits)
    known: dict[tuple[int, tuple[str, ...]], tuple[Linear, list[Array]]] = {}
    searched = settled_for(weighed.hypothesis.effects)
    scores, residuals, inside = [], [], []
    for place, event in enumerate(events.telemetry):
        ways = taught(events, weighed, event.id, without[event.id])
        learnt = sum(result.log_start_of(event.samples) for result in searched)
        scores.append(whole - float(logsumexp([way.score for way in ways])) - learnt)
        predicted = []
        for way in ways:
            begins = tuple(str(effect.onset) for effect in way.whole.effects)
            # one beginning may be taught by several members, each linear about its own mode
            own, centre = (id(way.member), begins), way.member.mode.point
            if own not in known:
                rows, factors = linearise(way.whole, centre)
                known[own] = with_torque_noise(way.whole, centre, rows, factors), factors
            linear, factors = known[own]
            predicted.append((*predicted_rows(linear, place, -centre), factors[place]))
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
    own, parts = linear.columns.parts[place], list(linear.columns.parts)
    parts[place] = PartColumns(own.places, own.values[:first])
    used = np.concatenate([linear.target[: hidden.start], linear.target[hidden.stop :]])
    known = Linear(used, ColumnsByPart(tuple(parts), linear.columns.width), linear.precision)
    mean = np.zeros(len(linear.precision))
    mean[: len(centre)] = centre
    precision = known.gram()
    fitted = np.linalg.solve(precision, known.columns.along(used) + linear.precision * mean)
    new, places = own.values[first:], own.places
    covariance = np.linalg.inv(precision)[np.ix_(places, places)]
    spread = np.sqrt(1.0 + np.einsum("mp,mp->m", new @ covariance, new))
    return linear.target[hidden] - new @ fitted[places], spread


def held_out_totals(
    events: Events,
    weighed: Weighed[Hypothesis],
    rng: np.random.Generator,
    fits: Sequence[Fits],
) -> HeldOut:
    """Every totals row held out in turn, by the results of :func:`fits_to_hold_out`."""
    whole, without = by_all(events, weighed, fits[0]), _by_event(events, fits)
    scores, residuals, inside = [], [], []
    for place, row in enumerate(events.rows):
        ways = taught(events, weighed, row.id, without[row.id])
        scores.append(whole - float(logsumexp([way.score for way in ways])))
        others = events.without(row.id)
        each = [
            predicted_balance(way.whole, place, on_events(others, way.member), way.mode, rng)
            for way in ways
        ]
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
    points, term = whole.model.points(_in_whole(z, others, whole, rng)), whole.model.totals_rows
    system, factor = term.at(points).system, term.thrust_factor(points)
    if factor is not None:
        level = factor[:, place] * level
    design = system.design[:, place, :3]
    residual = system.target[:, place, :3] - (design @ level[..., None])[..., 0]
    noise = system.covariance[:, place, :3, :3] + system.torque_covariance[place, :3, :3]
    thrusts = design @ prior.departures
    spread = np.einsum("nii->ni", noise) + (thrusts**2).sum(-1)
    return residual.mean(0), np.sqrt(residual.var(0) + spread.mean(0))


def _in_whole(z: Array, others: Hypothesis, whole: Hypothesis, rng: np.random.Generator) -> Array:
    """Draws (n, d) of the others' model in the whole one's coordinates (n, d').

    What the row that is held out brings alone, as the noise of the only ΔV, has its prior.
    """
    known, names = list(others.model.space.names), whole.model.space.names
    if tuple(known) == tuple(names):
        return z
    result = rng.standard_normal((len(z), len(names)))
    both = [place for place, name in enumerate(names) if name in known]
    result[:, both] = z[:, [known.index(names[place]) for place in both]]
    return result
