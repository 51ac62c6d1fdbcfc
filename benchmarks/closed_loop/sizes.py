"""How many σ a hidden effect stands out by, whatever the unknowns of the baseline make of it.

On the flight that has the effect, seen without noise, the balance of momentum at the parameters
without the effect leaves δ. With the noise of the rows whitened and X the slopes of the balance
along each parameter of the baseline times the width of its prior, σ² = δᵀ(1 + X Xᵀ)⁻¹ δ. Rate bias
and rate scale hide in the balance (in the initial momentum, in the inertia): theirs comes from
attitudes against rates. Between firings attitudes tell rates as well, and better: a straight line
through them for T seconds has a slope as rates of noise σ_θ √12/T in every row would give it. No
line shows a swing: of one with angular frequency Ω attitudes tell as rates of noise Ω σ_θ would.
Linear, and rough on purpose: it says whether a trial is a fair question, not what the answer is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from closed_loop.arrays import Array
from closed_loop.cassini import AXES, THRUSTERS, Table, Truth, spread
from closed_loop.flight import Flight
from closed_loop.hidden import Departures, Effect
from closed_loop.records import Channels
from closed_loop.valve import Valve

SETTLED_S = 0.6
"""After a firing, until a row counts: the tail has gone."""
LONGEST_S = 32.0
"""Of a line through attitudes: what lasts longer the balance says as well."""
_SLOPE_STEP = 0.02
_LEAST_WIDTH = 1e-9
_WIDE_N_M_S = 1e3
_VALVES = ("tau_rise_s", "tau_fall_s")


class Seen:
    """The rows of a flight that say something: what its channels would show without noise."""

    def __init__(self, flight: Flight, channels: Channels, departures: Departures) -> None:
        bias = flight.event.kind == "bias"
        step = math.lcm(channels.row_every_ms, channels.counter_every_ms if bias else 1)
        offset = round(1000.0 * departures.time_offset_s)
        at = flight.row_ms
        keep = at % step == 0
        for pulses in flight.pulses:
            for start, end in pulses:
                keep &= (at - offset < start) | (at - offset >= end + round(1000 * SETTLED_S))
        self.flight = flight
        fired = [0, *sorted(start for pulses in flight.pulses for start, _ in pulses), int(at[-1])]
        quiet = np.minimum(1e-3 * np.diff(fired), LONGEST_S)
        # most time is in the long pieces
        self.quiet_s = float(quiet @ quiet / quiet.sum())
        self.time_s = 1e-3 * at[keep]
        self.counted_s = self.time_s - departures.time_offset_s
        self.attitude = flight.attitude[keep]
        scale = np.array([1.0 + departures.rate_scale.get(axis, 0.0) for axis in AXES])
        bias_rad_s = np.array([departures.rate_bias_rad_s.get(axis, 0.0) for axis in AXES])
        self.rate = scale * flight.rate[keep] + bias_rad_s
        self.wheels = flight.wheels[keep]
        self.to_body = _rotations(self.attitude)
        self._effective: dict[tuple[float, float], Array] = {}

    def effective_s(self, rise_s: float, fall_s: float, delay_s: float) -> Array:
        """∫ κ dt of every thruster at every row, (n, 8), for given time constants."""
        key = (rise_s, fall_s)
        if key not in self._effective:
            columns = [
                Valve(pulses, delay_s, rise_s, fall_s).effective_s(self.counted_s)
                for pulses in self.flight.pulses
            ]
            self._effective[key] = np.stack(columns, axis=1)
        return self._effective[key]

    def balance(self, truth: Truth) -> Array:
        """What the balance of momentum leaves at every row, in body axes (n, 3)."""
        body = truth.body(self.flight.event.name)
        momentum = body.momentum(self.rate, self.wheels)
        torque = np.array([truth.parameters[f"external_torque_{axis}_n_m"] for axis in AXES])
        effective = self.effective_s(body.rise_s, body.fall_s, body.delay_s)
        impulse = np.diff(effective, axis=0) @ (body.torque_per_newton_m * body.thrust_n[:, None])
        impulse += np.diff(self.time_s)[:, None] * torque
        inertial = np.einsum("nji,nj->ni", self.to_body, momentum)
        middle = 0.5 * (self.to_body[1:] + self.to_body[:-1])
        inertial[1:] -= np.cumsum(np.einsum("nji,nj->ni", middle, impulse), axis=0)
        return np.einsum("nij,nj->ni", self.to_body, inertial - inertial[0])

    def noise(self, truth: Truth, channels: Channels, swing_hz: float = 0.0) -> Array:
        """Covariance of a row of the balance, (3, 3): that of rates, wheels and attitudes.

        ``swing_hz``: of what is hidden, where it swings.
        """
        body = truth.body(self.flight.event.name)
        gyro = channels.rate_noise_rad_s**2 + channels.rate_step_rad_s**2 / 12.0
        per_s = max(math.sqrt(12.0) / self.quiet_s, 2.0 * math.pi * swing_hz)
        rate = 1.0 / (1.0 / gyro + 1.0 / (per_s * channels.attitude_noise_rad) ** 2)
        rpm = channels.wheel_noise_rpm**2 + channels.wheel_step_rpm**2 / 12.0
        wheel = (2.0 * np.pi / 60.0) ** 2 * rpm
        arms = body.wheel_axes * body.wheel_inertia_kg_m2
        momentum = body.momentum(self.rate, self.wheels)
        square = np.mean(np.sum(momentum**2, axis=1))
        turned = square * np.eye(3) - np.mean(momentum[:, :, None] * momentum[:, None, :], axis=0)
        return np.asarray(
            rate * body.inertia_kg_m2 @ body.inertia_kg_m2.T
            + wheel * arms @ arms.T
            + channels.attitude_noise_rad**2 * turned
        )


def sigma(
    flights: Sequence[Flight],
    baseline: Truth,
    effects: Sequence[Effect],
    departures: Departures,
    channels: Channels,
    priors: Table,
) -> float:
    """σ of what is hidden in flights that have it; ``baseline`` is the truth without it."""
    square = 0.0
    if any(effect.kind in ("rate_bias", "rate_scale") for effect in effects):
        return math.sqrt(sum(_kinematic(flight, departures, channels) for flight in flights))
    seen = [Seen(flight, channels, departures) for flight in flights]
    swings = (effect.parameters.get("frequency_hz", 0.0) for effect in effects)
    swing_hz = max(swings, default=0.0)
    noises = [s.noise(baseline, channels, swing_hz) for s in seen]
    whiteners = [np.linalg.inv(np.linalg.cholesky(noise)) for noise in noises]

    def stacked(truth: Truth) -> Array:
        rows = [s.balance(truth) @ w.T for s, w in zip(seen, whiteners, strict=True)]
        return np.concatenate([r.ravel() for r in rows])

    left = stacked(baseline)
    columns = [
        (stacked(up) - stacked(down)) / (2.0 * _SLOPE_STEP)
        for up, down in _moved(baseline, [f.event.name for f in flights], priors)
    ]
    columns += _initial_momenta(seen, whiteners)
    slopes = np.stack(columns, axis=1)
    inner = np.eye(slopes.shape[1]) + slopes.T @ slopes
    along = slopes.T @ left
    square += float(left @ left - along @ np.linalg.solve(inner, along))
    return math.sqrt(max(square, 0.0))


def _moved(baseline: Truth, events: Sequence[str], priors: Table) -> list[tuple[Truth, Truth]]:
    """The truth with each unknown of the baseline a little up and down, in prior widths."""
    tables: Mapping[str, Table] = priors["parameters"]
    moves: list[tuple[Truth, Truth]] = []
    for name, value in baseline.parameters.items():
        if not name.startswith(("cm_", "thruster_l", "rwa", "inertia_", "external_", *_VALVES)):
            continue
        step = _SLOPE_STEP * spread(tables[name])
        if step > _LEAST_WIDTH * abs(value) * _SLOPE_STEP and step > 0.0:
            moves.append(
                (baseline.changed({name: value + step}), baseline.changed({name: value - step}))
            )

    def thrust(part: str, names: Sequence[str], where: Sequence[str]) -> None:
        step = _SLOPE_STEP * spread(tables[f"thrust_{part}_n"])
        up, down = (_lifted(baseline, names, where, sign * step) for sign in (1.0, -1.0))
        moves.append((up, down))

    thrust("common", THRUSTERS, events)
    for name in THRUSTERS:
        thrust("individual", [name], events)
    for event in events:
        thrust("event", THRUSTERS, [event])
        for name in THRUSTERS:
            thrust("jitter", [name], [event])
    return moves


def _lifted(truth: Truth, names: Sequence[str], events: Sequence[str], step: float) -> Truth:
    """The truth with some thrusts higher in some events."""
    return Truth(
        truth.wheels,
        truth.parameters,
        {
            event: {
                k: value + (step if k in names and event in events else 0.0)
                for k, value in thrusts.items()
            }
            for event, thrusts in truth.thrust_n.items()
        },
    )


def _initial_momenta(seen: Sequence[Seen], whiteners: Sequence[Array]) -> list[Array]:
    """Whitened columns of each event's unknown initial momentum."""
    rows = [3 * len(s.time_s) for s in seen]
    starts = np.concatenate([[0], np.cumsum(rows)])
    columns = []
    for s, w, start, size in zip(seen, whiteners, starts, rows, strict=False):
        for axis in range(3):
            column = np.zeros(starts[-1])
            part = np.einsum("nij,j->ni", s.to_body, np.eye(3)[axis]) @ w.T
            column[start : start + size] = _WIDE_N_M_S * part.ravel()
            columns.append(column)
    return columns


