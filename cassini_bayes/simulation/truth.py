"""The truth of a simulation: parameters and thrusts of every event, and the file for them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from cassini_bayes.errors import InputError
from cassini_bayes.simulation.effects import ChosenEffect
from cassini_bayes.simulation.plan import Plan
from cassini_bayes.spacecraft import Spacecraft

FORMAT: Final = 1
TORQUE_NOISE: Final = "torque_noise_n_m_s05"  # where a scenario wants it
DEFAULTS: Final[Mapping[str, float]] = {
    **{f"external_torque_{axis}_n_m": 0.0 for axis in "xyz"},
    **{f"rate_bias_{axis}_rad_s": 0.0 for axis in "xyz"},
    **{f"tau_{which}_s": 0.0 for which in ("delay", "rise", "fall")},
    "thrust_event_n": 0.0,
    "mass_factor": 1.0,
    "fsw_acceleration_factor": 1.0,
    "fsw_impulse_offset_s": 0.0,
    "accelerometer_scale_m_s": 2.0202e-3,  # paper 000 appendix D
    "accelerometer_bias_m_s2": 0.0,
}
"""What a scenario may leave out: an effect that is not there."""

_ALWAYS: Final = (
    "thrust_common_n",
    "mass_kg",
    *(f"cm_{axis}_m" for axis in "xyz"),
    *(f"inertia_{element}_kg_m2" for element in ("xx", "yy", "zz", "xy", "xz", "yz")),
)


@dataclass(frozen=True)
class Truth:
    """Values of parameters, with departures per event and thruster.

    Attributes
    ----------
    parameters
        Common to all events.
    events
        Values that replace the common ones in one event.
    individual_n, jitter_n
        Departures of thrust by thruster, and by event and thruster.
    """

    parameters: Mapping[str, float]
    events: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    individual_n: Mapping[str, float] = field(default_factory=dict)
    jitter_n: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def of(self, event: str) -> dict[str, float]:
        """Parameters of one event, defaults filled in; ``mass_kg`` is the true mass."""
        values = {**DEFAULTS, **self.parameters, **self.events.get(event, {})}
        if "mass_kg" in values:
            values["mass_kg"] *= values["mass_factor"]
        return values

    def thrust_n(self, event: str, thrusters: Iterable[str]) -> dict[str, float]:
        """Thrust of every thruster in one event: common + individual + event + jitter."""
        values = self.of(event)
        level = values["thrust_common_n"] + values["thrust_event_n"]
        jitter = self.jitter_n.get(event, {})
        return {
            name: level + self.individual_n.get(name, 0.0) + jitter.get(name, 0.0)
            for name in thrusters
        }


def required_parameters(
    spacecraft: Spacecraft, branch: str, wheels: tuple[int, ...]
) -> tuple[str, ...]:
    """Parameters without a default that a simulation with these wheels and thrusters needs."""
    prime = [spacecraft.wheel(number) for number in wheels]
    tilts = [name for wheel in prime for name in wheel.tilt_parameters or ()]
    return (
        *_ALWAYS,
        *spacecraft.geometry[branch].parameters,
        *(wheel.inertia_parameter for wheel in prime),
        *tilts,
    )


def check_complete(truth: Truth, needed: Iterable[str], events: Iterable[str], where: str) -> None:
    """Check that every event has every needed parameter, and thrusts above zero.

    Raises
    ------
    InputError
        Names the parameter and the event.
    """
    for event in events:
        values = truth.of(event)
        for name in needed:
            if name not in values:
                raise InputError(
                    f"{where}: truth.{name}",
                    f"a value, needed by event {event}",
                    "nothing",
                    f"add {name} = … under [truth], or draw_from a priors file that has it",
                )


def truth_fields(
    seed: int, plans: Iterable[Plan], effects: Iterable[ChosenEffect]
) -> dict[str, Any]:
    """The content of ``truth.json``: format, seed, the parameters that were simulated, effects.

    And, by event, what differs from event to event (parameters, thrust of every thruster).
    ``parameters`` holds the values with all effects applied, those that all events share.
    """
    plans = tuple(plans)
    every = {plan.event.id: dict(plan.parameters) for plan in plans}
    thrusts = {plan.event.id: dict(plan.thrust_n) for plan in plans}
    first = next(iter(every.values()))
    shared = {
        name: value
        for name, value in first.items()
        if all(values.get(name) == value for values in every.values())
    }
    return {
        "format": FORMAT,
        "seed": seed,
        "parameters": shared,
        "effects": [
            {
                "name": effect.name,
                "parameters": dict(effect.values),
                **({} if effect.events is None else {"events": list(effect.events)}),
            }
            for effect in effects
        ],
        "events": {
            event: {
                "parameters": {k: v for k, v in values.items() if k not in shared},
                "thrust_n": thrusts[event],
            }
            for event, values in every.items()
        },
    }


def truth_text(seed: int, plans: Iterable[Plan], effects: Iterable[ChosenEffect]) -> str:
    """``truth.json`` of a simulation."""
    return json.dumps(truth_fields(seed, plans, effects), indent=2, allow_nan=False) + "\n"
