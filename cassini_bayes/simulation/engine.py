"""From a plan to the motion: arrays for the compiled loop, start state, duration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from cassini_bayes.checks import nearest
from cassini_bayes.errors import InputError
from cassini_bayes.simulation import kernel
from cassini_bayes.simulation.motion import RPM_PER_RAD_S, Motion, PulseLog
from cassini_bayes.simulation.plan import Plan
from cassini_bayes.simulation.settings import Slew
from cassini_bayes.spacecraft import (
    Spacecraft,
    centre_of_mass,
    inertia_tensor,
    pair_indicator,
    thruster_directions,
    thruster_positions,
    wheel_axes,
    wheel_inertias,
)

Array = NDArray[np.float64]
RAMP_TIME_CONSTANTS = 6.0
"""Paper 001 section IV: a wheel has arrived n = 6 time constants after its linear ramp."""


@dataclass(frozen=True)
class Steps:
    """The time grid: integrator steps per control cycle and per record, control cycle in s."""

    step_s: float
    per_cycle: int
    per_record: int

    @classmethod
    def of(cls, step_s: float, cycle_s: float, record_s: float) -> Steps:
        """Whole numbers of steps per cycle and record.

        Raises
        ------
        InputError
            The step does not divide them.
        """
        counts = []
        for name, span in (("cycle_s", cycle_s), ("the record interval", record_s)):
            count = round(span / step_s)
            if count < 1 or abs(count * step_s - span) > 1e-9:
                raise InputError(
                    "scenario: step_s",
                    f"a step that divides {name} = {span:g} s",
                    f"{step_s:g} s",
                    "choose e.g. 0.005",
                )
            counts.append(count)
        return cls(step_s, counts[0], counts[1])


def prime_wheels(plan: Plan) -> Spacecraft:
    """The spacecraft with its prime wheels only, in the order of the event's columns."""
    wheels = tuple(plan.spacecraft.wheel(number) for number in plan.wheel_numbers)
    return replace(plan.spacecraft, wheels=wheels)


def make_body(plan: Plan) -> kernel.Body:
    """Mass properties as arrays.

    Raises
    ------
    InputError
        The inertia cannot be that of a body with these wheels and appendages.
    """
    prime = prime_wheels(plan)
    axes = np.ascontiguousarray(wheel_axes(prime, plan.parameters))
    wheels = wheel_inertias(prime, plan.parameters)
    inertia = inertia_tensor(plan.parameters)
    couplings = np.zeros((3, len(plan.appendages)))
    for m, appendage in enumerate(plan.appendages):
        couplings[:, m] = _unit(appendage.axis) * math.sqrt(appendage.inertia_kg_m2)
    reduced = inertia - (axes * wheels) @ axes.T - couplings @ couplings.T
    if np.any(np.linalg.eigvalsh(reduced) <= 0.0):
        raise InputError(
            f"event {plan.event.id}: inertia",
            "a positive definite inertia, greater than that of wheels and appendages",
            np.array2string(inertia, precision=1).replace("\n", ""),
            "check the inertia elements and the appendages' inertias",
        )
    return kernel.Body(
        inertia_kg_m2=np.ascontiguousarray(inertia),
        reduced_inverse=np.asarray(np.linalg.inv(reduced), dtype=np.float64),
        axes=axes,
        wheel_inertia_kg_m2=np.ascontiguousarray(wheels),
        wheel_inverse=1.0 / wheels,
        drag_coulomb_n_m=float(plan.wheels.drag_coulomb_n_m),
        drag_viscous_n_m_s=float(plan.wheels.drag_viscous_n_m_s),
        couplings=couplings,
        frequencies_rad_s=_floats([2 * np.pi * a.frequency_hz for a in plan.appendages]),
        dampings=_floats([a.damping for a in plan.appendages]),
        mass_kg=float(plan.parameters["mass_kg"]),
    )


