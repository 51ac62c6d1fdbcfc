"""Conditions of a trial: what a user's telemetry may be like, drawn together with the truth.

What was calibrated under one condition says little about others: counters that are rounded, another
controller, biases without slews. Every trial of a campaign draws one level of every condition, and
results are given by stratum, one level of one condition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Flags, Places
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import ScenarioFile, scenario_of
from cassini_bayes.spacecraft.parameters import NOISE_LEVELS
from cassini_bayes.studies.scenario import draw_wheel_rates

# Priors file, branch, wheels, and what is true of the parts that the priors say nothing of.
CRAFTS: Final = MappingProxyType(
    {
        "A branch": (
            "cassini_a_branch_telemetry.toml",
            "A",
            [1, 2, 3],
            {
                "mass_kg": 3000.0,
                "rwa4_inertia_kg_m2": 0.16,
                "rwa4_tilt_u_rad": 0.0,
                "rwa4_tilt_v_rad": 0.0,
            },
        ),
        "B branch": ("cassini_b_branch_telemetry.toml", "B", [1, 2, 4], {"mass_kg": 2380.0}),
    }
)
BIASES: Final = MappingProxyType(
    {"one bias": 1, "three biases": 3, "six biases": 6, "bias and slews": 1, "slews": 0}
)
CADENCES: Final = MappingProxyType(
    {
        "1 s": (1.0, 1.0),
        "4 s": (4.0, 4.0),
        "4 s, counters 10 s": (4.0, 10.0),
    }
)
COUNTER_STEPS: Final = MappingProxyType({"1 ms": 0.001, "10 ms": 0.01, "control cycle": 0.125})
WHEEL_STEPS: Final = MappingProxyType({"0.1 rpm": 0.1, "1 rpm": 1.0})
RATES: Final = MappingProxyType(
    {"as flown": (1.7e-5, 0.25, 5e-6), "ten times finer": (2.0e-6, 0.4, 0.0)}
)
# As unlike as the format allows; the first is that of the shipped scenarios.
CONTROLLERS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "hysteresis": {"rate_gain_s": 10.0, "hysteresis": 0.15},
        "widths adapted": {"rate_gain_s": 10.0, "hysteresis": 0.15, "pulse_law": "adaptive"},
        "proportional, 0.5 s off": {
            "rate_gain_s": 10.0,
            "hysteresis": 0.05,
            "pulse_law": "proportional",
            "minimum_off_s": 0.5,
        },
        "one second off": {"rate_gain_s": 15.0, "hysteresis": 0.05, "minimum_off_s": 1.0},
        "high gain, union": {"rate_gain_s": 25.0, "hysteresis": 0.0, "mapping": "union"},
    }
)
# Torque of a wheel's motor, N m: the first is that of the shipped scenarios. A bias takes as long
# by either, and changes wheel rates the less. So thrusters push to and fro, not to one side.
DRIVES: Final = MappingProxyType({"30 mN m": 0.03, "2 mN m": 0.002})


@dataclass(frozen=True)
class Condition:
    """One level of every condition, by name."""

    craft: str
    events: str
    cadence: str
    counter_step: str
    wheel_step: str
    rates: str
    controller: str
    noise: str  # known or inferred
    drive: str = next(iter(DRIVES))

    @property
    def strata(self) -> dict[str, str]:
        """Level by condition."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def places(self) -> Places:
        """Places of the levels among those of :data:`LEVELS`, in its order."""
        return np.array([LEVELS[name].index(level) for name, level in self.strata.items()])


LEVELS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "craft": tuple(CRAFTS),
        "events": tuple(BIASES),
        "cadence": tuple(CADENCES),
        "counter_step": tuple(COUNTER_STEPS),
        "wheel_step": tuple(WHEEL_STEPS),
        "rates": tuple(RATES),
        "controller": tuple(CONTROLLERS),
        "noise": ("inferred", "known"),
        "drive": tuple(DRIVES),
    }
)


