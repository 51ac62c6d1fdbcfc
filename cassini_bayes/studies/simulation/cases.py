"""Scenarios as the sections of the page run them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from cassini_bayes.simulation import ScenarioFile, SimulatedEvent, make_plan, simulate_plan
from cassini_bayes.studies.scenario import draw_truth

SCENARIOS: Final = Path("runs/scenarios")


def with_settings(file: ScenarioFile, **updates: object) -> ScenarioFile:
    """A scenario file with other settings."""
    return replace(file, scenario=file.scenario.model_copy(update=updates))


def simulated(file: ScenarioFile, seed: int) -> tuple[SimulatedEvent, ...]:
    """All events of a scenario, without effects."""
    truth = draw_truth(file, seed)
    scenario = file.scenario
    return tuple(
        simulate_plan(make_plan(scenario, file.spacecraft, event, truth), scenario, seed)
        for event in scenario.event
    )
