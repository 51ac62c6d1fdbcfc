"""The spacecraft in Basilisk: rigid hub, balanced reaction wheels, thrusters with ramps, external
torque.

Equations of motion, wheels, thrusters and their integration (classical Runge-Kutta) are Basilisk's.
Its ``thrusterDynamicEffector`` follows tables of thrust against time when a valve opens and closes,
and begins in them where the thrust stands; tables of exponentials make a first-order valve with
different rise and fall. (``thrusterStateEffector`` has one time constant for both, and holds its
force over each step.) Modules are stepped one by one, so that steps are short only while a valve
moves and end on edges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.simulation import (
    extForceTorque,
    linearSpringMassDamper,
    reactionWheelStateEffector,
    spacecraft,
    svIntegrators,
    thrusterDynamicEffector,
)
from Basilisk.utilities import simIncludeRW

from closed_loop.arrays import Array
from closed_loop.cassini import Body

Vector = tuple[float, float, float]

NANO = 1_000_000_000
FIRING_STEP_S = 0.005
COAST_STEP_S = 0.125
SETTLED = 16.0
"""Time constants after which a valve's thrust is taken as 0 (1e-7 of the steady one)."""
_FINE = 0.005
_FOREVER_S = 1e6
_RAD_S_PER_RPM = 2.0 * math.pi / 60.0


@dataclass(frozen=True)
class Slosh:
    """A particle on a spring in the body: mass, place at rest, direction, frequency, damping."""

    mass_kg: float
    place_m: Vector
    direction: Vector
    frequency_hz: float
    damping: float
    start_m: float


@dataclass(frozen=True)
class WheelDrag:
    """Friction of a wheel: Coulomb's and viscous."""

    coulomb_n_m: float
    viscous_n_m_s: float


@dataclass(frozen=True)
class State:
    """Attitude (inertial to body, scalar last), body rate and wheel rates in rad/s."""

    attitude: tuple[float, float, float, float]
    rate: Vector
    wheels: Vector


