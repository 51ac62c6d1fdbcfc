"""What a set of events can see, before anything is sampled.

At the prior means the model is linearised: a parameter's effect on the balance of every row is a
combination of the same columns that the likelihood has, so the expected information of all
parameters, thrusts, torques and momenta together comes from the Gram matrices alone. With the
priors (standard normal coordinates) it gives the expected posterior width over the prior's; the
data's own part gives the singular values, the signal over noise of every direction per prior width.
Noise levels act on the scatter of the rows, not on their mean, and have no place here.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.model.posterior import Model
from cassini_bayes.model.terms import STEP, Points, Term, slopes_of
from cassini_bayes.model.thrusts import ThrustPrior
from cassini_bayes.model.unknowns import Unknowns
from cassini_bayes.spacecraft.parameters import EFFECT_BLOCK

LIMITS: Final = (0.3, 0.7, 0.95)
"""Posterior over prior width, from which on quantities are called by the next verdict. Judgement of
where to cut: at 0.3 data weigh ten times as much as the prior, at 0.7 as much, at 0.95 0.1."""
TOGETHER: Final = 0.9  # correlation from which on two quantities are called tied together
NOISE_BLOCK: Final = "noise"
UNCONSTRAINED: Final = "not seen"
QUANTITY: Final = ("quantity", "block", "unit", "prior_sd", "expected_sd", "ratio")
VERDICTS: Final = ("seen well", "seen", "hardly seen", UNCONSTRAINED)


@dataclass(frozen=True)
class Observability:
    """Expected widths per quantity, singular values of all directions, and the same in words.

    ``table``: quantity, unit, prior_sd, expected_sd, ratio (expected posterior over prior width),
    verdict. ``together`` are pairs of quantities that the data tie to one combination.
    """

    table: pd.DataFrame
    singular_values: Array
    together: tuple[tuple[str, str, float], ...]
    sentences: tuple[str, ...]

    @property
    def unseen_effects(self) -> tuple[str, ...]:
        """In words: parameters of effects about which the events have no information."""
        of_effects = self.table["block"] == EFFECT_BLOCK
        unseen = self.table[of_effects & (self.table["verdict"] == UNCONSTRAINED)]["quantity"]
        return tuple(
            f"These events cannot see {name}: its posterior is its prior." for name in unseen
        )


def observability(model: Model) -> Observability:
    """Expected posterior over prior widths in a model, from Gram matrices and totals rows alone."""
    unknowns = model.unknowns
    information = _information(model, unknowns)
    covariance = np.asarray(np.linalg.inv(information + np.eye(unknowns.size)), dtype=np.float64)
    expected = _expected(model, unknowns, covariance)
    table = _quantities(model, unknowns, covariance, every_event=True)
    table["verdict"] = [VERDICTS[bisect_right(LIMITS, ratio)] for ratio in table["ratio"]]
    asked = _asked(model, unknowns)
    singular = np.sqrt(np.maximum(np.linalg.eigvalsh(_marginal(information, asked)), 0.0))[::-1]
    together = _together(model.space.names, expected)
    return Observability(table, singular, together, _sentences(table, singular, together))


def event_worth(model: Model) -> pd.DataFrame:
    """What each event is worth: how much wider every shared quantity would be without it.

    The same linearisation as :func:`observability`, the event's information taken out. One row per
    event and quantity (thrust levels; walked parameters but the noise levels): ``narrowing`` =
    1 − sd with all events / sd without this one. Nothing is eliminated event by event beforehand:
    of slews, that would cancel most digits.
    """
    unknowns = model.unknowns
    parts = list(_parts(model, unknowns))
    total = np.eye(unknowns.size)
    for _, places, part in parts:
        total[np.ix_(places, places)] += part
    everything = _quantities(model, unknowns, np.asarray(np.linalg.inv(total)))
    named = everything[["quantity", "block", "unit"]]
    tables = []
    for place, places, part in parts:
        rest = total.copy()
        rest[np.ix_(places, places)] -= part
        without = _quantities(model, unknowns, np.asarray(np.linalg.inv(rest)))
        narrowing = 1.0 - everything["expected_sd"] / without["expected_sd"]
        tables.append(named.assign(event=model.events[place].id, narrowing=narrowing))
    return pd.concat(tables, ignore_index=True)


def _expected(model: Model, unknowns: Unknowns, covariance: Array) -> Array:
    """Expected covariance (d, d) of the walked parameters' standard coordinates."""
    factor = model.space.correlation_factor
    return np.asarray(factor @ covariance[unknowns.walked, unknowns.walked] @ factor.T)


