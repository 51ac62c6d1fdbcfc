"""The velocity change that the flight software computes on board, as a channel of its own.

ΔV = (F_table / M_table)(f u + o n) along the net commanded impulse, with u the net on-time, n the
pulses along it, f a factor and o the on-time added per pulse. Thrust, mass and tail-off in it are
the software's own: it holds no information on the true thrust. The channel is linear in f and o,
which are integrated out exactly given the noise and drawn back afterwards (walked, they form a
funnel with it that hardly mixes).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cassini_bayes.balance.totals_terms import TotalsStack
from cassini_bayes.computing.arrays import Array, Flags


@dataclass(frozen=True)
class ComputedDeltaV:
    """Printed ΔV of the events that declare a computed one, and its linear model.

    Coordinates w = (f, o) have independent normal priors; in units of their standard deviations the
    information matrix is rotation @ diag(eigenvalues) @ rotationᵀ over the noise variance.
    """

    used: Flags  # (E,)
    printed_m_s: Array  # (C,) along the net commanded impulse
    design: Array  # (C, 2)
    prior_mean: Array  # (2,)
    prior_sd: Array  # (2,)
    rotation: Array  # (2, 2)
    eigenvalues: Array  # (2,) (m/s)²
    projection: Array  # (2,) rotationᵀ × scaled designᵀ × misfit at the prior mean
    misfit_square: float


def computed_channel(
    stack: TotalsStack,
    directions: Array,
    used: Flags,
    prior_mean: Array,
    prior_sd: Array,
) -> ComputedDeltaV:
    """Assemble the channel for the events marked in ``used`` (E,); directions (3, K)."""
    net = stack.on_time_s[used] @ directions.T
    on_time = np.linalg.norm(net, axis=-1)
    unit = net / np.where(on_time > 0, on_time, 1.0)[:, None]
    pulses = np.einsum("ek,ck,ec->e", stack.pulses[used], directions, unit)
    acceleration = stack.thrust_predicted_n[used] / stack.mass_kg[used]
    design = acceleration[:, None] * np.stack([on_time, pulses], axis=-1)
    printed = np.einsum("ec,ec->e", stack.delta_v_m_s[used], unit)
    scaled = design * prior_sd
    eigenvalues, rotation = np.linalg.eigh(scaled.T @ scaled)
    misfit = printed - design @ prior_mean
    return ComputedDeltaV(
        used=used,
        printed_m_s=printed,
        design=design,
        prior_mean=prior_mean,
        prior_sd=prior_sd,
        rotation=np.asarray(rotation, dtype=np.float64),
        eigenvalues=np.maximum(np.asarray(eigenvalues, dtype=np.float64), 0.0),
        projection=np.asarray(rotation.T @ (scaled.T @ misfit), dtype=np.float64),
        misfit_square=float(misfit @ misfit),
    )


def channel_log_likelihood(channel: ComputedDeltaV, variance: Array) -> Array:
    """Log density of all printed ΔV with f and o integrated out; variance (...) of one figure."""
    noise = np.asarray(variance)[..., None]
    explained = (channel.projection**2 / (noise + channel.eigenvalues)).sum(-1)
    square = (channel.misfit_square - explained) / noise[..., 0]
    log_det = np.log1p(channel.eigenvalues / noise).sum(-1)
    count = len(channel.printed_m_s)
    return np.asarray(-0.5 * (square + log_det + count * np.log(2.0 * np.pi * noise[..., 0])))


def draw_software(channel: ComputedDeltaV, variance: Array, rng: np.random.Generator) -> Array:
    """One draw of (f, o) given the noise variance (n,) per point, shape (n, 2)."""
    noise = np.asarray(variance)[:, None]
    spread = np.sqrt(noise / (noise + channel.eigenvalues))
    centre = channel.projection / (noise + channel.eigenvalues)
    scaled = (centre + spread * rng.standard_normal((len(noise), 2))) @ channel.rotation.T
    return np.asarray(channel.prior_mean + channel.prior_sd * scaled)


def predicted_delta_v(channel: ComputedDeltaV, software: Array) -> Array:
    """Computed ΔV (n, C) in m/s at (f, o) of shape (n, 2), without noise."""
    return np.asarray(software @ channel.design.T)


def event_channel_log_likelihood(
    channel: ComputedDeltaV, software: Array, variance: Array
) -> Array:
    """Log density (n, E) of each event's printed ΔV given f, o and noise; 0 where not computed."""
    noise = np.asarray(variance)[:, None]
    misfit = channel.printed_m_s - predicted_delta_v(channel, software)
    density = np.zeros((len(software), len(channel.used)))
    density[:, channel.used] = -0.5 * (misfit**2 / noise + np.log(2.0 * np.pi * noise))
    return density
