"""Momentum, order of the integrator, impulse of single pulses, speed."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np

from cassini_bayes.report.study_page import markdown_table
from cassini_bayes.simulation import (
    Motion,
    ScenarioFile,
    make_plan,
    read_scenario,
    stream,
)
from cassini_bayes.simulation.arrays import make_thrusters
from cassini_bayes.simulation.engine import Steps, simulate_motion
from cassini_bayes.simulation.kernel import thrust_step
from cassini_bayes.simulation.settings import StartSettings
from cassini_bayes.simulation.telemetry import record_interval_s
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES
from cassini_bayes.studies.scenario import draw_truth, simulate_file
from cassini_bayes.studies.simulation.cases import SCENARIOS, simulated

Result = TypeVar("Result")
WIDTHS_S: Final = (0.007, 0.02, 0.06, 0.125, 0.25, 0.5, 0.75)
STREAMS: Final = ("start", "knowledge", "torque noise")
SHAPES: Final = ("rectangular", "first_order", "first_order_held", "published_2005")
ORDER_STEPS_S: Final = (2.0, 1.0, 0.5)
FINEST_STEP_S: Final = 0.0625
SPEED_RUNS: Final = 6  # the first may compile
MEMORY_RUNS: Final = 3


def relative_drift(motion: Motion) -> float:
    """Largest |H − H(0) − ∫τ dt| over the largest |H|, inertial frame."""
    momentum = motion.momentum_inertial_n_m_s()
    gain = momentum - momentum[0] - motion.angular_impulse_n_m_s
    return float(np.abs(gain).max() / np.linalg.norm(momentum, axis=1).max())


def momentum_section() -> str:
    """Momentum, integrator order, impulse and speed, as a table."""
    slews = read_scenario(SCENARIOS / "slews_2000.toml")
    biases = read_scenario(SCENARIOS / "biases_2009_2010.toml")
    orders = ", ".join(f"{order:.2f}" for order in integrator_orders(biases))
    errors = {shape: max(impulse_error(width, shape) for width in WIDTHS_S) for shape in SHAPES}
    impulse = "largest relative error of a pulse's impulse, 7 to 750 ms"
    drifts = {
        "relative drift of inertial momentum, slews, 4200 s": slews,
        "drift beyond the torque's integral, wheel bias": biases,
    }
    speeds = {
        "wheel bias, 5 ms steps, one core": biases,
        "slews with two appendages, 5 ms steps": slews,
    }
    in_memory = {"wheel bias of 1291 s": (biases, 1), "slews of 4200 s": (slews, 0)}
    rows = [
        *(
            [what, f"{relative_drift(simulated(file, 1)[0].motion):.1e}", "1e-8"]
            for what, file in drifts.items()
        ),
        ["order of the integrator, tumbling, steps of 2, 1, 0.5 s", orders, "4"],
        *([f"{impulse}, {shape}", f"{error:.1e}", "1e-6"] for shape, error in errors.items()),
        *(
            [f"speed, {what}", f"{speed(file):,.0f} × real time", "2,000"]
            for what, file in speeds.items()
        ),
        *(
            [f"in memory, {what} to telemetry", f"{in_memory_s(*event):.2f} s", "–"]
            for what, event in in_memory.items()
        ),
    ]
    return markdown_table(["figure", "measured", "required"], rows)


def integrator_orders(file: ScenarioFile) -> tuple[float, ...]:
    """log₂ of the ratio of errors when the step is halved: a tumbling body, no thrusters.

    Errors are distances of attitude and rate at the end from a run with a far finer step.
    """
    event = file.scenario.event[0].model_copy(
        update={"thrusters_on": False, "duration_s": 96.0, "start": StartSettings(rate_rad_s=0.1)}
    )
    ends = []
    for step in (*ORDER_STEPS_S, FINEST_STEP_S):
        scenario = file.scenario.model_copy(
            update={"event": (event,), "step_s": step, "cycle_s": ORDER_STEPS_S[0]}
        )
        plan = make_plan(scenario, file.spacecraft, event, draw_truth(file, 1))
        steps = Steps.of(step, scenario.cycle_s, scenario.cycle_s)
        motion = simulate_motion(plan, steps, *(stream(1, use) for use in STREAMS))
        ends.append(np.concatenate([motion.attitude[-1], motion.rate_rad_s[-1]]))
    errors = [float(np.linalg.norm(end - ends[-1])) for end in ends[:-1]]
    return tuple(math.log2(a / b) for a, b in itertools.pairwise(errors))


def impulse_error(width_s: float, shape: str = "first_order") -> float:
    """Relative error of the impulse of one pulse against the closed form of its shape."""
    file = read_scenario(SCENARIOS / "fsds_2005.toml")
    truth = draw_truth(file, 1)
    propulsion = file.scenario.propulsion.model_copy(update={"pulse_shape": shape})
    scenario = file.scenario.model_copy(update={"propulsion": propulsion})
    plan = make_plan(scenario, file.spacecraft, scenario.event[0], truth)
    thrusters = make_thrusters(plan)
    on, width = np.array([0.0]), np.array([width_s])
    level = total = 0.0
    for i in range(800):
        level, gained = thrust_step(level, 0.005 * i, 0.005, on, width, 1, thrusters)
        total += gained
    taus = [plan.parameters[f"tau_{which}_s"] for which in ("delay", "rise", "fall")]
    expected = float(PULSE_SHAPES[plan.propulsion.pulse_shape].effective_time(width_s, *taus))
    return abs(total / expected - 1.0)


def speed(file: ScenarioFile) -> float:
    """Simulated seconds per second of processor time: the best of five, after compilation."""
    truth = draw_truth(file, 1)
    scenario = file.scenario
    plan = make_plan(scenario, file.spacecraft, scenario.event[0], truth)
    steps = Steps.of(scenario.step_s, scenario.cycle_s, record_interval_s(scenario.telemetry))
    motion, best = fastest(
        lambda: simulate_motion(plan, steps, *(stream(1, use) for use in STREAMS)), SPEED_RUNS
    )
    return motion.duration_s / best


def in_memory_s(file: ScenarioFile, index: int) -> float:
    """Processor time from a checked scenario to the telemetry of one event: the best of three."""
    event = file.scenario.event[index]
    single = replace(file, scenario=file.scenario.model_copy(update={"event": (event,)}))
    return fastest(lambda: simulate_file(single, 1), MEMORY_RUNS)[1]


def fastest(work: Callable[[], Result], runs: int) -> tuple[Result, float]:
    """The result of some work, and its least processor time of several runs, s."""
    times = []
    for _ in range(runs):
        began = time.process_time()
        result = work()
        times.append(time.process_time() - began)
    return result, min(times)
