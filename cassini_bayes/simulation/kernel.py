"""The loop in time, compiled: rigid body with wheels and bending modes, thrusters, controllers.

All compiled functions are in this one file on purpose: numba's cache on disk notices a change in
the file of a function, but not in another file that the function calls into. Arrays are float64,
body axes, SI units; every name in the structures says the unit. ``docs/topics/simulation.md``
derives the equations.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.compilation import compiled

Integers = NDArray[np.int64]

STANDARD_GRAVITY_M_S2: Final = 9.80665
HYDRAZINE_DENSITY_KG_M3: Final = 1008.0
HOLD_WHEELS, BIAS_WHEELS, TORQUE_WHEELS = 0, 1, 2  # what the wheels do
EDGE_TOLERANCE_S: Final = 1e-12


class Body(NamedTuple):
    """Mass properties: M modes with mass-normalised couplings δ, W wheels with axes a."""

    inertia_kg_m2: Array  # (3, 3) with the stationary wheels
    reduced_inverse: Array  # (3, 3) inverse of I − Σ I_w a aᵀ − Σ δ δᵀ
    axes: Array  # (3, W)
    wheel_inertia_kg_m2: Array  # (W,)
    wheel_inverse: Array  # (W,) 1 / inertia: a division costs as much as five products
    drag_coulomb_n_m: float
    drag_viscous_n_m_s: float
    couplings: Array  # (3, M)
    frequencies_rad_s: Array  # (M,)
    dampings: Array  # (M,)
    mass_kg: float


class Torque(NamedTuple):
    """External torque: steady, and a pulse peak · exp(−½ ((t − centre)/width)²)."""

    steady_n_m: Array  # (3,)
    peak_n_m: Array  # (3,)
    centre_s: float
    width_s: float


class WheelLoop(NamedTuple):
    """Speed loop of the wheel manager (paper 001 section IV)."""

    action: int
    target_rad_s: Array  # (W,)
    start_s: float
    torque_limit_n_m: float
    time_constant_s: float
    drag_compensation: float


class Thrusters(NamedTuple):
    """Thrusters of the branch, and the pulse shape as four numbers beside its time constants.

    Thrust rises from ``start_delay_s`` after the on command (to a fraction ``jump`` at once) until
    ``rise_end_delay_s`` after the off command, is held until ``hold_end_delay_s`` after it, and
    then decays.
    """

    levers_m: Array  # (3, K) torque per newton
    directions: Array  # (3, K)
    thrust_n: Array  # (K,) steady, at the start of the event
    leak_n: Array  # (K,)
    leak_start_s: float
    parasitic_m: Array  # (3, K) extra torque per newton (plume)
    start_delay_s: float
    rise_end_delay_s: float
    hold_end_delay_s: float
    jump: float
    tau_rise_s: float
    tau_fall_s: float
    warmup_deficit: Array  # (K,)
    warmup_time_s: float
    surge_fraction: float
    surge_start_s: float
    surge_decay_s: float
    isp_s: Array  # (5,) P0 … P4 of paper 001 eq. (19)
    tank_pressure_kpa: float
    ullage_m3: float


class RcsLaw(NamedTuple):
    """Bang-off-bang controller (paper 001 section III)."""

    active: bool
    dead_band_rad: Array  # (3,)
    rate_gain_s: float
    hysteresis: float
    rate_clamp_rad_s: float
    pulse_min_s: float
    pulse_max_s: float
    pulse_resolution_s: float
    adaptive: bool
    proportional_band: float  # of the dead-band, over which widths grow to the largest; 0: no
    minimum_off_s: float
    shared_only: bool
    latency_cycles: int
    pairs: Array  # (6, K): +x −x +y −y +z −z
    burn: Array  # (K,) 1 for thrusters of a ΔV burn
    burn_delta_v_m_s: float
    burn_start_s: float
    burn_acceleration_m_s2: Array  # (K,) along the burn, as the flight software computes it
    burn_offset_s: float  # on-time that it adds for every pulse


class RwaLaw(NamedTuple):
    """PD controller with feed-forward (paper 000 section III) and its slews."""

    active: bool
    inertia_kg_m2: Array  # (3, 3) the controller's knowledge
    to_wheels: Array  # (W, 3) inverse (or pseudo-inverse) of the wheel axes
    bandwidth_rad_s: float
    damping: float
    torque_limit_n_m: float
    feed_forward: bool
    slew_start_s: Array  # (S,)
    slew_axis: Array  # (S, 3)
    slew_angle_rad: Array  # (S,)
    slew_rate_rad_s: Array  # (S,)
    slew_acceleration_rad_s2: Array  # (S,)
    slew_base: Array  # (S + 1, 4) attitude at rest before each slew, and at the end
    free_axis: int  # nobody holds it from this time on: its own direction is what is held
    free_from_s: float


class Pulses(NamedTuple):
    """Log of commanded pulses; the loop fills it. Pulses that touch are one."""

    start_s: Array  # (K, P)
    width_s: Array  # (K, P)
    number: Integers  # (K,)


class Record(NamedTuple):
    """Log of the motion at the recorded times; the loop fills it."""

    time_s: Array  # (N,)
    attitude: Array  # (N, 4)
    rate_rad_s: Array  # (N, 3)
    wheels_rad_s: Array  # (N, W)
    modes: Array  # (N, 2M): η (kg^½ m), η̇
    attitude_error_rad: Array  # (N, 3)
    angular_impulse_n_m_s: Array  # (N, 3) inertial, of all external torques
    delta_v_body_m_s: Array  # (N, 3)
    delta_v_inertial_m_s: Array  # (N, 3)
    tank_pressure_kpa: Array  # (N,)
    propellant_kg: Array  # (N,)


@compiled
def drag_torque(coulomb: float, viscous: float, speed: float) -> float:
    """Drag on a wheel, N m: Coulomb (smoothed within about 1 rad/s of rest) and viscous."""
    if coulomb == 0.0:
        return viscous * speed  # tanh is what would cost
    return coulomb * math.tanh(speed) + viscous * speed


@compiled
def speed_loop_torque(loop: WheelLoop, inertia: float, target: float, speed: float) -> float:
    """Accelerating torque of the speed loop: I_w (target − speed)/τ_W within the torque limit."""
    wanted = inertia * (target - speed) / loop.time_constant_s
    return min(max(wanted, -loop.torque_limit_n_m), loop.torque_limit_n_m)


@compiled
def external_torque(torque: Torque, time: float, out: Array) -> None:
    """External torque in body axes at a time, into ``out``."""
    factor = 0.0
    if torque.width_s > 0.0:
        x = (time - torque.centre_s) / torque.width_s
        factor = math.exp(-0.5 * x * x)
    for i in range(3):
        out[i] = torque.steady_n_m[i] + factor * torque.peak_n_m[i]


@compiled
def derivative(
    time: float,
    y: Array,
    thrust_torque: Array,
    motor: Array,
    body: Body,
    torque: Torque,
    loop: WheelLoop,
    out: Array,
    work: Array,
) -> None:
    """Equations of motion: ẏ of y = (q, ω, ρ, η, η̇), into ``out``; ``work`` is (3,) scratch.

    J ω̇ = τ − Σ a u − ω × H − Σ δ f with H = I ω + Σ a I_w ρ + Σ δ η̇ and
    J = I − Σ I_w a aᵀ − Σ δ δᵀ;  I_w ρ̇ = u − I_w a·ω̇;
    η̈ = f − δ·ω̇ with f = −2ζΩη̇ − Ω²η;  q̇ = ½ Ω(ω) q.
    """
    n_wheels = body.axes.shape[1]
    n_modes = body.couplings.shape[1]
    wx, wy, wz = y[4], y[5], y[6]
    inertia = body.inertia_kg_m2
    hx = inertia[0, 0] * wx + inertia[0, 1] * wy + inertia[0, 2] * wz
    hy = inertia[1, 0] * wx + inertia[1, 1] * wy + inertia[1, 2] * wz
    hz = inertia[2, 0] * wx + inertia[2, 1] * wy + inertia[2, 2] * wz
    external_torque(torque, time, work)
    tx = work[0] + thrust_torque[0]
    ty = work[1] + thrust_torque[1]
    tz = work[2] + thrust_torque[2]
    for j in range(n_wheels):
        speed = y[7 + j]
        momentum = body.wheel_inertia_kg_m2[j] * speed
        hx += body.axes[0, j] * momentum
        hy += body.axes[1, j] * momentum
        hz += body.axes[2, j] * momentum
        drag = drag_torque(body.drag_coulomb_n_m, body.drag_viscous_n_m_s, speed)
        if loop.action == BIAS_WHEELS:
            target = loop.target_rad_s[j]
            if time < loop.start_s:
                target = speed
            accelerating = speed_loop_torque(loop, body.wheel_inertia_kg_m2[j], target, speed)
            wheel_torque = accelerating - (1.0 - loop.drag_compensation) * drag
        elif loop.action == HOLD_WHEELS:
            wheel_torque = -(1.0 - loop.drag_compensation) * drag
        else:
            wheel_torque = motor[j] - drag
        out[7 + j] = wheel_torque * body.wheel_inverse[j]
        tx -= body.axes[0, j] * wheel_torque
        ty -= body.axes[1, j] * wheel_torque
        tz -= body.axes[2, j] * wheel_torque
    first = 7 + n_wheels
    for m in range(n_modes):
        speed = y[first + n_modes + m]
        frequency = body.frequencies_rad_s[m]
        force = -2.0 * body.dampings[m] * frequency * speed
        force -= frequency * frequency * y[first + m]
        out[first + m] = speed
        out[first + n_modes + m] = force
        hx += body.couplings[0, m] * speed
        hy += body.couplings[1, m] * speed
        hz += body.couplings[2, m] * speed
        tx -= body.couplings[0, m] * force
        ty -= body.couplings[1, m] * force
        tz -= body.couplings[2, m] * force
    tx -= wy * hz - wz * hy
    ty -= wz * hx - wx * hz
    tz -= wx * hy - wy * hx
    inverse = body.reduced_inverse
    ax = inverse[0, 0] * tx + inverse[0, 1] * ty + inverse[0, 2] * tz
    ay = inverse[1, 0] * tx + inverse[1, 1] * ty + inverse[1, 2] * tz
    az = inverse[2, 0] * tx + inverse[2, 1] * ty + inverse[2, 2] * tz
    for j in range(n_wheels):
        out[7 + j] -= body.axes[0, j] * ax + body.axes[1, j] * ay + body.axes[2, j] * az
    for m in range(n_modes):
        out[first + n_modes + m] -= (
            body.couplings[0, m] * ax + body.couplings[1, m] * ay + body.couplings[2, m] * az
        )
    out[0] = 0.5 * (wz * y[1] - wy * y[2] + wx * y[3])
    out[1] = 0.5 * (-wz * y[0] + wx * y[2] + wy * y[3])
    out[2] = 0.5 * (wy * y[0] - wx * y[1] + wz * y[3])
    out[3] = 0.5 * (-wx * y[0] - wy * y[1] - wz * y[2])
    out[4] = ax
    out[5] = ay
    out[6] = az


@compiled
def runge_kutta_step(
    time: float,
    step: float,
    y: Array,
    thrust_torque: Array,
    motor: Array,
    body: Body,
    torque: Torque,
    loop: WheelLoop,
    work: Array,
    scratch: Array,
) -> None:
    """One classical Runge-Kutta step of ``y`` in place; scratch: ``work`` (5, len(y)), (3,)."""
    size = y.shape[0]
    k1, k2, k3, k4, at = work[0], work[1], work[2], work[3], work[4]
    half = 0.5 * step
    derivative(time, y, thrust_torque, motor, body, torque, loop, k1, scratch)
    for i in range(size):
        at[i] = y[i] + half * k1[i]
    derivative(time + half, at, thrust_torque, motor, body, torque, loop, k2, scratch)
    for i in range(size):
        at[i] = y[i] + half * k2[i]
    derivative(time + half, at, thrust_torque, motor, body, torque, loop, k3, scratch)
    for i in range(size):
        at[i] = y[i] + step * k3[i]
    derivative(time + step, at, thrust_torque, motor, body, torque, loop, k4, scratch)
    sixth = step / 6.0
    for i in range(size):
        y[i] += sixth * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    scale = 1.0 / math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2] + y[3] * y[3])
    for i in range(4):
        y[i] *= scale


@compiled
def to_inertial(y: Array, vector: Array, out: Array) -> None:
    """A body vector in the inertial frame, Cᵀ v with C of the quaternion y[:4], into ``out``."""
    x, yy, z, s = y[0], y[1], y[2], y[3]
    norm = x * x + yy * yy + z * z + s * s
    vx, vy, vz = vector[0], vector[1], vector[2]
    cx, cy, cz = yy * vz - z * vy, z * vx - x * vz, x * vy - yy * vx
    dot = x * vx + yy * vy + z * vz
    square = s * s - (x * x + yy * yy + z * z)
    out[0] = (square * vx + 2.0 * x * dot + 2.0 * s * cx) / norm
    out[1] = (square * vy + 2.0 * yy * dot + 2.0 * s * cy) / norm
    out[2] = (square * vz + 2.0 * z * dot + 2.0 * s * cz) / norm


@compiled
def exponential_approach(level: float, goal: float, tau: float, span: float) -> tuple[float, float]:
    """Level after ``span`` of ẋ = (goal − x)/τ, and ∫ x dt: exact, with the limit at τ = 0."""
    if tau <= 0.0:
        return goal, goal * span
    gone = -math.expm1(-span / tau)
    return level + (goal - level) * gone, goal * span + (level - goal) * tau * gone


@compiled
def thrust_step(
    level: float, time: float, step: float, on: Array, width: Array, count: int, shape: Thrusters
) -> tuple[float, float]:
    """Thrust fraction after a step, and its integral over the step: exact between edges.

    Only the two latest pulses can still have an edge that matters: one that goes on beyond the next
    (an offset may make it) ends while that one holds the valve open.
    """
    end = time + step
    now = time
    integral = 0.0
    last_edge = on[count - 1] + width[count - 1] + shape.hold_end_delay_s
    if level < 1e-18 and time > last_edge:
        return 0.0, 0.0
    while end - now > EDGE_TOLERANCE_S:
        rising = False
        held = False
        edge = end
        for back in range(2):
            index = count - 1 - back
            if index < 0:
                break
            start = on[index] + shape.start_delay_s
            off = on[index] + width[index]
            rise_end = off + shape.rise_end_delay_s
            hold_end = off + shape.hold_end_delay_s
            if now >= start - EDGE_TOLERANCE_S and now < rise_end - EDGE_TOLERANCE_S:
                rising = True
                if now < start + EDGE_TOLERANCE_S:
                    level = max(level, shape.jump)
            elif now >= start - EDGE_TOLERANCE_S and now < hold_end - EDGE_TOLERANCE_S:
                held = True
            for candidate in (start, rise_end, hold_end):
                if now + EDGE_TOLERANCE_S < candidate < edge:
                    edge = candidate
        span = edge - now
        if rising:
            level, area = exponential_approach(level, 1.0, shape.tau_rise_s, span)
        elif held:
            area = level * span
        else:
            level, area = exponential_approach(level, 0.0, shape.tau_fall_s, span)
        integral += area
        now = edge
    return level, integral


@compiled
def specific_impulse(isp: Array, duty: float) -> float:
    """I_sp(μ) = P0 − P1 exp(−P2 μ) − P3 exp(−P4 μ), in s (paper 001 eq. 19)."""
    first: float = isp[1] * math.exp(-isp[2] * duty)
    second: float = isp[3] * math.exp(-isp[4] * duty)
    plateau: float = isp[0]
    return plateau - first - second


@compiled
def turn_from(target: Array, y: Array) -> tuple[tuple[float, float, float], float]:
    """The turn from the target to the attitude as a quaternion: vector and scalar."""
    tx, ty, tz, ts = target[0], target[1], target[2], target[3]
    x, yy, z, s = y[0], y[1], y[2], y[3]
    ex = ts * x - s * tx + (yy * tz - z * ty)
    ey = ts * yy - s * ty + (z * tx - x * tz)
    ez = ts * z - s * tz + (x * ty - yy * tx)
    return (ex, ey, ez), ts * s + tx * x + ty * yy + tz * z


@compiled
def turned(base: Array, x: float, y: float, z: float, scalar: float, out: Array) -> None:
    """The attitude after a turn by a quaternion in body axes, into ``out``."""
    out[0] = scalar * base[0] + base[3] * x + base[1] * z - base[2] * y
    out[1] = scalar * base[1] + base[3] * y + base[2] * x - base[0] * z
    out[2] = scalar * base[2] + base[3] * z + base[0] * y - base[1] * x
    out[3] = scalar * base[3] - base[0] * x - base[1] * y - base[2] * z


@compiled
def attitude_error(target: Array, y: Array, out: Array) -> None:
    """Small-angle error of the attitude against the target, body axes, rad, into ``out``."""
    (ex, ey, ez), es = turn_from(target, y)
    sign = 2.0 if es >= 0.0 else -2.0
    out[0], out[1], out[2] = sign * ex, sign * ey, sign * ez


@compiled
def direction_error(target: Array, y: Array, axis: int, out: Array) -> None:
    """Small-angle error of the direction of one body axis against the target's, into ``out``.

    With t the target's axis in body axes (of C(y) C(target)ᵀ) it is t × axis: nothing along the
    axis itself, about which the body may have turned by any angle.
    """
    turn, es = turn_from(target, y)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    # components of C[:, axis] across the axis, C = (s² − e·e) 1 + 2 e eᵀ − 2 s [e×]
    on_first = 2.0 * turn[first] * turn[axis] + 2.0 * es * (-turn[second])
    on_second = 2.0 * turn[second] * turn[axis] + 2.0 * es * turn[first]
    out[axis] = 0.0
    out[first] = on_second
    out[second] = -on_first


@compiled
def control_error(law: RwaLaw, time: float, target: Array, y: Array, out: Array) -> None:
    """Error of the attitude, or of the free axis' direction from its time on, into ``out``."""
    if time >= law.free_from_s:
        direction_error(target, y, law.free_axis, out)
    else:
        attitude_error(target, y, out)


