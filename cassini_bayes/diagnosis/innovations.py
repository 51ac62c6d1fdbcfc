"""Row by row: the baseline's innovations, and what can be fitted away.

At the mode the balance is linear in everything: a row's momentum is columns times unknowns
(thrusts, initial momentum, torque, cut tails) plus the derivatives with respect to the walked
parameters times their departure, plus noise. With X all of these columns, whitened, and P their
prior precision, the innovations are r = (1 − X (XᵀX + P)⁻¹ Xᵀ) y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from cassini_bayes.balance.linearised import (
    InnovationRows,
    Linear,
    fitted_away,
    whitened,
    with_unknowns,
)
from cassini_bayes.balance.part_columns import ColumnsByPart, PartColumns
from cassini_bayes.balance.statistics.columns import Rows
from cassini_bayes.balance.statistics.layout import Layout
from cassini_bayes.balance.telemetry_balance import TelemetryBalance
from cassini_bayes.balance.telemetry_noise import noise_covariance
from cassini_bayes.balance.telemetry_weights import balance_weights
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.correlations import mean_of_others
from cassini_bayes.diagnosis.hypotheses import Hypothesis, expected_thrusts_n, thrust_factors
from cassini_bayes.diagnosis.rows_and_turns import with_turns
from cassini_bayes.diagnosis.unresolved import unresolved
from cassini_bayes.effects.effect import Remainder

SMOOTHED_ROWS: Final = 31
"""Of running means of channels behind slopes: judgement, noise a fifth or less, and half a minute
is short beside a slew."""
_STEP: Final = 1e-3  # standard normals, for slopes: central differences good to 1e-6
_WIDE: Final = 1e-12  # N m, the least width of a torque's prior: one that is fixed has none


def _columns(terms: TelemetryBalance, rows: Rows, weights: Array) -> Array:
    """Unknowns' columns and the measured momentum (n, 3, P) from one point's weights (B, 3)."""
    pattern = terms.pattern
    vectors = rows.vector.shape[2]
    n, unknowns = len(rows.time_s), len(pattern.start) - 1
    result = np.zeros((n, 3, unknowns))
    for owner in range(unknowns):
        for b in range(pattern.start[owner], pattern.start[owner + 1]):
            if not np.any(weights[b]):
                continue
            column = pattern.row[b]
            if column < vectors:
                result[:, :, owner] += rows.vector[:, :, column] * weights[b]
            else:
                result[:, :, owner] += rows.scalar[:, column - vectors, None] * weights[b]
    return result


def thrust_columns(hypothesis: Hypothesis, z: Array, place: int) -> Array:
    """Momentum per newton (n, 3, K), N m s/N, of every thruster in an event's rows at z (d,)."""
    model, term = hypothesis.model, hypothesis.model.telemetry[place]
    physics = term.physics(model.points(z[None]))
    weights = balance_weights(term.balance, physics)[0]
    columns = _columns(term.balance, term.event.usable_rows, weights)
    return columns[:, :, : term.balance.pattern.thrusters]


def smoothed(rows: Rows, layout: Layout) -> Rows:
    """Rows whose rates and wheel rates are running means of the rows about them.

    Slopes of the measured momentum with respect to inertias are the channels themselves. With their
    noise in them any noise could be fitted away, as in the naive likelihood of the residual. So a
    row's own noise is in none of its means: of an hour in which a body stands still a 31st of it
    tells of an inertia that is five standard deviations off.
    """
    vectors, scalar = len(layout.vector), rows.scalar.copy()
    for place in (
        *range(layout.rate.start, layout.rate.stop),
        *range(layout.wheel.start, layout.wheel.stop),
    ):
        scalar[:, place - vectors] = mean_of_others(scalar[:, place - vectors], SMOOTHED_ROWS)
    return replace(rows, scalar=scalar)


