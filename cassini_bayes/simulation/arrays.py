"""From a plan to the arrays of the compiled loop: body, thrusters, controllers, torques."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known
from cassini_bayes.simulation import kernel
from cassini_bayes.simulation.plan import Plan
from cassini_bayes.spacecraft import (
    Spacecraft,
    cant_axes,
    centre_of_mass,
    inertia_tensor,
    pair_indicator,
    thruster_directions,
    thruster_positions,
    wheel_axes,
    wheel_inertias,
)
from cassini_bayes.spacecraft.two_wheels import (
    HELD_AXES,
    SpinModulation,
    free_axis,
    torque_coupling,
    wheel_torques,
)
from cassini_bayes.spacecraft.units import RPM_PER_RAD_S

LEAST_SINGULAR_VALUE: Final = 0.1
"""Of the wheel axes (1 for orthogonal ones): less, and two wheels are all but parallel."""
LEAST_ALONG: Final = 0.5
"""Of a thruster's force along a burn that has to be with it: within 60° of the direction."""
NEVER_REACHED_RAD: Final = 1e9
"""Dead-band of an axis that is not the thrusters' to hold."""


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
        couplings[:, m] = unit(appendage.axis) * math.sqrt(appendage.inertia_kg_m2)
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
        frequencies_rad_s=floats([2 * np.pi * a.frequency_hz for a in plan.appendages]),
        dampings=floats([a.damping for a in plan.appendages]),
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
        thrust_n=floats([plan.thrust_n[name] for name in names]),
        leak_n=floats([plan.leaks_n.get(name, 0.0) for name in names]),
        leak_start_s=plan.leak_start_s,
        parasitic_m=parasitic,
        start_delay_s=start - min(plan.impulse_offset_s, 0.0),
        rise_end_delay_s=rise_end + max(plan.impulse_offset_s, 0.0),
        hold_end_delay_s=hold_end + max(plan.impulse_offset_s, 0.0),
        jump=jump,
        tau_rise_s=rise,
        tau_fall_s=fall,
        warmup_deficit=floats([plan.warmup_deficit.get(name, 0.0) for name in names]),
        warmup_time_s=float(plan.warmup_time_s),
        surge_fraction=plan.surge.fraction,
        surge_start_s=plan.surge.start_s,
        surge_decay_s=plan.surge.decay_s,
        isp_s=floats(plan.propulsion.isp_s),
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
    check_known("scenario: propulsion.pulse_shape", shape, edges)
    return edges[shape]


def _canted_directions(plan: Plan) -> Array:
    """Force directions (3, K): unit(d + a e1 + b e2) of thrusters that are canted."""
    directions = np.array(thruster_directions(plan.spacecraft, plan.branch))
    for k, name in enumerate(plan.thrusters):
        if name not in plan.cants_rad:
            continue
        a, b = plan.cants_rad[name]
        first, second = cant_axes(directions[:, k])
        canted = directions[:, k] + a * first + b * second
        directions[:, k] = canted / np.linalg.norm(canted)
    return directions


def uses_thrusters(plan: Plan) -> bool:
    """Whether thrusters hold the attitude, or an axis of it: biases and burns."""
    return plan.event.kind in ("bias", "delta_v")


def uses_wheels(plan: Plan) -> bool:
    """Whether the wheels hold the attitude, or two axes of it: slews, quiet periods, hybrids."""
    return not uses_thrusters(plan) or plan.event.hybrid is not None


def axes_by_thrusters(plan: Plan) -> Array:
    """1 for every body axis (3,) that thrusters hold, 0 for the others."""
    hybrid = plan.event.hybrid
    if not uses_thrusters(plan) or hybrid is None:
        return np.full(3, float(uses_thrusters(plan)))
    return floats([float(axis == free_axis(hybrid.controller)) for axis in range(3)])


def external_torque(plan: Plan) -> kernel.Torque:
    """External torque as numbers."""
    steady = floats([plan.parameters[f"external_torque_{axis}_n_m"] for axis in "xyz"])
    pulse = plan.torque_pulse
    return kernel.Torque(steady, floats(pulse.peak_n_m), pulse.centre_s, pulse.width_s)


