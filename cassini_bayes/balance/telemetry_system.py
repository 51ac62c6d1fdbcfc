"""Normal equations of one telemetry event: its Gram matrices with the noise whitened away.

The likelihood is that of the measured channels with the true wheel rates as latent variables:
docs/topics/telemetry-likelihood.md §2 and §3. Columns and weights are those of
:mod:`cassini_bayes.balance.telemetry_weights`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.balance.flat_motion import log_measure
from cassini_bayes.balance.kernel import Noise, Placed, normal_equations, without_first
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.telemetry_balance import TelemetryBalance
from cassini_bayes.balance.telemetry_noise import (
    band_covariances,
    channel_variances,
    open_counters,
    open_scales,
    turn_noise,
)
from cassini_bayes.balance.telemetry_weights import (
    balance_weights,
    own_prior,
    turn_weights,
    walk_weights,
)
from cassini_bayes.computing.arrays import Array

_THRUST_SPREAD: Final = 0.3  # of thrusts about their level, where slow modes place them


@dataclass(frozen=True)
class EventSystem:
    """Normal equations of one telemetry event at a batch of points, the noise whitened away.

    ``normal`` (n, P, P) are inner products over all rows of the columns of the unknowns, the
    measured momentum last, slow torque noise integrated out; ``log_scale`` (n,) gathers every
    determinant. The priors of the initial
    momentum, torque and cut tails are N(own_mean, own_sd²).
    """

    normal: Array
    log_scale: Array
    own_sd: Array  # (n, U)
    own_mean: Array  # (U,)
    kept: Array  # (n, F, W, W) of every fast band


def event_system(
    event: TelemetryBalance,
    physics: Physics,
    parameters: Mapping[str, Array],
    torque_mean: Array,
    torque_sd: Array,
) -> EventSystem:
    """Normal equations and determinants of one event at a batch of points.

    Parameters
    ----------
    physics
        The physics at n points.
    parameters
        Noise, name → (n,) array: standard deviations, and of torque the root of its density.
    torque_mean, torque_sd
        (3,) prior of the event's steady torque, N m.
    """
    n, k = len(physics.inertia_kg_m2), event.pattern.thrusters
    reduced, bands = event.reduced, event.bands
    variances = channel_variances(event, parameters)
    scales = open_scales(event, physics)
    weights = balance_weights(event, physics, scales=scales)
    own_mean, sd = own_prior(event, torque_mean, torque_sd)
    own_sd = np.tile(sd, (n, 1))
    left_open = open_counters(event, physics, scales)
    faster = [band.faster_s3 for band in event.turns]
    by_turn = turn_noise(event, physics, variances, left_open.turns, faster)
    walk = walk_weights(event, parameters)
    noise = Noise(
        np.ascontiguousarray(event.wheel_weights(physics)),
        band_covariances(event, physics, variances, left_open.rows),
        variances.wheels,
        variances.turns.torque,
        by_turn.covariance,
    )
    normals = walk.shape[1]
    mean = np.zeros((n, normals + k + len(own_mean)))
    mean[:, normals : normals + k] = event.thrusts_n
    mean[:, normals + k :] = own_mean
    spread = _THRUST_SPREAD * event.thrusts_n.mean() if k > 0 else 0.0
    placed = Placed(normals, mean, spread, own_sd)
    used = np.concatenate([walk, weights[:, reduced.entries]], axis=1)
    turned = turn_weights(event, physics, weights, by_turn.gain)[:, :, reduced.turned]
    normal, log_scale, kept = normal_equations(
        used,
        np.ascontiguousarray(turned),
        noise,
        reduced.places,
        bands.slow,
        bands.fast,
        bands.turns,
        placed,
    )
    if normals > 0:
        normal, log_scale = without_first(normal, normals, log_scale)
    log_scale += log_measure(event, physics, by_turn)
    # of the channels' densities: rates and wheels of every row, turns of every contrast
    contrasts = sum(band.contrasts for band in event.turns)
    channels = event.statistics.rows * (3 + len(event.wheel_places)) + 3 * contrasts
    log_scale -= 0.5 * channels * np.log(2.0 * np.pi)
    return EventSystem(normal, log_scale, own_sd, own_mean, kept)
