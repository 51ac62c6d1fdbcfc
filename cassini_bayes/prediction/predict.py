"""The predictive distribution of one planned wheel bias, draw by draw, without a closed loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from typing import Final, Literal, get_args

import numpy as np

from cassini_bayes.balance.physics import effective_on_times
from cassini_bayes.balance.totals_terms import (
    hold_attitude_covariance,
    hold_rate_covariance,
    wheel_rounding_covariance,
)
from cassini_bayes.computing.arrays import Array
from cassini_bayes.prediction.demand import PairSolver
from cassini_bayes.prediction.firing import FiringDraws, draw_firing, mean_firing
from cassini_bayes.prediction.ground_knowledge import (
    DURATION_SD_S,
    group_impulse,
    hydrazine_g,
    hydrazine_variance,
)
from cassini_bayes.prediction.learning import Learned
from cassini_bayes.prediction.physics import (
    demand_of,
    features_of,
    momentum_per_rpm,
    solver_of,
    wheel_momentum,
)
from cassini_bayes.prediction.requests import BiasRequest
from cassini_bayes.prediction.wheel_profile import SETTLING_TIMES
from cassini_bayes.spacecraft import thruster_directions
from cassini_bayes.spacecraft.units import RPM_PER_RAD_S

Source = Literal[
    "limit cycle", "rates at the ends", "thrust and geometry", "thrust of the event", "on-board ΔV"
]
SOURCES: Final[tuple[Source, ...]] = get_args(Source)


@dataclass(frozen=True)
class Prediction:
    """Draws of everything asked of a bias; leading axis n.

    ``delta_v_computed_m_s`` is what the flight software will print, ``delta_v_delivered_m_s`` what
    the thrusters give the spacecraft; both in body axes, None without the ground's mass and thrust.
    ``hydrazine_g`` is the figure as printed (None where no event had one). ``powerless`` is the
    share of draws in which a thruster has no thrust, or less: the trend led them there.
    """

    request: BiasRequest
    epoch: datetime
    thrusters: tuple[str, ...]
    units: tuple[tuple[int, ...], ...]
    on_time_s: Array  # (n, K)
    pulses: Array  # (n, K)
    duration_s: Array  # (n,)
    delta_v_computed_m_s: Array | None  # (n, 3)
    delta_v_delivered_m_s: Array | None  # (n, 3)
    hydrazine_g: Array | None  # (n,)
    powerless: float

    def unit_on_time_s(self) -> Array:
        """On-times per printed unit (n, U): a pair of the couple axis counts once."""
        return self.on_time_s[:, [unit[0] for unit in self.units]]

    def unit_pulses(self) -> Array:
        """Pulses per printed unit (n, U)."""
        return self.pulses[:, [unit[0] for unit in self.units]]

    def unit_names(self) -> tuple[str, ...]:
        """``y1_y3`` for a pair, ``z1`` for a single thruster."""
        return tuple("_".join(self.thrusters[k] for k in unit) for unit in self.units)


def predict(
    learned: Learned,
    request: BiasRequest,
    rng: np.random.Generator,
    hold: frozenset[Source] = frozenset(),
) -> Prediction:
    """Draw the bias once per joint draw.

    Parameters
    ----------
    learned
        What past events taught.
    request
        Checked by :func:`.requests.check_request`.
    rng
        The same generator state gives the same draws.
    hold
        Sources of uncertainty held at their mean, for an error budget.
    """
    if "thrust and geometry" in hold:
        learned = replace(learned, physics=learned.physics.at_mean())
    model, physics = learned.model, learned.physics
    epoch = request.epoch or learned.last_epoch
    streams = rng.spawn(7)  # a source that is held leaves the draws of the others alone
    thrust = thrusts_at(learned, epoch, streams[0], still="thrust of the event" in hold)
    duration = _durations(learned, request, streams[1])
    on_time = _firings(learned, request, thrust, duration, streams[2:4], hold)
    pulses = _pulses(learned, on_time, streams[4])
    shape, balance = model.totals_rows.pulse_shape, physics.balance(model)
    effective = effective_on_times(shape, balance, on_time[:, None], pulses[:, None])[:, 0]
    return Prediction(
        request=request,
        epoch=epoch,
        thrusters=model.thrusters,
        units=learned.layout.units,
        on_time_s=on_time,
        pulses=pulses,
        duration_s=duration,
        delta_v_computed_m_s=_computed(
            learned, epoch, on_time, pulses, streams[5], still="on-board ΔV" in hold
        ),
        delta_v_delivered_m_s=_delivered(learned, epoch, thrust * effective),
        hydrazine_g=_hydrazine(learned, thrust, effective, streams[6]),
        powerless=float((thrust <= 0.0).any(1).mean()),
    )


def _firings(
    learned: Learned,
    request: BiasRequest,
    thrust: Array,
    duration: Array,
    streams: list[np.random.Generator],
    hold: frozenset[Source],
) -> Array:
    """On-times (n, K)."""
    model, physics, n = learned.model, learned.physics, learned.size
    solver = solver_of(model, physics, thrust, learned.pulses.coefficients[:, 0])
    rates = (request.start_rpm, request.end_rpm)
    demand = demand_of(model, physics, learned.manager, request.wheels, rates, duration)
    features = features_of(model, solver, demand, duration)
    ends = wheel_momentum(model, physics, request.wheels, np.stack(rates))
    impulse = demand.sum(1)
    noise = _momentum_noise(learned, request, ends, duration, streams[0])
    if "rates at the ends" not in hold:
        impulse = impulse + noise
    drawn = draw_firing(learned.firing, features, streams[1], learned.layout.cycle_s)
    if "limit cycle" in hold:
        mean = {k: np.full(n, np.mean(v)) for k, v in learned.firing.items()}
        drawn = mean_firing(mean, features, learned.layout.cycle_s)
    return on_times_of(learned, solver, impulse, drawn)


def thrusts_at(
    learned: Learned, epoch: datetime, rng: np.random.Generator, *, still: bool
) -> Array:
    """Thrusts (n, K), N, of a new event: level, trend of the printed thrust, own departures.

    ``still``: without departures, and with the trend's mean.
    """
    loading = learned.model.thrust_prior.departures
    moved = learned.thrust_moved_n(epoch)
    departure = rng.standard_normal((learned.size, loading.shape[1])) @ loading.T
    if still:
        departure, moved = np.zeros_like(departure), np.full_like(moved, moved.mean())
    level = learned.physics.delivered_n(learned.model)
    return np.asarray(level + moved[:, None] + departure)


def _durations(learned: Learned, request: BiasRequest, rng: np.random.Generator) -> Array:
    """Durations (n,): the slowest wheel's ramp and the settling, with the figures' scatter."""
    draws = learned.manager_draws
    change = np.abs(request.end_rpm - request.start_rpm)
    columns = [learned.ramp_wheels.index(number) for number in request.wheels]
    ramps = draws.coefficients[:, columns] * change
    loop = draws.coefficients[:, -1]
    linear = np.maximum(ramps.max(-1) - loop, 0.0)
    scatter = DURATION_SD_S * np.sqrt(draws.scale_square) * rng.standard_normal(learned.size)
    return np.asarray(np.maximum(linear + SETTLING_TIMES * loop + scatter, 1.0))


def _momentum_noise(
    learned: Learned,
    request: BiasRequest,
    ends: Array,
    duration_s: Array,
    rng: np.random.Generator,
) -> Array:
    """What the dead-band leaves at both ends, the rates' step, less the external torque: (n, 3)."""
    model, p = learned.model, learned.physics.parameters
    inertia = learned.physics.balance(model).inertia_kg_m2
    covariance = hold_rate_covariance(inertia, np.asarray(p["hold_rate_rad_s"]))
    covariance = np.broadcast_to(covariance, (learned.size, 3, 3))
    start, end = ends[:, :1], ends[:, 1:]
    attitude = np.asarray(p["hold_attitude_rad"])
    covariance = covariance + hold_attitude_covariance(start, end, attitude)[:, 0]
    prime = np.array([[w.number in request.wheels for w in model.spacecraft.wheels]])
    per_rpm = momentum_per_rpm(model, learned.physics)
    unit = np.full(per_rpm.shape[-1], RPM_PER_RAD_S)
    step = np.asarray(p["wheel_resolution_rpm"])
    covariance = covariance + wheel_rounding_covariance(per_rpm, unit, prime, step)[:, 0]
    factor = np.linalg.cholesky(covariance + 1e-12 * np.eye(3))
    normals = rng.standard_normal((2, learned.size, 3))
    torque = model.torque_mean_n_m + model.torque_sd_n_m * normals[1]
    return np.asarray((factor @ normals[0][..., None])[..., 0] - torque * duration_s[:, None])


