"""Conditions of a trial, drawn or given: events, controller, channels, truth; and their flight.

Every use of chance has a generator of its own, made of the seed and a label, so that an effect
changes no draw: two flights of a scene differ by what is hidden alone.
"""

from __future__ import annotations

import datetime
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from closed_loop import thruster_control
from closed_loop.cassini import Table, Truth, draw, draw_truth, read_priors
from closed_loop.flight import Event, Flight, Knowledge, fly
from closed_loop.hidden import Departures, Effect, applied
from closed_loop.records import (
    RPM_PER_RAD_S,
    Channels,
    priors_toml,
    row_times,
    telemetry_csv,
    truth_json,
    write_record,
)
from closed_loop.thruster_control import CYCLE_MS, Law
from closed_loop.vehicle import State, WheelDrag
from closed_loop.wheel_control import Ramp, Turn, product

Quaternion = tuple[float, float, float, float]
PRIORS = Path(__file__).parents[2] / "priors" / "cassini_b_branch_telemetry.toml"
BELIEVED_INERTIA = (6558.0, 5393.0, 3518.0)
MOST_RPM = 1_000.0
_MOTOR_SHARE = 0.8
"""Of the motors' limit: what a ramp may ask for."""
_SLEW_TORQUE_N_M = 0.06
_SLEW_LIMIT_N_M = 0.2


@dataclass(frozen=True)
class Conditions:
    """What is drawn for a trial, or given; everything is recorded."""

    branch: str
    controller: str
    events: tuple[str, ...]
    """Kinds, in order."""
    row_every_s: int
    counter_every_s: int
    counter_step_s: float
    wheel_step_rpm: float
    rate_noise_rad_s: float
    rate_step_rad_s: float
    attitude_noise_rad: float
    attitude_digits: int
    phase_ms: int
    """From the control cycle before the first row to that row."""
    wheel_drag: bool
    start_rate_rad_s: float
    shortest_s: float
    """Least and greatest length of an event."""
    longest_s: float


@dataclass(frozen=True)
class Scene:
    """A trial that is ready to be flown."""

    seed: int
    conditions: Conditions
    priors: Table
    channels: Channels
    truth: Truth
    events: tuple[Event, ...]
    knowledge: Knowledge
    drag: WheelDrag | None
    law: Law

    def record(self) -> dict[str, Any]:
        """The conditions as ``truth.json`` keeps them."""
        return {
            **asdict(self.conditions),
            "law": thruster_control.described(self.law),
            "wheel_noise_rpm": self.channels.wheel_noise_rpm,
            "knowledge": asdict(self.knowledge),
            "drag": None if self.drag is None else asdict(self.drag),
        }


Flown = tuple[list[Flight], Truth, Departures]
"""Flights of a scene's events, and the truth and the departures that they had."""


def generator(seed: int, label: str) -> np.random.Generator:
    """A generator of its own for one use of chance."""
    return np.random.default_rng([seed, zlib.crc32(label.encode())])


def draw_conditions(seed: int, given: Mapping[str, Any]) -> Conditions:
    """Conditions by chance, but for those that are given."""
    unknown = set(given) - {one.name for one in fields(Conditions)}
    if unknown:
        raise ValueError(f"no conditions are called {', '.join(sorted(unknown))}")
    rng = generator(seed, "conditions")
    controller = given.get("controller", str(rng.choice(list(thruster_control.NAMES))))
    steps = [0.001, 0.01] if controller == "pulse_frequency" else [0.001, 0.01, 1e-3 * CYCLE_MS]
    step = given.get("counter_step_s", float(rng.choice(steps)))
    row = given.get("row_every_s", int(rng.choice([1, 1, 4])))
    rate_noise, rate_step = [(2e-6, 0.0), (2e-5, 5e-6)][rng.integers(2)]
    attitude_noise, digits = [(2e-5, 8), (1e-5, 6)][rng.integers(2)]
    # a counter of whole cycles is read between cycles
    phase = 0 if rng.uniform() < 0.5 or step == 1e-3 * CYCLE_MS else int(rng.integers(1, CYCLE_MS))
    drawn = {
        "branch": str(rng.choice(["A", "B"])),
        "controller": controller,
        "events": _draw_kinds(rng),
        "row_every_s": row,
        "counter_every_s": int(rng.choice([row, row, 10])),
        "counter_step_s": step,
        "wheel_step_rpm": float(rng.choice([0.1, 1.0])),
        "rate_noise_rad_s": rate_noise,
        "rate_step_rad_s": rate_step,
        "attitude_noise_rad": attitude_noise,
        "attitude_digits": digits,
        "phase_ms": phase,
        "wheel_drag": bool(rng.uniform() < 0.5),
        "start_rate_rad_s": float(rng.choice([2e-5, 1e-4, 4e-4])),
        "shortest_s": 1200.0,
        "longest_s": 2000.0,
    }
    return Conditions(**{**drawn, **given})


