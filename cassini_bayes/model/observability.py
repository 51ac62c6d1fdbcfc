"""What a set of events can see, before anything is sampled.

At the prior means the model is linearised: a parameter's effect on the balance of every row is a
combination of the same columns that the likelihood has, so the expected information of all
parameters, thrusts, torques and momenta together comes from the Gram matrices alone. With the
priors (standard normal coordinates) it gives the expected posterior width over the prior's; the
data's own part gives the singular values, the signal over noise of every direction per prior width.
Noise levels act on the scatter of the rows, not on their mean, and have no place here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes.balance.bands import Band
from cassini_bayes.balance.measured_delta_v import DeltaVStatistics, on_time_weights
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.telemetry_terms import (
    INITIAL_SD_N_M_S,
    TelemetryTerms,
    balance_weights,
    cut_tail_sd,
    noise_covariance,
)
from cassini_bayes.balance.totals_terms import RAD_S_PER_RPM
from cassini_bayes.model.posterior import Model, full_parameters, physics_at, system_of
from cassini_bayes.model.totals import TotalsTerm, linear_system
from cassini_bayes.spacecraft import thruster_directions

Array = NDArray[np.float64]
STEP: Final = 0.05  # in prior standard deviations
SEEN_WELL: Final = 0.3
SEEN: Final = 0.7
HARDLY: Final = 0.95
TOGETHER: Final = 0.9
NOISE_BLOCK: Final = "noise"


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


@dataclass(frozen=True)
class _Coordinates:
    """Places of the standardised unknowns: walked, shared thrust levels, each event's own."""

    walked: int
    shared: int
    fires: tuple[bool, ...]  # per event of the model
    own: tuple[slice, ...]  # per event: departures of thrust, none where their priors are fixed
    extra: tuple[slice, ...]  # per event: torque, and for telemetry initial momentum and tails
    size: int


def observability(model: Model) -> Observability:
    """Expected posterior over prior widths in a joint model, from its Gram matrices alone."""
    places = _coordinates(model)
    information = _information(model, places)
    covariance = np.asarray(np.linalg.inv(information + np.eye(places.size)), dtype=np.float64)
    walked = _walked_rows(model, covariance)
    thrusts = _thrust_rows(model, places, covariance)
    table = pd.DataFrame([*thrusts, *walked])
    table["verdict"] = [_verdict(float(ratio)) for ratio in table["ratio"]]
    asked = _asked(model, places)
    singular = np.sqrt(np.maximum(np.linalg.eigvalsh(_marginal(information, asked)), 0.0))[::-1]
    together = _together(model, covariance)
    return Observability(table, singular, together, _sentences(table, singular, together))


def _coordinates(model: Model) -> _Coordinates:
    at = model.space.dimension
    shared, p = model.thrust_prior.shared.shape[1], model.thrust_prior.own.shape[1]
    at += shared
    fired = set(model.fired_ids)
    own, extra = [], []
    first = len(model.event_ids) - len(model.telemetry)
    for i, name in enumerate(model.event_ids):
        width = p if name in fired else 0
        own.append(slice(at, at + width))
        at += width
        more = 3 if i < first else 6 + len(model.telemetry[i - first].pattern.cuts)
        extra.append(slice(at, at + more))
        at += more
    fires = tuple(name in fired for name in model.event_ids)
    return _Coordinates(model.space.dimension, shared, fires, tuple(own), tuple(extra), at)


