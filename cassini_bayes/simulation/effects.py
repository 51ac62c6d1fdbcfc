"""Effects that a scenario can hide in its events: the catalogue of causes, and some outside it.

An effect is a name, the keys of its parameters, what may stand behind the colon of its name, and a
function from plan to plan. Effects change what happens, never which random numbers are drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known, nearest
from cassini_bayes.simulation.limits import (
    Limit,
    is_not_negative,
    is_positive,
    is_share,
    limited,
)
from cassini_bayes.simulation.plan import Plan, Surge, TorquePulse, Vector, frozen_mapping
from cassini_bayes.simulation.settings import Appendage, EffectRequest
from cassini_bayes.spacecraft import WHEEL_KEYS, Spacecraft

Values = Mapping[str, float]
Change = Callable[[Plan, str, Values], Plan]
AXES: Final = ("x", "y", "z")
ELEMENTS: Final = ("xx", "yy", "zz", "xy", "xz", "yz")
FLEXIBLE_INERTIA_FRACTION: Final = 0.01
"""Usual inertia of the oscillating part over the spacecraft's about the same axis: small, so that
the given amplitude is what the rates show."""


@dataclass(frozen=True)
class Effect:
    """One kind of effect.

    Attributes
    ----------
    name
        Without target.
    keys
        Required parameters; ``{target}`` stands for the target.
    targets
        ``None``, or which targets the name takes: thruster, wheel, axis, element.
    change
        Applies it to a plan.
    catalogued
        Whether a diagnosis knows it by name.
    optional
        Parameters with defaults, told with the effect.
    further
        Parameters that may be given, and are told only then.
    """

    name: str
    keys: tuple[str, ...]
    targets: str | None
    change: Change
    catalogued: bool = True
    optional: Mapping[str, float] = field(default_factory=dict)
    further: tuple[str, ...] = ()


def _set(vector: Vector, index: int, value: float) -> Vector:
    changed = list(vector)
    changed[index] = value
    return (changed[0], changed[1], changed[2])


def _thrust_factor(plan: Plan, target: str, values: Values) -> Plan:
    return plan.with_thrust_factor(values["thrust_factor"], only=target or None)


def _thrust_warmup(plan: Plan, _: str, values: Values) -> Plan:
    deficits = frozen_mapping(dict.fromkeys(plan.thrusters, values["warmup_deficit"]))
    return replace(plan, warmup_deficit=deficits, warmup_time_s=values["warmup_time_s"])


def _parameters(plan: Plan, _: str, values: Values) -> Plan:
    return plan.with_parameters(**values)


def _of_wheel(plan: Plan, target: str, values: Values) -> Plan:
    """The target alone, whatever the spacecraft calls its parameters, and whoever shares them."""
    changed = plan.with_parameters(**values)
    own = plan.spacecraft.with_own_parameters(int(target), values)
    return replace(changed, spacecraft=own)


def _articulation(plan: Plan, target: str, values: Values) -> Plan:
    turned = _of_wheel(plan, target, values)
    return replace(turned, spacecraft=turned.spacecraft.with_platforms(turned.parameters))


def _pulse_shape(plan: Plan, _: str, values: Values) -> Plan:
    return replace(plan, impulse_offset_s=values["impulse_time_offset_s"])


def _misalignment(plan: Plan, target: str, values: Values) -> Plan:
    cant = (values["cant_a_rad"], values["cant_b_rad"])
    return replace(plan, cants_rad={**plan.cants_rad, target: cant})


def _leak(plan: Plan, target: str, values: Values) -> Plan:
    leaks = frozen_mapping({**plan.leaks_n, target: values["leak_n"]})
    return replace(plan, leaks_n=leaks, leak_start_s=values.get("start_s", 0.0))


def _time_offset(plan: Plan, _: str, values: Values) -> Plan:
    misreading = replace(plan.misreading, counters_late_s=values["time_offset_s"])
    return replace(plan, misreading=misreading)


def _rate_scale(plan: Plan, target: str, values: Values) -> Plan:
    scale = _set(plan.misreading.rate_scale, AXES.index(target), values["rate_scale"])
    return replace(plan, misreading=replace(plan.misreading, rate_scale=scale))


def _flexible_mode(plan: Plan, _: str, values: Values) -> Plan:
    index, fraction = int(values["axis"]), values["inertia_fraction"]
    # what is given is the free spacecraft's mode; an appendage has the modes of a clamped one
    clamped = math.sqrt(1.0 - fraction)
    rate = values["amplitude_rad_s"] / fraction  # momentum is shared: I ω = −J_a θ̇ about the axis
    phase, omega = values.get("phase_rad", 0.0), 2.0 * math.pi * values["frequency_hz"]
    mode = Appendage(
        name="flexible_mode",
        axis=_set((0.0, 0.0, 0.0), index, 1.0),
        inertia_kg_m2=fraction * plan.parameters[f"inertia_{ELEMENTS[index]}_kg_m2"],
        frequency_hz=values["frequency_hz"] * clamped,
        damping=values["damping"] * clamped,
        initial_angle_rad=rate / omega * math.sin(phase),
        initial_rate_rad_s=rate * math.cos(phase),
    )
    return replace(plan, appendages=(*plan.appendages, mode))


def _firing_logic(plan: Plan, _: str, values: Values) -> Plan:
    changed = {
        "mapping": "shared" if plan.rcs.mapping == "union" else "union",
        "rate_gain_s": plan.rcs.rate_gain_s * values["rate_gain_factor"],
        "dead_band_rad": tuple(b * values["dead_band_factor"] for b in plan.rcs.dead_band_rad),
        "hysteresis": values["hysteresis"],
    }
    return replace(plan, rcs=plan.rcs.model_copy(update=changed))


def _atmospheric_torque(plan: Plan, _: str, values: Values) -> Plan:
    peak = (values["peak_x_n_m"], values["peak_y_n_m"], values["peak_z_n_m"])
    return replace(plan, torque_pulse=TorquePulse(peak, values["centre_s"], values["width_s"]))


def _pressure_surge(plan: Plan, _: str, values: Values) -> Plan:
    surge = Surge(values["thrust_fraction"], values["start_s"], values["decay_s"])
    return replace(plan, surge=surge)


def _tachometer(plan: Plan, _: str, values: Values) -> Plan:
    misreading = replace(plan.misreading, speed_slope_per_rpm=values["slope_per_rpm"])
    return replace(plan, misreading=misreading)


def _plume(plan: Plan, target: str, values: Values) -> Plan:
    return replace(plan, plume=frozen_mapping({**plan.plume, target: values["lever_m"]}))


_INERTIA, *_TILTS, _ARTICULATION = WHEEL_KEYS
_TORQUES: Final = tuple(f"external_torque_{axis}_n_m" for axis in AXES)
_MODE: Final = ("frequency_hz", "damping", "amplitude_rad_s")
_USUAL_MODE: Final = frozen_mapping({"axis": 2.0, "inertia_fraction": FLEXIBLE_INERTIA_FRACTION})
_USUAL_LOGIC: Final = frozen_mapping(
    {"rate_gain_factor": 1.0, "dead_band_factor": 1.0, "hysteresis": 0.3}
)
_TORQUE_PULSE: Final = ("peak_x_n_m", "peak_y_n_m", "peak_z_n_m", "centre_s", "width_s")
_SURGE: Final = ("thrust_fraction", "start_s", "decay_s")
_ALL: Final = (
    Effect("thrust_scale", ("thrust_factor",), None, _thrust_factor),
    Effect("thruster_degraded", ("thrust_factor",), "thruster", _thrust_factor),
    Effect("thrust_warmup", ("warmup_deficit", "warmup_time_s"), None, _thrust_warmup),
    Effect("tail_off", ("tau_fall_s",), None, _parameters),
    Effect("pulse_shape", ("impulse_time_offset_s",), None, _pulse_shape),
    Effect("center_of_mass", ("cm_{target}_m",), "axis", _parameters),
    Effect("wheel_inertia", (_INERTIA,), "wheel", _of_wheel),
    Effect("wheel_alignment", tuple(_TILTS), "tilting wheel", _of_wheel),
    Effect("wheel_articulation", (_ARTICULATION,), "articulated wheel", _articulation),
    Effect("thruster_misalignment", ("cant_a_rad", "cant_b_rad"), "thruster", _misalignment),
    Effect("external_torque", _TORQUES, None, _parameters),
    Effect("thruster_leak", ("leak_n",), "thruster", _leak, further=("start_s",)),
    Effect("inertia", ("inertia_{target}_kg_m2",), "element", _parameters),
    Effect("time_offset", ("time_offset_s",), None, _time_offset),
    Effect("rate_bias", ("rate_bias_{target}_rad_s",), "axis", _parameters),
    Effect("rate_scale", ("rate_scale",), "axis", _rate_scale),
    Effect(
        "flexible_mode",
        *(_MODE, None, _flexible_mode),
        optional=_USUAL_MODE,
        further=("phase_rad",),
    ),
    Effect("firing_logic", (), None, _firing_logic, optional=_USUAL_LOGIC),
    Effect("atmospheric_torque", _TORQUE_PULSE, None, _atmospheric_torque, catalogued=False),
    Effect("pressure_surge", _SURGE, None, _pressure_surge, catalogued=False),
    Effect("tachometer_scale", ("slope_per_rpm",), None, _tachometer, catalogued=False),
    Effect("plume_impingement", ("lever_m",), "thruster", _plume, catalogued=False),
)
EFFECTS: Final[Mapping[str, Effect]] = MappingProxyType({effect.name: effect for effect in _ALL})
_LIMITS: Final = (
    Limit(
        "thrust_factor|warmup_time_s|width_s|decay_s|frequency_hz|inertia_fraction",
        *(is_positive, "a number above 0", "give a size that is physical"),
    ),
    Limit(
        ".*_inertia_kg_m2|inertia_(xx|yy|zz)_kg_m2",
        *(is_positive, "a number above 0", "an inertia is positive"),
    ),
    Limit(
        "leak_n|tau_fall_s|damping|warmup_deficit",
        *(is_not_negative, "0 or more", "give a size that is physical"),
    ),
    Limit("warmup_deficit", is_share, "a fraction from 0 to 1", "1 is no thrust when cold"),
    Limit("inertia_fraction", lambda x: x < 1.0, "a fraction below 1", "an appendage is a part"),
    Limit("thrust_fraction", lambda x: x > -1.0, "more than -1", "-1 would be no thrust at all"),
    Limit("axis", (0.0, 1.0, 2.0).__contains__, "0, 1 or 2 for x, y or z", "choose an axis"),
    Limit("hysteresis", is_share, "a fraction from 0 to 1", "choose a fraction"),
)


@dataclass(frozen=True)
class ChosenEffect:
    """An effect with its target and every parameter; ``events`` limits it (None: all)."""

    effect: Effect
    target: str
    values: Mapping[str, float]
    events: tuple[str, ...] | None

    @property
    def name(self) -> str:
        """The name as a scenario and a diagnosis spell it."""
        return f"{self.effect.name}:{self.target}" if self.target else self.effect.name

    def acts_in(self, event: str) -> bool:
        """Whether it acts in an event of this id."""
        return self.events is None or event in self.events

    def applied(self, plan: Plan) -> Plan:
        """The plan with this effect, if it acts in that event."""
        if not self.acts_in(plan.event.id):
            return plan
        return self.effect.change(plan, self.target, self.values)


def possible_targets(
    effect: Effect, spacecraft: Spacecraft, branch: str, wheels: tuple[int, ...]
) -> tuple[str, ...]:
    """What may stand behind the colon of an effect's name; empty where there is no colon."""
    if effect.targets == "thruster":
        return spacecraft.thruster_names(branch)
    if effect.targets == "wheel":
        return tuple(str(number) for number in wheels)
    if effect.targets == "tilting wheel":
        return tuple(str(n) for n in wheels if spacecraft.wheel(n).tilt_parameters is not None)
    if effect.targets == "articulated wheel":
        return tuple(str(n) for n in wheels if spacecraft.wheel(n).platform is not None)
    return {"axis": AXES, "element": ELEMENTS}.get(effect.targets or "", ())