def linearise(
    hypothesis: Hypothesis, z: Array, *, smooth_channels: bool = True
) -> tuple[Linear, list[Array]]:
    """The whitened linear model at z (d,), and the lower factor (3, 3) of every event's noise.

    ``smooth_channels``: slopes see running means of the channels; not for channels without noise.
    """
    model = hypothesis.model
    d = len(z)
    points = np.vstack([z, z + _STEP * np.eye(d), z - _STEP * np.eye(d)])
    located = model.points(points)
    loading = model.thrust_prior.shared
    targets, blocks, event_precision, factors = [], [], [], []
    for term in model.telemetry:
        terms, physics, rows = term.balance, term.physics(located), term.event.usable_rows
        weights = balance_weights(terms, physics)
        noise = noise_covariance(terms, physics, located.parameters)[0]
        factor = np.linalg.cholesky(noise)
        smooth = smoothed(rows, terms.statistics.layout) if smooth_channels else rows
        centre = _columns(terms, rows, weights[0])
        k = terms.pattern.thrusters
        moved, thrust = thrust_factors(term, located), expected_thrusts_n(term, located)
        mean = np.concatenate([thrust[0], terms.initial_mean_n_m_s, model.torque_mean_n_m])
        unknown = centre[:, :, :-1]
        at = np.concatenate([mean, np.zeros(unknown.shape[2] - len(mean))])
        target = centre[:, :, -1] - unknown @ at
        slopes = _slopes(terms, smooth, weights[1 : 1 + d] - weights[1 + d :], at)
        slopes += unknown[:, :, :k] @ (thrust[1 : 1 + d] - thrust[1 + d :]).T
        slopes /= 2.0 * _STEP
        rest = unknown[:, :, k:]
        shared = (
            np.concatenate([slopes, unknown[:, :, :k] @ (moved[0][:, None] * loading)], axis=2)
            if k
            else slopes
        )
        individual = unknown[:, :, :k] @ model.thrust_prior.departures if k else unknown[:, :, :0]
        sd = _event_sd(terms, model.torque_sd_n_m)
        blocks.append((shared, np.concatenate([individual, rest], axis=2)))
        event_precision.append(np.concatenate([np.ones(individual.shape[2]), sd**-2]))
        targets.append(target)
        factors.append(factor)
    shared_width = d + (loading.shape[1] if loading.size else 0)
    return _stacked(targets, blocks, event_precision, factors, shared_width), factors


def effect_columns(
    base: Hypothesis, z: Array, extended: Sequence[tuple[Hypothesis, Array]]
) -> list[Array]:
    """What effects add to the whitened rows of every telemetry event, (3 n, S), at z (d,).

    Parameters as of :func:`effect_momentum`.
    """
    located, result = base.model.points(z[None]), []
    added = effect_momentum(base, z, extended)
    for term, of_event in zip(base.model.telemetry, added, strict=True):
        noise = noise_covariance(term.balance, term.physics(located), located.parameters)[0]
        result.append(whitened(of_event, np.linalg.cholesky(noise)))
    return result


def effect_momentum(
    base: Hypothesis, z: Array, extended: Sequence[tuple[Hypothesis, Array]]
) -> list[Array]:
    """What effects add to the rows of every telemetry event, (n, 3, S), N m s, at z (d,).

    With U the momentum per newton and F the mean levels, an effect that makes U′ of U and the
    levels' factors f′ of those of the base, f, adds (U′ − U) F f + U F (f′ − f).

    Parameters
    ----------
    base
        The hypothesis without them, of which z is a point.
    extended
        It with an effect more, and values (s, k) of that effect's coordinates; S is the sum of s.
    """
    model = base.model
    located = model.points(z[None])
    thrust = located.mean_levels_n[0]
    points = [
        hypothesis.model.points(np.column_stack([np.tile(z, (len(values), 1)), values]))
        for hypothesis, values in extended
    ]
    result = []
    for place, term in enumerate(model.telemetry):
        terms, k = term.balance, term.balance.pattern.thrusters
        physics, before = term.physics(located), thrust_factors(term, located)[0]
        weights, shifts = [], []
        for (own, _), at in zip(extended, points, strict=True):
            with_effect = own.model.telemetry[place]
            weights.append(balance_weights(terms, with_effect.physics(at)))
            shifts.append(thrust[:k] * (thrust_factors(with_effect, at) - before))
        at_base = expected_thrusts_n(term, located)[0]
        mean = (at_base, terms.initial_mean_n_m_s, model.torque_mean_n_m)
        added = _slopes(
            terms,
            smoothed(term.event.usable_rows, terms.statistics.layout),
            np.concatenate(weights) - balance_weights(terms, physics),
            np.concatenate([*mean, np.zeros(terms.pattern.hidden)]),
        )
        added += thrust_columns(base, z, place) @ np.concatenate(shifts).T
        result.append(added)
    return result


