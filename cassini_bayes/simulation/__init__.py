"""The simulation: closed-loop wheel biases, slews and burns, and effects hidden in them.

It integrates the equations of motion of a rigid body with wheels and thrusters; it shares geometry
and pulse physics with the inference and nothing else. ``docs/topics/simulation.md`` has the
physics.
"""

from __future__ import annotations

from cassini_bayes.simulation.effects import EFFECTS, ChosenEffect, Effect, choose_effect
from cassini_bayes.simulation.events import SimulatedEvent, make_plan, simulate_plan
from cassini_bayes.simulation.motion import Motion, PulseLog
from cassini_bayes.simulation.plan import Plan
from cassini_bayes.simulation.reader import ScenarioFile, read_scenario, scenario_of
from cassini_bayes.simulation.settings import EffectRequest, EventSettings, Scenario
from cassini_bayes.simulation.streams import stream
from cassini_bayes.simulation.telemetry import (
    Telemetry,
    event_fields,
    event_text,
    hydrazine_g,
    observe,
    telemetry_text,
    totals_row,
)
from cassini_bayes.simulation.truth import (
    TORQUE_NOISE,
    Truth,
    check_complete,
    required_parameters,
    truth_fields,
    truth_text,
)

__all__ = [
    "EFFECTS",
    "TORQUE_NOISE",
    "ChosenEffect",
    "Effect",
    "EffectRequest",
    "EventSettings",
    "Motion",
    "Plan",
    "PulseLog",
    "Scenario",
    "ScenarioFile",
    "SimulatedEvent",
    "Telemetry",
    "Truth",
    "check_complete",
    "choose_effect",
    "event_fields",
    "event_text",
    "hydrazine_g",
    "make_plan",
    "observe",
    "read_scenario",
    "required_parameters",
    "scenario_of",
    "simulate_plan",
    "stream",
    "telemetry_text",
    "totals_row",
    "truth_fields",
    "truth_text",
]