def _quantities(
    model: Model, unknowns: Unknowns, covariance: Array, *, every_event: bool = False
) -> pd.DataFrame:
    """Thrust levels, thrusts of every event that fires if asked for, walked parameters."""
    stop = unknowns.levels.stop
    cases = []
    if model.fires:
        levels = np.concatenate([_level_slopes(model), model.thrust_prior.shared], axis=1)
        cases.append(("all events", slice(stop, stop), levels))
    if every_event:
        cases += _thrusts_of_events(model, unknowns)
    thrusts = _thrust_rows(model, unknowns, covariance, cases)
    walked = _walked_rows(model, _expected(model, unknowns, covariance))
    return pd.DataFrame([*thrusts, *walked], columns=QUANTITY)


def _information(model: Model, unknowns: Unknowns) -> Array:
    """Expected information (size, size) of the data on all standardised unknowns."""
    information = np.zeros((unknowns.size, unknowns.size))
    for _, places, part in _parts(model, unknowns):
        information[np.ix_(places, places)] += part
    return information


def _parts(model: Model, unknowns: Unknowns) -> Iterator[tuple[int, Places, Array]]:
    """Event, the places of the unknowns it acts on, and its expected information on them."""
    points = model.points(_steps(model))
    slopes = _level_slopes(model)
    for term, events in zip(model.terms, model.events_of_term, strict=True):
        own = _effect_slopes(model, term, points)
        for event, part in term.at(points).expected_information(events.start):
            if model.events[event].fires:
                if slopes.size:
                    part = _with_levels(part, slopes, model.thrust_prior)
                if own is not None:
                    factor, each = own
                    place = event - events.start
                    prior = model.thrust_prior.scaled(factor[place])
                    part = _with_levels(part, each[place], prior)
            yield event, unknowns.of_event(event), part


def _steps(model: Model) -> Array:
    """The prior means, then a step up and a step down in every walked coordinate."""
    steps = STEP * np.eye(model.space.dimension)
    return np.concatenate([np.zeros((1, len(steps))), steps, -steps])


def _level_slopes(model: Model) -> Array:
    """Change (K, d) of the mean thrust levels with what is walked; (K, 0) where there is none."""
    prior = model.thrust_prior
    if prior.chained is None and not prior.common_is_walked:
        return np.zeros((len(prior.shared), 0))
    points = model.points(_steps(model))
    offset = prior.offset_at(points.parameters, points.common_n)
    levels = points.common_n[:, None] + (np.zeros(len(prior.shared)) if offset is None else offset)
    return slopes_of(levels).T


def _effect_slopes(model: Model, term: Term, points: Points) -> tuple[Array, Array] | None:
    """Factors (E, K) of effects on levels in a term's events, and the means' slopes (E, K, d).

    None without such effects; ``points`` are those of :func:`_steps`.
    """
    factor = term.thrust_factor(points)
    if factor is None or not factor.shape[1]:
        return None
    prior = model.thrust_prior
    mean = prior.mean_at(points.parameters, points.common_n)[0]
    return factor[0], np.asarray(mean[:, None] * np.moveaxis(slopes_of(factor), 0, -1))


def _with_levels(information: Array, slopes: Array, prior: ThrustPrior) -> Array:
    """An event's information with mean levels that follow what is walked.

    A term's own takes them as constant: a step of the mean is a step of levels and departures.
    """
    d, factor = slopes.shape[1], np.concatenate([prior.shared, prior.departures], axis=1)
    move = np.eye(len(information))
    move[d : d + factor.shape[1], :d] = np.linalg.pinv(factor) @ slopes
    return np.asarray(move.T @ information @ move)


def _asked(model: Model, unknowns: Unknowns) -> Places:
    """Places of what is asked for: walked parameters but the noise levels, shared thrust levels."""
    walked = [i for i, block in enumerate(model.space.blocks) if block != NOISE_BLOCK]
    return np.array([*walked, *range(unknowns.levels.start, unknowns.levels.stop)], dtype=np.intp)


def _marginal(information: Array, asked: Places) -> Array:
    """The data's information on some unknowns, the others integrated out under their priors."""
    others = np.setdiff1d(np.arange(len(information)), asked)
    kept = information[np.ix_(asked, asked)]
    if len(others) == 0:
        return kept
    across = information[np.ix_(asked, others)]
    inner = information[np.ix_(others, others)] + np.eye(len(others))
    return np.asarray(kept - across @ np.linalg.solve(inner, across.T))


def _walked_rows(model: Model, expected: Array) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    before = np.linalg.norm(model.space.correlation_factor, axis=1)
    for i, name in enumerate(model.space.names):
        if model.space.blocks[i] == NOISE_BLOCK:
            continue
        prior = float(model.space.distributions[i].sd() * before[i])
        ratio = float(np.sqrt(expected[i, i]) / before[i])
        rows.append(_row(name, model.space.blocks[i], model.specs[name].unit, prior, ratio))
    return rows