def _slopes(terms: TelemetryBalance, rows: Rows, differences: Array, at: Array) -> Array:
    """Changes (n, 3, d) of what the unknowns predict less the measured momentum.

    ``differences`` (d, B, 3) are those of the weights along every coordinate.
    """
    pattern, vectors = terms.pattern, rows.vector.shape[2]
    share = np.repeat(np.r_[at, -1.0], np.diff(pattern.start))
    weights = np.zeros((vectors + rows.scalar.shape[1], 3, len(differences)))
    np.add.at(weights, pattern.row, np.moveaxis(share[:, None] * differences, 0, -1))
    used = np.flatnonzero(np.any(weights[:vectors], axis=(1, 2)))
    by_vector, by_scalar = weights[used], weights[vectors:]
    return np.stack(
        [
            rows.vector[:, c, used] @ by_vector[:, c] + rows.scalar @ by_scalar[:, c]
            for c in range(3)
        ],
        axis=1,
    )


def _event_sd(terms: TelemetryBalance, torque_sd: Array) -> Array:
    sd = np.concatenate([np.full(3, terms.initial_sd_n_m_s), np.maximum(torque_sd, _WIDE)])
    return np.concatenate([sd, np.ones(terms.pattern.hidden)])


def _stacked(
    targets: Sequence[Array],
    blocks: Sequence[tuple[Array, Array]],
    event_precision: Sequence[Array],
    factors: Sequence[Array],
    shared: int,
) -> Linear:
    white, parts, first = [], [], shared
    for of_rows, (common, of_event), factor, precision in zip(
        targets, blocks, factors, event_precision, strict=True
    ):
        white.append((of_rows @ np.linalg.inv(factor).T).reshape(-1))
        stop = first + len(precision)
        values = np.concatenate([whitened(common, factor), whitened(of_event, factor)], axis=1)
        parts.append(PartColumns(np.r_[0 : common.shape[2], first:stop], values))
        first = stop
    every = np.concatenate([np.ones(shared), *event_precision])
    return Linear(np.concatenate(white), ColumnsByPart(tuple(parts), first), every)


def innovations(hypothesis: Hypothesis, z: Array) -> Remainder:
    """What a hypothesis leaves of telemetry at its mode z (d,), what records leave open as well.

    Its linear model has a column for everything that records leave open (:mod:`.unresolved`).
    """
    events = [term.event for term in hypothesis.model.telemetry]
    linear, factors = linearise(hypothesis, z)
    opened = [unresolved(hypothesis, z, place) for place in range(len(events))]
    linear = with_unknowns(linear, opened, factors)
    target = linear.about_prior_mean(z)
    left = fitted_away(linear, target)
    rows = []
    for event, part, factor in zip(events, linear.parts, factors, strict=True):
        usable = event.usable_rows
        white = left[part].reshape(-1, 3)
        samples = event.samples
        at = event.usable_places
        fires = samples.on_time_s.shape[1] > 0
        rows.append(
            InnovationRows(
                event.id,
                usable.time_s,
                white,
                white @ factor.T,
                samples.rate_rad_s[at],
                samples.wheel_rad_s[at],
                samples.on_time_s[at] if fires else np.zeros((len(at), 0)),
                event.wheels,
                event.thrusters,
                factor,
                samples.attitude[at],
            )
        )
    parameters = hypothesis.model.space.to_parameters(z[None])
    return Remainder(
        tuple(event.samples for event in events),
        tuple(rows),
        linear,
        target,
        {name: float(np.ravel(value)[0]) for name, value in parameters.items()},
        partial(with_turns, hypothesis, z, linear, rows),
    )


def left_by(weighed: Weighed[Hypothesis]) -> Remainder:
    """What a hypothesis leaves of telemetry, looked at before or now (:func:`innovations`)."""
    return weighed.remainder or innovations(weighed.hypothesis, weighed.mode.point)


def examined(weighed: Weighed[Hypothesis]) -> Weighed[Hypothesis]:
    """A hypothesis on telemetry with what it leaves, so that nobody has to look twice."""
    return replace(weighed, remainder=left_by(weighed))
