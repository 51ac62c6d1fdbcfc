"""Open loop against Basilisk: agreement of rates and wheel speeds, and speed on the same problem.

A tumbling body with three wheels under constant motor torques, no controller, no thruster: the one
problem that both programs state alike. Same rigid body and wheels, classical Runge-Kutta, same step
and span, processor time of one core; only the final state is recorded. The agreement shows whether
the equations are right, the speed whether calibration by thousands of simulations can be afforded.

Needs Basilisk (``pip install bsk``), which is no dependency of the package: without it this script
says so and ends. Not named ``bench_…`` so that ``make bench`` does without it.
"""

from __future__ import annotations

import datetime
import importlib.util
import math
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

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

Array = NDArray[np.float64]
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
    thrusters, rcs, rwa = make_thrusters(plan), rcs_law(plan, body), rwa_law(plan, body)
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


def main() -> None:
    """Run both, print agreement and speed."""
    plan = make_plan()
    own = own_run(plan)
    result = own()  # compiles
    seconds = []
    for _ in range(REPEATS):
        began = time.process_time()
        result = own()
        seconds.append(time.process_time() - began)
    print(f"this package: {SPAN_S / statistics.median(seconds):,.0f} × real time")
    print(f"              median of {REPEATS}, {min(seconds):.4f} to {max(seconds):.4f} s")
    if importlib.util.find_spec("Basilisk") is None:
        print("Basilisk is not installed (pip install bsk): no comparison", file=sys.stderr)
        return
    times, reference = [], result
    for _ in range(REPEATS):
        other = basilisk_run(plan)
        reference = other()
        times.append(other.seconds)  # type: ignore[attr-defined]
    print(f"Basilisk:     {SPAN_S / statistics.median(times):,.0f} × real time")
    print(f"              median of {REPEATS}, {min(times):.4f} to {max(times):.4f} s")
    print(f"ratio of medians: {statistics.median(times) / statistics.median(seconds):.1f}")
    names = ("ω_x", "ω_y", "ω_z", "ρ_1", "ρ_2", "ρ_3")
    for name, a, b in zip(names, result, reference, strict=True):
        print(f"{name}: {a:+.12e}  {b:+.12e}  relative difference {abs(a / b - 1.0):.1e}")


if __name__ == "__main__":
    main()