def on_times_of(learned: Learned, solver: PairSolver, impulse: Array, drawn: FiringDraws) -> Array:
    """On-times (n, K): opposing sides, the shared thruster alone, the rest one-sidedly."""
    layout, n = learned.layout, learned.size
    a, b = layout.ring_axes
    both = np.zeros((n, 6))
    for axis in (a, b):
        both[:, 2 * axis : 2 * axis + 2] = 0.5 * drawn.minor_ring_s[:, None]
    c = layout.couple_axis
    both[:, 2 * c : 2 * c + 2] = drawn.minor_couple_s[:, None]
    rest = impulse - (solver.torque @ both[..., None])[..., 0]
    first = solver.on_times(rest[:, None])[:, 0]
    signs = [np.where(first[:, 2 * axis] >= first[:, 2 * axis + 1], 0, 1) for axis in (a, b)]
    common = layout.ring[signs[0], signs[1]]
    draw = np.arange(n)
    alone = np.minimum(drawn.shared_s, first[:, 2 * a] + first[:, 2 * a + 1])
    rest = rest - solver.each[draw, :, common] * alone[:, None]
    pairs = both + solver.on_times(rest[:, None])[:, 0]
    on_time = pairs @ layout.pairs
    on_time[draw, common] += alone
    return np.asarray(on_time)