def _draw_kinds(rng: np.random.Generator) -> tuple[str, ...]:
    """One to eight biases alone, some with slews or a quiescent period, or slews alone."""
    biases = int(rng.choice(8, p=[0.2, 0.2, 0.2, 0.14, 0.1, 0.06, 0.05, 0.05])) + 1
    others = [str(kind) for kind in rng.choice(["slew", "slew", "slew", "quiescent"], 2)]
    share = rng.uniform()
    if share < 0.45:
        return ("bias",) * biases
    if share < 0.85:
        return ("bias",) * min(biases, 6) + tuple(others[: int(rng.integers(1, 3))])
    return ("slew",) * int(rng.integers(1, 4)) + (("quiescent",) if rng.uniform() < 0.3 else ())


def draw_scene(seed: int, given: Mapping[str, Any] | None = None, priors: Path = PRIORS) -> Scene:
    """Everything about a trial but what is hidden in it."""
    conditions = draw_conditions(seed, given or {})
    document = read_priors(priors, conditions.branch)
    rng = generator(seed, "scene")
    channels = Channels(
        row_every_ms=1000 * conditions.row_every_s,
        counter_every_ms=1000 * conditions.counter_every_s,
        counter_step_ms=round(1000 * conditions.counter_step_s),
        wheel_noise_rpm=draw(document["parameters"]["wheel_noise_rpm"], rng),
        wheel_step_rpm=conditions.wheel_step_rpm,
        rate_noise_rad_s=conditions.rate_noise_rad_s,
        rate_step_rad_s=conditions.rate_step_rad_s,
        attitude_noise_rad=conditions.attitude_noise_rad,
        attitude_digits=conditions.attitude_digits,
    )
    law = thruster_control.draw_law(
        conditions.controller, BELIEVED_INERTIA, conditions.counter_step_s, rng
    )
    knowledge = Knowledge(
        attitude_rad=float(rng.uniform(0.3e-5, 2e-5)),
        rate_rad_s=float(10.0 ** rng.uniform(-6.0, -5.2)),
        inertia_factor=float(rng.normal(1.0, 0.01)),
    )
    drag = WheelDrag(float(rng.uniform(5e-4, 2e-3)), float(rng.uniform(2e-6, 1e-5)))
    names = tuple(f"{i + 1}-{kind}" for i, kind in enumerate(conditions.events))
    truth = draw_truth(document, names, generator(seed, "truth"))
    events = tuple(
        _draw_event(name, kind, i, conditions, law, generator(seed, f"event {name}"))
        for i, (name, kind) in enumerate(zip(names, conditions.events, strict=True))
    )
    return Scene(
        seed, conditions, document, channels, truth, events, knowledge,
        drag if conditions.wheel_drag else None, law,
    )  # fmt: skip


def _draw_event(
    name: str, kind: str, index: int, conditions: Conditions, law: Law, rng: np.random.Generator
) -> Event:
    epoch = datetime.datetime(2010, 1, 1, tzinfo=datetime.UTC) + datetime.timedelta(
        days=9.5 * index
    )
    duration = 10.0 * round(0.1 * rng.uniform(conditions.shortest_s, conditions.longest_s))
    target = _random_attitude(rng)
    speeds = rng.uniform(-MOST_RPM, MOST_RPM, (2, 3)) / RPM_PER_RAD_S
    bandwidth, damping = float(rng.uniform(0.05, 0.15)), float(rng.uniform(0.7, 1.0))
    ramp, turns, limit, start_law = None, (), _SLEW_LIMIT_N_M, None
    start = State(target, (0.0, 0.0, 0.0), _three(speeds[0]))
    if kind == "bias":
        ramp, limit = _draw_ramp(speeds, duration, rng)
        start_law = law
        off = rng.uniform(-0.7, 0.7, 3) * np.array(law.dead_band_rad)
        x, y, z = (0.5 * off).tolist()
        attitude = product(target, (x, y, z, math.sqrt(1.0 - x * x - y * y - z * z)))
        rate = conditions.start_rate_rad_s * rng.standard_normal(3)
        start = State(_upper(attitude), _three(rate), _three(speeds[0]))
    elif kind == "slew":
        turns = _draw_turns(duration, rng)
    elif kind != "quiescent":
        raise ValueError(f"an event is a bias, a slew or quiescent, not {kind!r}")
    return Event(
        name, kind, epoch.strftime("%Y-%m-%dT%H:%M:%SZ"), round(1000 * duration),
        conditions.phase_ms, target, start, ramp, start_law, turns, limit, bandwidth, damping,
    )  # fmt: skip


