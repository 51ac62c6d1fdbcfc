"""The angular-momentum balance of telemetry: weights of its columns, and its noise.

Per row, in body axes,

    I ω + T I_w ρ − R h0 − Σ_k F_k q_k s_k − τ D = noise

(:mod:`cassini_bayes.statistics.columns` has the columns). The likelihood is that of the measured
channels with the true body rate as a latent variable: docs/telemetry-likelihood.md §2 and §3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.spacecraft import (
    Spacecraft,
    inertia_tensor,
    lever_arms,
    wheel_axes,
    wheel_inertias,
)
from cassini_bayes.statistics import EventStatistics, Sampling, contract, project
from cassini_bayes.statistics.columns import CUT_PARTS
from cassini_bayes.terms import RAD_S_PER_RPM

Array = NDArray[np.float64]
Places = NDArray[np.int64]
INITIAL_SD_N_M_S: Final = 10.0
CONTROL_CYCLE_S: Final = 0.125
_CLOSE_S: Final = 0.4


@dataclass(frozen=True)
class Pattern:
    """Which columns enter which unknown: entries in order of owner (contraction.py).

    Unknowns are the K thrusts, the initial momentum (3), the steady torque (3), the cut tails (S),
    and last the measured momentum.
    """

    row: Places
    start: Places
    thrusters: int
    cuts: tuple[int, ...]  # places among the counts of close pairs that are not all zero


@dataclass(frozen=True)
class TelemetryTerms:
    """One telemetry event, ready for likelihood calls.

    ``initial_mean_n_m_s`` centres the wide prior of the unknown initial momentum; ``spin`` (3, 3)
    is the mean of |h|² 1 − h hᵀ over the rows, by which attitude noise enters; ``mode_values`` and
    ``mode_projection`` are the cosines of the torque noise turned so that their Gram matrix, scaled
    by the spectrum of a random walk, is diagonal.
    """

    statistics: EventStatistics
    sampling: Sampling
    pattern: Pattern
    wheel_places: tuple[int, ...]
    mean_rate: Array  # (3,)
    rate_values: Array  # (3,) variances of the measured rates along their principal axes
    rate_vectors: Array  # (3, 3) these axes as columns
    initial_mean_n_m_s: Array
    spin: Array
    mode_values: Array  # (M,)
    mode_projection: Array  # (M, 3, A)

    @property
    def id(self) -> str:
        """Name of the event."""
        return self.statistics.event_id

    @property
    def fires(self) -> bool:
        """Whether the event has thrusters that fired."""
        return self.pattern.thrusters > 0


@dataclass(frozen=True)
class EventSystem:
    """Normal equations of one telemetry event at a batch of points, the noise whitened away.

    ``normal`` (n, P, P) are inner products over all rows of the columns of the unknowns, the
    measured momentum last; ``log_scale`` (n,) gathers every determinant. The priors of the initial
    momentum, torque and cut tails are N(own_mean, own_sd²).
    """

    normal: Array
    log_scale: Array
    own_sd: Array  # (n, U)
    own_mean: Array  # (U,)


def cut_probability(counter_interval_s: float) -> float:
    """Chance that two pulses of one counter interval are a control cycle apart.

    Measured on the closed-loop simulation at 1, 4 and 10 s: 0.45, 0.09, 0.035
    (docs/telemetry-likelihood.md §6).
    """
    return min(0.5, _CLOSE_S / counter_interval_s) if counter_interval_s > 0 else 0.0


def make_terms(
    statistics: EventStatistics,
    sampling: Sampling,
    spacecraft: Spacecraft,
    nominal: Mapping[str, float],
) -> TelemetryTerms:
    """Prepare one event: everything that does not change during a fit.

    ``nominal`` are parameter values good to some percent (prior means): they centre the wide prior
    of the initial momentum and scale the attitude noise.
    """
    layout = statistics.layout
    numbers = [wheel.number for wheel in spacecraft.wheels]
    places = tuple(numbers.index(number) for number in layout.wheels)
    gram, rows = statistics.gram, statistics.rows
    mean = gram[0, 0, layout.one, layout.rate] / rows
    second = gram[0, 0, layout.rate, layout.rate] / rows
    values, vectors = np.linalg.eigh(second - np.outer(mean, mean))
    inertia, wheels = _momentum_weights(spacecraft, places, nominal)
    scalars = np.concatenate([inertia, np.zeros((3, 1)), wheels], axis=1)
    span = slice(layout.rate.start, layout.wheel.stop)
    squares = scalars @ (gram[0, 0, span, span] / rows) @ scalars.T
    start = np.linalg.lstsq(
        _initial_gram(statistics), _initial_target(statistics, scalars, span), rcond=None
    )[0]
    mode_values, mode_projection = _turned_modes(statistics)
    return TelemetryTerms(
        statistics=statistics,
        sampling=sampling,
        pattern=_pattern(statistics),
        wheel_places=places,
        mean_rate=mean,
        rate_values=np.maximum(values, 0.0),
        rate_vectors=vectors,
        initial_mean_n_m_s=start,
        spin=np.trace(squares) * np.eye(3) - squares,
        mode_values=mode_values,
        mode_projection=mode_projection,
    )


def _momentum_weights(
    spacecraft: Spacecraft, places: tuple[int, ...], parameters: Mapping[str, Array | float]
) -> tuple[Array, Array]:
    """Inertia (…, 3, 3) and wheel weights T diag(I_w) (…, 3, W) of the event's wheels."""
    axes = wheel_axes(spacecraft, parameters)
    spins = wheel_inertias(spacecraft, parameters)
    weights = (axes * spins[..., None, :])[..., list(places)]
    return inertia_tensor(parameters), np.asarray(weights)