def _pulses(learned: Learned, on_time: Array, rng: np.random.Generator) -> Array:
    """Pulse counts (n, K): r u with variance φ r u, whole, at least one where it fired."""
    mean = learned.pulses.coefficients[:, :1] * on_time
    spread = np.sqrt(learned.pulses.scale_square[:, None] * mean)
    counts = np.rint(mean + spread * rng.standard_normal(mean.shape))
    for unit in learned.layout.units:
        counts[:, list(unit)] = counts[:, [unit[0]]]
    return np.asarray(np.where(on_time > 0.0, np.maximum(counts, 1.0), 0.0))


def _computed(
    learned: Learned,
    epoch: datetime,
    on_time: Array,
    pulses: Array,
    rng: np.random.Generator,
    *,
    still: bool,
) -> Array | None:
    """ΔV of the on-board computation: (F/M)(f u + o n) along the thrust, and lateral scatter."""
    if learned.acceleration is None or learned.model.totals_rows.computed is None:
        return None
    directions = thruster_directions(learned.model.spacecraft, learned.model.branch)
    software = learned.physics.software
    normals = rng.standard_normal((learned.size, 5))  # thrust over mass, along it, and X, Y, Z
    scatter = learned.acceleration.scatter * normals[:, 0]
    acceleration = learned.acceleration.at(epoch) + scatter
    noise = np.asarray(learned.physics.parameters["delta_v_noise_m_s"]) * normals[:, 1]
    lateral = np.sqrt(learned.lateral_square)[:, None] * normals[:, 2:]
    if still:
        software = np.broadcast_to(software.mean(0), software.shape)
        acceleration = np.full_like(acceleration, acceleration.mean())
        noise, lateral = np.zeros_like(noise), np.zeros_like(lateral)
    weighted = software[:, :1] * on_time + software[:, 1:] * pulses
    net = acceleration[:, None] * (weighted @ directions.T)
    unit = net / np.maximum(np.linalg.norm(net, axis=-1, keepdims=True), 1e-15)
    across = lateral - unit * (lateral * unit).sum(-1, keepdims=True)
    return np.asarray(net + unit * noise[:, None] + across)


def _delivered(learned: Learned, epoch: datetime, impulse: Array) -> Array | None:
    """ΔV that the thrusters deliver: Σ d F s / M, M the table mass times its factor."""
    if learned.mass is None:
        return None
    directions = thruster_directions(learned.model.spacecraft, learned.model.branch)
    factor = np.asarray(learned.physics.parameters.get("mass_factor", 1.0))
    mass = factor * learned.mass.at(epoch)
    return np.asarray(impulse @ directions.T / np.broadcast_to(mass, (learned.size,))[:, None])


def _hydrazine(
    learned: Learned, thrust: Array, effective: Array, rng: np.random.Generator
) -> Array | None:
    if learned.hydrazine is None:
        return None
    total, couple = group_impulse(learned.layout, thrust, effective)
    grams = np.maximum(hydrazine_g(learned.hydrazine.coefficients, total, couple), 0.0)
    spread = np.sqrt(learned.hydrazine.scale_square * hydrazine_variance(grams))
    return np.asarray(np.maximum(grams + spread * rng.standard_normal(learned.size), 0.0))