def _information(model: Model, places: _Coordinates) -> Array:
    """Expected information (size, size) of the data on all standardised unknowns."""
    information = np.zeros((places.size, places.size))
    d = model.space.dimension
    steps = np.concatenate([np.zeros((1, d)), STEP * np.eye(d), -STEP * np.eye(d)])
    full = full_parameters(model, steps)
    first = len(model.event_ids) - len(model.telemetry)
    if model.totals is not None:
        for i, (index, part) in enumerate(_totals_parts(model, model.totals, full, places)):
            assert i < first
            information[np.ix_(index, index)] += part
    physics = physics_at(model, full) if model.telemetry else None
    for place, terms in enumerate(model.telemetry, start=first):
        assert physics is not None  # there is telemetry
        index = _index(places, place)
        system = system_of(model, terms, physics, full)
        nominal = {name: values[:1] for name, values in full.items()}
        bands = zip(
            (terms.slow, *terms.fast), (None, *terms.reduced.grams), system.kept[0], strict=True
        )
        for band, gram, estimate in bands:
            kept = estimate[None]
            weights = balance_weights(terms, physics, model.thrust_prior.common_mean_n, kept)
            columns = _columns(model, terms, weights)
            noise = noise_covariance(terms, physics, full, kept)[0]
            information[np.ix_(index, index)] += _whitened(
                terms, band, gram, columns, noise, nominal
            )
        for own in model.delta_v:
            if own.event_id == terms.id:
                index, part = _delta_v_part(model, own, physics, full, places, place)
                information[np.ix_(index, index)] += part
    return information


def _delta_v_part(
    model: Model,
    statistics: DeltaVStatistics,
    physics: Physics,
    full: Mapping[str, Array],
    places: _Coordinates,
    event: int,
) -> tuple[NDArray[np.int64], Array]:
    """Information of a burn's velocity change on the walked parameters and its thrusts.

    The offset of each axis is eliminated with the Gram matrix of the centred columns.
    """
    d = model.space.dimension
    directions = thruster_directions(model.spacecraft, model.branch)
    n, k = len(full["mass_kg"]), directions.shape[1]
    per_newton = on_time_weights(statistics, physics, n, k) / full["mass_kg"][:, None, None]
    each = directions.T[None, :, :, None] * per_newton[:, :, None, :]  # (n, K, 3, 4 K)
    total = model.thrust_prior.common_mean_n * each.sum(1)
    walked = (total[1 : d + 1] - total[d + 1 :]) / (2.0 * STEP)
    levels = np.einsum("kca,kq->qca", each[0], model.thrust_prior.shared)
    own = np.einsum("kca,kq->qca", each[0], model.thrust_prior.own)
    columns = np.concatenate([walked, levels, own])
    gram, one = statistics.gram[:-1, :-1], statistics.gram[:-1, -1]
    centred = gram - np.outer(one, one) / statistics.rows
    noise = full["delta_v_noise_m_s"][0] ** 2 + full["delta_v_resolution_m_s"][0] ** 2 / 12.0
    index = _index(places, event)[: len(columns)]
    return index, np.einsum("uca,ab,vcb->uv", columns, centred, columns, optimize=True) / noise


def _index(places: _Coordinates, event: int) -> NDArray[np.int64]:
    """Places of an event's unknowns: walked, shared levels, own departures, its extra ones."""
    own, extra = places.own[event], places.extra[event]
    shared = range(places.walked, places.walked + places.shared * places.fires[event])
    return np.array(
        [
            *range(places.walked),
            *shared,
            *range(own.start, own.stop),
            *range(extra.start, extra.stop),
        ],
        dtype=np.int64,
    )


def _columns(model: Model, terms: TelemetryTerms, weights: Array) -> Array:
    """Coefficients (unknown, 3, A) of the derivative of the residual in all standardised unknowns.

    weights (1 + 2d, B, 3): at the prior mean, then one step up and one down per parameter.
    """
    pattern, reduced = terms.pattern, terms.reduced
    owner = np.repeat(np.arange(len(pattern.start) - 1), np.diff(pattern.start))
    k, last = pattern.thrusters, len(pattern.start) - 2
    by_owner = np.zeros((len(weights), last + 1, 3, reduced.slow.shape[1]))
    for b, column in zip(reduced.entries, reduced.row, strict=True):
        by_owner[:, owner[b], :, column] += weights[:, b]
    nominal = np.zeros(last + 1)
    nominal[:k] = -model.thrust_prior.common_mean_n
    nominal[k : k + 3] = -terms.initial_mean_n_m_s
    nominal[k + 3 : k + 6] = -model.torque_mean_n_m
    nominal[last] = 1.0
    residual = np.einsum("nuca,u->nca", by_owner, nominal)
    d = (len(weights) - 1) // 2
    walked = (residual[1 : d + 1] - residual[d + 1 :]) / (2.0 * STEP)
    thrust = -by_owner[0, :k]
    sd = np.concatenate([np.full(3, INITIAL_SD_N_M_S), model.torque_sd_n_m])
    tails = cut_tail_sd(terms)
    own = -by_owner[0, k:last] * np.concatenate([sd, tails])[:, None, None]
    parts = [walked]
    if k:
        parts.append(np.einsum("kca,kq->qca", thrust, model.thrust_prior.shared))
        parts.append(np.einsum("kca,kq->qca", thrust, model.thrust_prior.own))
    return np.concatenate([*parts, own])


