"""Honest events under drawn conditions, as the reader would give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from cassini_bayes.balance.statistics import Samples
from cassini_bayes.events.telemetry import Chunk, TelemetryEvent
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.priors.reader import Priors
from cassini_bayes.simulation import SimulatedEvent
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM
from cassini_bayes.studies.conditions import Condition, beliefs_under, scenario_under
from cassini_bayes.studies.scenario import simulate_file, simulated_samples

EFFECTS: Final[Mapping[str, Mapping[str, float]]] = MappingProxyType(
    {
        "thrust_scale": {"thrust_factor": 0.85},
        "thruster_degraded:z4": {"thrust_factor": 0.7},
        "thrust_warmup": {"warmup_deficit": 0.3, "warmup_time_s": 4.0},
        "tail_off": {"tau_fall_s": 0.1},
        "pulse_shape": {"impulse_time_offset_s": 0.03},
        "center_of_mass:y": {"cm_y_m": 0.10},
        "wheel_inertia:2": {"rwa2_inertia_kg_m2": 0.168},
        "thruster_misalignment:y2": {"cant_a_rad": 0.05, "cant_b_rad": -0.05},
        "external_torque": {f"external_torque_{axis}_n_m": 1e-4 for axis in "xyz"},
        "thruster_leak:z1": {"leak_n": 1e-3},
        "inertia:xx": {"inertia_xx_kg_m2": 7200.0},
        "time_offset": {"time_offset_s": 1.5},
        "rate_bias:z": {"rate_bias_z_rad_s": 1e-5},
        "rate_scale:x": {"rate_scale": 0.02},
        "flexible_mode": {"frequency_hz": 0.13, "damping": 0.002, "amplitude_rad_s": 2e-5},
    }
)
"""Clear effects of the catalogue, two to four of its prior's standard deviations."""


@dataclass(frozen=True, eq=False)
class Flight:
    """Telemetry of the events of one draw, totals of its biases, and what is believed of them."""

    priors: Priors
    events: tuple[tuple[TelemetryEvent, Chunk], ...]
    rows: tuple[TotalsEvent, ...]


def fly(
    condition: Condition,
    scenario: Path,
    priors: Path,
    rng: np.random.Generator,
    effect: str | None = None,
) -> Flight:
    """Fly the events of a condition, an effect hidden in all of them."""
    hidden = () if effect is None else ({"name": effect, "parameters": dict(EFFECTS[effect])},)
    file = scenario_under(condition, scenario, priors, rng, hidden)
    believed = beliefs_under(condition, priors)
    flight = simulate_file(file, int(rng.integers(2**62)), priors=believed)
    events = [recorded(event, simulated_samples(event)[0]) for event in flight.events]
    return Flight(believed, tuple(events), flight.totals())


def recorded(event: SimulatedEvent, samples: Samples) -> tuple[TelemetryEvent, Chunk]:
    """Telemetry of a simulated event as the reader would give it."""
    settings, rows = event.plan.event, len(samples)
    place = Path(settings.id)
    described = TelemetryEvent(
        id=settings.id,
        kind=settings.kind,
        epoch=settings.epoch,
        branch=event.plan.branch,
        wheels=tuple(event.plan.wheel_numbers),
        thrusters=simulated_samples(event)[1],
        delta_v_source=None,
        source="simulation",
        folder=place,
        telemetry=place / "telemetry.csv",
        digest="",
    )
    chunk = Chunk(
        first_row=2,
        time_s=samples.time_s.copy(),
        attitude=samples.attitude.copy(),
        rate_rad_s=samples.rate_rad_s.copy(),
        wheel_rpm=samples.wheel_rad_s / RAD_S_PER_RPM,
        on_time_s=samples.on_time_s.copy(),
        pulses=samples.pulses.copy(),
        delta_v_m_s=np.zeros((rows, 0)),
        tank_pressure_kpa=np.full(rows, np.nan),
        accelerometer_counts=np.full(rows, np.nan),
    )
    return described, chunk


def with_events(condition: Condition, events: str) -> Condition:
    """The same condition with another mix of events."""
    return replace(condition, events=events)
