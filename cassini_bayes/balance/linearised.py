"""The momentum balance row by row, linear in all that is unknown about a point of a model.

A row's momentum is columns times unknowns plus noise. With X all columns, whitened, and P the prior
precision of their unknowns, what the prior and the fit leave of a target y is

    r = (1 − X (XᵀX + P)⁻¹ Xᵀ) y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.balance.statistics.turns import WhiteTurns
from cassini_bayes.computing.arrays import Array, Places


@dataclass(frozen=True)
class EventRows:
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
    """Whitened linear model of all events: target (m,), columns (m, p), prior precision (p,)."""

    target: Array
    columns: Array
    precision: Array
    rows: tuple[int, ...]  # of every event, three values each

    @property
    def parts(self) -> tuple[slice, ...]:
        """Where every event's values are in ``target``."""
        ends = 3 * np.cumsum([0, *self.rows])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    def about_prior_mean(self, z: Array) -> Array:
        """The target (m,) had it been taken where the first unknowns z (d,), standard, are zero."""
        return np.asarray(self.target + self.columns[:, : len(z)] @ z)

    def gram(self) -> Array:
        """XᵀX + P (p, p), summed over events on the columns that each of them has."""
        total = np.diag(self.precision)
        for part in self.parts:
            own = self.columns[part]
            kept = np.flatnonzero(np.any(own, axis=0))
            own = own[:, kept]
            total[np.ix_(kept, kept)] += own.T @ own
        return total


def fitted_away(linear: Linear, target: Array) -> Array:
    """What the prior and the fit leave (m, …) of one or more targets (m, …)."""
    coefficients = np.linalg.solve(linear.gram(), linear.columns.T @ target)
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
    of_value = np.repeat(of_part, 3 * np.array(linear.rows))
    blocks, has = [], []
    for group in np.unique(of_part):
        rows = np.flatnonzero((of_value == group) & counts)
        blocks.append((linear.columns[rows], np.column_stack([columns[rows], target[rows]])))
        has.append(np.any(blocks[-1][0], axis=0))
    shared = np.flatnonzero(np.sum(has, axis=0) != 1)
    wholes = []
    for (block, both), own_has in zip(blocks, has, strict=True):
        own = np.setdiff1d(np.flatnonzero(own_has), shared, assume_unique=True)
        common, beside = block[:, shared], block[:, own]
        inner = beside.T @ beside + np.diag(linear.precision[own])
        right = np.column_stack([common, both])
        pulled = beside.T @ right
        taken = pulled.T @ np.linalg.solve(inner, pulled)
        wholes.append(right.T @ right - taken)
    return shared, wholes


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
    widths = [len(variance) for _, variance in opened]
    added, place = np.zeros((len(linear.target), sum(widths))), 0
    for part, (columns, variance), factor in zip(linear.parts, opened, factors, strict=True):
        stop = place + len(variance)
        added[part, place:stop] = whitened(columns, factor)
        place = stop
    precision = 1.0 / np.concatenate([np.zeros(0), *(variance for _, variance in opened)])
    return replace(
        linear,
        columns=np.concatenate([linear.columns, added], axis=1),
        precision=np.concatenate([linear.precision, precision]),
    )
