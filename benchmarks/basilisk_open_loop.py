"""Open loop against Basilisk: agreement of rates and wheel speeds, and speed on the same problem.

A tumbling body with three wheels under constant motor torques, no controller, no thruster: the one
problem that both programs state alike. Same rigid body and wheels, classical Runge-Kutta, same step
and span, processor time of one core; only the final state is recorded. The agreement shows whether
the equations are right, the speed whether calibration by thousands of simulations can be afforded.

Needs Basilisk (``pip install bsk``), which is no dependency of the package: without it this script
says so and ends. Not named ``bench_…`` so that ``make bench`` does without it.
"""

from __future__ import annotations

import argparse
import datetime
import importlib.util
import math
import platform
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.files.storage import write_text
from cassini_bayes.simulation import kernel
from cassini_bayes.simulation.arrays import make_body, make_thrusters, rcs_law, rwa_law
from cassini_bayes.simulation.engine import Steps
from cassini_bayes.simulation.plan import Plan, frozen_mapping
from cassini_bayes.simulation.settings import (
    EventSettings,
    PropulsionSettings,
    RcsSettings,
    RwaSettings,
    StartSettings,
    WheelSettings,
)
from cassini_bayes.spacecraft import load_spacecraft

STEP_S = 0.005
SPAN_S = 200.0
REPEATS = 5
RATE_RAD_S = (0.02, -0.03, 0.04)
SPEED_RPM = (500.0, -800.0, 1200.0)
MOTOR_N_M = (0.03, -0.02, 0.025)
RPM = 2.0 * math.pi / 60.0
PARAMETERS = {
    "cm_x_m": 0.0,
    "cm_y_m": 0.0,
    "cm_z_m": 0.0,
    "thruster_lx_m": 1.234,
    "thruster_ly_m": 1.61,
    "thruster_lzz_m": 3.019,
    "thruster_lzy_m": 2.88,
    "rwa1_inertia_kg_m2": 0.161,
    "rwa2_inertia_kg_m2": 0.160,
    "rwa3_inertia_kg_m2": 0.161,
    "inertia_xx_kg_m2": 6558.0,
    "inertia_yy_kg_m2": 5393.0,
    "inertia_zz_kg_m2": 3518.0,
    "inertia_xy_kg_m2": -164.0,
    "inertia_xz_kg_m2": -12.0,
    "inertia_yz_kg_m2": 149.0,
    "tau_delay_s": 0.0,
    "tau_rise_s": 0.0,
    "tau_fall_s": 0.0,
    "mass_kg": 2400.0,
    "fsw_acceleration_factor": 1.0,
    **{f"external_torque_{axis}_n_m": 0.0 for axis in "xyz"},
}


def make_plan() -> Plan:
    """The body and its wheels; the event is a shell."""
    spacecraft = load_spacecraft("cassini")
    event = EventSettings(
        id="open-loop",
        kind="delta_v",
        epoch=datetime.datetime(2010, 1, 1, tzinfo=datetime.UTC),
        from_rpm=SPEED_RPM,
        duration_s=SPAN_S,
        thrusters_on=False,
    )
    return Plan(
        spacecraft,
        "B",
        (1, 2, 3),
        event,
        frozen_mapping(PARAMETERS),
        frozen_mapping(dict.fromkeys(spacecraft.thruster_names("B"), 0.7)),
        RcsSettings(),
        RwaSettings(),
        WheelSettings(),
        PropulsionSettings(),
        StartSettings(),
    )


def own_run(plan: Plan) -> Callable[[], Array]:
    """A function that integrates with this package and returns ω and ρ at the end."""
    body = make_body(plan)
    n_steps = round(SPAN_S / STEP_S)
    # constant motor torques: the loop's own hold, with minus the torque as what drag would be
    torque = kernel.Torque(np.zeros(3), np.zeros(3), 0.0, 0.0)
    loop = kernel.WheelLoop(kernel.HOLD_WHEELS, np.zeros(3), 0.0, 1.0, 1.0, 1.0)
    steps = Steps.of(STEP_S, SPAN_S, SPAN_S)
    thrusters, rcs, rwa = make_thrusters(plan), rcs_law(plan), rwa_law(plan, body)
    knowledge = np.zeros((2, 3))

    def run() -> Array:
        y = np.concatenate([[0.0, 0.0, 0.0, 1.0], RATE_RAD_S, np.array(SPEED_RPM) * RPM])
        pulses = kernel.Pulses(np.zeros((8, 2)), np.zeros((8, 2)), np.zeros(8, dtype=np.int64))
        record = kernel.empty_record(2, 3, 0)
        kernel.advance(
            y, np.array(MOTOR_N_M), steps.step_s, n_steps, steps.per_cycle, steps.per_record, body,
            torque, loop, thrusters, rcs, rwa, knowledge, knowledge, pulses, record,
        )  # fmt: skip
        return y[4:10].copy()

    return run