@compiled
def profile(
    time: float, angle: float, rate: float, acceleration: float
) -> tuple[float, float, float]:
    """Angle, rate and acceleration of a rest-to-rest slew within its limits (a trapezoid)."""
    sign = 1.0 if angle >= 0.0 else -1.0
    size = abs(angle)
    peak = min(rate, math.sqrt(size * acceleration))
    ramp = peak / acceleration
    cruise = size / peak - ramp if peak > 0.0 else 0.0
    if time <= 0.0 or peak == 0.0:
        return 0.0, 0.0, 0.0
    if time < ramp:
        climbed = sign * 0.5 * acceleration * time * time
        return climbed, sign * acceleration * time, sign * acceleration
    if time < ramp + cruise:
        return sign * peak * (time - 0.5 * ramp), sign * peak, 0.0
    left = 2.0 * ramp + cruise - time
    if left > 0.0:
        reached = sign * (size - 0.5 * acceleration * left * left)
        return reached, sign * acceleration * left, -sign * acceleration
    return sign * size, 0.0, 0.0


@compiled
def slew_target(law: RwaLaw, time: float, target: Array, rate: Array, acceleration: Array) -> None:
    """Commanded attitude, rate and acceleration (body axes) at a time, into the arrays."""
    current = -1
    for i in range(law.slew_start_s.shape[0]):
        if time >= law.slew_start_s[i]:
            current = i
    for i in range(3):
        rate[i] = 0.0
        acceleration[i] = 0.0
    if current < 0:
        target[:] = law.slew_base[0]
        return
    angle, speed, ramp = profile(
        time - law.slew_start_s[current],
        law.slew_angle_rad[current],
        law.slew_rate_rad_s[current],
        law.slew_acceleration_rad_s2[current],
    )
    axis = law.slew_axis[current]
    sine, cosine = math.sin(0.5 * angle), math.cos(0.5 * angle)
    x, y, z = sine * axis[0], sine * axis[1], sine * axis[2]
    turned(law.slew_base[current], x, y, z, cosine, target)
    for i in range(3):
        rate[i] = speed * axis[i]
        acceleration[i] = ramp * axis[i]


