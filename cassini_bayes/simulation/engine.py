"""From a plan to the motion: time grid, duration, start state, and the loop itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.random import Generator

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.simulation import kernel
from cassini_bayes.simulation.arrays import (
    axes_by_thrusters,
    external_torque,
    floats,
    make_body,
    make_thrusters,
    prime_wheels,
    rcs_law,
    rwa_law,
    turned,
    unit,
    wheel_loop,
)
from cassini_bayes.simulation.motion import Motion, PulseLog
from cassini_bayes.simulation.plan import Plan
from cassini_bayes.spacecraft import wheel_inertias
from cassini_bayes.spacecraft.two_wheels import free_axis
from cassini_bayes.spacecraft.units import RPM_PER_RAD_S

RAMP_TIME_CONSTANTS = 6.0
"""Paper 001 section IV: a wheel has arrived n = 6 time constants after its linear ramp."""
MOST_CYCLES: Final = 2_000_000
MOST_RECORDS: Final = 2_000_000
MOST_STEPS_PER_CYCLE: Final = 1_000_000
STEPS_PER_RECORD: Final = 100
"""What fits into memory and an hour: three days of control cycles."""


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
            count = round(min(span / step_s, 2.0 * MOST_STEPS_PER_CYCLE))
            if not 1 <= count <= MOST_STEPS_PER_CYCLE or abs(count * step_s - span) > 1e-9:
                raise InputError(
                    "scenario: step_s",
                    f"a step that divides {name} = {span:g} s, not too finely",
                    f"{step_s:g} s",
                    "choose e.g. 0.005",
                )
            counts.append(count)
        return cls(step_s, counts[0], counts[1])


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
    """Duration of an event, a whole number of control cycles.

    Raises
    ------
    InputError
        An event whose duration neither is given nor follows; less than a cycle, or too many.
    """
    event, where = plan.event, f"event {plan.event.id}: duration_s"
    duration = event.duration_s
    if duration is None:
        if event.kind == "bias" and event.hybrid is None:
            duration = event.start_s + ramp_duration_s(plan) + event.settle_s
        elif event.slew:
            duration = max(s.start_s + s.duration_s for s in event.slew) + event.settle_s
        else:
            expected = f"the duration of a {event.kind} event"
            raise InputError(where, expected, "nothing", "add duration_s = …")
    if not cycle_s * (1.0 - 1e-9) <= duration <= MOST_CYCLES * cycle_s:
        raise InputError(
            where,
            f"1 to {MOST_CYCLES:,} control cycles of {cycle_s:g} s",
            f"{duration:g} s",
            "simulate it in parts; or check rates, limits and inertias if it was not given",
        )
    return math.ceil(duration / cycle_s - 1e-9) * cycle_s


def simulate_motion(
    plan: Plan,
    steps: Steps,
    start_rng: Generator,
    knowledge_rng: Generator,
    torque_rng: Generator,
) -> Motion:
    """Integrate one event.

    Parameters
    ----------
    plan
        The event with all its effects.
    steps
        Time grid.
    start_rng, knowledge_rng, torque_rng
        Draw the start within the dead-band, the controllers' knowledge errors, and torque noise.

    Raises
    ------
    InputError
        As :func:`event_duration_s`; more records or steps than there may be; a motion that the
        steps cannot follow.
    """
    cycle = steps.step_s * steps.per_cycle
    duration = event_duration_s(plan, cycle)
    n_cycles = round(duration / cycle)
    n_steps = n_cycles * steps.per_cycle
    n_records = n_steps // steps.per_record + 1
    if max(n_records, n_steps // STEPS_PER_RECORD) > MOST_RECORDS:
        raise InputError(
            f"event {plan.event.id}: duration_s",
            f"at most {MOST_RECORDS:,} records and {MOST_RECORDS * STEPS_PER_RECORD:,} steps",
            f"{n_records:,} and {n_steps:,}",
            "sample less often, take longer steps, or simulate it in parts",
        )
    body = make_body(plan)
    n_wheels = body.axes.shape[1]
    state = _start_state(plan, body, start_rng)
    starts, widths = np.zeros((2, len(plan.thrusters), n_cycles + 1))
    pulses = kernel.Pulses(starts, widths, np.zeros(len(plan.thrusters), dtype=np.int64))
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
        external_torque(plan),
        _torque_noise(plan, n_cycles + 1, cycle, torque_rng),
        wheel_loop(plan),
        make_thrusters(plan),
        rcs_law(plan),
        rwa_law(plan, body),
        attitude_knowledge,
        rate_knowledge,
        pulses,
        record,
    )
    if not all(np.isfinite(field).all() for field in record):
        raise InputError(
            f"event {plan.event.id}: motion",
            "a motion that steps of this length can follow",
            f"no finite numbers with step_s = {steps.step_s:g}",
            "shorten the step; check frequencies, inertias, torques and their units",
        )
    logs = {
        name: PulseLog(pulses.start_s[k, : pulses.number[k]], pulses.width_s[k, : pulses.number[k]])
        for k, name in enumerate(plan.thrusters)
    }
    return Motion(*record, pulses=logs, body=body)


def _start_state(plan: Plan, body: kernel.Body, rng: Generator) -> Array:
    """y = (q, ω, ρ, η, η̇) at the start.

    On axes under thruster control the attitude error is uniform within a part of the dead-band and
    the rate normal; the wheels' start at rest on target, but for a hybrid's spin. The draws are
    made either way.
    """
    error = rng.uniform(-1.0, 1.0, 3) * plan.start.attitude_spread * floats(plan.rcs.dead_band_rad)
    rate = rng.standard_normal(3) * plan.start.rate_rad_s
    held = axes_by_thrusters(plan)
    error, rate = held * error, held * rate
    if plan.event.hybrid is not None:
        rate[free_axis(plan.event.hybrid.controller)] += plan.event.hybrid.spin_rad_s
    scales = floats([math.sqrt(mode.inertia_kg_m2) for mode in plan.appendages])
    eta = scales * floats([mode.initial_angle_rad for mode in plan.appendages])
    eta_dot = scales * floats([mode.initial_rate_rad_s for mode in plan.appendages])
    rate = rate - np.linalg.solve(body.inertia_kg_m2, body.couplings @ eta_dot)
    attitude = turned(unit(plan.event.attitude), error)
    wheels = np.array(plan.event.from_rpm) / RPM_PER_RAD_S
    return np.concatenate([attitude, rate, wheels, eta, eta_dot])


def _torque_noise(plan: Plan, n_cycles: int, cycle_s: float, rng: Generator) -> Array:
    """White torque (n, 3), N m, constant in a control cycle: a² Δt of momentum squared in each."""
    if plan.torque_noise_n_m_s05 == 0.0:
        return np.zeros((n_cycles, 3))
    return plan.torque_noise_n_m_s05 / math.sqrt(cycle_s) * rng.standard_normal((n_cycles, 3))


def _knowledge(plan: Plan, n_cycles: int, rng: Generator) -> tuple[Array, Array]:
    held = axes_by_thrusters(plan) > 0.0
    rcs, rwa = plan.rcs, plan.rwa
    # time comes first, so that a longer event begins with the draws of a shorter one
    noise = rng.standard_normal((n_cycles, 2, 3))
    attitude = np.where(held, rcs.attitude_knowledge_rad, rwa.attitude_knowledge_rad)
    rate = np.where(held, rcs.rate_knowledge_rad_s, rwa.rate_knowledge_rad_s)
    return np.ascontiguousarray(noise[:, 0] * attitude), np.ascontiguousarray(noise[:, 1] * rate)