def basilisk_run(plan: Plan) -> Callable[[], Array]:
    """A function that integrates with Basilisk, once; its set-up is not timed."""
    from Basilisk.architecture import messaging
    from Basilisk.simulation import reactionWheelStateEffector, spacecraft, svIntegrators
    from Basilisk.utilities import SimulationBaseClass, macros, simIncludeRW

    body = make_body(plan)
    simulation = SimulationBaseClass.SimBaseClass()
    process = simulation.CreateNewProcess("dynamics")
    process.addTask(simulation.CreateNewTask("step", macros.sec2nano(STEP_S)))
    craft = spacecraft.Spacecraft()
    craft.hub.mHub = body.mass_kg
    craft.hub.r_BcB_B = [[0.0], [0.0], [0.0]]
    craft.hub.IHubPntBc_B = body.inertia_kg_m2.tolist()
    craft.hub.sigma_BNInit = [[0.0], [0.0], [0.0]]
    craft.hub.omega_BN_BInit = [[value] for value in RATE_RAD_S]
    factory = simIncludeRW.rwFactory()
    for j in range(3):
        factory.create(
            "custom",
            body.axes[:, j].tolist(),
            Omega=SPEED_RPM[j],
            Js=float(body.wheel_inertia_kg_m2[j]),
            rWB_B=[0.0, 0.0, 0.0],
            u_max=1.0,
            Omega_max=6000.0,
            RWModel=messaging.BalancedWheels,
        )
    effector = reactionWheelStateEffector.ReactionWheelStateEffector()
    factory.addToSpacecraft("wheels", effector, craft)
    command = messaging.ArrayMotorTorqueMsgPayload()
    command.motorTorque = list(MOTOR_N_M)
    message = messaging.ArrayMotorTorqueMsg().write(command)
    effector.rwMotorCmdInMsg.subscribeTo(message)
    integrator = svIntegrators.svIntegratorRK4(craft)
    craft.setIntegrator(integrator)
    simulation.AddModelToTask("step", effector)
    simulation.AddModelToTask("step", craft)
    kept = (factory, message, integrator)

    def run() -> Array:
        simulation.InitializeSimulation()
        simulation.ConfigureStopTime(macros.sec2nano(SPAN_S))
        began = time.process_time()
        simulation.ExecuteSimulation()
        run.seconds = time.process_time() - began  # type: ignore[attr-defined]
        omega = np.array(craft.scStateOutMsg.read().omega_BN_B)
        speeds = np.array(effector.rwSpeedOutMsg.read().wheelSpeeds[:3])
        assert kept
        return np.concatenate([omega, speeds])

    return run


@dataclass(frozen=True)
class Timing:
    """Median, least and greatest processor time of some runs, s."""

    median_s: float
    least_s: float
    most_s: float

    @classmethod
    def of(cls, seconds: list[float]) -> Timing:
        """Summary of some runs."""
        return cls(statistics.median(seconds), min(seconds), max(seconds))

    @property
    def speed(self) -> float:
        """Simulated over processor time."""
        return SPAN_S / self.median_s


def measure() -> tuple[Timing, Timing, Array, Array]:
    """Processor times and final states of both programs, run one after the other."""
    plan = make_plan()
    own = own_run(plan)
    result = own()  # compiles
    own_s, other_s = [], []
    reference = result
    for _ in range(REPEATS):
        began = time.process_time()
        result = own()
        own_s.append(time.process_time() - began)
        other = basilisk_run(plan)
        reference = other()
        other_s.append(other.seconds)  # type: ignore[attr-defined]
    return Timing.of(own_s), Timing.of(other_s), result, reference


PAGE = """# Open loop against Basilisk

Written by `python benchmarks/basilisk_open_loop.py --out docs/results` with Python {python},
numpy {numpy}, numba {numba}, Basilisk (`bsk`) {bsk}. A tumbling body with three wheels under
constant motor torques, no controller, no thrusters: same rigid body and wheels, classical
Runge-Kutta, steps of {step:g} ms, span {span:g} s, only the final state
recorded; processor time of one core, median of {repeats} runs (least to most), taken by turns.

| program | time of a run [s] | × real time |
| --- | --- | --- |
| this package | {own.median_s:.4f} ({own.least_s:.4f} to {own.most_s:.4f}) | {own.speed:,.0f} |
| Basilisk | {other.median_s:.4f} ({other.least_s:.4f} to {other.most_s:.4f}) | {other.speed:,.0f} |

Ratio of the medians: {ratio:.1f} (required: 20).

| final state | this package | Basilisk | relative difference (required: 1e-6) |
| --- | --- | --- | --- |
{rows}
"""


def main() -> None:
    """Run both, print agreement and speed; with ``--out`` write them to a page too."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="folder for simulation_basilisk.md")
    options = parser.parse_args()
    if importlib.util.find_spec("Basilisk") is None:
        print("Basilisk is not installed (pip install bsk): no comparison", file=sys.stderr)
        return
    own, other, result, reference = measure()
    names = (
        "ω_x [rad/s]",
        "ω_y [rad/s]",
        "ω_z [rad/s]",
        "ρ_1 [rad/s]",
        "ρ_2 [rad/s]",
        "ρ_3 [rad/s]",
    )
    rows = [
        f"| {name} | {a:+.12e} | {b:+.12e} | {abs(a / b - 1.0):.1e} |"
        for name, a, b in zip(names, result, reference, strict=True)
    ]
    text = PAGE.format(
        python=platform.python_version(),
        numpy=np.__version__,
        numba=version("numba"),
        bsk=version("bsk"),
        step=1e3 * STEP_S,
        span=SPAN_S,
        repeats=REPEATS,
        own=own,
        other=other,
        ratio=other.median_s / own.median_s,
        rows="\n".join(rows),
    )
    print(text)
    if options.out is not None:
        write_text(options.out / "simulation_basilisk.md", text)


if __name__ == "__main__":
    main()