def wheel_loop(plan: Plan) -> kernel.WheelLoop:
    """The wheel manager's speed loop as numbers."""
    actions = {"bias": kernel.BIAS_WHEELS, "delta_v": kernel.HOLD_WHEELS}
    target = plan.event.from_rpm if plan.event.to_rpm is None else plan.event.to_rpm
    action = actions.get(plan.event.kind, kernel.TORQUE_WHEELS)
    return kernel.WheelLoop(
        action=kernel.TORQUE_WHEELS if uses_wheels(plan) else action,
        target_rad_s=floats(target) / RPM_PER_RAD_S,
        start_s=plan.event.start_s,
        torque_limit_n_m=plan.wheels.torque_limit_n_m,
        time_constant_s=plan.wheels.time_constant_s,
        drag_compensation=plan.wheels.drag_compensation,
    )


def _burn(plan: Plan) -> tuple[Array, Array]:
    """Thrusters (K,) of a burn, 1 or 0, and the acceleration (K,) along it by every thruster.

    A burn takes the thrusters that answer no torque demand, for they serve velocity changes only;
    where there are none, those that turn the body about X and Y. It goes where these push together,
    without those that push elsewhere. The acceleration is what flight software computes.

    Raises
    ------
    InputError
        Their forces cancel each other.
    """
    directions = thruster_directions(plan.spacecraft, plan.branch)
    pairs = pair_indicator(plan.spacecraft, plan.branch)
    spare = pairs.sum(axis=0) == 0.0
    candidates = np.asarray(spare if spare.any() else pairs[:4].sum(axis=0) > 0.0)
    net = directions[:, candidates].sum(axis=1)
    size = float(np.linalg.norm(net))
    burn = candidates & (net @ directions >= LEAST_ALONG * size)
    if size < LEAST_ALONG or not burn.any():
        names = [name for name, is_one in zip(plan.thrusters, candidates, strict=True) if is_one]
        raise InputError(
            f"event {plan.event.id}: kind",
            "for a delta_v event, thrusters that push the spacecraft somewhere together",
            f"{', '.join(names)}, whose forces add up to {size:.2g} of one thruster's",
            "add thrusters to the spacecraft file that are in no axis pair: they serve burns",
        )
    along = unit(directions[:, burn].sum(axis=1)) @ directions
    return burn.astype(np.float64), plan.computed_acceleration_m_s2 * along


def rcs_law(plan: Plan) -> kernel.RcsLaw:
    """The thruster controller's settings as numbers.

    Raises
    ------
    InputError
        The event is a burn of a spacecraft whose thrusters push nowhere together.
    """
    settings = plan.rcs
    pairs = pair_indicator(plan.spacecraft, plan.branch)
    burn, accelerations = np.zeros((2, len(plan.thrusters)))
    offset_s = 0.0
    if plan.event.kind == "delta_v" and plan.event.delta_v_m_s > 0.0:
        burn, accelerations = _burn(plan)
        offset_s = plan.parameters["fsw_impulse_offset_s"]
    held, band = axes_by_thrusters(plan) > 0.0, settings.proportional_band
    return kernel.RcsLaw(
        active=uses_thrusters(plan) and plan.event.thrusters_on,
        dead_band_rad=np.where(held, floats(settings.dead_band_rad), NEVER_REACHED_RAD),
        rate_gain_s=settings.rate_gain_s,
        hysteresis=settings.hysteresis,
        rate_clamp_rad_s=settings.rate_clamp_rad_s,
        pulse_min_s=settings.pulse_min_s,
        pulse_max_s=settings.pulse_max_s,
        pulse_resolution_s=settings.pulse_resolution_s,
        adaptive=settings.pulse_law == "adaptive",
        proportional_band=band if settings.pulse_law == "proportional" else 0.0,
        minimum_off_s=settings.minimum_off_s,
        shared_only=settings.mapping == "shared",
        latency_cycles=settings.latency_cycles,
        pairs=np.ascontiguousarray(pairs),
        burn=burn,
        burn_delta_v_m_s=plan.event.delta_v_m_s,
        burn_start_s=plan.event.start_s,
        burn_acceleration_m_s2=accelerations,
        burn_offset_s=offset_s,
    )


