"""Made-up plans for the simulation's tests: Cassini's numbers in round figures."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any

import numpy as np

from cassini_bayes.simulation.engine import Steps, simulate_motion
from cassini_bayes.simulation.motion import Motion
from cassini_bayes.simulation.plan import Plan, frozen_mapping
from cassini_bayes.simulation.settings import (
    EventSettings,
    PropulsionSettings,
    RcsSettings,
    RwaSettings,
    Slew,
    StartSettings,
    WheelSettings,
)
from cassini_bayes.spacecraft import load_spacecraft

EPOCH = datetime.datetime(2010, 1, 1, tzinfo=datetime.UTC)
PARAMETERS: Mapping[str, float] = {
    "cm_x_m": 0.13,
    "cm_y_m": 0.057,
    "cm_z_m": 1.064,
    "thruster_lx_m": 1.234,
    "thruster_ly_m": 1.61,
    "thruster_lzz_m": 3.019,
    "thruster_lzy_m": 2.88,
    "rwa1_inertia_kg_m2": 0.161,
    "rwa2_inertia_kg_m2": 0.16,
    "rwa3_inertia_kg_m2": 0.161,
    "rwa4_inertia_kg_m2": 0.16,
    "rwa4_tilt_u_rad": 0.01,
    "rwa4_tilt_v_rad": -0.02,
    "inertia_xx_kg_m2": 6558.0,
    "inertia_yy_kg_m2": 5393.0,
    "inertia_zz_kg_m2": 3518.0,
    "inertia_xy_kg_m2": -164.0,
    "inertia_xz_kg_m2": -12.0,
    "inertia_yz_kg_m2": 149.0,
    "external_torque_x_n_m": 0.0,
    "external_torque_y_n_m": 0.0,
    "external_torque_z_n_m": 0.0,
    "tau_delay_s": 0.005,
    "tau_rise_s": 0.02,
    "tau_fall_s": 0.04,
    "mass_kg": 2400.0,
    "mass_factor": 1.0,
    "thrust_common_n": 0.75,
    "fsw_acceleration_factor": 1.0,
    "fsw_impulse_offset_s": 0.0,
}
BIAS: Mapping[str, Any] = {
    "id": "bias",
    "kind": "bias",
    "from_rpm": (-1118.0, 1290.0, 330.0),
    "to_rpm": (626.0, 1300.0, -729.0),
}
SLEWS = tuple(
    Slew(
        start_s=600.0 * i,
        axis=axis,
        angle_rad=angle,
        rate_rad_s=rate,
        acceleration_rad_s2=acceleration,
    )
    for i, (axis, angle, rate, acceleration) in enumerate(
        [
            ((1.0, 0.0, 0.0), 0.4, 1.8e-3, 5e-6),
            ((0.0, 1.0, 0.0), -0.25, 0.89e-3, 5e-6),
            ((0.0, 0.0, 1.0), 0.6, 3.8e-3, 1e-5),
            ((1.0, 1.0, 0.0), -0.3, 1.2e-3, 5e-6),
            ((0.3, -0.5, 0.8), 0.5, 1.8e-3, 5e-6),
            ((0.0, 1.0, -1.0), 0.3, 1.2e-3, 5e-6),
        ]
    )
)

EFFECT_CASES: Mapping[str, Mapping[str, Any]] = {
    "thrust_scale": {"thrust_factor": 0.9},
    "thruster_degraded:z4": {"thrust_factor": 0.77},
    "thrust_warmup": {"warmup_deficit": 0.3, "warmup_time_s": 2.0},
    "tail_off": {"tau_fall_s": 0.065},
    "pulse_shape": {"impulse_time_offset_s": 0.012},
    "center_of_mass:y": {"cm_y_m": 0.10},
    "wheel_inertia:2": {"rwa2_inertia_kg_m2": 0.166},
    "wheel_alignment:4": {"rwa4_tilt_u_rad": 0.05, "rwa4_tilt_v_rad": 0.02},
    "wheel_articulation:4": {"rwa4_articulation_rad": -2.0},
    "thruster_misalignment:y2": {"cant_a_rad": 0.02, "cant_b_rad": -0.03},
    "external_torque": {f"external_torque_{axis}_n_m": 2e-4 for axis in "xyz"},
    "thruster_leak:z1": {"leak_n": 0.01},
    "inertia:xx": {"inertia_xx_kg_m2": 7000.0},
    "time_offset": {"time_offset_s": 2.0},
    "rate_bias:z": {"rate_bias_z_rad_s": 1e-5},
    "rate_scale:x": {"rate_scale": 0.02},
    "flexible_mode": {"frequency_hz": 0.13, "damping": 0.002, "amplitude_rad_s": 1e-5},
    "firing_logic": {"rate_gain_factor": 2.0},
    "atmospheric_torque": {
        "peak_x_n_m": 0.05,
        "peak_y_n_m": 0.0,
        "peak_z_n_m": 0.1,
        "centre_s": 60.0,
        "width_s": 20.0,
    },
    "pressure_surge": {"thrust_fraction": 0.2, "start_s": 50.0, "decay_s": 40.0},
    "tachometer_scale": {"slope_per_rpm": 5e-6},
    "plume_impingement:z4": {"lever_m": 0.1},
}


def make_plan(
    event: Mapping[str, Any] = BIAS,
    parameters: Mapping[str, float] | None = None,
    thrust_n: float = 0.75,
    branch: str = "B",
    wheels: tuple[int, ...] = (1, 2, 4),
    manager: WheelSettings | None = None,
    **changes: Any,
) -> Plan:
    """A plan of one event; ``changes`` replace fields of the plan."""
    spacecraft = load_spacecraft("cassini")
    settings = {
        "rcs": RcsSettings(),
        "rwa": RwaSettings(),
        "wheels": manager or WheelSettings(),
        "propulsion": PropulsionSettings(),
        "start": StartSettings(),
    }
    return Plan(
        spacecraft,
        branch,
        wheels,
        EventSettings.model_validate({"epoch": EPOCH, **event}),
        frozen_mapping({**PARAMETERS, **(parameters or {})}),
        frozen_mapping(dict.fromkeys(spacecraft.thruster_names(branch), thrust_n)),
        **{**settings, **changes},
    )


def run(
    plan: Plan,
    seed: int = 1,
    step_s: float = 0.005,
    cycle_s: float = 0.125,
    record_s: float = 0.125,
) -> Motion:
    """The motion of a plan; start, knowledge errors and torque noise from the seed."""
    streams = (np.random.default_rng([seed, i]) for i in range(3))
    return simulate_motion(plan, Steps.of(step_s, cycle_s, record_s), *streams)
