"""The momentum balance row by row, linear in all that is unknown about a point of a model.

A row's momentum is columns times unknowns plus noise. With X all columns, whitened, and P the prior
precision of their unknowns, what the prior and the fit leave of a target y is

    r = (1 − X (XᵀX + P)⁻¹ Xᵀ) y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.balance.part_columns import ColumnsByPart, PartColumns
from cassini_bayes.balance.statistics.turns import WhiteTurns
from cassini_bayes.computing.arrays import Array, Places


@dataclass(frozen=True)
class InnovationRows:
    """What a model leaves of one event's rows, and the channels there.

    ``residual_n_m_s`` (n, 3) is momentum about body axes, ``white`` (n, 3) the same whitened:
    ``residual_n_m_s = white @ noise_factor.T`` with the lower factor (3, 3) of a row's noise. With
    ``turns`` all that is of the balance integrated over quiet pieces, N m s², in which turns of the
    attitude are measured and not rates, and whitened along every piece
    (:class:`.statistics.turns.WhiteTurns`).
    """

    event: str
    time_s: Array
    white: Array
    residual_n_m_s: Array
    rate_rad_s: Array
    wheel_rad_s: Array
    on_time_s: Array  # (n, K)
    wheels: tuple[int, ...]  # numbers of the columns of wheel_rad_s
    thrusters: tuple[str, ...]
    noise_factor: Array
    attitude: Array  # (n, 4) Euler parameters, scalar last
    turns: WhiteTurns | None = None


@dataclass(frozen=True)
class Linear:
    """Whitened linear model of all events: target (m,), columns (m, p), prior precision (p,).

    A row has three values.
    """

    target: Array
    columns: ColumnsByPart
    precision: Array

    @property
    def parts(self) -> tuple[slice, ...]:
        """Where every event's values are in ``target``."""
        return self.columns.slices

    @property
    def rows(self) -> tuple[int, ...]:
        """How many every event has."""
        return tuple(len(part.values) // 3 for part in self.columns.parts)

    def about_prior_mean(self, z: Array) -> Array:
        """The target (m,) had it been taken where the first unknowns z (d,), standard, are zero."""
        moved = np.zeros(len(self.precision))
        moved[: len(z)] = z
        return np.asarray(self.target + self.columns @ moved)

    def gram(self) -> Array:
        """XᵀX + P (p, p)."""
        return self.columns.gram() + np.diag(self.precision)


def fitted_away(linear: Linear, target: Array) -> Array:
    """What the prior and the fit leave (m, …) of one or more targets (m, …)."""
    taken = linear.columns.along(target)
    coefficients = np.asarray(np.linalg.solve(linear.gram(), taken), dtype=np.float64)
    return np.asarray(target - linear.columns @ coefficients)


@dataclass(frozen=True)
class Information:
    """What data say of weights w of further columns C: M (q, q) and h (q,).

    M = Cᵀ V⁻¹ C and h = Cᵀ V⁻¹ y, V = 1 + X P⁻¹ Xᵀ.
    """

    matrix: Array
    vector: Array


def information(
    linear: Linear,
    target: Array,
    columns: Array,
    *,
    used: Array | None = None,
    groups: Sequence[int] | None = None,
) -> Information:
    """Information on whitened columns (m, q) beside a linear model.

    Parameters
    ----------
    linear
        The model with its prior.
    target
        y (m,), less what is known of it.
    columns
        The further ones.
    used
        (m,) which values count; all by default.
    groups
        The group of every part; unknowns of one group alone are summed over first. By default
        every part is its own.
    """
    shared, wholes = _by_group(linear, target, columns, used, groups)
    return _beside(linear.precision[shared], sum(wholes, np.zeros_like(wholes[0])))


def information_without_each(linear: Linear, target: Array, columns: Array) -> list[Information]:
    """:func:`information` of all parts but one, for each of them: as quick as that of all."""
    shared, wholes = _by_group(linear, target, columns)
    prior, nothing = linear.precision[shared], np.zeros_like(wholes[0])
    others = [[*wholes[:i], *wholes[i + 1 :]] for i in range(len(wholes))]
    return [_beside(prior, sum(own, nothing)) for own in others]


def _by_group(
    linear: Linear,
    target: Array,
    columns: Array,
    used: Array | None = None,
    groups: Sequence[int] | None = None,
) -> tuple[Places, list[Array]]:
    """Unknowns (s,) that groups share, and inner products (s + q + 1, s + q + 1) of every group.

    Of the columns of these unknowns, of the further ones and of the target, the group's own
    unknowns summed over.
    """
    counts = np.ones(len(target), dtype=bool) if used is None else used
    of_part = np.arange(len(linear.parts)) if groups is None else np.asarray(groups)
    blocks, owners = [], np.zeros(len(linear.precision), dtype=np.int64)
    for group in np.unique(of_part):
        members = np.flatnonzero(of_part == group)
        block = _stacked([linear.columns.parts[i] for i in members])
        rows = np.concatenate([np.r_[linear.parts[i]] for i in members])
        kept = counts[rows]
        both = np.column_stack([columns[rows[kept]], target[rows[kept]]])
        blocks.append((PartColumns(block.places, block.values[kept]), both))
        owners[block.places[np.any(blocks[-1][0].values, axis=0)]] += 1
    shared = np.flatnonzero(owners != 1)
    wholes = []
    for block, both in blocks:
        common = np.zeros((len(both), len(shared)))
        is_common = owners[block.places] != 1
        common[:, np.searchsorted(shared, block.places[is_common])] = block.values[:, is_common]
        has = np.any(block.values, axis=0) & ~is_common
        own, beside = block.places[has], block.values[:, has]
        inner = beside.T @ beside + np.diag(linear.precision[own])
        right = np.column_stack([common, both])
        pulled = beside.T @ right
        taken = pulled.T @ np.linalg.solve(inner, pulled)
        wholes.append(right.T @ right - taken)
    return shared, wholes


def _stacked(parts: Sequence[PartColumns]) -> PartColumns:
    """Parts as one that has the columns of all."""
    places = np.unique(np.concatenate([part.places for part in parts]))
    values = np.zeros((sum(len(part.values) for part in parts), len(places)))
    first = 0
    for part in parts:
        stop = first + len(part.values)
        values[first:stop, np.searchsorted(places, part.places)] = part.values
        first = stop
    return PartColumns(places, values)


def _beside(prior: Array, whole: Array) -> Information:
    """Information by inner products, unknowns of a precision ``prior`` (s,) summed over, too."""
    n = len(prior)
    across = whole[:n, n:]
    remaining = whole[n:, n:] - across.T @ np.linalg.solve(whole[:n, :n] + np.diag(prior), across)
    return Information(remaining[:-1, :-1], remaining[:-1, -1])


def diagonal(matrix: Array, vector: Array) -> tuple[Array, Array]:
    """Eigenvalues κ (q,) of M (q, q), none below zero, and h (q,) along its eigenvectors."""
    if len(vector) == 1:
        return np.maximum(matrix[0], 0.0), vector
    kappa, vectors = np.linalg.eigh(matrix)
    return np.maximum(kappa, 0.0), vectors.T @ vector


def change_of_evidence(kappa: Array, rotated: Array, amplitudes: Array) -> Array:
    """Change (n,) of the log evidence by weights w ~ N(0, a²), for amplitudes a (n,).

    ½ hᵀ (M + a⁻²)⁻¹ h − ½ log |1 + a² M|, with M and h as :func:`diagonal` has them.
    """
    square = amplitudes[:, None] ** 2
    grown = 1.0 + square * kappa
    return np.asarray(0.5 * (square * rotated**2 / grown - np.log(grown)).sum(-1))


def mean_change_of_evidence(
    matrix: Array, vector: Array, amplitudes: Array, log_weights: Array
) -> float:
    """Log of the weighted mean of e^Δ(a) over amplitudes a (n,), Δ by M (q, q) and h (q,)."""
    changes = change_of_evidence(*diagonal(matrix, vector), amplitudes)
    return float(logsumexp(changes + log_weights) - logsumexp(log_weights))


def whitened(columns: Array, factor: Array) -> Array:
    """Columns (n, 3, s) of an event in units of its noise, (3 n, s), with its factor (3, 3)."""
    white = np.einsum("ab,nbs->nas", np.linalg.inv(factor), columns)
    return np.asarray(white.reshape(3 * len(columns), -1))


def with_unknowns(
    linear: Linear,
    opened: Sequence[tuple[Array, Array]],
    factors: Sequence[Array],
) -> Linear:
    """The linear model with a column for everything that is left open.

    Parameters
    ----------
    linear
        Of the likelihood's columns.
    opened
        Columns (n, 3, s) in N m s and their variances (s,), of every event
        (:func:`cassini_bayes.diagnosis.unresolved.unresolved`).
    factors
        Lower factors (3, 3) of every event's noise.
    """
    parts, place = [], linear.columns.width
    for own, (columns, variance), factor in zip(linear.columns.parts, opened, factors, strict=True):
        added = np.arange(place, place + len(variance))
        place += len(variance)
        values = np.concatenate([own.values, whitened(columns, factor)], axis=1)
        parts.append(PartColumns(np.concatenate([own.places, added]), values))
    precision = 1.0 / np.concatenate([np.zeros(0), *(variance for _, variance in opened)])
    return replace(
        linear,
        columns=ColumnsByPart(tuple(parts), place),
        precision=np.concatenate([linear.precision, precision]),
    )