def _to_wheels(plan: Plan, axes: Array) -> Array:
    """Torque of each wheel per torque about every body axis (W, 3)."""
    hybrid, where = plan.event.hybrid, f"event {plan.event.id}: wheels"
    if hybrid is not None:
        shares, held = np.zeros((axes.shape[1], 3)), list(HELD_AXES[hybrid.controller])
        shares[:, held] = wheel_torques(axes, hybrid.controller, where)
        return shares
    least = float(np.linalg.svd(axes, compute_uv=False)[-1])
    if uses_wheels(plan) and (axes.shape[1] < 3 or least < LEAST_SINGULAR_VALUE):
        raise InputError(
            where,
            f"three wheels whose axes span space, for a {plan.event.kind} event",
            f"wheels {list(plan.wheel_numbers)}, too few or all but parallel",
            "choose other prime wheels, or with two of them a hybrid controller",
        )
    return np.ascontiguousarray(np.linalg.pinv(axes), dtype=np.float64)


def _check_spin(plan: Plan, axes: Array) -> None:
    """Paper 004's assumption G1 > |G2| of a body that spins while two wheels hold X and Y."""
    hybrid, rates = plan.event.hybrid, plan.event.from_rpm
    if hybrid is None or hybrid.controller != "dfpw" or hybrid.spin_rad_s <= 0.0:
        return
    where = f"event {plan.event.id}"
    craft = prime_wheels(plan)
    momentum = axes @ (wheel_inertias(craft, plan.parameters) * floats(rates) / RPM_PER_RAD_S)
    p_x, p_y = (float(value) for value in torque_coupling(axes, "dfpw", f"{where}: wheels"))
    SpinModulation(
        plan.parameters["inertia_zz_kg_m2"],
        hybrid.spin_rad_s,
        (p_x, p_y),
        (float(momentum[0]), float(momentum[1])),
        f"{where}: from_rpm and spin_rad_s",
    )


def rwa_law(plan: Plan, body: kernel.Body) -> kernel.RwaLaw:
    """The wheel controller's settings as numbers, and the attitudes between its slews.

    Raises
    ------
    InputError
        The wheels are to hold the attitude, or two axes of it, and cannot turn the body about them;
        or a free spin would stop before it has come round.
    """
    hybrid = plan.event.hybrid
    free_from = math.inf
    if hybrid is not None and not uses_thrusters(plan):
        free_from = 0.0
        _check_spin(plan, body.axes)
    elif hybrid is not None and hybrid.free_from_s is not None:
        free_from = hybrid.free_from_s
    slews = sorted(plan.event.slew, key=lambda slew: slew.start_s)
    base = [unit(plan.event.attitude)]
    for slew in slews:
        base.append(turned(base[-1], unit(slew.axis) * slew.angle_rad))
    return kernel.RwaLaw(
        active=uses_wheels(plan),
        inertia_kg_m2=body.inertia_kg_m2,
        to_wheels=_to_wheels(plan, body.axes),
        bandwidth_rad_s=plan.rwa.bandwidth_rad_s,
        damping=plan.rwa.damping,
        torque_limit_n_m=plan.rwa.torque_limit_n_m,
        feed_forward=plan.rwa.feed_forward,
        slew_start_s=floats([slew.start_s for slew in slews]),
        slew_axis=np.array([unit(slew.axis) for slew in slews]).reshape(-1, 3),
        slew_angle_rad=floats([slew.angle_rad for slew in slews]),
        slew_rate_rad_s=floats([slew.rate_rad_s for slew in slews]),
        slew_acceleration_rad_s2=floats([slew.acceleration_rad_s2 for slew in slews]),
        slew_base=np.array(base),
        free_axis=0 if hybrid is None else free_axis(hybrid.controller),
        free_from_s=free_from,
    )


def turned(attitude: Array, angle: Array) -> Array:
    """The attitude after a turn by a rotation vector in body axes."""
    size = float(np.linalg.norm(angle))
    half = 0.5 * math.sin(0.5 * size) / (0.5 * size) if size > 0.0 else 0.5
    x, y, z = half * angle
    result = np.empty(4)
    kernel.turned(attitude, x, y, z, math.cos(0.5 * size), result)
    return result


def unit(vector: Sequence[float]) -> Array:
    """A vector over its length."""
    array = floats(vector)
    return array / float(np.linalg.norm(array))


def floats(values: Sequence[float]) -> Array:
    """Numbers as an array for the compiled loop."""
    return np.array(values, dtype=np.float64)
