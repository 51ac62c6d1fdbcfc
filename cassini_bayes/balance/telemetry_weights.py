"""Weights of a telemetry event's columns at parameter points: what makes momentum of them.

Columns are those of :mod:`cassini_bayes.balance.statistics.columns`, their order that of the
event's pattern (:class:`.Pattern`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.kernel import turned_weights
from cassini_bayes.balance.open_counters import OpenScales
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.statistics.layout import CUT_COLUMNS
from cassini_bayes.balance.statistics.walk import walk_scales
from cassini_bayes.balance.telemetry_balance import Reduced, TelemetryBalance
from cassini_bayes.balance.telemetry_noise import open_scales
from cassini_bayes.computing.arrays import Array

SHARE_SPREAD: Final = 0.5  # relative sd of a couple's share of close pulses about that of all


def without_idle_columns(
    event: TelemetryBalance, physics: Physics, *, walks: bool
) -> TelemetryBalance:
    """The same event without the columns whose weights vanish at every one of a few points.

    ``physics`` holds parameter points in general position, (n, …); ``walks`` tells whether there is
    torque noise. Likelihood calls cost half as much without idle columns.
    """
    pattern = event.pattern
    used = np.any(balance_weights(event, physics) != 0.0, axis=(0, 2))
    used[pattern.turns] = len(event.turns) > 0  # without weight in rows
    entries = np.flatnonzero(used)
    # in the order in which the unknowns need them: inner products are symmetric
    columns, first = np.unique(pattern.row[entries], return_index=True)
    columns = columns[np.argsort(first)]
    if walks:
        columns = np.r_[event.reduced.walk, columns]
    place = np.empty(event.statistics.layout.size, dtype=np.int64)
    place[columns] = np.arange(len(columns))
    counts = np.bincount(pattern.owner[entries], minlength=len(pattern.start) - 1)
    full, turned = event.reduced, np.flatnonzero(used[pattern.turned])
    reduced = Reduced(
        entries=entries,
        columns=columns,
        row=place[pattern.row[entries]],
        start=np.concatenate([[0], np.cumsum(counts)]),
        wheels=np.searchsorted(entries, pattern.wheels),
        turned=turned,
        turned_entries=np.searchsorted(entries, pattern.turned[turned]),
        walk=place[full.walk] if walks else full.walk[:0],
    )
    return replace(event, reduced=reduced)


def balance_weights(
    event: TelemetryBalance,
    physics: Physics,
    kept: Array | None = None,
    scales: OpenScales | None = None,
) -> Array:
    """Weights (n, B, 3) of all entries of the pattern, in its order, at a batch of n points.

    The measured momentum is that of the measured rates and wheels, or with the matrices ``kept``
    (n, W, W) of a band that of the estimate of the true wheel rates. For residuals and their
    derivatives: the same columns and weights that the likelihood has. ``scales`` are those of
    :func:`.open_scales`, where they are known.
    """
    wheels = event.wheel_weights(physics)
    if kept is not None:
        wheels = wheels @ kept
    weights = _unknown_weights(event, physics, scales or open_scales(event, physics))
    weights[:, event.pattern.start[-2] :] = _measured_weights(event, physics, wheels)
    return weights


def turn_weights(event: TelemetryBalance, physics: Physics, weights: Array, gain: Array) -> Array:
    """Weights (n, T, 7, 3) of the entries ``turned`` of the pattern for integrated columns.

    All others have those of rows, ``weights`` (n, B, 3); ``gain`` (n, T, 3, 3) is of the bands.
    Turns of the body need no gyro; where rates and turns err alike, by which both differ from each
    other tells the error of each: (1 + Q) I Θ − Q I (∫ω_m dt − ∫b dt)/(1 + s) + all else.
    """
    # in rows they are those of the gyro's momentum, per rate and per its bias
    of_gyro = weights[:, event.pattern.turned[:4]]
    inertia = np.ascontiguousarray(physics.inertia_kg_m2)
    return turned_weights(of_gyro, inertia, np.ascontiguousarray(gain))


def walk_weights(event: TelemetryBalance, parameters: Mapping[str, Array]) -> Array:
    """Weights (n, 3 D, 3) of the slowest cosines of torque noise, for standard normals.

    Every cosine has one unknown per inertial axis. It is in rows and in turns alike, which as two
    noises would seem to tell the same thing independently (docs/topics/telemetry-likelihood.md §8).
    """
    cosines = len(event.reduced.walk) // 3
    if cosines == 0:
        return np.zeros((len(parameters["torque_noise_n_m_s05"]), 0, 3))
    scale = np.repeat(walk_scales(event.statistics.duration_s, cosines)[1:], 3)
    return np.multiply.outer(parameters["torque_noise_n_m_s05"], np.tile(scale[:, None], 3))


def _measured_weights(event: TelemetryBalance, physics: Physics, wheels: Array) -> Array:
    """Weights of the measured momentum's entries, in their order; turns have none in rows.

    What a steady torque or an effect's own column puts in is taken off the measured momentum.
    """
    n, by_rate = len(wheels), physics.momentum_per_rate
    bias = np.broadcast_to(physics.rate_bias_rad_s, (n, 3))
    shift = by_rate @ bias[..., None]
    torque = -np.broadcast_to(physics.steady_torque_n_m, (n, 3))
    extra = [-np.broadcast_to(physics.extra.get(name, 0.0), (n, 3)) for name in event.extra]
    return np.concatenate(
        [
            np.swapaxes(by_rate, -1, -2),
            -shift[..., 0][:, None],
            np.swapaxes(wheels, -1, -2),
            np.zeros((n, 3, 3)),
            np.repeat(torque[:, :, None], 3, axis=2),
            *(weight[:, None] for weight in extra),
        ],
        axis=1,
    )


def _unknown_weights(event: TelemetryBalance, physics: Physics, scales: OpenScales) -> Array:
    """Weights (n, B, 3) of the unknowns' entries."""
    pattern, places, n = event.pattern, event.unknowns, len(physics.inertia_kg_m2)
    weights = np.zeros((n, len(pattern.row), 3))
    k = pattern.thrusters
    tails = pattern.start[places.tails.start]
    weights[:, pattern.start[places.initial.start] : tails] = 1.0
    if k > 0:
        arms = np.broadcast_to(physics.arms_m, (n, 3, k))
        own = np.broadcast_to(physics.impulse_offset_s, (n, k))
        arm = np.swapaxes(arms, -1, -2)
        pulse = event.sampling.pulses.of_thrusters(physics.tau_s, own)
        fired = arm[..., :, None] * pulse[:, :, None, :]
        weights[:, pattern.fired] = fired.reshape(n, -1, 1)
        weights[:, pattern.lost] = -scales.lost.mean_s[:, None, None] * arm[:, pattern.lost_by]
        for entry, thruster, name in pattern.brought:
            if name in physics.extra:
                on_time = np.asarray(physics.extra[name])
                weights[:, entry] = on_time[:, None] * arm[:, thruster]
        couples = np.swapaxes(scales.torque_n_m[:, :, pattern.hiding], -1, -2)
        unit = hidden_unit_s(event, scales)
        weights[:, tails : tails + pattern.hidden] = unit[..., None] * couples
    return weights


