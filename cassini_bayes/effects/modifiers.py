"""What each kind of effect does to the physics: one small function per kind.

Every function takes the physics at n points, the parameters there and the effect's own values, and
returns the changed physics. Totals rows and telemetry see the same change. Signs and meanings are
those of the catalogue (docs/criticism.md §2).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.physics import Modifier, Parameters, Physics
from cassini_bayes.effects.catalogue import AXES, Effect
from cassini_bayes.effects.columns import (
    FLEXIBLE,
    SHIFT_NODES_S,
    WARMUP_NODES_S,
    flexible_slopes,
    hat_weights,
    lagrange_weights,
    shift_column,
    warmup_column,
    warmup_tail_column,
)
from cassini_bayes.spacecraft import (
    Spacecraft,
    centre_of_mass,
    thruster_directions,
    thruster_positions,
    wheel_axes,
)

Array = NDArray[np.float64]
Values = Mapping[str, Array]
LEAST_TAU_S: Final = 1e-3


@dataclass(frozen=True)
class Setting:
    """Where an effect acts: spacecraft, branch, the effect's target, the flexible mode's axis."""

    spacecraft: Spacecraft
    branch: str
    target: str
    axis: int = 2

    @property
    def thrusters(self) -> tuple[str, ...]:
        """Names of the branch's thrusters in order."""
        return self.spacecraft.thruster_names(self.branch)

    @property
    def thruster(self) -> int:
        """Place of the target among the thrusters."""
        return self.thrusters.index(self.target)


Change = Callable[[Physics, Parameters, Values, Setting], Physics]


def modifier_of(
    effect: Effect, spacecraft: Spacecraft, branch: str, axis: int = 2, *, rows: bool = False
) -> Modifier:
    """The effect as a change of physics that reads its own walked parameters.

    ``rows``: the physics is that of telemetry rows, where a pulse's impulse is a turning vector.
    """
    setting = Setting(spacecraft, branch, effect.target, axis)
    change = {**CHANGES, **(ROW_CHANGES if rows else {})}[effect.kind]
    names = [(parameter.key, parameter.name) for parameter in effect.parameters]

    def modify(physics: Physics, parameters: Parameters) -> Physics:
        values = {key: np.asarray(parameters[name], dtype=np.float64) for key, name in names}
        return change(physics, parameters, values, setting)

    return modify


def _factor(physics: Physics, change: Array) -> Physics:
    """Thrust factors of all thrusters (n, K) times a change that broadcasts to it."""
    size = physics.arms_m.shape[-1]
    if size == 0:
        return physics
    whole = np.broadcast_to(np.asarray(physics.thrust_factor), (*change.shape[:-1], size))
    return replace(physics, thrust_factor=whole * change)


def _thrust_scale(physics: Physics, _: Parameters, values: Values, __: Setting) -> Physics:
    return _factor(physics, values["thrust_factor"][..., None])


