"""One event in closed loop: cycles of control, edges of valves, samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from closed_loop.arrays import Array
from closed_loop.cassini import THRUSTERS, Body, Truth
from closed_loop.hidden import Departures, leak_force
from closed_loop.thruster_control import CYCLE_MS, Law
from closed_loop.valve import Firing, Pulses, merged
from closed_loop.vehicle import State, Vehicle, WheelDrag
from closed_loop.wheel_control import AttitudeByWheels, Ramp, Turn, angles, product

NS_PER_MS = 1_000_000
_WARMUP_STEP_MS = 25


@dataclass(frozen=True)
class Knowledge:
    """What controllers believe: errors of attitude and rate in each cycle (1 σ), and inertia."""

    attitude_rad: float
    rate_rad_s: float
    inertia_factor: float


@dataclass(frozen=True)
class Event:
    """What is to be flown.

    Attributes
    ----------
    duration_ms
        From the first row to the last.
    phase_ms
        From the control cycle before the first row to that row.
    ramp, law
        Of a bias; ``start`` holds its attitude errors and rates about ``target``.
    turns
        Of an event under wheel control.
    """

    name: str
    kind: str
    epoch: str
    duration_ms: int
    phase_ms: int
    target: tuple[float, float, float, float]
    start: State
    ramp: Ramp | None
    law: Law | None
    turns: tuple[Turn, ...]
    wheel_limit_n_m: float
    bandwidth_rad_s: float
    damping: float


@dataclass(frozen=True, eq=False)
class Flight:
    """What happened, without noise; times in ms since the first row.

    ``attitude`` (n, 4), ``rate`` and ``wheels`` (n, 3, rad/s) at ``row_ms``; ``pulses`` as
    commanded, one tuple a thruster.
    """

    event: Event
    body: Body
    row_ms: NDArray[np.int64]
    attitude: Array
    rate: Array
    wheels: Array
    pulses: tuple[Pulses, ...]


class Valves:
    """Edges still to come of every valve."""

    def __init__(self, body: Body, longer_s: float) -> None:
        self._delay = round(1e9 * body.delay_s)
        self._longer = round(1e9 * longer_s)
        self._open: list[list[list[int]]] = [[] for _ in THRUSTERS]

    def add(self, firing: Firing) -> None:
        """A command; one that comes before the valve has closed keeps it open."""
        opens = firing.start_ms * NS_PER_MS + self._delay
        closes = opens + firing.width_ms * NS_PER_MS + self._longer
        waiting = self._open[firing.thruster]
        if waiting and opens <= waiting[-1][1]:
            waiting[-1][1] = max(waiting[-1][1], closes)
        else:
            waiting.append([opens, closes])

    def next_edge(self, now_ns: int) -> int | None:
        """When the next valve moves."""
        times = [t for waiting in self._open for span in waiting[:2] for t in span if t > now_ns]
        return min(times, default=None)

    def is_open(self, now_ns: int) -> list[bool]:
        """Which valves are open from now on."""
        for waiting in self._open:
            while waiting and waiting[0][1] <= now_ns:
                waiting.pop(0)
        return [bool(waiting) and waiting[0][0] <= now_ns for waiting in self._open]


def fly(
    event: Event,
    truth: Truth,
    departures: Departures,
    knowledge: Knowledge,
    drag: WheelDrag | None,
    row_ms: Sequence[int],
    rng: np.random.Generator,
) -> Flight:
    """Fly an event and keep its motion at the times of its rows."""
    body = truth.body(event.name, departures.cants_rad)
    vehicle = Vehicle(
        body,
        event.start,
        slosh=departures.slosh,
        drag=drag,
        wheel_torque_n_m=event.wheel_limit_n_m,
        swirl_m=[departures.swirl_m.get(name, 0.0) for name in THRUSTERS],
    )
    cycles = math.ceil((event.duration_ms + event.phase_ms + 1) / CYCLE_MS)
    errors = rng.standard_normal((cycles, 6))
    errors *= np.repeat([knowledge.attitude_rad, knowledge.rate_rad_s], 3)
    run = _Run(event, truth, departures, body, vehicle)
    pilot = _Pilot(event, body, knowledge)
    samples = [event.phase_ms + int(t) for t in row_ms]
    states: list[State] = []
    for cycle in range(cycles):
        now_ms = cycle * CYCLE_MS
        motors, firings = pilot.command(vehicle.state(), errors[cycle].tolist(), now_ms)
        vehicle.set_motors(motors)
        run.disturb(now_ms)
        run.command(firings)
        while len(states) < len(samples) and samples[len(states)] < now_ms + CYCLE_MS:
            run.advance(samples[len(states)] * NS_PER_MS)
            states.append(vehicle.state())
        run.advance((now_ms + CYCLE_MS) * NS_PER_MS)
    attitude = np.array([state.attitude for state in states])
    phase = event.phase_ms
    return Flight(
        event,
        body,
        np.array(row_ms, dtype=np.int64),
        attitude,
        np.array([state.rate for state in states]),
        np.array([state.wheels for state in states]),
        tuple(
            merged(
                (f.start_ms - phase, f.start_ms + f.width_ms - phase)
                for f in run.firings
                if f.thruster == k
            )
            for k in range(len(THRUSTERS))
        ),
    )


class _Pilot:
    """Both controllers of an event, and what they believe."""

    def __init__(self, event: Event, body: Body, knowledge: Knowledge) -> None:
        self._event = event
        self._inertia = [knowledge.inertia_factor * value for value in body.wheel_inertia_kg_m2]
        self._thrusters = None if event.law is None else event.law.start()
        self._wheels = AttitudeByWheels(
            event.target,
            event.turns,
            knowledge.inertia_factor * body.inertia_kg_m2,
            body.wheel_axes,
            body.wheel_inertia_kg_m2,
            event.bandwidth_rad_s,
            event.damping,
        )

    def command(
        self, state: State, errors: Sequence[float], now_ms: int
    ) -> tuple[tuple[float, float, float], list[Firing]]:
        event, time_s = self._event, 1e-3 * now_ms
        rate = [value + error for value, error in zip(state.rate, errors[3:], strict=True)]
        if self._thrusters is None or event.ramp is None:
            a, b, c = (0.5 * error for error in errors[:3])
            seen = product(state.attitude, (a, b, c, 1.0))
            return self._wheels.torques(time_s, seen, rate, state.wheels), []
        off = angles(event.target, state.attitude)
        error = [value + noise for value, noise in zip(off, errors[:3], strict=True)]
        firings = []
        # no thruster fires before the first row, nor so late that a pulse would outlast the record
        if now_ms >= event.phase_ms and now_ms < event.phase_ms + event.duration_ms - 2_000:
            firings = self._thrusters.fire(error, rate, now_ms)
        motors = event.ramp.torques(time_s, state.wheels, self._inertia, event.wheel_limit_n_m)
        return motors, firings


class _Run:
    """Valves and disturbances of a vehicle on its way from stop to stop."""

    def __init__(
        self, event: Event, truth: Truth, departures: Departures, body: Body, vehicle: Vehicle
    ) -> None:
        self.firings: list[Firing] = []
        self._event, self._departures, self._body, self._vehicle = event, departures, body, vehicle
        self._valves = Valves(body, departures.pulse_longer_s)
        self._leak = leak_force(body.position_m, body.direction, departures.leaks_n)
        self._steady = np.array([truth.parameters[f"external_torque_{a}_n_m"] for a in "xyz"])
        self._on_ms = [0] * len(THRUSTERS)

    def disturb(self, now_ms: int) -> None:
        """External force and torque during the cycle that begins now."""
        share = (now_ms + 0.5 * CYCLE_MS - self._event.phase_ms) / self._event.duration_ms
        drift = np.array(self._departures.drift_peak_n_m) * (2.0 * share - 1.0)
        self._vehicle.set_external(self._leak[0], self._leak[1] + self._steady + drift)

    def command(self, firings: Sequence[Firing]) -> None:
        """Take the commands of a cycle.

        Raises
        ------
        ValueError
            A command that begins in the past, whose valve would never be seen to open.
        """
        for firing in firings:
            if firing.start_ms * NS_PER_MS < self._vehicle.now_ns:
                raise ValueError(f"a command at {firing.start_ms} ms, in the past: {firing}")
            self.firings.append(firing)
            self._valves.add(firing)

    def advance(self, until_ns: int) -> None:
        """Go from edge to edge."""
        vehicle = self._vehicle
        while vehicle.now_ns < until_ns:
            edge = self._valves.next_edge(vehicle.now_ns)
            stop = until_ns if edge is None else min(edge, until_ns)
            if self._departures.warmup_deficit:
                self._warm(stop)
            vehicle.advance(stop)
            if stop == edge:
                vehicle.set_valves(self._valves.is_open(stop))

    def _warm(self, stop_ns: int) -> None:
        """Catalyst beds warm up with their own on-time: F∞ (1 − deficit e^(−t_on/t_w))."""
        vehicle, departures = self._vehicle, self._departures
        while vehicle.now_ns < stop_ns:
            following = min(vehicle.now_ns + _WARMUP_STEP_MS * NS_PER_MS, stop_ns)
            open_now = self._valves.is_open(vehicle.now_ns)
            span = (following - vehicle.now_ns) // NS_PER_MS
            for k, is_open in enumerate(open_now):
                if is_open:
                    on_s = 1e-3 * (self._on_ms[k] + 0.5 * span)
                    cold = departures.warmup_deficit * math.exp(-on_s / departures.warmup_time_s)
                    vehicle.set_thrust(k, float(self._body.thrust_n[k]) * (1.0 - cold))
                    self._on_ms[k] += span
            vehicle.advance(following)
