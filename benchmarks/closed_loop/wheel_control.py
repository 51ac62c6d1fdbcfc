"""Wheels: ramps to commanded rates in a bias; attitude by wheels in slews and quiescent periods."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from closed_loop.cassini import Array

Three = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True)
class Ramp:
    """Rates of three wheels that go from one value to the other along straight lines.

    Attributes
    ----------
    start_rad_s, end_rad_s
        Rates of the wheels.
    begin_s, finish_s
        When each wheel begins to change its rate and when it is done.
    servo_s
        Time constant of the loop that follows the line.
    """

    start_rad_s: Three
    end_rad_s: Three
    begin_s: Three
    finish_s: Three
    servo_s: float

    def torques(
        self, time_s: float, rates: Sequence[float], inertia: Sequence[float], limit_n_m: float
    ) -> Three:
        """Motor torques within the limit."""
        found = []
        for j in range(3):
            span = self.finish_s[j] - self.begin_s[j]
            slope = (self.end_rad_s[j] - self.start_rad_s[j]) / span
            share = min(max(time_s - self.begin_s[j], 0.0), span)
            moving = self.begin_s[j] <= time_s < self.finish_s[j]
            wanted = self.start_rad_s[j] + slope * share
            torque = inertia[j] * ((slope if moving else 0.0) + (wanted - rates[j]) / self.servo_s)
            found.append(min(max(torque, -limit_n_m), limit_n_m))
        return (found[0], found[1], found[2])


@dataclass(frozen=True)
class Turn:
    """A rest-to-rest turn about a body axis: its acceleration is one period of a sine."""

    begin_s: float
    span_s: float
    axis: Three
    angle_rad: float

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Angle, rate and acceleration."""
        share = min(max((time_s - self.begin_s) / self.span_s, 0.0), 1.0)
        phase = 2.0 * math.pi * share
        rate = self.angle_rad / self.span_s
        return (
            self.angle_rad * (share - math.sin(phase) / (2.0 * math.pi)),
            rate * (1.0 - math.cos(phase)),
            2.0 * math.pi * rate / self.span_s * math.sin(phase),
        )


@dataclass(frozen=True, eq=False)
class AttitudeByWheels:
    """PD about a reference with its acceleration and the gyroscopic torque fed forward.

    ``inertia_kg_m2`` (3, 3), ``wheel_axes`` (3, 3; columns) and ``wheel_inertia_kg_m2`` (3,) are
    what the controller believes. Body axes; the reference turns about fixed axes one after the
    other.
    """

    start: Quaternion
    turns: tuple[Turn, ...]
    inertia_kg_m2: Array
    wheel_axes: Array
    wheel_inertia_kg_m2: Array
    bandwidth_rad_s: float
    damping: float

    def reference(self, time_s: float) -> tuple[Quaternion, Array, Array]:
        """Attitude, rate and acceleration that are wanted."""
        attitude, rate, acceleration = self.start, np.zeros(3), np.zeros(3)
        for turn in self.turns:
            if time_s < turn.begin_s:
                break
            angle, speed, change = turn.at(time_s)
            half = 0.5 * angle
            x, y, z = (math.sin(half) * value for value in turn.axis)
            attitude = product(attitude, (x, y, z, math.cos(half)))
            rate, acceleration = speed * np.array(turn.axis), change * np.array(turn.axis)
        return attitude, rate, acceleration

    def torques(
        self, time_s: float, attitude: Quaternion, rate: Sequence[float], wheels: Sequence[float]
    ) -> Three:
        """Motor torques."""
        wanted, wanted_rate, acceleration = self.reference(time_s)
        omega = np.array(rate)
        momentum = self.inertia_kg_m2 @ omega + self.wheel_axes @ (
            self.wheel_inertia_kg_m2 * np.array(wheels)
        )
        pull = self.bandwidth_rad_s**2 * np.array(angles(wanted, attitude))
        pull += 2.0 * self.damping * self.bandwidth_rad_s * (omega - wanted_rate)
        body_torque = self.inertia_kg_m2 @ (acceleration - pull) + np.cross(omega, momentum)
        motor = -np.linalg.solve(self.wheel_axes, body_torque)
        return (float(motor[0]), float(motor[1]), float(motor[2]))


def product(first: Quaternion, second: Quaternion) -> Quaternion:
    """Turn by the first, then by the second about the axes that the first left behind."""
    x, y, z, w = first
    a, b, c, d = second
    return (
        w * a + d * x + y * c - z * b,
        w * b + d * y + z * a - x * c,
        w * c + d * z + x * b - y * a,
        w * d - x * a - y * b - z * c,
    )


def angles(wanted: Quaternion, attitude: Quaternion) -> Three:
    """Small angles, in body axes, by which an attitude is ahead of the wanted one."""
    x, y, z, w = product((-wanted[0], -wanted[1], -wanted[2], wanted[3]), attitude)
    factor = 2.0 if w >= 0.0 else -2.0
    return (factor * x, factor * y, factor * z)