@compiled
def wheel_command(
    law: RwaLaw,
    body: Body,
    loop: WheelLoop,
    y: Array,
    error: Array,
    rate: Array,
    acceleration: Array,
    motor: Array,
    work: Array,
) -> None:
    """Motor torques of the PD controller with feed-forward, into ``motor``; ``work`` is (3, ·)."""
    n_wheels = motor.shape[0]
    momentum, wanted, gyro = work[0], work[1], work[2]
    stiffness = law.bandwidth_rad_s * law.bandwidth_rad_s
    viscosity = 2.0 * law.damping * law.bandwidth_rad_s
    for i in range(3):
        momentum[i] = 0.0
        wanted[i] = -law.inertia_kg_m2[i, i] * (
            stiffness * error[i] + viscosity * (y[4 + i] - rate[i])
        )
        for j in range(3):
            momentum[i] += law.inertia_kg_m2[i, j] * y[4 + j]
            if law.feed_forward:
                wanted[i] += law.inertia_kg_m2[i, j] * acceleration[j]
        for j in range(n_wheels):
            momentum[i] += body.axes[i, j] * body.wheel_inertia_kg_m2[j] * y[7 + j]
    gyro[0] = y[5] * momentum[2] - y[6] * momentum[1]
    gyro[1] = y[6] * momentum[0] - y[4] * momentum[2]
    gyro[2] = y[4] * momentum[1] - y[5] * momentum[0]
    for j in range(n_wheels):
        value = 0.0
        for i in range(3):
            value -= law.to_wheels[j, i] * (wanted[i] + (gyro[i] if law.feed_forward else 0.0))
        drag = drag_torque(body.drag_coulomb_n_m, body.drag_viscous_n_m_s, y[7 + j])
        value += loop.drag_compensation * drag
        motor[j] = min(max(value, -law.torque_limit_n_m), law.torque_limit_n_m)


