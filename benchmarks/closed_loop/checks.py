"""The generator against what it does not contain: conservation, closed forms, its own commands."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from closed_loop import vehicle as vehicles
from closed_loop.arrays import Array
from closed_loop.cassini import THRUSTERS, Body, Truth
from closed_loop.flight import NS_PER_MS, Flight
from closed_loop.hidden import Departures, Effect
from closed_loop.records import telemetry_csv
from closed_loop.scene import Scene, draw_scene, fly_scene, generator
from closed_loop.sizes import sigma
from closed_loop.thruster_control import PAIRS
from closed_loop.valve import Pulses, Valve, merged
from closed_loop.vehicle import NANO, Slosh, State, Vehicle, WheelDrag, free_frequency_hz

AT_REST = State((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
SEED = 20270101


@dataclass(frozen=True)
class Check:
    """A figure and the bound that it has to stay below."""

    what: str
    found: float
    bound: float
    unit: str = ""

    @property
    def passed(self) -> bool:
        """Whether the figure is within the bound; NaN is not."""
        return bool(self.found <= self.bound)

    def line(self) -> str:
        """One line of the report."""
        sign = "ok  " if self.passed else "FAIL"
        return f"{sign} {self.what}: {self.found:.2e}{self.unit} (at most {self.bound:.0e})"


def all_checks() -> Iterator[Check]:
    """Every check, as it is done."""
    scene = draw_scene(SEED, {"events": ("bias",), "branch": "B"})
    truth = scene.truth
    body = truth.body(scene.events[0].name)
    yield from conservation(body)
    yield from conservation_in_slews()
    yield from pulses(body)
    yield lever_arms(body)
    yield torque_step(body)
    yield from attitude_convention(body)
    yield particle_at_rest(body)
    yield particle_swings(body)
    yield from shorter_steps(body)
    for controller in ("phase_plane", "pulse_frequency", "pulse_width"):
        flown = draw_scene(SEED, {"controller": controller, "events": ("bias",), "row_every_s": 1})
        yield from closed_loop(controller, flown)
    yield from effects()


def rotation(attitude: tuple[float, ...] | Array) -> Array:
    """Inertial-to-body matrix (q4² − q·q) 1 + 2 q qᵀ − 2 q4 [q×]."""
    x, y, z, w = attitude
    q = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray((w * w - q @ q) * np.eye(3) + 2.0 * np.outer(q, q) - 2.0 * w * cross)


def inertial_momentum(body: Body, state: State) -> Array:
    """Angular momentum about the centre of mass in inertial axes."""
    own = body.momentum(np.array(state.rate), np.array(state.wheels))
    return np.asarray(rotation(state.attitude).T @ own)


def conservation(body: Body) -> Iterator[Check]:
    """Momentum without thrusters: tumbling, motors and drag at work."""
    start = State((0.5, -0.5, 0.5, 0.5), (2e-3, -1e-3, 1.5e-3), (80.0, -60.0, 100.0))
    for name, slosh in (("", None), (", a particle swinging", _PARTICLE)):
        flown = Vehicle(body, start, drag=WheelDrag(1e-3, 5e-6), slosh=slosh)
        initial, own = flown.basilisk_momentum(), inertial_momentum(body, flown.state())
        drift, difference = 0.0, 0.0
        for second in range(1, 601):
            flown.set_motors((0.03, -0.02 if second < 300 else 0.04, 0.01))
            flown.advance(second * NANO)
            drift = max(drift, _apart(flown.basilisk_momentum(), initial))
            difference = max(difference, _apart(inertial_momentum(body, flown.state()), own))
        yield Check(f"momentum by Basilisk, 600 s of tumbling{name}: relative drift", drift, 1e-9)
        if slosh is None:
            yield Check(
                "momentum from rates, wheels and attitude: relative drift", difference, 1e-9
            )


_PARTICLE = Slosh(40.0, (0.4, 0.6, 0.9), (0.6, 0.0, 0.8), 0.1, 0.003, 0.01)


def conservation_in_slews() -> Iterator[Check]:
    """Momentum in a slew event, its steady torque taken out."""
    scene = draw_scene(SEED, {"events": ("slew",)})
    none = {f"external_torque_{axis}_n_m": 0.0 for axis in "xyz"}
    still = Scene(**{**vars(scene), "truth": scene.truth.changed(none)})
    flight = fly_scene(still, ())[0][0]
    states = [
        State(tuple(q), tuple(w), tuple(r))
        for q, w, r in zip(flight.attitude, flight.rate, flight.wheels, strict=True)
    ]
    momenta = [inertial_momentum(flight.body, state) for state in states]
    drift = max(_apart(momentum, momenta[0]) for momentum in momenta)
    yield Check("momentum over a slew event: relative drift", drift, 1e-9)
    wanted = max(abs(turn.angle_rad) for turn in flight.event.turns)
    turned = max(
        2.0 * np.arccos(min(1.0, abs(float(q @ flight.attitude[0])))) for q in flight.attitude
    )
    yield Check("slew: turned through the first angle at least", wanted - turned, 1e-2, " rad")


def pulses(body: Body) -> Iterator[Check]:
    """Impulses of single, merged and cut pulses against the closed form of a first-order valve."""
    cases = {
        "20 ms": [(1000, 1020)],
        "125 ms": [(1000, 1125)],
        "250 ms": [(1000, 1250)],
        "1 s": [(1000, 2000)],
        "125 + 125 ms merged": [(1000, 1125), (1125, 1250)],
        "125 ms cut after 125 ms": [(1000, 1125), (1250, 1375)],
        "125 ms cut after 30 ms": [(1000, 1125), (1155, 1280)],
        "20 ms cut after 3 ms": [(1000, 1020), (1023, 1043)],
    }
    for name, intervals in cases.items():
        given = _fired(body, 2, intervals, longer_s=0.0)
        s = _described_effective_s(intervals, body)
        expected = s * body.thrust_n[2] * body.torque_per_newton_m[2]
        yield Check(f"impulse of {name}: relative error", _apart(given, expected), 2e-5)
    # the bookkeeping of valves, which sizes rest on, against the same description
    worst = 0.0
    for intervals in cases.values():
        valve = Valve(merged(intervals), body.delay_s, body.rise_s, body.fall_s)
        own, expected = valve.effective_s([9.0])[0], _described_effective_s(intervals, body)
        worst = max(worst, abs(own / expected - 1.0))
    yield Check("closed form of valves against a numerical integral: relative error", worst, 1e-5)


def _fired(body: Body, thruster: int, intervals: list[tuple[int, int]], longer_s: float) -> Array:
    """Momentum, in inertial axes, that pulses of one thruster give a body at rest."""
    flown = Vehicle(body, AT_REST)
    valve = Valve(merged(intervals), body.delay_s, body.rise_s, body.fall_s, longer_s)
    for time_s, is_open in valve.edges():
        flown.advance(round(time_s * NANO))
        flown.set_valves([is_open and k == thruster for k in range(len(THRUSTERS))])
    flown.advance(5 * NANO)
    return inertial_momentum(body, flown.state())


def _described_effective_s(intervals: list[tuple[int, int]], body: Body) -> float:
    """∫ κ dt straight from the description: κ in 10 µs steps, whatever is commanded."""
    step, level, total = 1e-5, 0.0, 0.0
    for tick in range(round(3.0 / step)):
        commanded_at = 1e3 * ((tick + 0.5) * step + 1.0 - body.delay_s)
        is_open = any(start <= commanded_at < end for start, end in intervals)
        aim, constant = (1.0, body.rise_s) if is_open else (0.0, body.fall_s)
        following = aim + (level - aim) * np.exp(-step / constant)
        total += 0.5 * step * (level + following)
        level = following
    return total


def lever_arms(body: Body) -> Check:
    """Pairs turn the body as controllers believe, with the arms of the description."""
    worst = 0.0
    for (axis, sense), pair in PAIRS.items():
        turned = sum(_fired(body, k, [(100, 600)], 0.0) for k in pair)
        s = Valve(((100, 600),), body.delay_s, body.rise_s, body.fall_s).effective_s([9.0])[0]
        expected = sum(s * body.thrust_n[k] * body.torque_per_newton_m[k] for k in pair)
        worst = max(worst, _apart(np.asarray(turned), np.asarray(expected)))
        if np.argmax(np.abs(turned)) != axis or sense * np.asarray(turned)[axis] <= 0.0:
            worst = np.inf
    return Check("six pairs, 500 ms: relative error of the momentum", worst, 1e-4)


def torque_step(body: Body) -> Check:
    """A steady torque about a principal axis: ω = τ t/λ."""
    moments, axes = np.linalg.eigh(body.inertia_kg_m2)
    flown = Vehicle(body, AT_REST)
    flown.set_external((0.0, 0.0, 0.0), (0.02 * axes[:, 1]).tolist())
    flown.advance(300 * NANO)
    # wheels at rest keep their inertial spin: to first order they do not follow the body
    wheels = body.wheel_axes * body.wheel_inertia_kg_m2 @ body.wheel_axes.T
    felt = body.inertia_kg_m2 - wheels
    expected = np.linalg.solve(felt, 0.02 * 300.0 * axes[:, 1])
    share = np.linalg.norm(wheels) / moments[1]
    return Check(
        "step of torque, 300 s: relative error of the rate",
        _apart(np.array(flown.state().rate), expected),
        0.1 * share,
    )


def attitude_convention(body: Body) -> Iterator[Check]:
    """q̇ = ½ Ω(ω) q integrated from Basilisk's rates against Basilisk's attitude."""
    start = State((0.1, -0.3, 0.2, np.sqrt(0.86)), (3e-3, -2e-3, 4e-3), (50.0, -80.0, 20.0))
    flown = Vehicle(body, start)
    times = [round(0.05 * NANO * k) for k in range(1, 12_001)]
    rates = [np.array(start.rate)]
    for time_ns in times:
        flown.advance(time_ns)
        rates.append(np.array(flown.state().rate))
    q = np.array(start.attitude)
    for before, middle, after in zip(rates[:-2:2], rates[1:-1:2], rates[2::2], strict=True):
        q = _turned(q, before, middle, after, 0.1)
    found = np.array(flown.state().attitude)
    error = rotation(q) @ rotation(found).T - np.eye(3)
    yield Check(
        "attitude from integrated rates, 600 s at 0.3 deg/s",
        float(np.abs(error).max()),
        1e-8,
        " rad",
    )
    # inertial-to-body: a fixed inertial direction moves by −ω × in body axes
    c0, c1 = rotation(start.attitude), rotation(_attitude_after(body, start, NS_PER_MS))
    moved = (c1 - c0) @ np.array([0.0, 0.0, 1.0]) / 1e-3
    expected = -np.cross(start.rate, c0 @ np.array([0.0, 0.0, 1.0]))
    yield Check(
        "attitude is inertial to body: relative error of a direction's motion",
        _apart(moved, expected),
        1e-4,
    )


def _attitude_after(body: Body, start: State, span_ns: int) -> tuple[float, ...]:
    """Attitude some time after the start."""
    flown = Vehicle(body, start)
    flown.advance(span_ns)
    return flown.state().attitude


def _turned(q: Array, before: Array, middle: Array, after: Array, step: float) -> Array:
    """One Runge-Kutta step of q̇ = ½ Ω(ω) q."""

    def slope(rate: Array, at: Array) -> Array:
        x, y, z = rate
        omega = np.array([[0, z, -y, x], [-z, 0, x, y], [y, -x, 0, z], [-x, -y, -z, 0]])
        return np.asarray(0.5 * omega @ at)

    k1 = slope(before, q)
    k2 = slope(middle, q + 0.5 * step * k1)
    k3 = slope(middle, q + 0.5 * step * k2)
    k4 = slope(after, q + step * k3)
    q = q + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return np.asarray(q / np.linalg.norm(q))


def particle_at_rest(body: Body) -> Check:
    """A body with a particle that does not swing turns as the body without."""
    stiff = Slosh(40.0, (0.4, 0.6, 0.9), (0.6, 0.0, 0.8), 3.0, 0.7, 0.0)
    rates = []
    for slosh in (None, stiff):
        flown = Vehicle(body, AT_REST, slosh=slosh)
        flown.set_external((0.0, 0.0, 0.0), (0.01, -0.02, 0.015))
        flown.advance(60 * NANO)
        rates.append(np.array(flown.state().rate))
    return Check(
        "particle on a stiff spring: relative difference of the rate",
        _apart(rates[1], rates[0]),
        1e-4,
    )


def particle_swings(body: Body) -> Check:
    """A particle let go swings at the frequency of the free spacecraft, by the zeros of a rate."""
    loose = replace(_PARTICLE, damping=0.0)
    flown = Vehicle(body, AT_REST, slosh=loose)
    rate, every_s = [], 0.05
    for row in range(1, 6_001):
        flown.advance(round(row * every_s * NANO))
        rate.append(flown.state().rate[1])
    own = np.array(rate) - np.mean(rate)
    after = np.flatnonzero((own[1:] >= 0.0) & (own[:-1] < 0.0))
    zeros_s = every_s * (after + own[after] / (own[after] - own[after + 1]))
    found = (len(zeros_s) - 1) / (zeros_s[-1] - zeros_s[0])
    return Check(
        "frequency of a particle on the free spacecraft: relative difference",
        abs(found / free_frequency_hz(body, loose) - 1.0),
        1e-3,
    )


def shorter_steps(body: Body) -> Iterator[Check]:
    """The same commands with half the steps."""
    found = []
    usual = vehicles.FIRING_STEP_S, vehicles.COAST_STEP_S
    for share in (1.0, 0.5):
        vehicles.FIRING_STEP_S, vehicles.COAST_STEP_S = (share * step for step in usual)
        flown = Vehicle(body, State((0.0, 0.0, 0.0, 1.0), (1e-4, 0.0, 0.0), (60.0, -90.0, 40.0)))
        for k in range(40):
            for when, is_open in ((1000 * k + 5, True), (1000 * k + 47, False)):
                flown.advance(when * NS_PER_MS)
                flown.set_valves([is_open and j == k % 8 for j in range(8)])
        flown.advance(60 * NANO)
        found.append(inertial_momentum(body, flown.state()))
    vehicles.FIRING_STEP_S, vehicles.COAST_STEP_S = usual
    yield Check(
        "forty pulses with half the steps: relative difference of momentum",
        _apart(found[1], found[0]),
        1e-6,
    )


def closed_loop(name: str, scene: Scene) -> Iterator[Check]:
    """A whole bias: momentum against impulses, counters against commands, attitude held."""
    flights, truth, departures = fly_scene(scene, ())
    flight = flights[0]
    left = _left_over(flight, truth, departures)
    yield Check(f"{name}: momentum of a bias less impulses and torque, relative", left, 2e-5)
    yield Check(f"{name}: counters against commands, in steps", _counter_error(scene, flight), 0.5)
    from_target = [rotation(q) @ rotation(flight.event.target).T for q in flight.attitude]
    angle = max(float(np.abs(c - np.eye(3)).max()) for c in from_target)
    yield Check(f"{name}: largest angle off the target", angle, 2e-2, " rad")
    own = sigma(flights, scene.truth, (), departures, scene.channels, scene.priors)
    yield Check(f"{name}: sigma of nothing hidden", own, 0.5)
    lasting = [b[0] - a[1] for pulses in flight.pulses for a, b in pairwise(pulses)]
    yield Check(
        f"{name}: pulses apart from each other", float(-min(lasting, default=1)), -1.0, " ms"
    )


def _left_over(flight: Flight, truth: Truth, departures: Departures) -> float:
    """Share of the exchanged momentum that impulses and steady torques do not account for."""
    body = flight.body
    times = 1e-3 * flight.row_ms
    delivered = np.stack([_delivered(p, times, body, departures) for p in flight.pulses], axis=1)
    torque = np.array([truth.parameters[f"external_torque_{axis}_n_m"] for axis in "xyz"])
    for name, size in departures.leaks_n.items():
        torque = torque + size * body.torque_per_newton_m[THRUSTERS.index(name)]
    total, exchanged, worst = np.zeros(3), 0.0, 0.0
    first = None
    for i, (q, w, r) in enumerate(zip(flight.attitude, flight.rate, flight.wheels, strict=True)):
        momentum = rotation(q).T @ body.momentum(w, r)
        if first is None:
            first = momentum
            continue
        s = (delivered[i] - delivered[i - 1]) * body.thrust_n
        arms = (
            body.torque_per_newton_m
            + np.array([departures.swirl_m.get(name, 0.0) for name in THRUSTERS])[:, None]
            * body.direction
        )
        step = times[i] - times[i - 1]
        drift = (times[i] + times[i - 1]) / times[-1] - 1.0
        impulse = s @ arms + step * (torque + drift * np.array(departures.drift_peak_n_m))
        total = total + rotation(0.5 * (q + flight.attitude[i - 1])).T @ impulse
        exchanged = max(exchanged, float(np.linalg.norm(total)))
        worst = max(worst, float(np.linalg.norm(momentum - first - total)))
    return worst / exchanged


def _delivered(pulses: Pulses, times: Array, body: Body, departures: Departures) -> Array:
    """∫ κ dt up to each time, in units of the steady thrust of a warm thruster."""
    valve = Valve(pulses, body.delay_s, body.rise_s, body.fall_s, departures.pulse_longer_s)
    if not departures.warmup_deficit:
        return valve.effective_s(times)
    # in short steps, each with the thrust that the on-time so far allows
    fine = np.unique(np.concatenate([times, *(_around(start, end) for start, end in pulses)]))
    on_s = np.zeros(len(fine))
    for start, end in pulses:
        opens = 1e-3 * start + body.delay_s
        on_s += np.clip(fine - opens, 0.0, 1e-3 * (end - start))
    middle = 0.5 * (on_s[1:] + on_s[:-1])
    cold = departures.warmup_deficit * np.exp(-middle / departures.warmup_time_s)
    total = np.concatenate([[0.0], np.cumsum(np.diff(valve.effective_s(fine)) * (1.0 - cold))])
    return np.interp(times, fine, total)


def _around(start_ms: int, end_ms: int) -> Array:
    return 1e-3 * np.arange(start_ms, end_ms + 1500, 5)


def _counter_error(scene: Scene, flight: Flight) -> float:
    """Most that on-times differ from the commands, in counter steps; 9 if pulses differ."""
    noise = generator(1, "noise")
    text = telemetry_csv(flight, scene.channels, Departures(), scene.truth.wheels, noise)
    rows = [row for row in csv.DictReader(io.StringIO(text)) if row["on_time_z1_s"]]
    worst = 0.0
    for name, spans in zip(THRUSTERS, flight.pulses, strict=True):
        for row in rows:
            now = round(1000.0 * float(row["time_s"]))
            on_ms = sum(min(end, now) - start for start, end in spans if start < now)
            if int(row[f"pulses_{name}"]) != sum(start <= now for start, _ in spans):
                return 9.0
            error = abs(1000.0 * float(row[f"on_time_{name}_s"]) - on_ms)
            worst = max(worst, error / scene.channels.counter_step_ms)
    return worst - 1e-9


def effects() -> Iterator[Check]:
    """Every effect on the motion is what its description says; at no size it is not there."""
    given = {
        "events": ("bias",),
        "branch": "B",
        "row_every_s": 1,
        "shortest_s": 300.0,
        "longest_s": 300.0,
    }
    scene = draw_scene(SEED, given)
    plain = fly_scene(scene, ())[0][0]
    cases: dict[str, tuple[dict[str, float], dict[str, float]]] = {
        "thrust_scale": ({"thrust_factor": 1.0}, {"thrust_factor": 1.3}),
        "thruster_degraded:y2": ({"thrust_factor": 1.0}, {"thrust_factor": 0.6}),
        "thrust_warmup": (
            {"warmup_deficit": 1e-12, "warmup_time_s": 1.0},
            {"warmup_deficit": 0.4, "warmup_time_s": 1.0},
        ),
        "pulse_shape": ({"impulse_time_offset_s": 0.0}, {"impulse_time_offset_s": 0.03}),
        "thruster_misalignment:y2": (
            {"cant_a_rad": 0.0, "cant_b_rad": 0.0},
            {"cant_a_rad": 0.1, "cant_b_rad": -0.2},
        ),
        "thruster_leak:z3": ({"leak_n": 0.0}, {"leak_n": 1e-3}),
        "drifting_torque": (
            {f"peak_{axis}_n_m": 0.0 for axis in "xyz"},
            {"peak_x_n_m": 1e-3, "peak_y_n_m": -2e-3, "peak_z_n_m": 5e-4},
        ),
        "thrust_swirl:y1": ({"lever_m": 0.0}, {"lever_m": 0.3}),
    }
    worst = 0.0
    for name, (nothing, some) in cases.items():
        flight = fly_scene(scene, (Effect(name, nothing),))[0][0]
        worst = max(worst, float(np.abs(flight.rate - plain.rate).max()))
        flights, truth, departures = fly_scene(scene, (Effect(name, some),))
        left = _left_over(flights[0], truth, departures)
        yield Check(f"{name}: momentum less impulses and torques, relative", left, 1e-4)
    yield Check("effects of no size: largest change of a rate", worst, 1e-8, " rad/s")


def _apart(found: Array, expected: Array) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def report(log: Callable[[str], None]) -> bool:
    """Do all checks, say each; whether all passed."""
    passed = True
    for check in all_checks():
        log(check.line())
        passed &= check.passed
    return passed