class Vehicle:
    """One event's spacecraft: commands and torques go in, motion comes out.

    Parameters
    ----------
    body
        Mass properties, wheels, thrusters.
    start
        At time 0.
    slosh
        A moving part, at rest within the body's mass properties.
    drag
        Of every wheel.
    wheel_torque_n_m
        Limit of the motors.
    swirl_m
        Torque of each thruster about its own force, per newton.
    """

    def __init__(
        self,
        body: Body,
        start: State,
        *,
        slosh: Slosh | None = None,
        drag: WheelDrag | None = None,
        wheel_torque_n_m: float = 0.2,
        swirl_m: Sequence[float] = (0.0,) * 8,
    ) -> None:
        self._body = body
        self._now_ns = 0
        self._moving_until_ns = 0
        self._coast_ns = round(COAST_STEP_S * NANO)
        self._settle_ns = round(SETTLED * max(body.rise_s, body.fall_s) * NANO)
        self._hub = spacecraft.Spacecraft()
        mass, centre, inertia = body.mass_kg, body.centre_m, body.inertia_kg_m2
        if slosh is not None:
            mass, centre, inertia = without_particle(body, slosh)
            self._coast_ns = round(NANO / (40.0 * slosh.frequency_hz))
        self._hub.hub.mHub = mass
        self._hub.hub.r_BcB_B = _column(centre)
        self._hub.hub.IHubPntBc_B = inertia.tolist()
        scalar = 1.0 + start.attitude[3]
        if scalar < 1.0:
            raise ValueError("start with a scalar part of the attitude that is not negative")
        self._hub.hub.sigma_BNInit = _column([value / scalar for value in start.attitude[:3]])
        self._hub.hub.omega_BN_BInit = _column(start.rate)
        # the solver is the default one, stated because its order matters here
        self._integrator = svIntegrators.svIntegratorRK4(self._hub)
        self._hub.setIntegrator(self._integrator)
        self._last = start.attitude
        self._slosh = None if slosh is None else self._add_slosh(slosh)
        self._add_wheels(start.wheels, drag, wheel_torque_n_m)
        self._add_thrusters(swirl_m)
        self._external = extForceTorque.ExtForceTorque()
        self._hub.addDynamicEffector(self._external)
        modules = (self._hub, self._wheels, self._thrusters, self._external)
        for module in modules:
            module.Reset(0)
        self.set_motors((0.0, 0.0, 0.0))
        self._hub.UpdateState(0)

    def _add_slosh(self, slosh: Slosh) -> Any:
        particle = linearSpringMassDamper.LinearSpringMassDamper()
        spring = slosh.mass_kg * (2.0 * math.pi * slosh.frequency_hz) ** 2
        particle.massInit = slosh.mass_kg
        particle.r_PB_B = _column(slosh.place_m)
        particle.pHat_B = _column(slosh.direction)
        particle.k = spring
        particle.c = 2.0 * slosh.damping * math.sqrt(spring * slosh.mass_kg)
        particle.rhoInit = slosh.start_m
        self._hub.addStateEffector(particle)
        return particle

    def _add_wheels(self, rates: Vector, drag: WheelDrag | None, limit_n_m: float) -> None:
        self._factory = simIncludeRW.rwFactory()
        friction = {}
        if drag is not None:
            # below the limit cycle friction is linear in the rate, which keeps it from chattering
            friction = {
                "useRWfriction": True,
                "fCoulomb": drag.coulomb_n_m,
                "cViscous": drag.viscous_n_m_s,
                "omegaLimitCycle": 0.5,
            }
        body = self._body
        for j, rate in enumerate(rates):
            self._factory.create(
                "custom",
                body.wheel_axes[:, j].tolist(),
                Omega=rate / _RAD_S_PER_RPM,
                Js=float(body.wheel_inertia_kg_m2[j]),
                rWB_B=[0.0, 0.0, 0.0],
                u_max=limit_n_m,
                Omega_max=1e5,
                RWModel=messaging.BalancedWheels,
                **friction,
            )
        self._wheels = reactionWheelStateEffector.ReactionWheelStateEffector()
        self._factory.addToSpacecraft("wheels", self._wheels, self._hub)
        self._motors = messaging.ArrayMotorTorqueMsg()
        self._wheels.rwMotorCmdInMsg.subscribeTo(self._motors)
        self._motor_payload = messaging.ArrayMotorTorqueMsgPayload()

    def _add_thrusters(self, swirl_m: Sequence[float]) -> None:
        body = self._body
        self._thrusters = thrusterDynamicEffector.ThrusterDynamicEffector()
        rise, fall = _ramp(body.rise_s, rising=True), _ramp(body.fall_s, rising=False)
        self._configurations = []
        for k, thrust in enumerate(body.thrust_n):
            one = thrusterDynamicEffector.THRSimConfig()
            one.thrLoc_B = _column(body.position_m[k])
            one.thrDir_B = _column(body.direction[k])
            one.MaxThrust = float(thrust)
            one.MaxSwirlTorque = float(thrust) * swirl_m[k]
            one.steadyIsp = 0.0  # no mass is lost
            one.MinOnTime = 1e-6
            one.ThrusterOnRamp = thrusterDynamicEffector.ThrusterTimeVector(rise)
            one.ThrusterOffRamp = thrusterDynamicEffector.ThrusterTimeVector(fall)
            self._thrusters.addThruster(one)
            self._configurations.append(one)
        self._valves = messaging.THRArrayOnTimeCmdMsg()
        self._thrusters.cmdsInMsg.subscribeTo(self._valves)
        self._hub.addDynamicEffector(self._thrusters)

    @property
    def now_ns(self) -> int:
        """Time that has been reached."""
        return self._now_ns

    def state(self) -> State:
        """Motion now; the quaternion's sign goes on from state to state."""
        message = self._hub.scStateOutMsg.read()
        x, y, z = message.sigma_BN
        square = x * x + y * y + z * z
        scale = 2.0 / (1.0 + square)
        attitude = (scale * x, scale * y, scale * z, (1.0 - square) / (1.0 + square))
        if sum(a * b for a, b in zip(attitude, self._last, strict=True)) < 0.0:
            attitude = (-attitude[0], -attitude[1], -attitude[2], -attitude[3])
        self._last = attitude
        speeds = self._wheels.rwSpeedOutMsg.read().wheelSpeeds
        rate = message.omega_BN_B
        return State(attitude, (rate[0], rate[1], rate[2]), (speeds[0], speeds[1], speeds[2]))

    def set_valves(self, is_open: Sequence[bool]) -> None:
        """Open and close the valves now: the delay of a command is the caller's."""
        payload = messaging.THRArrayOnTimeCmdMsgPayload()
        payload.OnTimeRequest = [_FOREVER_S if one else 0.0 for one in is_open]
        self._valves.write(payload, self._now_ns)
        still = _FOREVER_S * NANO if any(is_open) else self._settle_ns
        self._moving_until_ns = self._now_ns + round(still)

    def set_thrust(self, thruster: int, thrust_n: float) -> None:
        """Another steady thrust from now on."""
        self._configurations[thruster].MaxThrust = thrust_n

    def set_motors(self, torque_n_m: Vector) -> None:
        """Motor torques on the wheels from now on."""
        self._motor_payload.motorTorque = list(torque_n_m)
        self._motors.write(self._motor_payload, self._now_ns)

    def set_external(self, force_n: Sequence[float], torque_n_m: Sequence[float]) -> None:
        """A force at the frame's origin and a torque about it, in body axes, from now on."""
        self._external.extForce_B = _column(force_n)
        self._external.extTorquePntB_B = _column(torque_n_m)

    def advance(self, until_ns: int) -> None:
        """Integrate, in short steps while a valve is open or its tail goes on."""
        short = round(FIRING_STEP_S * NANO)
        while self._now_ns < until_ns:
            step = (
                min(short, self._coast_ns)
                if self._now_ns < self._moving_until_ns
                else self._coast_ns
            )
            self._wheels.UpdateState(self._now_ns)
            self._thrusters.UpdateState(self._now_ns)
            self._now_ns = min(self._now_ns + step, until_ns)
            self._hub.UpdateState(self._now_ns)

    def basilisk_momentum(self) -> Array:
        """Angular momentum about the centre of mass in inertial axes, as Basilisk reckons it."""
        return np.array(self._hub.totRotAngMomPntC_N).ravel()


