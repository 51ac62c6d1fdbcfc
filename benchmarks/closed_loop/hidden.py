"""What can be hidden in a flight: the effects of the result formats, and a few outside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from closed_loop.cassini import AXES, ELEMENTS, THRUSTERS, Array, Truth, is_body
from closed_loop.vehicle import Slosh

UNCATALOGUED = ("drifting_torque", "thrust_swirl")
"""Kinds that have no name in the result formats: a diagnosis should say ``unknown``."""


@dataclass(frozen=True)
class Effect:
    """One hidden effect: its name, its parameters, and how many σ it stands out by."""

    name: str
    parameters: Mapping[str, float]
    sigma: float | None = None

    @property
    def kind(self) -> str:
        """The name before the colon."""
        return self.name.partition(":")[0]

    @property
    def target(self) -> str:
        """What stands behind the colon."""
        return self.name.partition(":")[2]


@dataclass
class Departures:
    """How a flight and its record depart from rigid body, plain valves and honest channels."""

    cants_rad: dict[str, tuple[float, float]] = field(default_factory=dict)
    leaks_n: dict[str, float] = field(default_factory=dict)
    warmup_deficit: float = 0.0
    warmup_time_s: float = 1.0
    pulse_longer_s: float = 0.0
    slosh: Slosh | None = None
    drift_peak_n_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    swirl_m: dict[str, float] = field(default_factory=dict)
    rate_bias_rad_s: dict[str, float] = field(default_factory=dict)
    rate_scale: dict[str, float] = field(default_factory=dict)
    time_offset_s: float = 0.0


def applied(truth: Truth, effects: Sequence[Effect]) -> tuple[Truth, Departures]:
    """The truth with effects on its parameters, and everything else that departs."""
    departures = Departures()
    for effect in effects:
        truth = _apply(truth, effect, departures)
    return truth, departures


def _apply(truth: Truth, effect: Effect, departures: Departures) -> Truth:
    kind, target, values = effect.kind, effect.target, effect.parameters
    if kind == "thrust_scale":
        return truth.changed(thrust_factors=dict.fromkeys(THRUSTERS, values["thrust_factor"]))
    if kind == "thruster_degraded":
        return truth.changed(thrust_factors={target: values["thrust_factor"]})
    if kind in ON_PARAMETERS:
        return truth.changed(parameters=values)
    if kind == "thrust_warmup":
        departures.warmup_deficit = values["warmup_deficit"]
        departures.warmup_time_s = values["warmup_time_s"]
    elif kind == "pulse_shape":
        departures.pulse_longer_s = values["impulse_time_offset_s"]
    elif kind == "thruster_misalignment":
        departures.cants_rad[target] = (values["cant_a_rad"], values["cant_b_rad"])
    elif kind == "thruster_leak":
        departures.leaks_n[target] = values["leak_n"]
    elif kind == "time_offset":
        departures.time_offset_s = values["time_offset_s"]
    elif kind == "rate_bias":
        departures.rate_bias_rad_s[target] = values[f"rate_bias_{target}_rad_s"]
    elif kind == "rate_scale":
        departures.rate_scale[target] = values["rate_scale"]
    elif kind == "flexible_mode":
        departures.slosh = _slosh(values)
    elif kind == "drifting_torque":
        x, y, z = (values[f"peak_{axis}_n_m"] for axis in AXES)
        departures.drift_peak_n_m = (x, y, z)
    elif kind == "thrust_swirl":
        departures.swirl_m[target] = values["lever_m"]
    else:
        raise ValueError(f"no effect is called {effect.name!r}")
    return truth


ON_PARAMETERS = (
    "tail_off",
    "center_of_mass",
    "wheel_inertia",
    "wheel_alignment",
    "external_torque",
    "inertia",
)
"""Kinds whose parameters are those of the baseline, with other values."""
ON_THRUSTS = ("thrust_scale", "thruster_degraded")
ON_RECORD = ("time_offset", "rate_bias", "rate_scale")
"""Kinds that change what channels show, not the motion."""
ONE_SIDED = {"thruster_degraded": -1.0, "thruster_leak": 1.0, "pulse_shape": 1.0}
NEEDS_FIRING = (
    "thrust_scale",
    "thruster_degraded",
    "thrust_warmup",
    "tail_off",
    "pulse_shape",
    "thruster_misalignment",
    "center_of_mass",
    "time_offset",
    "thrust_swirl",
)
CLEAR = (
    "thrust_scale",
    "thruster_degraded",
    "thrust_warmup",
    "tail_off",
    "pulse_shape",
    "center_of_mass",
    "wheel_inertia",
    "wheel_alignment",
    "thruster_misalignment",
    "external_torque",
    "thruster_leak",
    "inertia",
    "time_offset",
    "rate_bias",
    "rate_scale",
    "flexible_mode",
)


def targets(kind: str, wheels: Sequence[int]) -> tuple[str, ...]:
    """What a kind can act on; an empty name where it has no target."""
    if kind in ("thruster_degraded", "thruster_misalignment", "thruster_leak", "thrust_swirl"):
        return THRUSTERS
    if kind in ("center_of_mass", "rate_bias", "rate_scale"):
        return AXES
    if kind == "wheel_inertia":
        return tuple(str(wheel) for wheel in wheels)
    if kind == "wheel_alignment":
        return ("4",) if 4 in wheels else ()
    if kind == "inertia":
        return tuple(ELEMENTS)
    return ("",)


@dataclass(frozen=True)
class Growth:
    """A way for an effect to grow: parameters are start + size × step, or constant."""

    name: str
    start: Mapping[str, float]
    step: Mapping[str, float]
    constant: Mapping[str, float]

    def effect(self, size: float, truth: Truth) -> Effect | None:
        """The effect at a size; None where no spacecraft can be like that."""
        values = {key: self.start[key] + size * step for key, step in self.step.items()}
        effect = Effect(self.name, {**values, **self.constant})
        return effect if _possible(effect, truth) else None


def _possible(effect: Effect, truth: Truth) -> bool:
    value = effect.parameters
    if not 0.1 <= value.get("thrust_factor", 1.0) <= 2.0:
        return False
    if value.get("tau_fall_s", 0.05) < 0.004 or value.get("warmup_deficit", 0.0) > 0.9:
        return False
    if max(abs(value.get(f"cant_{side}_rad", 0.0)) for side in "ab") > 0.5:
        return False
    if abs(value.get("time_offset_s", 0.0)) > 2.0:
        return False
    if effect.kind == "inertia":
        return is_body({**truth.parameters, **value})
    return True


def draw_growth(
    name: str, truth: Truth, widths: Mapping[str, float], rng: np.random.Generator
) -> Growth:
    """A direction to grow in: one step is a size worth hiding.

    ``widths`` are the standard deviations of the parameters' priors.
    """
    effect = Effect(name, {})
    kind, target = effect.kind, effect.target
    sign = ONE_SIDED.get(kind) or float(rng.choice([-1.0, 1.0]))
    values = truth.parameters

    def several(keys: Sequence[str], step: float) -> dict[str, float]:
        direction = rng.standard_normal(len(keys))
        direction /= np.linalg.norm(direction)
        return {key: step * float(d) for key, d in zip(keys, direction, strict=True)}

    def growing(step: Mapping[str, float]) -> Growth:
        return Growth(name, {key: values.get(key, 0.0) for key in step}, step, {})

    if kind in ("thrust_scale", "thruster_degraded"):
        return Growth(name, {"thrust_factor": 1.0}, {"thrust_factor": 0.2 * sign}, {})
    if kind == "thrust_warmup":
        constant = {"warmup_time_s": float(10.0 ** rng.uniform(0.0, 1.0))}
        return Growth(name, {"warmup_deficit": 0.0}, {"warmup_deficit": 0.2}, constant)
    if kind == "tail_off":
        return growing({"tau_fall_s": 0.08 * sign})
    if kind == "pulse_shape":
        return growing({"impulse_time_offset_s": 0.03 * sign})
    if kind == "center_of_mass":
        key = f"cm_{target}_m"
        return growing({key: 5.0 * widths[key] * sign})
    if kind == "wheel_inertia":
        key = f"rwa{target}_inertia_kg_m2"
        return growing({key: 5.0 * widths[key] * sign})
    if kind == "wheel_alignment":
        keys = [f"rwa{target}_tilt_{side}_rad" for side in "uv"]
        return growing(several(keys, 5.0 * widths[keys[0]]))
    if kind == "thruster_misalignment":
        return growing(several(["cant_a_rad", "cant_b_rad"], 0.08))
    if kind == "external_torque":
        keys = [f"external_torque_{axis}_n_m" for axis in AXES]
        return growing(several(keys, 10.0 * widths[keys[0]]))
    if kind == "thruster_leak":
        return growing({"leak_n": 3e-5})
    if kind == "inertia":
        key = f"inertia_{target}_kg_m2"
        return growing({key: 5.0 * widths[key] * sign})
    if kind == "time_offset":
        return growing({"time_offset_s": 0.8 * sign})
    if kind == "rate_bias":
        return growing({f"rate_bias_{target}_rad_s": 5e-6 * sign})
    if kind == "rate_scale":
        return growing({"rate_scale": 0.01 * sign})
    if kind == "drifting_torque":
        return growing(several([f"peak_{axis}_n_m" for axis in AXES], 3e-5))
    if kind == "thrust_swirl":
        return growing({"lever_m": 0.2 * sign})
    return _slosh_growth(name, truth, rng)


def _slosh_growth(name: str, truth: Truth, rng: np.random.Generator) -> Growth:
    """A slosh particle that grows in mass; where and how it moves is constant."""
    place, along = rng.uniform(-1.0, 1.0, 3), rng.standard_normal(3)
    along /= np.linalg.norm(along)
    centre = np.array([truth.parameters[f"cm_{axis}_m"] for axis in AXES])
    constant = {
        "frequency_hz": float(10.0 ** rng.uniform(-1.7, -0.5)),
        "damping": float(10.0 ** rng.uniform(-3.0, -1.7)),
        "start_m": float(rng.uniform(0.0, 0.003)),
    }
    for axis in range(3):
        constant[f"place_{AXES[axis]}_m"] = float(centre[axis] + 1.5 * place[axis])
        constant[f"along_{AXES[axis]}"] = float(along[axis])
    return Growth(name, {"particle_kg": 0.0}, {"particle_kg": 20.0}, constant)


def _slosh(values: Mapping[str, float]) -> Slosh:
    place = (values["place_x_m"], values["place_y_m"], values["place_z_m"])
    along = (values["along_x"], values["along_y"], values["along_z"])
    return Slosh(
        values["particle_kg"],
        place,
        along,
        values["frequency_hz"],
        values["damping"],
        values["start_m"],
    )


def leak_force(
    position_m: Array, direction: Array, leaks_n: Mapping[str, float]
) -> tuple[Array, Array]:
    """Force and torque about the frame's origin of valves that leak."""
    force, torque = np.zeros(3), np.zeros(3)
    for name, size in leaks_n.items():
        k = THRUSTERS.index(name)
        own = size * direction[k]
        force += own
        torque += np.cross(position_m[k], own)
    return force, torque