@compiled
def demanded_widths(law: RcsLaw, error: Array, rate: Array, time: float, memory: Array) -> None:
    """Pulse width demanded of +x −x +y −y +z −z this cycle, into memory[0].

    u = −(e_θ + k e_ω), e_θ clamped; an axis begins to fire when |u| passes the dead-band and goes
    on until |u| falls below (1 − hysteresis) of it. A direction that has stopped stays off for the
    least time off. Proportional widths grow with what |u| has beyond the level at which it stops.
    ``memory`` rows: 0 widths; 1 whether firing; 2 the adaptive width; 3 the time of the direction's
    last firing.
    """
    clamp = law.rate_clamp_rad_s * law.rate_gain_s
    for axis in range(3):
        position = min(max(error[axis], -clamp), clamp) if clamp > 0.0 else error[axis]
        switch = -(position + law.rate_gain_s * rate[axis])
        band = law.dead_band_rad[axis]
        for side in range(2):
            row = 2 * axis + side
            value = switch if side == 0 else -switch
            was_firing = memory[1, row] > 0.0
            level = band * (1.0 - law.hysteresis)
            fires = value > level if was_firing else value > band
            # a pulse of this cycle's last ends within the cycle after it began
            rests = time - memory[3, row] < law.minimum_off_s + law.pulse_max_s - 1e-9
            if fires and not was_firing and rests:
                fires = False
            memory[0, row] = 0.0
            memory[1, row] = 0.0
            if not fires:
                continue
            memory[1, row] = 1.0
            width = law.pulse_max_s
            if law.adaptive:
                if not was_firing:
                    # a cycle that reached the other side was given too much, one that comes back
                    # to the same side within seconds too little
                    if memory[3, 2 * axis + 1 - side] > memory[3, row]:
                        memory[2, row] = max(0.5 * memory[2, row], law.pulse_min_s)
                    elif time - memory[3, row] < 10.0:
                        memory[2, row] = min(2.0 * memory[2, row], law.pulse_max_s)
                else:
                    memory[2, row] = law.pulse_max_s
                width = memory[2, row]
            if law.proportional_band > 0.0:
                share = (value - level) / (law.proportional_band * band)
                width = law.pulse_max_s * min(share, 1.0)
            steps = math.floor(width / law.pulse_resolution_s + 0.5)
            memory[0, row] = min(
                max(steps * law.pulse_resolution_s, law.pulse_min_s), law.pulse_max_s
            )
            memory[3, row] = time


