"""The discrepancy curve: momentum that nothing in the model explains, against time, with a band.

A torque that the model lacks, in body axes, leaves the momentum P(t) ∫ Pᵀ dg in the balance, P the
inertial-to-body rotation. Its integral about each body axis is

    g(t) = a Σ_m s_m ξ_m (cos(m π t/T) − 1),   ξ_m ~ N(0, 1):

a random walk, as ``unknown`` has it, with s_m ∝ 1/m, or a slow drift with s_m ∝ 1/m², either with
spread a T^½ at the end. Whitened, y = X β + G w + noise, w ~ N(0, a² Λ). With β integrated out,
V⁻¹ = 1 − X (XᵀX + P)⁻¹ Xᵀ, the eigenvalues κ and vectors U of Λ^½ Gᵀ V⁻¹ G Λ^½, and
b = Uᵀ Λ^½ Gᵀ V⁻¹ y:

    log p(y | a) = ½ Σ_j [a² b_j²/(1 + a² κ_j) − log(1 + a² κ_j)] + constant,
    η_j | a, y ~ N(a² b_j/(1 + a² κ_j), a²/(1 + a² κ_j)),   w = Λ^½ U η.

a is integrated over the prior that ``unknown`` has, walk and drift by their evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve

from cassini_bayes.balance.linearised import InnovationRows, Linear, change_of_evidence
from cassini_bayes.balance.part_columns import spread
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import Hypothesis, none_hypothesis
from cassini_bayes.diagnosis.innovations import innovations
from cassini_bayes.effects.effect import Remainder
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.spacecraft.attitude import direction_cosines

MODES: Final = 32
"""Cosines of an event: judgement, a curve down to a thirtieth of it; each costs three columns."""
DRAWS: Final = 2_000  # behind a band: its ends scatter by a twentieth of a standard deviation
TIMES: Final = 200  # points of a curve
POWERS: Final = (1, 2)  # of 1/m: random walk, slow drift
PROBABILITY: Final = 0.90
_NODES: Final = 121  # of the amplitude, twelve to a standard deviation of its prior
FARTHEST: Final = 5.0  # prior standard deviations of these


@dataclass(frozen=True)
class Curve:
    """Unexplained torque of one event integrated from its first row, N m s, body axes.

    ``mean``, ``low`` and ``high`` are (T, 3): posterior mean and pointwise central 90 % credible
    interval at ``time_s`` (T,).
    """

    event: str
    time_s: Array
    mean: Array
    low: Array
    high: Array


def curves_of(
    events: Events, unknown: Weighed[Hypothesis], rng: np.random.Generator
) -> tuple[Curve, ...]:
    """The curves of some events, about the mode of ``unknown``; none without telemetry."""
    if not events.telemetry:
        return ()
    _, point, left = baseline_at(events, unknown)
    prior = events.catalogue.unknown.torque_noise
    return discrepancy_curves(left.linear, left.rows, point, prior, rng)


def baseline_at(
    events: Events, unknown: Weighed[Hypothesis]
) -> tuple[Hypothesis, Array, Remainder]:
    """The baseline, its point (d,) at the mode of ``unknown``, and what it leaves there.

    There nuisances are not bent to explain what is missing, as they are at the baseline's mode.
    """
    full = none_hypothesis(events)
    point = full.part_of(unknown.hypothesis, unknown.mode.point)
    return full, point, innovations(full, point)


def discrepancy_curves(
    linear: Linear,
    rows: Sequence[InnovationRows],
    point: Array,
    torque_noise: Distribution,
    rng: np.random.Generator,
) -> tuple[Curve, ...]:
    """Posterior of the momentum that ``unknown`` would need, event by event.

    Parameters
    ----------
    linear, rows
        The baseline's linear model and innovations at a point.
    point
        The point z (d,): the prior mean of its walked parameters is −z away from it.
    torque_noise
        Prior of the noise density a in N m s^½, as ``unknown`` has it.
    rng
        For the posterior draws behind the band.
    """
    if not rows:
        return ()
    matrix, projection = _information(linear, rows, point)
    kinds = [_Kind.of(matrix, projection, rows, power) for power in POWERS]
    nodes, chosen = _amplitudes(kinds, torque_noise, rng)
    weights = np.empty((DRAWS, len(projection)))
    for i, kind in enumerate(kinds):
        of_kind = np.flatnonzero(chosen // _NODES == i)
        square = nodes[chosen[of_kind] % _NODES, None] ** 2
        spread = square / (1.0 + square * kind.kappa)
        eta = spread * kind.projection + np.sqrt(spread) * rng.standard_normal(
            (len(of_kind), len(projection))
        )
        weights[of_kind] = (eta @ kind.vectors.T) * kind.root
    return tuple(
        _curve(of_kind, weights[:, 3 * MODES * e : 3 * MODES * (e + 1)])
        for e, of_kind in enumerate(rows)
    )


@dataclass(frozen=True)
class _Kind:
    """One prior of the weights, diagonalised: Λ^½, κ, U and b, all (q,) or (q, q)."""

    root: Array
    kappa: Array
    vectors: Array
    projection: Array

    @classmethod
    def of(
        cls, matrix: Array, projection: Array, rows: Sequence[InnovationRows], power: int
    ) -> _Kind:
        root = np.concatenate([np.repeat(_mode_sd(event, power), 3) for event in rows])
        kappa, vectors = np.linalg.eigh(root[:, None] * matrix * root)
        return cls(root, np.maximum(kappa, 0.0), vectors, vectors.T @ (root * projection))

    def log_evidence(self, amplitude: Array) -> Array:
        """log p(y | a) (n,) up to a constant."""
        return change_of_evidence(self.kappa, self.projection, amplitude)


def _waves(event: InnovationRows, time_s: Array) -> Array:
    """cos(m π t/T) − 1 (n, M): nothing at the start, where the initial momentum is free."""
    span = event.time_s[-1] - event.time_s[0]
    order = np.arange(1.0, MODES + 1.0)
    return np.asarray(np.cos(np.pi * np.outer((time_s - event.time_s[0]) / span, order)) - 1.0)


def _gained(event: InnovationRows) -> Array:
    """P(t) ∫ Pᵀ e_c d(wave) (n, 3, M, 3): what a torque about body axis c leaves in the balance."""
    turn = direction_cosines(event.attitude)
    steps = np.diff(_waves(event, event.time_s), axis=0)
    back = 0.5 * (turn[1:] + turn[:-1])
    inertial = np.zeros((len(turn), 3, MODES, 3))
    inertial[1:] = np.cumsum(np.einsum("nm,nci->nimc", steps, back), axis=0)
    return np.asarray(np.einsum("nai,nimc->namc", turn, inertial, optimize=True))


def _mode_sd(event: InnovationRows, power: int) -> Array:
    """Standard deviations (M,) of the cosines' weights at a = 1, s^½: that of the end is T^½.

    g(T) − g(0) is minus twice the sum of the odd weights.
    """
    order = np.arange(1.0, MODES + 1.0)
    shape = order**-power
    end = 2.0 * np.sqrt((shape[::2] ** 2).sum())
    return np.asarray(np.sqrt(event.time_s[-1] - event.time_s[0]) / end * shape)


def _information(
    linear: Linear, rows: Sequence[InnovationRows], point: Array
) -> tuple[Array, Array]:
    """Gᵀ V⁻¹ G (q, q) and Gᵀ V⁻¹ y (q,), y about the prior mean; modes, then axes."""
    target = linear.about_prior_mean(point)
    own_gram, mixed, own_projection = [], [], []
    for event, part, known in zip(rows, linear.parts, linear.columns.parts, strict=True):
        n = len(event.time_s)
        inverse = np.linalg.inv(event.noise_factor)
        columns = np.einsum("ba,namc->nbmc", inverse, _gained(event)).reshape(3 * n, -1)
        own_gram.append(columns.T @ columns)
        mixed.append(spread(columns.T @ known.values, known.places, linear.columns.width).T)
        own_projection.append(columns.T @ target[part])
    across = np.concatenate(mixed, axis=1)
    factor = cho_factor(linear.gram(), lower=True)
    fitted = cho_solve(factor, np.column_stack([across, linear.columns.along(target)]))
    matrix = block_diag(*own_gram) - across.T @ fitted[:, :-1]
    return matrix, np.concatenate(own_projection) - across.T @ fitted[:, -1]


def _amplitudes(
    kinds: Sequence[_Kind], prior: Distribution, rng: np.random.Generator
) -> tuple[Array, Places]:
    """Nodes of a, even in the prior's standard normal, and draws (DRAWS,) of kind and node."""
    standard = np.linspace(-FARTHEST, FARTHEST, _NODES)
    nodes = prior.quantile_of_standard(standard)
    score = np.concatenate([kind.log_evidence(nodes) - 0.5 * standard**2 for kind in kinds])
    weight = np.exp(score - score.max())
    return nodes, rng.choice(len(weight), size=DRAWS, p=weight / weight.sum())


def _curve(event: InnovationRows, weights: Array) -> Curve:
    time = np.linspace(event.time_s[0], event.time_s[-1], TIMES)
    wave = _waves(event, time)
    draws = np.einsum("tm,dmc->dtc", wave, weights.reshape(len(weights), MODES, 3), optimize=True)
    tail = 0.5 * (1.0 - PROBABILITY)
    low, high = np.quantile(draws, [tail, 1.0 - tail], axis=0)
    return Curve(event.event, time, draws.mean(axis=0), low, high)