def _kinematic(flight: Flight, departures: Departures, channels: Channels) -> float:
    """σ² of rate bias and scale in one event: the noisier of attitudes and rates decides."""
    keep = flight.row_ms % channels.row_every_ms == 0
    time_s, rate = 1e-3 * flight.row_ms[keep], flight.rate[keep]
    step = 1e-3 * channels.row_every_ms
    total = 0.0
    for j, axis in enumerate(AXES):
        wrong = departures.rate_scale.get(axis, 0.0) * rate[:, j]
        wrong = wrong + departures.rate_bias_rad_s.get(axis, 0.0)
        turned = np.cumsum(wrong) * step
        turned = turned - turned.mean()
        by_attitude = float(turned @ turned) / channels.attitude_noise_rad**2
        by_rate = float(wrong @ wrong) / (
            channels.rate_noise_rad_s**2 + channels.rate_step_rad_s**2 / 12.0
        )
        if by_attitude > 0.0 and len(time_s) > 1:
            total += 1.0 / (1.0 / by_attitude + 1.0 / by_rate)
    return total


def _rotations(attitude: Array) -> Array:
    """Inertial-to-body matrices (n, 3, 3): (q4² − q·q) 1 + 2 q qᵀ − 2 q4 [q×]."""
    x, y, z, w = attitude.T
    zero = np.zeros_like(x)
    vector = attitude[:, :3]
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    scalar = (w**2 - np.sum(vector**2, axis=1))[:, None, None]
    outer = vector[:, :, None] * vector[:, None, :]
    return np.asarray(scalar * np.eye(3) + 2.0 * outer - 2.0 * w[:, None, None] * cross)