def _whitened(
    terms: TelemetryTerms,
    band: Band,
    gram: Array | None,
    columns: Array,
    noise: Array,
    nominal: Mapping[str, Array],
) -> Array:
    """Inner products of the derivatives over one band's rows, white and torque noise whitened."""
    values, vectors = np.linalg.eigh(noise)
    count, size = len(columns), terms.reduced.slow.shape[1]
    variance = values[:, None] + nominal["torque_noise_n_m_s05"][0] ** 2 * band.walk  # (3, R)
    modes = terms.reduced.slow.reshape(3 * size, -1)
    quiet = _channel_noise(terms, band, nominal)
    result = np.zeros((count, count))
    for own, axis in zip(variance, vectors.T, strict=True):
        along = (axis[:, None] * columns).reshape(count, -1)
        if gram is None:
            seen = along @ modes
            result += (seen / own) @ seen.T
        else:
            flat = gram.transpose(0, 2, 1, 3).reshape(3 * size, 3 * size)
            result += along @ flat @ along.T / own.mean()
        scalar = np.einsum("a,uac->uc", axis, columns)
        result -= (scalar * quiet) @ scalar.T / own.mean()
    return result


def _channel_noise(terms: TelemetryTerms, band: Band, nominal: Mapping[str, Array]) -> Array:
    """Square (A,) that the channels' own noise adds to each scalar column over a band's rows.

    Noise that drives a regressor tells nothing; the likelihood's Jacobian sees to the same.
    """
    layout = terms.statistics.layout
    used = terms.reduced.columns
    square = np.zeros(len(used))
    square[(used >= layout.rate.start) & (used < layout.rate.stop)] = (
        nominal["rate_noise_rad_s"][0] ** 2
    )
    square[(used >= layout.wheel.start) & (used < layout.wheel.stop)] = (
        nominal["wheel_noise_rpm"][0] * RAD_S_PER_RPM
    ) ** 2
    return band.rows * square


def _totals_parts(
    model: Model, totals: TotalsTerm, full: Mapping[str, Array], places: _Coordinates
) -> list[tuple[NDArray[np.int64], Array]]:
    """Information of every totals row: its balance, whitened, against all its unknowns."""
    system = linear_system(totals, full)
    linear = model.thrust_prior
    d = (len(system.common_n) - 1) // 2
    at_common = system.target - linear.common_mean_n * system.design.sum(-1)
    walked = -(at_common[1 : d + 1] - at_common[d + 1 :]) / (2.0 * STEP)
    found = []
    for i in range(len(totals.stack.event_ids)):
        design = system.design[0, i]
        torque = system.torque_design[i] * linear.torque_sd_n_m
        columns = np.concatenate(
            [walked[:, i].T, design @ linear.shared, design @ linear.own, torque], axis=1
        )
        white = np.linalg.solve(np.linalg.cholesky(system.covariance[0, i]), columns)
        found.append((_index(places, i), white.T @ white))
    return found


def _asked(model: Model, places: _Coordinates) -> NDArray[np.int64]:
    """Places of what is asked for: walked parameters but the noise levels, shared thrust levels."""
    walked = [i for i, block in enumerate(model.space.blocks) if block != NOISE_BLOCK]
    return np.array([*walked, *range(places.walked, places.walked + places.shared)])