def free_frequency_hz(body: Body, slosh: Slosh) -> float:
    """Frequency of a particle on the free spacecraft, which gives: f/√(1 − m/M − m aᵀ J⁻¹ a).

    f is that of its spring alone, M and J are with the particle at rest, and a = p × d with p from
    the centre of mass.
    """
    arm = np.cross(np.subtract(slosh.place_m, body.centre_m), slosh.direction)
    given = slosh.mass_kg / body.mass_kg
    given += slosh.mass_kg * float(arm @ np.linalg.solve(body.inertia_kg_m2, arm))
    return slosh.frequency_hz / math.sqrt(1.0 - given)


def without_particle(body: Body, slosh: Slosh) -> tuple[float, Array, Array]:
    """Mass, centre and inertia of the hub that makes up a body with a particle at rest."""
    place = np.array(slosh.place_m)
    mass = body.mass_kg - slosh.mass_kg
    centre = (body.mass_kg * body.centre_m - slosh.mass_kg * place) / mass
    inertia = body.inertia_kg_m2.copy()
    for part, where in ((mass, centre), (slosh.mass_kg, place)):
        arm = where - body.centre_m
        inertia -= part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, centre, inertia


def _ramp(constant_s: float, *, rising: bool) -> list[Any]:
    """An exponential as a table of straight lines; impulses are good to 1e-5 of its constant."""
    points = []
    time_s = 0.0
    while time_s < SETTLED * constant_s:
        time_s += _FINE * constant_s * math.exp(time_s / (3.0 * constant_s))
        left = math.exp(-time_s / constant_s)
        points.append((time_s, 1.0 - left if rising else left))
    points.append((1.01 * time_s, 1.0 if rising else 0.0))
    pairs = []
    for when, factor in points:
        pair = thrusterDynamicEffector.THRTimePair()
        pair.TimeDelta, pair.ThrustFactor, pair.IspFactor = when, factor, 1.0
        pairs.append(pair)
    return pairs


def _column(values: Sequence[float] | Array) -> list[list[float]]:
    return [[float(value)] for value in values]