def strata_of(levels: NDArray[Any]) -> list[tuple[str, str, Flags]]:
    """Condition, level, and which of n trials had it; ``levels`` (n, conditions) are places."""
    return [
        (name, level, levels[:, column] == place)
        for column, (name, known) in enumerate(LEVELS.items())
        for place, level in enumerate(known)
    ]


def draw_condition(rng: np.random.Generator) -> Condition:
    """One level of every condition, all with the same chance."""
    return Condition(**{name: str(rng.choice(levels)) for name, levels in LEVELS.items()})


def document_under(
    condition: Condition, scenario: Path, priors: Path, rng: np.random.Generator
) -> dict[str, Any]:
    """The document of a campaign's scenario under a condition, wheel rates drawn anew.

    Parameters
    ----------
    scenario
        Whose first bias and slews are flown.
    priors
        Folder of the priors files of :data:`CRAFTS`.
    """
    document = read_toml(scenario, "a scenario file")
    file, branch, wheels, given = CRAFTS[condition.craft]
    every, counters = CADENCES[condition.cadence]
    document["spacecraft"] |= {"branch": branch, "wheels": wheels}
    document["truth"] = {"draw_from": str((priors / file).resolve()), **given}
    document["rcs"] |= CONTROLLERS[condition.controller]
    document["telemetry"] |= {
        "attitude_every_s": every,
        "rate_every_s": every,
        "wheel_every_s": every,
        "counter_every_s": counters,
        "wheel_resolution_rpm": WHEEL_STEPS[condition.wheel_step],
        "rate_resolution_rad_s": RATES[condition.rates][2],
        "on_time_resolution_s": COUNTER_STEPS[condition.counter_step],
    }
    document["torque_noise"] = True
    document["event"] = _events(document["event"], condition.events)
    draw_wheel_rates(document["event"], rng)
    _drive(document, DRIVES[condition.drive])
    return document


def _drive(document: dict[str, Any], torque_n_m: float) -> None:
    """Drive wheels by a torque, in biases that take as long as by that of the scenarios."""
    document["wheels"] = document.get("wheels", {}) | {"torque_limit_n_m": torque_n_m}
    share = torque_n_m / next(iter(DRIVES.values()))
    for event in document["event"]:
        if event["kind"] == "bias":
            both = zip(event["from_rpm"], event["to_rpm"], strict=True)
            event["to_rpm"] = [start + share * (end - start) for start, end in both]


def scenario_under(
    condition: Condition,
    scenario: Path,
    priors: Path,
    rng: np.random.Generator,
    effects: Sequence[Mapping[str, Any]] = (),
) -> ScenarioFile:
    """The scenario of :func:`document_under`, with tables of ``effects`` hidden in all events."""
    document = document_under(condition, scenario, priors, rng)
    document["effect"] = [dict(effect) for effect in effects]
    return scenario_of(document, scenario.parent, str(scenario))


def _events(events: list[dict[str, Any]], mix: str) -> list[dict[str, Any]]:
    """As many copies of the first bias as the mix has, a month apart, and the slews."""
    bias = next(event for event in events if event["kind"] == "bias")
    slews = [event for event in events if event["kind"] == "slew"] if "slews" in mix else []
    copies = [
        bias | {"id": f"bias-{i + 1}", "epoch": datetime(2010, i + 1, 15, tzinfo=UTC)}
        for i in range(BIASES[mix])
    ]
    return [*copies, *slews]


def beliefs_under(condition: Condition, priors: Path) -> Priors:
    """What is believed of the truth, and it is drawn from; noise that is known is fixed later."""
    file = CRAFTS[condition.craft][0]
    median, spread, _ = RATES[condition.rates]
    rates = Distribution("lognorm", {"s": spread, "scale": median})
    return read_priors(priors / file).with_distribution("rate_noise_rad_s", rates)


def with_known_noise(priors: Priors, truth: Mapping[str, float]) -> Priors:
    """Priors in which every noise level is fixed at its true value."""
    for name in NOISE_LEVELS:
        priors = priors.with_fixed(name, truth[name])
    return priors