def _marginal(information: Array, asked: NDArray[np.int64]) -> Array:
    """The data's information on some unknowns, the others integrated out under their priors."""
    others = np.setdiff1d(np.arange(len(information)), asked)
    kept = information[np.ix_(asked, asked)]
    if len(others) == 0:
        return kept
    across = information[np.ix_(asked, others)]
    inner = information[np.ix_(others, others)] + np.eye(len(others))
    return np.asarray(kept - across @ np.linalg.solve(inner, across.T))


def _walked_rows(model: Model, covariance: Array) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for i, name in enumerate(model.space.names):
        if model.space.blocks[i] == NOISE_BLOCK:
            continue
        prior = model.space.distributions[i].sd()
        ratio = float(np.sqrt(covariance[i, i]))
        rows.append(_row(name, model.space.blocks[i], model.specs[name].unit, prior, ratio))
    return rows


def _thrust_rows(model: Model, places: _Coordinates, covariance: Array) -> list[dict[str, object]]:
    """Thrust of every thruster in every event that fires, and of its level over all events."""
    rows: list[dict[str, object]] = []
    if not model.fired_ids:
        return rows
    shared = slice(places.walked, places.walked + places.shared)
    names = model.spacecraft.thruster_names(model.branch)
    cases = [("all events", places.own[0], np.zeros_like(model.thrust_prior.own))]
    cases += [
        (name, places.own[i], model.thrust_prior.own)
        for i, name in enumerate(model.event_ids)
        if places.fires[i]
    ]
    for event, own, factor in cases:
        index = np.r_[shared, own]
        design = np.concatenate([model.thrust_prior.shared, factor], axis=1)
        after = np.einsum("kq,qr,kr->k", design, covariance[np.ix_(index, index)], design)
        before = (design**2).sum(1)
        for k, thruster in enumerate(names):
            if before[k] > 0:
                ratio = float(np.sqrt(after[k] / before[k]))
                label = f"thrust[{event},{thruster}]"
                rows.append(_row(label, "thrust", "N", float(np.sqrt(before[k])), ratio))
    return rows


def _row(name: str, block: str, unit: str, prior: float, ratio: float) -> dict[str, object]:
    return {
        "quantity": name,
        "block": block,
        "unit": unit,
        "prior_sd": prior,
        "expected_sd": prior * ratio,
        "ratio": ratio,
    }


def _verdict(ratio: float) -> str:
    for limit, word in ((SEEN_WELL, "seen well"), (SEEN, "seen"), (HARDLY, "hardly seen")):
        if ratio < limit:
            return word
    return "not seen"


def _together(model: Model, covariance: Array) -> tuple[tuple[str, str, float], ...]:
    """Pairs of walked parameters whose expected posterior correlation is strong."""
    names = model.space.names
    width = np.sqrt(np.diagonal(covariance))
    found = []
    for i, first in enumerate(names):
        for j in range(i):
            correlation = float(covariance[i, j] / (width[i] * width[j]))
            if abs(correlation) > TOGETHER:
                found.append((names[j], first, correlation))
    return tuple(sorted(found, key=lambda pair: -abs(pair[2])))


def _sentences(
    table: pd.DataFrame, singular: Array, together: tuple[tuple[str, str, float], ...]
) -> tuple[str, ...]:
    """The result in words: directions, then thrusts, inertia and nuisances by verdict."""
    told = int((singular > 1.0).sum())
    said = [
        f"Expected before sampling: of {len(singular)} directions among thrust levels, inertia and "
        f"nuisances these events tell {told} better than the priors do (singular values "
        f"{singular[0]:.3g} to {singular[-1]:.2g}; 1 is as good as the prior)."
    ]
    levels = table[table["quantity"].str.startswith("thrust[all events")]
    groups = [("thrust levels", levels), ("inertia", table[table["block"] == "inertia"])]
    groups.append(("nuisances", table[~table["block"].isin(["thrust", "inertia"])]))
    for name, rows in groups:
        if rows.empty:
            continue
        parts = []
        for verdict in ("seen well", "seen", "hardly seen", "not seen"):
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
        own = [group for group in groups if first in group or second in group]
        merged = list(dict.fromkeys([*(name for group in own for name in group), first, second]))
        groups = [group for group in groups if group not in own] + [merged]
    return groups
