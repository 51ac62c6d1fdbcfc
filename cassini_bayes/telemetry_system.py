"""Normal equations of one telemetry event: its Gram matrices with the noise whitened away.

The likelihood is that of the measured channels with the true wheel rates as latent variables:
docs/telemetry-likelihood.md §2 and §3. Columns and weights are those of
:mod:`cassini_bayes.telemetry_terms`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.physics import Physics
from cassini_bayes.statistics import contract, explained_by_modes, moments
from cassini_bayes.telemetry_bands import estimated_wheels, latent_wheels
from cassini_bayes.telemetry_terms import (
    INITIAL_SD_N_M_S,
    Reduced,
    TelemetryTerms,
    covariance_beside_wheels,
    covariance_of_wheels,
    measured_weights,
    unknown_weights,
)
from cassini_bayes.terms import RAD_S_PER_RPM

Array = NDArray[np.float64]
_THRUST_SPREAD: Final = 0.3  # of thrusts about their level, where slow modes place them


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
    kept: tuple[Array, ...]  # (n, W, W) of every band, the slow one first


def event_system(
    terms: TelemetryTerms,
    physics: Physics,
    parameters: Mapping[str, Array],
    thrust_n: float,
    torque_mean: Array,
    torque_sd: Array,
) -> EventSystem:
    """Normal equations and determinants of one event at a batch of points.

    Parameters
    ----------
    physics
        The physics at n points.
    parameters
        Noise levels, name → (n,) array.
    thrust_n
        Thrust that scales the cut tails (they are small).
    torque_mean, torque_sd
        (3,) prior of the event's steady torque, N m.
    """
    n, k, reduced = len(physics.inertia_kg_m2), terms.pattern.thrusters, terms.reduced
    wheels = physics.wheel_weights[..., list(terms.wheel_places)]
    weights, cut_sd = unknown_weights(terms, physics, n, thrust_n)
    weights[:, terms.pattern.start[-2] :] = measured_weights(terms, physics, wheels)
    used = np.ascontiguousarray(weights[:, reduced.entries])
    known_sd = np.broadcast_to([INITIAL_SD_N_M_S] * 3 + list(torque_sd), (n, 6))
    own_sd = np.concatenate([known_sd, cut_sd], axis=1)
    own_mean = np.concatenate([terms.initial_mean_n_m_s, torque_mean, np.zeros(cut_sd.shape[1])])
    walk = parameters["torque_noise_n_m_s05"] ** 2
    beside = covariance_beside_wheels(terms, physics, parameters)

    kept, log_density = latent_wheels(terms.slow, parameters)
    estimates = [kept]
    seen = wheels @ kept
    _set_wheels(reduced, used, seen)
    noise = beside + covariance_of_wheels(parameters, seen, wheels)
    values, vectors = np.linalg.eigh(noise)
    variance = values[:, :, None] + (walk[:, None] * terms.slow.walk)[:, None, :]
    normal = explained_by_modes(
        reduced.slow, reduced.row, reduced.start, used, vectors, 1.0 / variance
    )
    log_scale = log_density - 0.5 * np.log(variance).sum((-2, -1))

    lacking = None
    if any(band.motion is not None for band in terms.fast):
        prior = (np.r_[np.full(k, thrust_n), own_mean], own_sd, _THRUST_SPREAD * thrust_n)
        lacking = _lacking_momentum(reduced, used, normal, prior)
    for band, gram in zip(terms.fast, reduced.grams, strict=True):
        other = beside + (walk * band.walk.mean())[:, None, None] * np.eye(3)
        if band.motion is None:
            kept = np.broadcast_to(np.eye(wheels.shape[-1]), estimates[0].shape)
        else:
            assert lacking is not None  # where a band has motion
            products = moments(gram, reduced.wheels, lacking) / band.rows
            variance = (parameters["wheel_noise_rpm"] * RAD_S_PER_RPM) ** 2
            kept, log_density = estimated_wheels(band, products, other, wheels, variance)
            log_scale = log_scale + log_density
        estimates.append(kept)
        seen = wheels @ kept
        _set_wheels(reduced, used, seen)
        covariance = other + covariance_of_wheels(parameters, seen, wheels)
        if band.motion is None:
            log_scale = log_scale - 0.5 * band.rows * np.linalg.slogdet(covariance)[1]
        precision = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        normal = normal + contract(gram, reduced.row, reduced.start, used, precision)

    channels = 3 + len(terms.wheel_places)
    jacobian = np.linalg.slogdet(physics.momentum_per_rate)[1]
    rows = terms.statistics.rows
    log_scale = log_scale + rows * (jacobian - 0.5 * channels * np.log(2.0 * np.pi))
    return EventSystem(normal, log_scale, own_sd, own_mean, tuple(estimates))


def _lacking_momentum(
    reduced: Reduced, used: Array, normal: Array, prior: tuple[Array, Array, float]
) -> Array:
    """Column weights (n, 3, A') of the momentum that all but the wheels leaves to them.

    Unknowns are taken where the slow band and their priors (mean (P,), sd of the own ones (n, U),
    sd of thrusts) have them: good enough to tell how much the wheels move at higher frequencies.
    ``used`` are the weights (n, B', 3) of the entries.
    """
    mean, own_sd, thrust_sd = prior
    n = len(normal)
    thrusters = len(mean) - own_sd.shape[1]
    sd = np.concatenate([np.full((n, thrusters), thrust_sd), own_sd], axis=1)
    to_all = normal[:, :-1, :-1]
    precision = sd[:, :, None] * to_all * sd[:, None, :] + np.eye(len(mean))
    target = sd * (normal[:, :-1, -1] - to_all @ mean)
    at = mean + sd * np.linalg.solve(precision, target[..., None])[..., 0]
    signs = np.concatenate([at, np.full((n, 1), -1.0)], axis=1)[:, reduced.owner, None]
    signed = used * signs
    signed[:, reduced.wheel_entries] = 0.0
    return np.asarray(np.swapaxes(signed, -1, -2) @ reduced.scatter)


def _set_wheels(reduced: Reduced, used: Array, wheels: Array) -> None:
    """Give the entries (n, B', 3) of measured wheel rates the weights (n, 3, W)."""
    used[:, reduced.wheel_entries] = np.swapaxes(wheels, -1, -2)