def choose_effect(
    request: EffectRequest,
    spacecraft: Spacecraft,
    branch: str,
    wheels: tuple[int, ...],
    where: str,
    known: Mapping[str, Effect] = EFFECTS,
) -> ChosenEffect:
    """Check a requested effect against the effects that there are, and the spacecraft.

    Raises
    ------
    InputError
        Unknown name or target, a parameter that is missing, unknown or impossible.
    """
    kind, _, target = request.name.partition(":")
    check_known(f"{where}.name", kind, known, "the name of an effect", repr(request.name))
    effect = known[kind]
    targets = possible_targets(effect, spacecraft, branch, wheels)
    if effect.targets is None and target:
        raise InputError(f"{where}.name", repr(kind), repr(request.name), "drop the colon")
    if effect.targets is not None and target not in targets:
        expected = f"{kind}:<{effect.targets}>, one of {', '.join(targets) or 'none here'}"
        raise InputError(f"{where}.name", expected, repr(request.name), nearest(target, targets))
    required = tuple(key.format(target=target) for key in effect.keys)
    keys = (*required, *effect.optional, *effect.further)
    for key in request.parameters:
        check_known(f"{where}.parameters.{key}", key, keys, got="an unknown parameter")
    for key in required:
        if key not in request.parameters:
            raise InputError(f"{where}.parameters.{key}", "a number", "nothing", f"add {key} = …")
    values = dict(effect.optional)
    for key, value in request.parameters.items():
        values[key] = limited(f"{where}.parameters.{key}", key, value, _LIMITS)
    return ChosenEffect(effect, target, frozen_mapping(values), request.events)
