"""Flights of the blind trials: a scenario with effects hidden in it, with or without noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from cassini_bayes.diagnosis.events import Events, prepare
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.priors.reader import Priors
from cassini_bayes.simulation import ScenarioFile, Truth, scenario_of
from cassini_bayes.studies.scenario import (
    Simulation,
    draw_truth,
    draw_wheel_rates,
    simulate_file,
)
from cassini_bayes.studies.telemetry_calibration import reduced_simulation

CHANNEL_NOISE: Final = ("rate_noise_rad_s", "wheel_noise_rpm", "attitude_noise_rad")


@dataclass(frozen=True)
class Hidden:
    """An effect to hide: name as the simulation spells it, its parameters, its size in σ."""

    name: str
    parameters: dict[str, float]
    sigma: float


@dataclass(frozen=True)
class Blind:
    """A campaign: scenario, priors, seed, and which of its events are flown."""

    scenario: Path
    priors: Path
    seed: int
    events: tuple[str, ...]

    def document(self, rng: np.random.Generator) -> dict[str, Any]:
        """The scenario with wheel rates of this trial."""
        document = read_toml(self.scenario, "a scenario file")
        document["event"] = [e for e in document["event"] if e["id"] in self.events]
        draw_wheel_rates(document["event"], rng)
        return document


@dataclass(frozen=True)
class Scene:
    """One trial's truth before anything is hidden in it: scenario, seed of all noise, priors."""

    campaign: Blind
    document: dict[str, Any]
    seed: int
    priors: Priors

    def file(self, hidden: Sequence[Hidden]) -> ScenarioFile:
        """The scenario with effects."""
        effects = [{"name": h.name, "parameters": h.parameters} for h in hidden]
        where = self.campaign.scenario
        return scenario_of({**self.document, "effect": effects}, where.parent, str(where))

    def truth(self) -> Truth:
        """All parameters and thrusts without any effect."""
        return draw_truth(self.file(()), self.seed, self.priors)

    def fly(self, hidden: Sequence[Hidden]) -> Events:
        """The flight with effects, reduced; the same seed, so the same noise and truth."""
        return reduced(simulate_file(self.file(hidden), self.seed, priors=self.priors), self.priors)

    def fly_quietly(self, hidden: Sequence[Hidden]) -> Events:
        """The same flight with channels that have no noise; counters keep their resolution."""
        truth = self.truth()
        quiet = {**truth.parameters, **dict.fromkeys(CHANNEL_NOISE, 0.0)}
        flight = simulate_file(
            self.file(hidden), self.seed, truth=replace(truth, parameters=quiet), priors=self.priors
        )
        return reduced(flight, self.priors)


def reduced(flight: Simulation, priors: Priors) -> Events:
    """All events of a flight, ready for a diagnosis."""
    return prepare([reduced_simulation(event, priors) for event in flight.events], priors)