def _draw_ramp(
    speeds: np.ndarray, duration_s: float, rng: np.random.Generator
) -> tuple[Ramp, float]:
    """Ramps that end together, each as fast as motors allow, or one after the other."""
    begin, settle = float(rng.uniform(20.0, 90.0)), float(rng.uniform(60.0, 200.0))
    span = duration_s - begin - settle
    change = np.abs(speeds[1] - speeds[0])
    kind = str(rng.choice(["together", "as fast as may be", "in turn"]))
    whole = 0.161 * (change.sum() if kind == "in turn" else change.max())
    limit = max(float(rng.uniform(0.02, 0.06)), whole / (_MOTOR_SHARE * span))
    fastest = change * 0.161 / (_MOTOR_SHARE * limit)
    begins = np.full(3, begin)
    spans = fastest
    if kind == "together":
        spans = np.full(3, span)
    elif kind == "in turn":
        order = rng.permutation(3)
        begins[order] += np.concatenate([[0.0], np.cumsum(fastest[order])[:-1]])
    servo = float(rng.uniform(2.0, 10.0))
    ends = begins + np.maximum(spans, 1.0)
    return Ramp(_three(speeds[0]), _three(speeds[1]), _three(begins), _three(ends), servo), limit


def _draw_turns(duration_s: float, rng: np.random.Generator) -> tuple[Turn, ...]:
    """Turns about axes of their own, as many as there is time for; at least one."""
    turns: list[Turn] = []
    now = float(rng.uniform(20.0, 60.0))
    while True:
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        angle = float(rng.uniform(0.15, 1.2) * rng.choice([-1.0, 1.0]))
        fastest = float(rng.uniform(0.6e-3, 1.8e-3))
        if not turns:  # the first one has to fit
            angle = math.copysign(min(abs(angle), 0.4 * fastest * (duration_s - now)), angle)
        size = abs(angle)
        torque_bound = math.sqrt(2.0 * math.pi * size * max(BELIEVED_INERTIA) / _SLEW_TORQUE_N_M)
        span = max(2.0 * size / fastest, torque_bound)
        if now + span > duration_s - 20.0 and turns:
            return tuple(turns)
        turns.append(Turn(now, span, _three(axis), angle))
        now += span + float(rng.uniform(40.0, 120.0))


def _random_attitude(rng: np.random.Generator) -> Quaternion:
    values = rng.standard_normal(4)
    x, y, z, w = (values / np.linalg.norm(values)).tolist()
    return _upper((x, y, z, w))


def _upper(attitude: Quaternion) -> Quaternion:
    """The same attitude with a scalar part that is not negative."""
    x, y, z, w = attitude
    return attitude if w >= 0.0 else (-x, -y, -z, -w)


def _three(values: Sequence[float] | np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return (x, y, z)


def fly_scene(scene: Scene, effects: Sequence[Effect]) -> Flown:
    """Fly all events with what is hidden."""
    truth, departures = applied(scene.truth, effects)
    flights = [
        fly(
            event,
            truth,
            departures,
            scene.knowledge,
            scene.drag,
            row_times(event.kind, event.duration_ms, scene.channels),
            generator(scene.seed, f"pilot {event.name}"),
        )
        for event in scene.events
    ]
    return flights, truth, departures


def write_scene(
    folder: Path,
    scene: Scene,
    effects: Sequence[Effect],
    flown: Flown,
) -> None:
    """Event folders, truth and priors of a scene that has been flown."""
    flights, truth, departures = flown
    texts = {
        flight.event.name: telemetry_csv(
            flight, scene.channels, departures, scene.truth.wheels,
            generator(scene.seed, f"noise {flight.event.name}"),
        )
        for flight in flights
    }  # fmt: skip
    write_record(
        folder,
        flights,
        texts,
        scene.conditions.branch,
        scene.truth.wheels,
        truth_json(scene.seed, truth, effects, flights, scene.record()),
        priors_toml(scene.priors, scene.channels),
    )