@compiled
def is_shared(law: RcsLaw, widths: Array, row: int, k: int) -> bool:
    """Whether another direction than that of a row demands a thruster as well."""
    for other in range(6):
        if other != row and widths[other] > 0.0 and law.pairs[other, k] > 0.0:
            return True
    return False


@compiled
def thruster_widths(law: RcsLaw, widths: Array, burning: bool, out: Array) -> None:
    """Width commanded to every thruster, from the widths demanded of the six directions.

    Where two demands have a thruster in common, either only that one fires (the others would
    cancel each other's torque), or all of them do. In a burn the burn's thrusters are on, except
    those that a demand leaves out.
    """
    n_thrusters = out.shape[0]
    for k in range(n_thrusters):
        out[k] = 0.0
    for row in range(6):
        if widths[row] == 0.0:
            continue
        overlaps = False
        for k in range(n_thrusters):
            overlaps = overlaps or (law.pairs[row, k] > 0.0 and is_shared(law, widths, row, k))
        for k in range(n_thrusters):
            if law.pairs[row, k] == 0.0:
                continue
            if is_shared(law, widths, row, k) or not (overlaps and law.shared_only):
                out[k] = max(out[k], widths[row])
    if not burning:
        return
    for k in range(n_thrusters):
        if law.burn[k] == 0.0:
            continue
        off = 0.0
        for row in range(6):
            if widths[row] > 0.0 and law.pairs[row, k] == 0.0:
                for other in range(n_thrusters):
                    if law.burn[other] > 0.0 and law.pairs[row, other] > 0.0:
                        off = max(off, widths[row])
        rest = law.pulse_max_s - off
        out[k] = 0.0 if rest < law.pulse_min_s else rest