def _degraded(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    factor = values["thrust_factor"]
    change = np.ones((*factor.shape, len(setting.thrusters)))
    change[..., setting.thruster] = factor
    return _factor(physics, change)


def _with_extra(physics: Physics, weights: Mapping[str, Array]) -> Physics:
    return replace(physics, extra={**physics.extra, **weights})


def _warmup(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    shares = lagrange_weights(np.log(values["warmup_time_s"]), np.log(WARMUP_NODES_S))
    tail = np.asarray(physics.tau_s[2]) - np.asarray(physics.tau_s[1])  # of a first-order valve
    weights = {}
    for name in setting.thrusters:
        for i, node in enumerate(WARMUP_NODES_S):
            lost = -(values["warmup_deficit"] * shares[..., i])
            weights[warmup_column(name, node)] = lost
            weights[warmup_tail_column(name, node)] = lost * tail
    return _with_extra(physics, weights)


def _time_offset(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    shares = hat_weights(values["time_offset_s"], np.array(SHIFT_NODES_S))
    weights = {
        shift_column(name, node): shares[..., i]
        for name in setting.thrusters
        for i, node in enumerate(SHIFT_NODES_S)
        if node != 0.0
    }
    return _with_extra(physics, weights)


def _tail_off(physics: Physics, _: Parameters, values: Values, __: Setting) -> Physics:
    delay, rise, fall = physics.tau_s
    return replace(
        physics, tau_s=(delay, rise, np.maximum(fall + values["tau_fall_s"], LEAST_TAU_S))
    )


def _pulse_shape(physics: Physics, _: Parameters, values: Values, __: Setting) -> Physics:
    size = physics.arms_m.shape[-1]
    offset = np.broadcast_to(
        values["impulse_time_offset_s"][..., None], (*values["impulse_time_offset_s"].shape, size)
    )
    return replace(physics, impulse_offset_s=np.asarray(physics.impulse_offset_s) + offset)


def _pulse_shape_in_rows(physics: Physics, _: Parameters, values: Values, __: Setting) -> Physics:
    """More impulse as a longer tail, less as a slower rise: both turn with the body later.

    Counts of pulses do not: they stand in the body axes of the row that shows them.
    """
    delay, rise, fall = physics.tau_s
    offset = values["impulse_time_offset_s"]
    return replace(
        physics, tau_s=(delay, rise + np.maximum(-offset, 0.0), fall + np.maximum(offset, 0.0))
    )


def _centre(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    if physics.arms_m.shape[-1] == 0:
        return physics
    axis = AXES.index(setting.target)
    unit = np.eye(3)[axis]
    directions = thruster_directions(setting.spacecraft, setting.branch)
    turned = np.cross(unit, directions.T).T  # (3, K)
    shift = values[f"cm_{setting.target}_m"][..., None, None]
    return replace(physics, arms_m=physics.arms_m - shift * turned)


def _wheel_inertia(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    numbers = [wheel.number for wheel in setting.spacecraft.wheels]
    unit = np.eye(len(numbers))[numbers.index(int(setting.target))]
    (departure,) = values.values()
    return replace(
        physics, wheel_inertia_kg_m2=physics.wheel_inertia_kg_m2 + departure[..., None] * unit
    )


def _wheel_alignment(
    physics: Physics, parameters: Parameters, values: Values, setting: Setting
) -> Physics:
    tilted = {name: np.asarray(parameters[name]) + value for name, value in values.items()}
    return replace(physics, wheel_axes=wheel_axes(setting.spacecraft, {**parameters, **tilted}))


def _misalignment(
    physics: Physics, parameters: Parameters, values: Values, setting: Setting
) -> Physics:
    if physics.arms_m.shape[-1] == 0:
        return physics
    k = setting.thruster
    direction = thruster_directions(setting.spacecraft, setting.branch)[:, k]
    second = np.eye(3)[2 if abs(direction[1]) > 0.5 else 1]
    force = (
        direction
        + values["cant_a_rad"][..., None] * np.eye(3)[0]
        + values["cant_b_rad"][..., None] * second
    )
    force = force / np.linalg.norm(force, axis=-1, keepdims=True)
    places = thruster_positions(setting.spacecraft, setting.branch, parameters)[..., k]
    centre = centre_of_mass(parameters)
    nominal = np.cross(places - centre, direction)
    change = np.cross(places - centre, force) - nominal
    arms = np.array(
        np.broadcast_to(physics.arms_m, (*change.shape[:-1], *physics.arms_m.shape[-2:]))
    )
    arms[..., k] += change
    return replace(physics, arms_m=arms)


def _external_torque(physics: Physics, _: Parameters, values: Values, __: Setting) -> Physics:
    torque = np.stack([values[f"external_torque_{axis}_n_m"] for axis in AXES], axis=-1)
    return replace(physics, steady_torque_n_m=np.asarray(physics.steady_torque_n_m) + torque)


def _leak(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    if physics.arms_m.shape[-1] == 0:
        return physics
    arm = physics.arms_m[..., setting.thruster]
    torque = values["leak_n"][..., None] * arm
    return replace(physics, steady_torque_n_m=np.asarray(physics.steady_torque_n_m) + torque)


def _inertia(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    i, j = (AXES.index(axis) for axis in setting.target)
    unit = np.zeros((3, 3))
    unit[i, j] = unit[j, i] = 1.0
    (departure,) = values.values()
    return replace(physics, inertia_kg_m2=physics.inertia_kg_m2 + departure[..., None, None] * unit)


def _rate_bias(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    unit = np.eye(3)[AXES.index(setting.target)]
    (bias,) = values.values()
    return replace(
        physics, rate_bias_rad_s=np.asarray(physics.rate_bias_rad_s) + bias[..., None] * unit
    )


def _rate_scale(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    unit = np.eye(3)[AXES.index(setting.target)]
    scale = values["rate_scale"][..., None] * unit
    return replace(physics, rate_scale=np.asarray(physics.rate_scale) + scale)


def _flexible_mode(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """An appendage moves against the body: freely, and as the body's own rate drives it.

    Its frequency and damping depart from those of the columns in first order.
    """
    unit = np.eye(3)[setting.axis]
    moment = physics.inertia_kg_m2[..., setting.axis, setting.axis]
    weights = (
        values["cosine_rad_s"],
        values["sine_rad_s"],
        -values["inertia_fraction"],
    )
    own = {}
    for name, weight in zip(FLEXIBLE, weights, strict=True):
        line, dying = flexible_slopes(name)
        momentum = (moment * weight)[..., None] * unit
        own[name] = momentum
        own[line] = momentum * values["frequency_shift"][..., None]
        own[dying] = momentum * values["damping_shift"][..., None]
    return _with_extra(physics, own)


CHANGES: Final[Mapping[str, Change]] = {
    "thrust_scale": _thrust_scale,
    "thruster_degraded": _degraded,
    "thrust_warmup": _warmup,
    "tail_off": _tail_off,
    "pulse_shape": _pulse_shape,
    "center_of_mass": _centre,
    "wheel_inertia": _wheel_inertia,
    "wheel_alignment": _wheel_alignment,
    "thruster_misalignment": _misalignment,
    "external_torque": _external_torque,
    "thruster_leak": _leak,
    "inertia": _inertia,
    "time_offset": _time_offset,
    "rate_bias": _rate_bias,
    "rate_scale": _rate_scale,
    "flexible_mode": _flexible_mode,
}
ROW_CHANGES: Final[Mapping[str, Change]] = {"pulse_shape": _pulse_shape_in_rows}