def make_thrusters(plan: Plan) -> kernel.Thrusters:
    """Thrusters, pulse shape and tank as arrays."""
    directions = _canted_directions(plan)
    positions = thruster_positions(plan.spacecraft, plan.branch, plan.parameters)
    centre = centre_of_mass(plan.parameters)[:, None]
    levers = np.ascontiguousarray(np.cross(positions - centre, directions, axis=0))
    names = plan.thrusters
    parasitic = np.zeros((3, len(names)))
    for k, name in enumerate(names):
        # the plume pushes on a surface: a torque about the axis across thrust and lever
        across = np.cross(directions[:, k], levers[:, k])
        parasitic[:, k] = plan.plume.get(name, 0.0) * across / np.linalg.norm(across)
    tau_delay, tau_rise, tau_fall = (
        float(plan.parameters[f"tau_{which}_s"]) for which in ("delay", "rise", "fall")
    )
    start, rise_end, hold_end, jump, rise, fall = _edges(plan, tau_delay, tau_rise, tau_fall)
    return kernel.Thrusters(
        levers_m=levers,
        directions=np.ascontiguousarray(directions),
        thrust_n=_floats([plan.thrust_n[name] for name in names]),
        leak_n=_floats([plan.leaks_n.get(name, 0.0) for name in names]),
        parasitic_m=parasitic,
        start_delay_s=start - min(plan.impulse_offset_s, 0.0),
        rise_end_delay_s=rise_end,
        hold_end_delay_s=hold_end + max(plan.impulse_offset_s, 0.0),
        jump=jump,
        tau_rise_s=rise,
        tau_fall_s=fall,
        warmup_deficit=_floats([plan.warmup_deficit.get(name, 0.0) for name in names]),
        warmup_time_s=float(plan.warmup_time_s),
        surge_fraction=plan.surge.fraction,
        surge_start_s=plan.surge.start_s,
        surge_decay_s=plan.surge.decay_s,
        isp_s=_floats(plan.propulsion.isp_s),
        tank_pressure_kpa=float(plan.propulsion.tank_pressure_kpa),
        ullage_m3=float(plan.propulsion.ullage_m3),
    )


def _edges(
    plan: Plan, delay: float, rise: float, fall: float
) -> tuple[float, float, float, float, float, float]:
    """Start, end of rise, end of hold (after on, off, off), jump, τ_rise, τ_fall of the shape.

    ``published_2012`` is missing: its rise goes on after the off command, so it is no response
    with one state, and what a cut tail leaves would be undefined.
    """
    shape = plan.propulsion.pulse_shape
    jump = -math.expm1(-delay / rise) if rise > 0.0 else 1.0
    edges = {
        "rectangular": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        "first_order": (delay, delay, delay, 0.0, rise, fall),
        "first_order_held": (delay, 0.0, delay, 0.0, rise, fall),
        "published_2005": (delay, 0.0, delay, jump, rise, fall),
    }
    if shape not in edges:
        raise InputError(
            "scenario: propulsion.pulse_shape",
            f"one of {', '.join(edges)}",
            repr(shape),
            nearest(shape, edges),
        )
    return edges[shape]


def _canted_directions(plan: Plan) -> Array:
    """Force directions unit(d + a e1 + b e2); e1 = X, e2 across d and X (Z for ±Y, Y for ±Z)."""
    directions = np.array(thruster_directions(plan.spacecraft, plan.branch))
    for k, name in enumerate(plan.thrusters):
        if name not in plan.cants_rad:
            continue
        a, b = plan.cants_rad[name]
        first = np.array([1.0, 0.0, 0.0])
        second = np.abs(np.cross(directions[:, k], first))
        canted = directions[:, k] + a * first + b * second
        directions[:, k] = canted / np.linalg.norm(canted)
    return directions


def ramp_duration_s(plan: Plan) -> float:
    """T of paper 001 section IV for the slowest wheel: linear ramp and six time constants.

    With a the acceleration at the torque limit and Δ the speed change, the ramp ends when the
    speed loop leaves its limit, at Δ/a − τ_W (not before the start).
    """
    assert plan.event.to_rpm is not None
    inertias = wheel_inertias(prime_wheels(plan), plan.parameters)
    tau = plan.wheels.time_constant_s
    times = []
    for start, end, inertia in zip(plan.event.from_rpm, plan.event.to_rpm, inertias, strict=True):
        change = abs(end - start) / RPM_PER_RAD_S
        ramp = change * float(inertia) / plan.wheels.torque_limit_n_m - tau
        times.append(max(ramp, 0.0) + RAMP_TIME_CONSTANTS * tau if change > 0.0 else 0.0)
    return max(times)


def event_duration_s(plan: Plan, cycle_s: float) -> float:
    """Duration of an event, a whole number of control cycles."""
    event = plan.event
    duration = event.duration_s
    if duration is None:
        if event.kind == "bias":
            duration = event.start_s + ramp_duration_s(plan) + event.settle_s
        elif event.kind == "slew":
            duration = max(s.start_s + _slew_time(s) for s in event.slew) + event.settle_s
        else:
            raise InputError(
                f"event {event.id}: duration_s",
                f"the duration of a {event.kind} event",
                "nothing",
                "add duration_s = …",
            )
    return math.ceil(duration / cycle_s - 1e-9) * cycle_s