def own_prior(
    event: TelemetryBalance, torque_mean_n_m: Array, torque_sd_n_m: Array
) -> tuple[Array, Array]:
    """Prior mean and sd (U,) of the event's own unknowns, independent normals."""
    tails = np.ones(event.pattern.hidden)  # in units of their sd
    return (
        np.concatenate([event.initial_mean_n_m_s, torque_mean_n_m, np.zeros(len(tails))]),
        np.concatenate([np.full(3, event.initial_sd_n_m_s), torque_sd_n_m, tails]),
    )


def hidden_unit_s(event: TelemetryBalance, scales: OpenScales) -> Array:
    """What counters hide per standard deviation of every unknown (n, S + L), over their columns.

    Of a couple's departure from the share of close pairs: half of what is lost on average. Of a
    part of the event: the scatter of its pairs and unlike pulses, over how many there are. Of a
    rounding: what its pulses gain per on-time.
    """
    pattern = event.pattern
    places = np.array(pattern.cuts, dtype=np.int64)
    of_all = SHARE_SPREAD * scales.lost.mean_s[:, None]
    variance = scales.variance_s2(pattern.cut_pairs, pattern.cut_unlike)
    of_part = np.sqrt(variance) / event.statistics.cuts[places]
    of_cuts = np.where(places % CUT_COLUMNS == 0, of_all, of_part)
    return np.concatenate([of_cuts, event.pattern.level_units(scales.pulse_weights)], axis=1)
