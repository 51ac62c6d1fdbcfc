"""Flights of the blind trials: a scenario with effects hidden in it, with or without noise."""

from __future__ import annotations

import gc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from cassini_bayes.diagnosis.events import Events, prepare
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import ScenarioFile, Truth, scenario_of
from cassini_bayes.studies.blind.strata import STRATA, Stratum
from cassini_bayes.studies.conditions import (
    Condition,
    beliefs_under,
    document_under,
    draw_condition,
    with_known_noise,
)
from cassini_bayes.studies.scenario import (
    Simulation,
    draw_truth,
    draw_wheel_rates,
    simulate_file,
)
from cassini_bayes.studies.telemetry_calibration import reduced_simulation

PHASE_STEP: Final = "phase_step_rad"
CHANNEL_NOISE: Final = ("rate_noise_rad_s", "wheel_noise_rpm", "attitude_noise_rad")
FINEST_STEPS: Final = MappingProxyType(
    {"wheel_resolution_rpm": 0.0, "rate_resolution_rad_s": 0.0, "on_time_resolution_s": 0.001}
)
"""Of telemetry that shows what an effect changes, and nothing of how channels are rounded."""


@dataclass(frozen=True)
class Hidden:
    """An effect to hide: name as the simulation spells it, its parameters, its size in σ.

    An oscillation with a ``phase_step_rad`` starts every event so much further in its phase than
    the one before.
    """

    name: str
    parameters: dict[str, float]
    sigma: float

    def phases_rad(self, events: Sequence[str]) -> dict[str, float]:
        """Phase at the start of every event by its id; the events are in order of flight."""
        step = self.parameters.get(PHASE_STEP, 0.0)
        return {event: (place * step) % (2.0 * np.pi) for place, event in enumerate(events)}

    def effects(self, events: Sequence[str]) -> list[dict[str, Any]]:
        """As a scenario has it: one effect, or one for every event, whose ids are in order."""
        if PHASE_STEP not in self.parameters:
            return [{"name": self.name, "parameters": self.parameters}]
        known = {key: value for key, value in self.parameters.items() if key != PHASE_STEP}
        return [
            {"name": self.name, "parameters": {**known, "phase_rad": phase}, "events": [event]}
            for event, phase in self.phases_rad(events).items()
        ]


@dataclass(frozen=True)
class Blind:
    """A campaign: scenario, priors, seed, which of its events are flown, and its parts.

    ``all_drawn``: what the scenario gives of parameters that the priors know is drawn as well.
    ``over_conditions``: every trial draws its conditions and with them its events, and ``priors``
    is the folder of the files of :data:`~cassini_bayes.studies.conditions.CRAFTS`.
    """

    scenario: Path
    priors: Path
    seed: int
    events: tuple[str, ...]
    strata: tuple[Stratum, ...] = STRATA
    all_drawn: bool = False
    over_conditions: bool = False

    def stream(self, index: int) -> np.random.Generator:
        """All that is random in a trial: it depends on the seed and the trial's number alone."""
        return np.random.default_rng(np.random.SeedSequence((self.seed, index)))

    def condition(self, rng: np.random.Generator) -> Condition | None:
        """The first draw of a trial over conditions."""
        return draw_condition(rng) if self.over_conditions else None

    def document(self, rng: np.random.Generator) -> dict[str, Any]:
        """The scenario with wheel rates of this trial."""
        document = read_toml(self.scenario, "a scenario file")
        document["event"] = [e for e in document["event"] if e["id"] in self.events]
        draw_wheel_rates(document["event"], rng)
        return document

    def scene(self, rng: np.random.Generator, priors: Priors | None = None) -> Scene:
        """A trial's truth, before anything is hidden in it; ``priors`` where they are read."""
        condition = self.condition(rng)
        if condition is not None:
            return self._scene_under(condition, rng)
        priors = read_priors(self.priors) if priors is None else priors
        document = self.document(rng)
        if self.all_drawn:
            document = without_given(document, priors)
        return Scene(self, document, int(rng.integers(2**62)), priors)

    def _scene_under(self, condition: Condition, rng: np.random.Generator) -> Scene:
        document = document_under(condition, self.scenario, self.priors, rng)
        # torque noise is what `unknown` says: with it something would be hidden in every trial
        document["torque_noise"] = False
        believed = beliefs_under(condition, self.priors)
        scene = Scene(self, document, int(rng.integers(2**62)), believed, condition)
        if condition.noise == "inferred":
            return scene
        return replace(scene, priors=with_known_noise(believed, scene.truth().parameters))


def without_given(document: Mapping[str, Any], priors: Priors) -> dict[str, Any]:
    """A scenario's document that gives no parameter of the priors and no noise of a channel.

    Steps of telemetry stay: those in a priors file are of printed totals.
    """
    truth = {k: v for k, v in document["truth"].items() if k not in priors.parameters}
    telemetry = {k: v for k, v in document["telemetry"].items() if k not in CHANNEL_NOISE}
    return {**document, "truth": truth, "telemetry": telemetry}


@dataclass(frozen=True)
class Scene:
    """One trial's truth before anything is hidden in it: scenario, seed of all noise, priors."""

    campaign: Blind
    document: dict[str, Any]
    seed: int
    priors: Priors
    condition: Condition | None = None

    def file(self, hidden: Sequence[Hidden]) -> ScenarioFile:
        """The scenario with effects."""
        effects = [effect for own in hidden for effect in own.effects(self.event_ids)]
        where = self.campaign.scenario
        return scenario_of({**self.document, "effect": effects}, where.parent, str(where))

    @property
    def event_ids(self) -> list[str]:
        """Ids of all events in order of flight."""
        return [event["id"] for event in self.document["event"]]

    def truth(self) -> Truth:
        """All parameters and thrusts without any effect."""
        return draw_truth(self.file(()), self.seed, self.priors)

    def fly(self, hidden: Sequence[Hidden]) -> Events:
        """The flight with effects, reduced; the same seed, so the same noise and truth."""
        return reduced(simulate_file(self.file(hidden), self.seed, priors=self.priors), self.priors)

    def fly_quietly(self, hidden: Sequence[Hidden]) -> Events:
        """The same flight with channels that have no noise.

        Without conditions counters keep their resolution; under conditions steps are the finest:
        those that are coarse would drown what an effect changes.
        """
        truth, scene = self.truth(), self
        quiet = {**truth.parameters, **dict.fromkeys(CHANNEL_NOISE, 0.0)}
        if self.condition is not None:
            telemetry = {**self.document["telemetry"], **FINEST_STEPS}
            scene = replace(self, document={**self.document, "telemetry": telemetry})
        flight = simulate_file(
            scene.file(hidden),
            self.seed,
            truth=replace(truth, parameters=quiet),
            priors=self.priors,
        )
        return reduced(flight, self.priors)


def reduced(flight: Simulation, priors: Priors) -> Events:
    """All events of a flight, ready for a diagnosis."""
    # those of earlier flights lie in cycles, six events 0.3 GB, and collections are rare by default
    gc.collect()
    return prepare([reduced_simulation(event, priors) for event in flight.events], priors)