def _initial_gram(statistics: EventStatistics) -> Array:
    first = statistics.layout.initial
    return np.asarray(sum(statistics.gram[c, c, first, first] for c in range(3)))


def _initial_target(statistics: EventStatistics, scalars: Array, span: slice) -> Array:
    first = statistics.layout.initial
    return np.asarray(sum(statistics.gram[c, c, first, span] @ scalars[c] for c in range(3)))


def _turned_modes(statistics: EventStatistics) -> tuple[Array, Array]:
    """Cosines scaled by the spectrum of a random walk, turned to a diagonal Gram matrix.

    Momentum gained from white torque noise of density a has cosine coefficients of variance
    2 a T/(m π)² (Karhunen-Loève expansion of a random walk about its mean).
    """
    order = np.arange(1, len(statistics.mode_gram) + 1)
    scale = np.sqrt(2.0 * statistics.duration_s) / (order * np.pi)
    values, turn = np.linalg.eigh(scale[:, None] * statistics.mode_gram * scale)
    return np.maximum(values, 0.0), np.einsum("lm,l,lca->mca", turn, scale, statistics.projection)


def _pattern(statistics: EventStatistics) -> Pattern:
    layout = statistics.layout
    cuts = tuple(int(place) for place in np.flatnonzero(statistics.close_pairs > 0))
    entries: list[list[int]] = []
    for k in range(len(layout.thrusters)):
        first = layout.fired.start + 9 * k
        couple = next(g for g, members in enumerate(layout.couples) if k in members)
        own = [layout.cut.start + place for place in cuts if place // CUT_PARTS == couple]
        entries.append([*range(first, first + 9), *own])
    entries += [[column] for column in range(layout.torque.stop)]
    entries += [[layout.cut.start + place] for place in cuts]
    entries.append([*range(layout.rate.start, layout.wheel.stop)])
    start = np.cumsum([0, *map(len, entries)])
    row = [column for own in entries for column in own]
    return Pattern(np.array(row), start.astype(np.int64), len(layout.thrusters), cuts)


def event_system(
    terms: TelemetryTerms,
    spacecraft: Spacecraft,
    branch: str,
    parameters: Mapping[str, Array],
    thrust_n: float,
    torque_mean: Array,
    torque_sd: Array,
) -> EventSystem:
    """Normal equations and determinants of one event at a batch of points.

    Parameters
    ----------
    parameters
        name → (n,) array; all of them.
    thrust_n
        Thrust that scales the cut tails (they are small).
    torque_mean, torque_sd
        (3,) prior of the event's steady torque, N m.
    """
    pattern, rows = terms.pattern, terms.statistics.rows
    inertia, wheels = _momentum_weights(spacecraft, terms.wheel_places, parameters)
    n = len(inertia)
    rate_variance = parameters["rate_noise_rad_s"] ** 2
    wheel_variance = (parameters["wheel_noise_rpm"] * RAD_S_PER_RPM) ** 2
    kept, spread = _latent_rate(terms, rate_variance)
    to_latent = inertia @ kept
    wheel_square = wheels @ np.swapaxes(wheels, -1, -2)
    noise = (
        rate_variance[:, None, None] * to_latent @ np.swapaxes(inertia, -1, -2)
        + wheel_variance[:, None, None] * wheel_square
        + parameters["attitude_noise_rad"][:, None, None] ** 2 * terms.spin
    )
    weights, own_sd = _weights(terms, spacecraft, branch, parameters, thrust_n)
    # the measured momentum comes last: rates, constant, wheels
    weights[:, pattern.start[-2] :] = np.concatenate(
        [
            np.swapaxes(to_latent, -1, -2),
            ((inertia - to_latent) @ terms.mean_rate)[:, None],
            np.swapaxes(wheels, -1, -2),
        ],
        axis=1,
    )
    values, vectors = np.linalg.eigh(noise)
    precision = (vectors / values[:, None, :]) @ np.swapaxes(vectors, -1, -2)
    normal = contract(terms.statistics.gram, pattern.row, pattern.start, weights, precision)
    log_scale = rows * (
        -0.5 * np.log(values).sum(-1)
        + 0.5 * np.linalg.slogdet(wheel_square)[1]
        - 0.5 * spread
        - 3.0 * np.log(2.0 * np.pi)
    )
    walk = parameters["torque_noise_n_m_s05"] ** 2
    if np.any(walk > 0):
        ratio = walk[:, None, None] * terms.mode_values[:, None] / values[:, None, :]
        seen = project(terms.mode_projection, pattern.row, pattern.start, weights)
        turned = np.einsum("nce,nmck->nmek", vectors, seen)
        gain = walk[:, None, None] / (values[:, None, :] ** 2 * (1.0 + ratio))
        flat = (np.sqrt(gain)[..., None] * turned).reshape(n, -1, turned.shape[-1])
        normal = normal - np.swapaxes(flat, -1, -2) @ flat
        log_scale = log_scale - 0.5 * np.log1p(ratio).sum((-2, -1))
    return EventSystem(
        normal=normal,
        log_scale=log_scale,
        own_sd=np.concatenate(
            [np.broadcast_to([INITIAL_SD_N_M_S] * 3 + list(torque_sd), (n, 6)), own_sd], axis=1
        ),
        own_mean=np.concatenate([terms.initial_mean_n_m_s, torque_mean, np.zeros(own_sd.shape[1])]),
    )


def _latent_rate(terms: TelemetryTerms, rate_variance: Array) -> tuple[Array, Array]:
    """Best linear estimate of the true rate from the measured one, and the rate's own density.

    The measured rate has variance V = S + σ² with the true rate's S inferred, S = max(V − σ², 0)
    along the principal axes of the measured covariance. Returns the matrix S V⁻¹ (n, 3, 3) that
    takes a departure from the mean rate to its estimate, and log det V + tr(V⁻¹ V̂) (n,).
    """
    variance = np.maximum(terms.rate_values, rate_variance[:, None])
    share = 1.0 - rate_variance[:, None] / variance
    kept = (terms.rate_vectors * share[:, None, :]) @ terms.rate_vectors.T
    return kept, (np.log(variance) + terms.rate_values / variance).sum(-1)


def _weights(
    terms: TelemetryTerms,
    spacecraft: Spacecraft,
    branch: str,
    parameters: Mapping[str, Array],
    thrust_n: float,
) -> tuple[Array, Array]:
    """Weights (n, B, 3) of the unknowns' entries, and the prior sd of the cut tails (n, S)."""
    pattern, n = terms.pattern, len(parameters["rate_noise_rad_s"])
    weights = np.zeros((n, len(pattern.row), 3))
    k = pattern.thrusters
    own = pattern.start[k]
    own_sd = np.ones((n, len(pattern.cuts)))
    weights[:, own : own + 6] = 1.0
    if k > 0:
        arms = lever_arms(spacecraft, branch, parameters)
        pulse = pulse_weights(terms.sampling, parameters)
        lost = lost_per_cut_s(parameters)
        probability = cut_probability(terms.statistics.counter_interval_s)
        for thruster in range(k):
            first, stop = pattern.start[thruster], pattern.start[thruster + 1]
            arm = arms[..., thruster]
            fired = (arm[:, :, None] * pulse[:, None, :]).reshape(n, 9, 1)
            weights[:, first : first + 9] = fired
            weights[:, first + 9 : stop] = (-probability * lost[:, None] * arm)[:, None, :]
        couples = terms.statistics.layout.couples
        counts = terms.statistics.close_pairs
        spread = np.sqrt(probability * (1.0 - probability))
        for i, place in enumerate(pattern.cuts):
            members = list(couples[place // CUT_PARTS])
            weights[:, own + 6 + i] = thrust_n * lost[:, None] * arms[..., members].sum(-1)
            own_sd[:, i] = spread / np.sqrt(counts[place])
    return weights, own_sd


def pulse_weights(sampling: Sampling, parameters: Mapping[str, Array]) -> Array:
    """Weights (n, 3) of a thruster's pulse columns: 1 and the departures of τ_r and τ_f."""
    _, rise, fall = sampling.pulse_reference_s
    by_rise = parameters["tau_rise_s"] - rise
    return np.stack([np.ones_like(by_rise), by_rise, parameters["tau_fall_s"] - fall], axis=-1)


def lost_per_cut_s(parameters: Mapping[str, Array]) -> Array:
    """On-time that a tail loses when the next pulse starts one control cycle later, (n,) s.

    A first-order valve that opens at thrust x0 F loses (τ_f − τ_r) x0 of impulse over F, with
    x0 = exp(−gap/τ_f).
    """
    fall = np.maximum(parameters["tau_fall_s"], 1e-4)
    return np.asarray((fall - parameters["tau_rise_s"]) * np.exp(-CONTROL_CYCLE_S / fall))
