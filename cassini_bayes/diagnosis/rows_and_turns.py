"""What a model leaves of rows and of turns over quiet pieces, together.

Turns of the attitude show what is slower than a second or so better than a gyro. In a quiet piece
the integral of the balance holds, so every column of a row is integrated; the rates' own is
replaced by the turn. For searches before a fit: torque noise has a column for each of its cosines
of two minutes and more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cassini_bayes.balance.linearised import (
    Information,
    InnovationRows,
    Linear,
    fitted_away,
    information,
    whitened,
    with_unknowns,
)
from cassini_bayes.balance.part_columns import ColumnsByPart, PartColumns
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.statistics.columns import Rows
from cassini_bayes.balance.statistics.turns import (
    Pieces,
    WhiteTurns,
    pieces_of,
    turns_between,
)
from cassini_bayes.balance.statistics.walk import walk_columns, walk_scales
from cassini_bayes.balance.telemetry_balance import TelemetryBalance
from cassini_bayes.balance.telemetry_noise import wheel_covariance
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.effects.effect import Remainder

HALF_PERIOD_S: Final = 60.0
"""Of the fastest cosine of torque noise: with 1e-4 N m s^½ what is faster moves a body of 8,000
kg m² by less than 1e-5 rad, the noise of an attitude."""
MOST_COSINES: Final = 64  # of an event: judgement, longer ones have slow lines of torque noise
LEAST_ATTITUDE_RAD: Final = 1e-9  # noise that no star tracker goes below


@dataclass(frozen=True)
class BesideMode:
    """All events' rows, then their turns, linear about a mode: what further columns tell beside it.

    ``target`` (m,) is that of ``linear`` about the prior mean; ``rows`` and ``turned`` are the
    events of both.
    """

    linear: Linear
    target: Array
    rows: tuple[InnovationRows, ...]
    turned: tuple[InnovationRows, ...]

    @classmethod
    def of(cls, hypothesis: Hypothesis, z: Array, left: Remainder) -> BesideMode:
        """About a point z (d,) of a hypothesis that leaves ``left``."""
        linear, turned = joined(hypothesis, z, left.linear, left.rows)
        return cls(linear, linear.about_prior_mean(z), left.rows, turned)

    def white(self, momentum: Sequence[Array]) -> Array:
        """Columns of momentum (n, 3, q), N m s, in every event's rows: (m, q) in units of noise."""
        of_rows, of_turns = [], []
        for event, turns, own in zip(self.rows, self.turned, momentum, strict=True):
            of_rows.append(whitened(own, event.noise_factor))
            assert turns.turns is not None
            integrated = turns.turns.pieces.integrated(own.reshape(len(own), -1))
            white = whitened(integrated.reshape(own.shape), turns.noise_factor).reshape(own.shape)
            of_turns.append(turns.turns.whitened_axes(white).reshape(3 * len(own), -1))
        return np.concatenate([*of_rows, *of_turns])

    def information(self, momentum: Sequence[Array]) -> Information:
        """On further columns of momentum (n, 3, q), N m s, in the rows of every event."""
        groups = [*range(len(self.rows))] * 2
        return information(self.linear, self.target, self.white(momentum), groups=groups)


def side_by_side(apart: Sequence[Array], common: Sequence[Array] = ()) -> list[Array]:
    """Columns (n, 3, q) of every event: those of each event by itself, then common ones."""
    width, first, result = sum(own.shape[2] for own in apart), 0, []
    for own, shared in zip(apart, common or [own[:, :, :0] for own in apart], strict=True):
        whole = np.zeros((len(own), 3, width + shared.shape[2]))
        whole[:, :, first : first + own.shape[2]] = own
        whole[:, :, width:] = shared
        first += own.shape[2]
        result.append(whole)
    return result


def with_turns(
    hypothesis: Hypothesis, z: Array, linear: Linear, rows: Sequence[InnovationRows]
) -> tuple[Linear, tuple[InnovationRows, ...]]:
    """Linear model and innovations of all events' rows, then of all their turns, at z (d,).

    Parameters as of :func:`joined`.
    """
    both, turned = joined(hypothesis, z, linear, rows)
    left = fitted_away(both, both.about_prior_mean(z))
    events = [
        _innovations(event, left[part].reshape(-1, 3))
        for event, part in zip((*rows, *turned), both.parts, strict=True)
    ]
    return both, tuple(events)