def _slew_time(slew: Slew) -> float:
    size = abs(slew.angle_rad)
    peak = min(slew.rate_rad_s, math.sqrt(size * slew.acceleration_rad_s2))
    return size / peak + peak / slew.acceleration_rad_s2 if peak > 0.0 else 0.0


def simulate_motion(
    plan: Plan, steps: Steps, start_rng: Generator, knowledge_rng: Generator
) -> Motion:
    """Integrate one event.

    Parameters
    ----------
    plan
        The event with all its effects.
    steps
        Time grid.
    start_rng, knowledge_rng
        Draw the start within the dead-band, and the controllers' knowledge errors.
    """
    cycle = steps.step_s * steps.per_cycle
    duration = event_duration_s(plan, cycle)
    n_cycles = round(duration / cycle)
    n_steps = n_cycles * steps.per_cycle
    n_records = n_steps // steps.per_record + 1
    body = make_body(plan)
    n_wheels = body.axes.shape[1]
    n_thrusters = len(plan.thrusters)
    state = _start_state(plan, body, start_rng)
    pulses = kernel.Pulses(
        np.zeros((n_thrusters, n_cycles + 1)),
        np.zeros((n_thrusters, n_cycles + 1)),
        np.zeros(n_thrusters, dtype=np.int64),
    )
    record = kernel.empty_record(n_records, n_wheels, len(plan.appendages))
    attitude_knowledge, rate_knowledge = _knowledge(plan, n_cycles + 1, knowledge_rng)
    kernel.advance(
        state,
        np.zeros(n_wheels),
        steps.step_s,
        n_steps,
        steps.per_cycle,
        steps.per_record,
        body,
        _torque(plan),
        _wheel_loop(plan),
        make_thrusters(plan),
        rcs_law(plan, body),
        rwa_law(plan, body),
        attitude_knowledge,
        rate_knowledge,
        pulses,
        record,
    )
    logs = {
        name: PulseLog(pulses.start_s[k, : pulses.number[k]], pulses.width_s[k, : pulses.number[k]])
        for k, name in enumerate(plan.thrusters)
    }
    return Motion(*record, pulses=logs, body=body)


def _start_state(plan: Plan, body: kernel.Body, rng: Generator) -> Array:
    """y = (q, ω, ρ, η, η̇) at the start.

    Under thruster control the attitude error is uniform within a part of the dead-band and the
    rate normal; wheel-controlled events start at rest on target. The draws are made either way.
    """
    error = (
        rng.uniform(-1.0, 1.0, 3) * plan.start.attitude_spread * np.array(plan.rcs.dead_band_rad)
    )
    rate = rng.standard_normal(3) * plan.start.rate_rad_s
    if _uses_wheels(plan):
        error, rate = np.zeros(3), np.zeros(3)
    eta_dot = _floats([math.sqrt(a.inertia_kg_m2) * a.initial_rate_rad_s for a in plan.appendages])
    rate = rate - np.linalg.solve(body.inertia_kg_m2, body.couplings @ eta_dot)
    base = _unit(plan.event.attitude)
    attitude = _turned(base, error)
    wheels = np.array(plan.event.from_rpm) / RPM_PER_RAD_S
    return np.concatenate([attitude, rate, wheels, np.zeros(len(eta_dot)), eta_dot])


def _knowledge(plan: Plan, n_cycles: int, rng: Generator) -> tuple[Array, Array]:
    law = plan.rwa if _uses_wheels(plan) else plan.rcs
    noise = rng.standard_normal((2, n_cycles, 3))
    return noise[0] * law.attitude_knowledge_rad, noise[1] * law.rate_knowledge_rad_s


def _uses_wheels(plan: Plan) -> bool:
    return plan.event.kind in ("slew", "quiescent")


def _torque(plan: Plan) -> kernel.Torque:
    steady = _floats([plan.parameters[f"external_torque_{axis}_n_m"] for axis in "xyz"])
    pulse = plan.torque_pulse
    return kernel.Torque(steady, _floats(pulse.peak_n_m), pulse.centre_s, pulse.width_s)


