"""One event of a scenario, from its settings to motion and telemetry."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from cassini_bayes.simulation.effects import ChosenEffect
from cassini_bayes.simulation.engine import Steps, event_duration_s, simulate_motion
from cassini_bayes.simulation.motion import Motion
from cassini_bayes.simulation.plan import Plan, frozen_mapping
from cassini_bayes.simulation.settings import EventSettings, Scenario
from cassini_bayes.simulation.streams import stream
from cassini_bayes.simulation.telemetry import Telemetry, observe, record_interval_s
from cassini_bayes.simulation.truth import TORQUE_NOISE, Truth
from cassini_bayes.spacecraft import Spacecraft, check_axis_pairs


@dataclass(frozen=True)
class SimulatedEvent:
    """The plan of an event, what happened, and what telemetry shows of it."""

    plan: Plan
    motion: Motion
    telemetry: Telemetry


def make_plan(
    scenario: Scenario,
    spacecraft: Spacecraft,
    event: EventSettings,
    truth: Truth,
    effects: Iterable[ChosenEffect] = (),
) -> Plan:
    """The plan of one event: the truth and, one after the other, the effects.

    The duration is settled before the effects: commands do not know of them, and events with and
    without an effect can be subtracted row by row.

    Raises
    ------
    InputError
        Thrusters that the controller fires for a torque turn the spacecraft the other way.
    """
    branch, parameters = scenario.spacecraft.branch, truth.of(event.id)
    check_axis_pairs(spacecraft, branch, parameters)
    plan = Plan(
        spacecraft=spacecraft.with_platforms(parameters),
        branch=branch,
        wheel_numbers=scenario.spacecraft.wheels,
        event=event,
        parameters=frozen_mapping(parameters),
        thrust_n=frozen_mapping(truth.thrust_n(event.id, spacecraft.thruster_names(branch))),
        rcs=event.rcs or scenario.rcs,
        rwa=event.rwa or scenario.rwa,
        wheels=scenario.wheels,
        propulsion=scenario.propulsion,
        start=event.start or scenario.start,
        appendages=scenario.appendage,
        torque_noise_n_m_s05=parameters[TORQUE_NOISE] if scenario.torque_noise else 0.0,
    )
    duration = event_duration_s(plan, scenario.cycle_s)
    plan = replace(plan, event=event.model_copy(update={"duration_s": duration}))
    for effect in effects:
        plan = effect.applied(plan)
    return plan


def simulate_plan(plan: Plan, scenario: Scenario, seed: int) -> SimulatedEvent:
    """Integrate a plan and sample it; whatever is random has a stream of its own."""
    record = record_interval_s(scenario.telemetry)
    motion = simulate_motion(
        plan,
        Steps.of(scenario.step_s, scenario.cycle_s, record),
        stream(seed, plan.event.id, "start"),
        stream(seed, plan.event.id, "knowledge"),
        stream(seed, plan.event.id, "torque noise"),
    )
    return SimulatedEvent(plan, motion, observe(plan, motion, scenario.telemetry, seed))
