"""The content of a scenario: events, controllers, wheel manager, appendages, telemetry, effects.

Frozen models with every default stated once; the reader checks a file against them. Angles in rad,
wheel rates in rpm (as telemetry has them), everything else SI.
"""

from __future__ import annotations

import datetime
import math
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

# Limits that no spacecraft comes near: beyond them a slip of the pen would overflow somewhere.
LARGEST: Final = 1e12
SMALLEST: Final = 1e-9
Positive = Annotated[float, Field(ge=SMALLEST, le=LARGEST, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False, strict=True)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0, strict=True)]
Flag = Annotated[bool, Field(strict=True)]
Whole = Annotated[int, Field(strict=True)]
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False, strict=True)]
Vector = tuple[Number, Number, Number]
Quaternion = tuple[Number, Number, Number, Number]
TruthTable = dict[str, Any]


class Table(BaseModel):
    """A table of a scenario: unknown keys are refused, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SpacecraftSettings(Table):
    """Which spacecraft, thruster branch and prime wheels."""

    name: str | None = None
    file: str | None = None
    branch: str
    wheels: tuple[Whole, ...] = Field(min_length=1)


class RcsSettings(Table):
    """Thruster controller. Paper 001 section III gives cycle, pulse widths and dead-band.

    The gain, the hysteresis and the knowledge errors are printed nowhere;
    ``docs/topics/simulation.md`` says where the defaults come from.
    """

    dead_band_rad: Vector = (2e-3, 2e-3, 2e-3)
    rate_gain_s: Positive = 10.0
    hysteresis: Fraction = 0.0
    rate_clamp_rad_s: NotNegative = 0.0131
    pulse_min_s: Positive = 0.007
    pulse_max_s: Positive = 0.125
    pulse_resolution_s: Positive = 0.001
    pulse_law: Literal["fixed", "adaptive", "proportional"] = "fixed"
    proportional_band: Positive = 0.1
    minimum_off_s: NotNegative = 0.0
    mapping: Literal["shared", "union"] = "shared"
    latency_cycles: Literal[0, 1] = 0
    attitude_knowledge_rad: NotNegative = 2e-5
    rate_knowledge_rad_s: NotNegative = 2e-6


class RwaSettings(Table):
    """Wheel controller: PD with feed-forward; bandwidth and damping are assumed."""

    bandwidth_rad_s: Positive = 0.19
    damping: Positive = 0.9
    torque_limit_n_m: Positive = 0.13
    feed_forward: Flag = True
    attitude_knowledge_rad: NotNegative = 0.0
    rate_knowledge_rad_s: NotNegative = 0.0


class WheelSettings(Table):
    """Wheel manager (paper 001 section IV) and bearings.

    The time constant is the one that the durations printed in paper 001 imply.
    """

    torque_limit_n_m: Positive = 0.03
    time_constant_s: Positive = 16.5
    drag_coulomb_n_m: NotNegative = 0.0
    drag_viscous_n_m_s: NotNegative = 0.0
    drag_compensation: Fraction = 1.0


class PropulsionSettings(Table):
    """Pulse shape, specific impulse (paper 001 eq. 19: P0 … P4) and the blow-down tank.

    The coefficients of eq. (19) are printed nowhere; the default is the fit to the hydrazine that
    paper 001's ground software computed (``docs/results/simulation.md``).
    """

    pulse_shape: str = "first_order"
    isp_s: tuple[Positive, Number, Number, Number, Number] = (174.1, 22.8, 33.3, 0.0, 0.0)
    tank_pressure_kpa: Positive = 2000.0
    ullage_m3: Positive = 0.1


class Appendage(Table):
    """A boom, antenna or propellant mode: hinge axis, own inertia, frequency, damping ratio."""

    name: str
    axis: Vector
    inertia_kg_m2: Positive
    frequency_hz: Positive
    damping: NotNegative
    initial_angle_rad: Number = 0.0
    initial_rate_rad_s: Number = 0.0


class Slew(Table):
    """A rest-to-rest slew about a body axis, within rate and acceleration limits."""

    start_s: NotNegative
    axis: Vector
    angle_rad: Number
    rate_rad_s: Positive
    acceleration_rad_s2: Positive

    @property
    def duration_s(self) -> float:
        """Time from rest to rest: a trapezoid in rate, or a triangle below the rate limit."""
        size = abs(self.angle_rad)
        peak = min(self.rate_rad_s, math.sqrt(size * self.acceleration_rad_s2))
        return size / peak + peak / self.acceleration_rad_s2 if peak > 0.0 else 0.0


class StartSettings(Table):
    """Attitude error and rate at the start: 1 σ of uniform and of normal draws from the seed."""

    attitude_spread: Fraction = 1.0
    rate_rad_s: NotNegative = 0.0


class HybridSettings(Table):
    """Two wheels hold two axes (paper 004): X and Z (``ors``), or X and Y (``dfpw``).

    Thrusters hold the third in a bias, until ``free_from_s`` if it is given. A slew has no
    thrusters: the third axis is free, and the body begins with ``spin_rad_s`` about it.
    """

    controller: Literal["ors", "dfpw"]
    spin_rad_s: Number = 0.0
    free_from_s: NotNegative | None = None


class EventSettings(Table):
    """One event. A bias drives the wheels from ``from_rpm`` to ``to_rpm`` under thruster control;
    slews and quiescent periods start at ``from_rpm`` under wheel control; ``delta_v`` burns,
    from ``start_s`` on. With
    ``hybrid`` two wheels share the control with the thrusters (bias), or have it alone (slew).

    Without ``duration_s`` a bias ends ``settle_s`` after its last wheel has arrived (T of paper
    001: six time constants after its linear ramp), a set of slews ``settle_s`` after the last one.
    """

    id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    kind: Literal["slew", "bias", "quiescent", "delta_v"]
    epoch: datetime.datetime
    from_rpm: tuple[Number, ...]
    to_rpm: tuple[Number, ...] | None = None
    duration_s: Positive | None = None
    start_s: NotNegative = 0.0
    settle_s: NotNegative = 0.0
    attitude: Quaternion = (0.0, 0.0, 0.0, 1.0)
    slew: tuple[Slew, ...] = ()
    delta_v_m_s: NotNegative = 0.0
    thrusters_on: Flag = True
    truth: TruthTable = Field(default_factory=dict)
    start: StartSettings | None = None
    rcs: RcsSettings | None = None
    rwa: RwaSettings | None = None
    hybrid: HybridSettings | None = None


class TelemetrySettings(Table):
    """Sample interval of every channel group, noise (1 σ), resolution (least step), drop-outs.

    Noise and resolutions left out come from the truth's parameters of the same name, else 0.
    """

    attitude_every_s: Positive = 1.0
    rate_every_s: Positive = 1.0
    wheel_every_s: Positive = 1.0
    counter_every_s: Positive = 1.0
    delta_v_every_s: Positive = 10.0
    accelerometer_every_s: Positive = 1.0
    pressure_every_s: Positive = 60.0
    attitude_noise_rad: NotNegative | None = None
    rate_noise_rad_s: NotNegative | None = None
    rate_resolution_rad_s: NotNegative = 0.0
    wheel_noise_rpm: NotNegative | None = None
    wheel_resolution_rpm: NotNegative | None = None
    on_time_resolution_s: NotNegative | None = None
    delta_v: Literal["measured", "computed", "none"] = "none"
    delta_v_noise_m_s: NotNegative | None = None
    delta_v_resolution_m_s: NotNegative | None = None
    accelerometer: Flag = False
    pressure: Flag = False
    pressure_noise_kpa: NotNegative = 0.0
    drop_out: Fraction = 0.0
    source: str = "simulation"


class EffectRequest(Table):
    """An effect by name (``thruster_leak:z3``), its numbers, and the events it acts in (all)."""

    name: str
    parameters: dict[str, Any] = Field(default_factory=dict)
    events: tuple[str, ...] | None = None


class Scenario(Table):
    """A whole scenario file; ``step_s`` is the integrator's fixed step.

    Where a file leaves out ``cycle_s`` or ``pulse_max_s`` of ``rcs``, they are the control cycle of
    its spacecraft, s. With ``torque_noise`` a white torque acts, of the density
    ``torque_noise_n_m_s05`` of the truth.
    """

    spacecraft: SpacecraftSettings
    truth: TruthTable = Field(default_factory=dict)
    torque_noise: Flag = False
    step_s: Positive = 0.005
    cycle_s: Positive = 0.125
    rcs: RcsSettings = RcsSettings()
    rwa: RwaSettings = RwaSettings()
    wheels: WheelSettings = WheelSettings()
    propulsion: PropulsionSettings = PropulsionSettings()
    appendage: tuple[Appendage, ...] = ()
    start: StartSettings = StartSettings()
    event: tuple[EventSettings, ...] = Field(min_length=1)
    telemetry: TelemetrySettings = TelemetrySettings()
    effect: tuple[EffectRequest, ...] = ()