@compiled
def log_pulses(pulses: Pulses, time: float, widths: Array) -> None:
    """Add this cycle's pulses to the log; a pulse that touches the one before makes it longer."""
    for k in range(widths.shape[0]):
        if widths[k] == 0.0:
            continue
        last = pulses.number[k] - 1
        if last_end_s(pulses, k) > time - 1e-9:
            pulses.width_s[k, last] = time + widths[k] - pulses.start_s[k, last]
        else:
            pulses.start_s[k, last + 1] = time
            pulses.width_s[k, last + 1] = widths[k]
            pulses.number[k] += 1


@compiled
def last_end_s(pulses: Pulses, k: int) -> float:
    """When the last pulse of a thruster ends; long ago where there was none."""
    last = pulses.number[k] - 1
    return pulses.start_s[k, last] + pulses.width_s[k, last] if last >= 0 else -math.inf


@compiled
def can_thrust(time: float, thrusters: Thrusters, pulses: Pulses, levels: Array) -> bool:
    """Whether any thruster can push in the control cycle that begins: a tail, or a pulse."""
    for k in range(levels.shape[0]):
        if levels[k] > 0.0 or time <= last_end_s(pulses, k) + thrusters.hold_end_delay_s:
            return True
    return False


@compiled
def deliver(
    time: float,
    step: float,
    thrusters: Thrusters,
    leaking: bool,
    used_kg: float,
    pulses: Pulses,
    levels: Array,
    on_time: Array,
    torque: Array,
    force: Array,
) -> tuple[float, bool]:
    """Mean torque and force of all thrusters over a step, into the arrays.

    Advances the thrust levels and the thrusters' own on-times; returns the hydrazine used, kg, and
    whether anything thrust.
    """
    gained = 0.0
    thrusting = False
    for axis in range(3):
        torque[axis] = 0.0
        force[axis] = 0.0
    factor = 1.0 / (1.0 + used_kg / (HYDRAZINE_DENSITY_KG_M3 * thrusters.ullage_m3))
    if thrusters.surge_decay_s > 0.0 and time >= thrusters.surge_start_s:
        age = (time - thrusters.surge_start_s) / thrusters.surge_decay_s
        factor *= 1.0 + thrusters.surge_fraction * math.exp(-age)
    for k in range(thrusters.thrust_n.shape[0]):
        delivered = 0.0
        ends = last_end_s(pulses, k)
        if levels[k] > 0.0 or time <= ends + thrusters.hold_end_delay_s:
            on_time[k] += min(max(ends - time, 0.0), step)
            on, width, count = pulses.start_s[k], pulses.width_s[k], pulses.number[k]
            levels[k], delivered = thrust_step(levels[k], time, step, on, width, count, thrusters)
        if delivered == 0.0 and not leaking:
            continue
        thrusting = True
        strength = thrusters.thrust_n[k] * factor
        if thrusters.warmup_deficit[k] != 0.0:
            cold = math.exp(-on_time[k] / thrusters.warmup_time_s)
            strength *= 1.0 - thrusters.warmup_deficit[k] * cold
        newton_seconds = strength * delivered
        if time >= thrusters.leak_start_s:
            newton_seconds += thrusters.leak_n[k] * step
        isp = specific_impulse(thrusters.isp_s, on_time[k] / (time + step))
        gained += newton_seconds / (STANDARD_GRAVITY_M_S2 * isp)
        mean = newton_seconds / step
        for axis in range(3):
            lever = thrusters.levers_m[axis, k] + thrusters.parasitic_m[axis, k]
            torque[axis] += lever * mean
            force[axis] += thrusters.directions[axis, k] * mean
    return gained, thrusting