def joined(
    hypothesis: Hypothesis, z: Array, linear: Linear, rows: Sequence[InnovationRows]
) -> tuple[Linear, tuple[InnovationRows, ...]]:
    """Linear model of all events' rows, then of all their turns, at z (d,); events for the latter.

    ``linear`` and ``rows`` are those of the rows alone
    (:func:`cassini_bayes.diagnosis.innovations.innovations`), and what is left in these events is
    still that of the rows.
    """
    located = hypothesis.model.points(z[None])
    terms = [(term.balance, term.physics(located)) for term in hypothesis.model.telemetry]
    usable = [term.event.usable_rows for term in hypothesis.model.telemetry]
    linear = with_torque_noise(hypothesis, z, linear, [event.noise_factor for event in rows])
    targets, parts, turned = [linear.target], [*linear.columns.parts], []
    for (balance, physics), own, event, part, seen in zip(
        terms, usable, rows, linear.parts, linear.columns.parts, strict=True
    ):
        n = len(own.time_s)
        pieces = pieces_of(own, balance.statistics.layout, balance.sampling)
        factor, ratio = _turn_noise(balance, physics, located.parameters)
        white, to_white = WhiteTurns.over(pieces, ratio), np.linalg.inv(factor)
        to_turns = to_white @ event.noise_factor
        integrated = pieces.integrated(seen.values.reshape(n, -1)).reshape(n, 3, -1)
        integrated = np.einsum("ab,nbp->nap", to_turns, integrated)
        values = white.whitened_axes(integrated).reshape(3 * n, -1)
        parts.append(PartColumns(seen.places, values))
        target = pieces.integrated(linear.target[part].reshape(n, 3)) @ to_turns.T
        target += _turns_for_rates(physics, own, event.rate_rad_s, pieces) @ to_white.T
        targets.append(white.whitened_axes(target[:, :, None]).reshape(-1))
        turned.append(replace(event, noise_factor=factor, turns=white))
    columns = ColumnsByPart(tuple(parts), linear.columns.width)
    both = Linear(np.concatenate(targets), columns, linear.precision)
    return both, tuple(turned)


def _innovations(event: InnovationRows, white: Array) -> InnovationRows:
    return replace(event, white=white, residual_n_m_s=white @ event.noise_factor.T)


def with_torque_noise(
    hypothesis: Hypothesis, z: Array, linear: Linear, factors: Sequence[Array]
) -> Linear:
    """A linear model of all events' rows with the columns of its torque noise at z (d,)."""
    density = float(hypothesis.model.points(z[None]).parameters["torque_noise_n_m_s05"][0])
    walks = [
        torque_noise(term.balance, term.event.usable_rows, density)
        for term in hypothesis.model.telemetry
    ]
    return with_unknowns(linear, walks, factors)


def torque_noise(balance: TelemetryBalance, rows: Rows, density: float) -> tuple[Array, Array]:
    """Columns (n, 3, 3 M) of the slowest cosines of torque noise, and variances of their sizes.

    ``density`` is in N m s^½.
    """
    duration, layout = balance.statistics.duration_s, balance.statistics.layout
    count = min(math.ceil(duration / HALF_PERIOD_S), MOST_COSINES) if density > 0.0 else 0
    since_start = rows.vector[:, :, layout.initial]
    variance = np.repeat((density * walk_scales(duration, count)[1:]) ** 2, 3)
    return walk_columns(rows.time_s, since_start, duration, count), variance


def _turn_noise(
    balance: TelemetryBalance, physics: Physics, parameters: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Lower factor (3, 3) of the attitude's part of a turn's noise, N m s²; the wheels' part of it.

    That is the variance of a row over that of the attitude, (3,) in 1/s², about whitened axes. What
    wheels share between these is left out.
    """
    attitude = max(float(parameters["attitude_noise_rad"][0]), LEAST_ATTITUDE_RAD)
    inertia = attitude * physics.inertia_kg_m2[0]
    factor = np.linalg.cholesky(inertia @ inertia.T)
    to_white = np.linalg.inv(factor)
    of_wheels = wheel_covariance(balance, physics, parameters)[0]
    return factor, np.diagonal(to_white @ of_wheels @ to_white.T).copy()


def _turns_for_rates(physics: Physics, rows: Rows, rate_rad_s: Array, pieces: Pieces) -> Array:
    """I times the turn, less the integrated momentum of the gyro's rates (n, 3), N m s²."""
    steps = turns_between(rows.cosines)
    turned = pieces.centred(np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]))
    measured = pieces.integrated(rate_rad_s - np.broadcast_to(physics.rate_bias_rad_s, (1, 3)))
    by_rate = np.broadcast_to(physics.momentum_per_rate, (1, 3, 3))[0]
    return np.asarray(turned @ physics.inertia_kg_m2[0].T - measured @ by_rate.T)
