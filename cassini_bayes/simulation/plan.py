"""The plan of one event: the truth with all effects applied, before it becomes arrays.

An effect is a function from a plan to a plan. Whatever an effect can change has a field here, with
a value that changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from cassini_bayes.simulation.settings import (
    Appendage,
    EventSettings,
    PropulsionSettings,
    RcsSettings,
    RwaSettings,
    StartSettings,
    WheelSettings,
)
from cassini_bayes.spacecraft import Spacecraft

Vector = tuple[float, float, float]
NO_VECTOR: Vector = (0.0, 0.0, 0.0)


def frozen_mapping(values: Mapping[str, float] | None = None) -> Mapping[str, float]:
    """A read-only copy."""
    return MappingProxyType(dict(values or {}))


@dataclass(frozen=True)
class TorquePulse:
    """External torque peak · exp(−½ ((t − centre)/width)²), body axes."""

    peak_n_m: Vector = NO_VECTOR
    centre_s: float = 0.0
    width_s: float = 0.0


@dataclass(frozen=True)
class Surge:
    """Feed pressure up by a fraction at a time, falling back exponentially."""

    fraction: float = 0.0
    start_s: float = 0.0
    decay_s: float = 0.0


@dataclass(frozen=True)
class Misreading:
    """What the telemetry gets wrong. Rates: (1 + scale) ω + bias; counters shown late; speeds
    read as ρ (1 + slope |ρ|), slope per rpm.
    """

    rate_scale: Vector = NO_VECTOR
    counters_late_s: float = 0.0
    speed_slope_per_rpm: float = 0.0


@dataclass(frozen=True)
class Plan:
    """What happens in one event.

    ``parameters`` are named as in priors files; ``thrust_n`` is the steady thrust of every
    thruster of the branch at the start of the event.
    """

    spacecraft: Spacecraft
    branch: str
    wheel_numbers: tuple[int, ...]
    event: EventSettings
    parameters: Mapping[str, float]
    thrust_n: Mapping[str, float]
    rcs: RcsSettings
    rwa: RwaSettings
    wheels: WheelSettings
    propulsion: PropulsionSettings
    start: StartSettings
    appendages: tuple[Appendage, ...] = ()
    cants_rad: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    leaks_n: Mapping[str, float] = field(default_factory=frozen_mapping)
    leak_start_s: float = 0.0
    warmup_deficit: Mapping[str, float] = field(default_factory=frozen_mapping)
    warmup_time_s: float = 1.0
    impulse_offset_s: float = 0.0
    torque_noise_n_m_s05: float = 0.0  # momentum gained from white torque noise in 1 s, 1 σ an axis
    torque_pulse: TorquePulse = TorquePulse()
    surge: Surge = Surge()
    plume: Mapping[str, float] = field(default_factory=frozen_mapping)
    misreading: Misreading = Misreading()

    @property
    def thrusters(self) -> tuple[str, ...]:
        """Names of the thrusters of the branch, in file order."""
        return self.spacecraft.thruster_names(self.branch)

    @property
    def nominal_mass_kg(self) -> float:
        """Mass that the flight software assumes."""
        return self.parameters["mass_kg"] / self.parameters["mass_factor"]

    @property
    def computed_acceleration_m_s2(self) -> float:
        """Acceleration by one thruster as flight software computes it, c F/M (paper 001 eq. 22).

        F is the common thrust and M the mass that it assumes, c its ``fsw_acceleration_factor``.
        """
        factor = self.parameters["fsw_acceleration_factor"]
        return factor * self.parameters["thrust_common_n"] / self.nominal_mass_kg

    def with_parameters(self, **values: float) -> Plan:
        """The plan with other values of some parameters."""
        return replace(self, parameters=frozen_mapping({**self.parameters, **values}))

    def with_thrust_factor(self, factor: float, only: str | None = None) -> Plan:
        """The plan with all thrusters, or one, stronger by a factor."""
        scaled = {
            name: value * (factor if only in (None, name) else 1.0)
            for name, value in self.thrust_n.items()
        }
        return replace(self, thrust_n=frozen_mapping(scaled))