def empty_record(rows: int, wheels: int, modes: int) -> Record:
    """A log for so many rows, to be filled."""
    return Record(
        time_s=np.zeros(rows),
        attitude=np.zeros((rows, 4)),
        rate_rad_s=np.zeros((rows, 3)),
        wheels_rad_s=np.zeros((rows, wheels)),
        modes=np.zeros((rows, 2 * modes)),
        attitude_error_rad=np.zeros((rows, 3)),
        angular_impulse_n_m_s=np.zeros((rows, 3)),
        delta_v_body_m_s=np.zeros((rows, 3)),
        delta_v_inertial_m_s=np.zeros((rows, 3)),
        tank_pressure_kpa=np.zeros(rows),
        propellant_kg=np.zeros(rows),
    )


@compiled
def advance(
    y: Array,
    motor: Array,
    step: float,
    n_steps: int,
    steps_per_cycle: int,
    steps_per_record: int,
    body: Body,
    torque: Torque,
    torque_noise_n_m: Array,
    loop: WheelLoop,
    thrusters: Thrusters,
    rcs: RcsLaw,
    rwa: RwaLaw,
    attitude_knowledge_rad: Array,
    rate_knowledge_rad_s: Array,
    pulses: Pulses,
    record: Record,
) -> None:
    """Integrate ``y`` over ``n_steps`` fixed steps, filling ``pulses`` and ``record``.

    ``motor`` are the motors' torques outside the speed loop: constant, unless the wheel controller
    sets them.

    Thrust is integrated exactly over every step and enters as its mean, so no impulse is lost
    whatever the step; the rows of the ``_knowledge`` arrays are the errors with which the
    controllers know attitude and rate, those of ``torque_noise_n_m`` an external torque in body
    axes beside ``torque``, one row per control cycle each.
    """
    n_thrusters = thrusters.thrust_n.shape[0]
    n_wheels = body.axes.shape[1]
    levels = np.zeros(n_thrusters)
    on_time = np.zeros(n_thrusters)
    widths = np.zeros(n_thrusters)
    thrust_torque = np.zeros(3)
    force = np.zeros(3)
    rk_work = np.zeros((5, y.shape[0]))
    scratch = np.zeros(3)
    vectors = np.zeros((7, 3))
    target = np.zeros(4)
    middle = np.zeros(4)
    before = np.zeros(4)
    error, old_error, old_rate = vectors[0], vectors[1], vectors[2]
    seen_error, seen_rate, total, inertial = vectors[3], vectors[4], vectors[5], vectors[6]
    rate_command = np.zeros(3)
    acceleration = np.zeros(3)
    wheel_work = np.zeros((3, 3))
    memory = np.zeros((4, 6))
    memory[2] = rcs.pulse_max_s
    memory[3] = -1e9
    impulse = np.zeros(3)
    delta_v_body = np.zeros(3)
    delta_v_inertial = np.zeros(3)
    propellant = 0.0
    burned = 0.0
    kept = 0
    awake = False
    thrusting = False
    leaking = False
    for k in range(n_thrusters):
        leaking = leaking or thrusters.leak_n[k] > 0.0
    disturbed = torque.width_s > 0.0
    for axis in range(3):
        disturbed = disturbed or torque.steady_n_m[axis] != 0.0 or torque_noise_n_m[0, axis] != 0.0
    steady = np.zeros(3)
    acting = Torque(steady, torque.peak_n_m, torque.centre_s, torque.width_s)

    for i in range(n_steps + 1):
        time = i * step
        if i % steps_per_cycle == 0:
            slew_target(rwa, time, target, rate_command, acceleration)
            control_error(rwa, time, target, y, error)
            cycle = i // steps_per_cycle
            for axis in range(3):
                steady[axis] = torque.steady_n_m[axis] + torque_noise_n_m[cycle, axis]
                old_error[axis], old_rate[axis] = seen_error[axis], seen_rate[axis]
                seen_error[axis] = error[axis] + attitude_knowledge_rad[cycle, axis]
                seen_rate[axis] = (
                    y[4 + axis] - rate_command[axis] + rate_knowledge_rad_s[cycle, axis]
                )
            if rwa.active:
                wheel_command(
                    rwa, body, loop, y, seen_error, rate_command, acceleration, motor, wheel_work
                )
            if rcs.active and i < n_steps and time < rwa.free_from_s:
                if rcs.latency_cycles > 0 and cycle > 0:
                    demanded_widths(rcs, old_error, old_rate, time, memory)
                else:
                    demanded_widths(rcs, seen_error, seen_rate, time, memory)
                burning = burned < rcs.burn_delta_v_m_s and time >= rcs.burn_start_s
                thruster_widths(rcs, memory[0], burning, widths)
                log_pulses(pulses, time, widths)
                for k in range(n_thrusters):
                    if burning and widths[k] > 0.0:
                        began = pulses.start_s[k, pulses.number[k] - 1] == time
                        offset = rcs.burn_offset_s if began else 0.0
                        burned += rcs.burn_acceleration_m_s2[k] * (widths[k] + offset)
            awake = leaking or can_thrust(time, thrusters, pulses, levels)
        if i % steps_per_record == 0:
            slew_target(rwa, time, target, rate_command, acceleration)
            control_error(rwa, time, target, y, error)
            record.time_s[kept] = time
            record.attitude[kept] = y[:4]
            record.rate_rad_s[kept] = y[4:7]
            record.wheels_rad_s[kept] = y[7 : 7 + n_wheels]
            record.modes[kept] = y[7 + n_wheels :]
            record.attitude_error_rad[kept] = error
            record.angular_impulse_n_m_s[kept] = impulse
            record.delta_v_body_m_s[kept] = delta_v_body
            record.delta_v_inertial_m_s[kept] = delta_v_inertial
            record.tank_pressure_kpa[kept] = thrusters.tank_pressure_kpa / (
                1.0 + propellant / (HYDRAZINE_DENSITY_KG_M3 * thrusters.ullage_m3)
            )
            record.propellant_kg[kept] = propellant
            kept += 1
        if i == n_steps:
            break

        if awake:
            gained, thrusting = deliver(
                time,
                step,
                thrusters,
                leaking,
                propellant,
                pulses,
                levels,
                on_time,
                thrust_torque,
                force,
            )
            propellant += gained
        elif thrusting:
            thrusting = False
            thrust_torque[:] = 0.0
            force[:] = 0.0
        for axis in range(4):
            before[axis] = y[axis]
        runge_kutta_step(time, step, y, thrust_torque, motor, body, acting, loop, rk_work, scratch)
        if not (thrusting or disturbed):
            continue

        for axis in range(4):
            middle[axis] = before[axis] + y[axis]
        external_torque(acting, time + 0.5 * step, total)
        for axis in range(3):
            total[axis] += thrust_torque[axis]
        to_inertial(middle, total, inertial)
        for axis in range(3):
            impulse[axis] += inertial[axis] * step
        to_inertial(middle, force, inertial)
        for axis in range(3):
            mass = body.mass_kg - propellant
            delta_v_body[axis] += force[axis] * step / mass
            delta_v_inertial[axis] += inertial[axis] * step / mass