def _thrusts_of_events(model: Model, unknowns: Unknowns) -> Iterator[tuple[str, slice, Array]]:
    """Each event that fires, the places of its departures, and its thrusts' design.

    Thrusts are those that acted, as in the fit's summary: f · level + departure, where effects act
    with factors f, uncertain themselves.
    """
    points = model.points(_steps(model))
    prior, slopes = model.thrust_prior, _level_slopes(model)
    for term, events in zip(model.terms, model.events_of_term, strict=True):
        own = _effect_slopes(model, term, points)
        for place in range(events.start, events.stop):
            by_walked, shared = slopes, prior.shared
            if not model.events[place].fires:
                continue
            if own is not None:
                factor, each = (of_term[place - events.start] for of_term in own)
                by_walked = each + factor[:, None] * slopes if slopes.size else each
                shared = factor[:, None] * shared
            design = np.concatenate([by_walked, shared, prior.departures], axis=1)
            yield model.events[place].id, unknowns.events[place].departures, design


def _thrust_rows(
    model: Model,
    unknowns: Unknowns,
    covariance: Array,
    cases: Sequence[tuple[str, slice, Array]],
) -> list[dict[str, object]]:
    """Thrust of every thruster in each case: its name, places of its departures, its design.

    A design (K, ·) is by walked coordinates (or by none), shared levels and departures.
    """
    rows: list[dict[str, object]] = []
    for event, departures, design in cases:
        linear = np.r_[unknowns.levels, departures]
        index = np.r_[: design.shape[1] - len(linear), linear]
        after = np.einsum("kq,qr,kr->k", design, covariance[np.ix_(index, index)], design)
        before = (design**2).sum(1)
        for k, thruster in enumerate(model.thrusters):
            if before[k] > 0:
                ratio = float(np.sqrt(after[k] / before[k]))
                label = f"thrust[{event},{thruster}]"
                rows.append(_row(label, "thrust", "N", float(np.sqrt(before[k])), ratio))
    return rows


def _row(name: str, block: str, unit: str, prior: float, ratio: float) -> dict[str, object]:
    return dict(zip(QUANTITY, (name, block, unit, prior, prior * ratio, ratio), strict=True))


def _together(names: Sequence[str], covariance: Array) -> tuple[tuple[str, str, float], ...]:
    """Pairs of walked parameters whose expected posterior correlation is strong."""
    width = np.sqrt(np.diagonal(covariance))
    result = []
    for i, first in enumerate(names):
        for j in range(i):
            correlation = float(covariance[i, j] / (width[i] * width[j]))
            if abs(correlation) > TOGETHER:
                result.append((names[j], first, correlation))
    return tuple(sorted(result, key=lambda pair: -abs(pair[2])))


def _sentences(
    table: pd.DataFrame, singular: Array, together: tuple[tuple[str, str, float], ...]
) -> tuple[str, ...]:
    """The result in words: directions, then thrusts, inertia and nuisances by verdict."""
    if not singular.size:
        return ("Thrust levels, inertia and all nuisances but noise are fixed: nothing to see.",)
    told = int((singular > 1.0).sum())
    said = [
        f"Expected before sampling: of {len(singular)} directions among thrust levels, inertia and "
        f"nuisances these events tell {told} better than the priors do (singular values "
        f"{singular[0]:.3g} to {singular[-1]:.2g}; 1 is as good as the prior)."
    ]
    levels = table[table["quantity"].str.startswith("thrust[all events")]
    others = ["thrust", "inertia", EFFECT_BLOCK]
    for name, rows in (
        ("thrust levels", levels),
        ("inertia", table[table["block"] == "inertia"]),
        ("nuisances", table[~table["block"].isin(others)]),
        ("effects", table[table["block"] == EFFECT_BLOCK]),
    ):
        if rows.empty:
            continue
        parts = []
        for verdict in VERDICTS:
            members = rows[rows["verdict"] == verdict]["quantity"]
            if len(members):
                labels = [str(m).removeprefix("thrust[all events,").rstrip("]") for m in members]
                parts.append(f"{verdict}: {', '.join(labels)}")
        said.append(f"{name[0].upper()}{name[1:]} – {'; '.join(parts)}.")
    said += [
        f"{', '.join(group)} are tied together (pairwise |r| > {TOGETHER}): the data tell their "
        "combination far better than each alone."
        for group in _groups(together)
    ]
    return tuple(said)


def _groups(together: tuple[tuple[str, str, float], ...]) -> list[list[str]]:
    """Quantities that are connected by strong correlations, each group once."""
    groups: list[list[str]] = []
    for first, second, _ in together:
        touched = [group for group in groups if first in group or second in group]
        merged = list(
            dict.fromkeys([*(name for group in touched for name in group), first, second])
        )
        groups = [group for group in groups if group not in touched] + [merged]
    return groups