def _wheel_loop(plan: Plan) -> kernel.WheelLoop:
    actions = {"bias": kernel.BIAS_WHEELS, "delta_v": kernel.HOLD_WHEELS}
    target = plan.event.from_rpm if plan.event.to_rpm is None else plan.event.to_rpm
    return kernel.WheelLoop(
        action=actions.get(plan.event.kind, kernel.TORQUE_WHEELS),
        target_rad_s=np.array(target, dtype=np.float64) / RPM_PER_RAD_S,
        start_s=plan.event.start_s,
        torque_limit_n_m=plan.wheels.torque_limit_n_m,
        time_constant_s=plan.wheels.time_constant_s,
        drag_compensation=plan.wheels.drag_compensation,
    )


def rcs_law(plan: Plan, body: kernel.Body) -> kernel.RcsLaw:
    """The thruster controller's settings as numbers."""
    settings = plan.rcs
    pairs = pair_indicator(plan.spacecraft, plan.branch)
    burn = np.zeros(len(plan.thrusters))
    acceleration = 0.0
    if plan.event.kind == "delta_v":
        burn = np.ascontiguousarray((pairs[:4].sum(axis=0) > 0).astype(np.float64))
        mean = float(np.mean([plan.thrust_n[name] for name in plan.thrusters]))
        acceleration = mean * plan.parameters["fsw_acceleration_factor"] / body.mass_kg
    return kernel.RcsLaw(
        active=not _uses_wheels(plan) and plan.event.thrusters_on,
        dead_band_rad=_floats(settings.dead_band_rad),
        rate_gain_s=settings.rate_gain_s,
        hysteresis=settings.hysteresis,
        rate_clamp_rad_s=settings.rate_clamp_rad_s,
        pulse_min_s=settings.pulse_min_s,
        pulse_max_s=settings.pulse_max_s,
        pulse_resolution_s=settings.pulse_resolution_s,
        adaptive=settings.pulse_law == "adaptive",
        shared_only=settings.mapping == "shared",
        latency_cycles=settings.latency_cycles,
        pairs=np.ascontiguousarray(pairs),
        burn=burn,
        burn_delta_v_m_s=plan.event.delta_v_m_s,
        burn_acceleration_m_s2=acceleration,
    )


def rwa_law(plan: Plan, body: kernel.Body) -> kernel.RwaLaw:
    """The wheel controller's settings as numbers, and the attitudes between its slews."""
    slews = sorted(plan.event.slew, key=lambda slew: slew.start_s)
    base = [_unit(plan.event.attitude)]
    for slew in slews:
        base.append(_turned(base[-1], _unit(slew.axis) * slew.angle_rad))
    return kernel.RwaLaw(
        active=_uses_wheels(plan),
        inertia_kg_m2=body.inertia_kg_m2,
        to_wheels=np.ascontiguousarray(np.linalg.pinv(body.axes), dtype=np.float64),
        bandwidth_rad_s=plan.rwa.bandwidth_rad_s,
        damping=plan.rwa.damping,
        torque_limit_n_m=plan.rwa.torque_limit_n_m,
        feed_forward=plan.rwa.feed_forward,
        slew_start_s=_floats([slew.start_s for slew in slews]),
        slew_axis=np.array([_unit(slew.axis) for slew in slews]).reshape(-1, 3),
        slew_angle_rad=_floats([slew.angle_rad for slew in slews]),
        slew_rate_rad_s=_floats([slew.rate_rad_s for slew in slews]),
        slew_acceleration_rad_s2=_floats([slew.acceleration_rad_s2 for slew in slews]),
        slew_base=np.array(base),
    )


def _turned(attitude: Array, angle: Array) -> Array:
    """The attitude after a turn by a rotation vector in body axes."""
    size = float(np.linalg.norm(angle))
    half = 0.5 * math.sin(0.5 * size) / (0.5 * size) if size > 0.0 else 0.5
    x, y, z = half * angle
    s = math.cos(0.5 * size)
    a, b, c, d = attitude
    return np.array(
        [
            s * a + d * x + b * z - c * y,
            s * b + d * y + c * x - a * z,
            s * c + d * z + a * y - b * x,
            s * d - a * x - b * y - c * z,
        ]
    )


def _unit(vector: Sequence[float]) -> Array:
    array = np.array(vector, dtype=np.float64)
    norm = float(np.linalg.norm(array))
    return array / norm


def _floats(values: Sequence[float]) -> Array:
    return np.array(values, dtype=np.float64)
