"""Units and orders that no single cell shows are caught by the balance; honest faults never are."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulation_cases import BIAS, EPOCH, PARAMETERS, SLEWS

from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import check_momentum, momentum_rows
from cassini_bayes.events.telemetry import (
    Chunk,
    TelemetryEvent,
    load_event,
    read_chunks,
    read_event,
)
from cassini_bayes.simulation import scenario_of
from cassini_bayes.spacecraft import load_spacecraft
from cassini_bayes.studies.scenario import simulate_file, write_simulation

CASSINI = load_spacecraft("cassini")
NOMINAL = {**PARAMETERS, "thrust_common_n": 0.75, "fsw_impulse_offset_s": 0.01}
DOCUMENT: Mapping[str, Any] = {
    "spacecraft": {"name": "cassini", "branch": "B", "wheels": [1, 2, 4]},
    "truth": NOMINAL,
    "event": [
        {**BIAS, "epoch": EPOCH},
        {
            "id": "slews",
            "kind": "slew",
            "epoch": EPOCH,
            "from_rpm": (300.0, -500.0, 700.0),
            "slew": [slew.model_dump() for slew in SLEWS[:4]],
        },
    ],
    "telemetry": {
        "rate_noise_rad_s": 2e-6,
        "wheel_noise_rpm": 0.2,
        "attitude_noise_rad": 2e-5,
        "on_time_resolution_s": 0.001,
    },
}
Event = tuple[TelemetryEvent, Chunk]
Change = Callable[[Chunk], Chunk]


def simulated(
    folder: Path, truth: Mapping[str, float], effect: Mapping[str, Any] | None
) -> list[Event]:
    """The bias and the slews of a scenario, read back."""
    document = copy.deepcopy(dict(DOCUMENT))
    document["truth"] = {**NOMINAL, **truth}
    document["effect"] = [] if effect is None else [dict(effect)]
    write_simulation(simulate_file(scenario_of(document), 5), folder)
    events = [read_event(folder / name, CASSINI) for name in ("bias", "slews")]
    return [(event, load_event(event, CASSINI)) for event in events]


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Event]:
    """Events without any fault."""
    events = simulated(tmp_path_factory.mktemp("honest"), {}, None)
    return {event.kind: (event, chunk) for event, chunk in events}


def turned(order: list[int]) -> Change:
    """Wheel columns in another order."""
    return lambda chunk: replace(chunk, wheel_rpm=chunk.wheel_rpm[:, order])


def scaled(name: str, factor: float) -> Change:
    """A channel in another unit."""
    return lambda chunk: replace(chunk, **{name: factor * getattr(chunk, name)})


def conjugate(chunk: Chunk) -> Chunk:
    """Attitudes body → J2000."""
    return replace(chunk, attitude=chunk.attitude * np.array([-1.0, -1.0, -1.0, 1.0]))


def scalar_first(chunk: Chunk) -> Chunk:
    """Attitudes with the scalar in q1."""
    return replace(chunk, attitude=np.roll(chunk.attitude, 1, axis=1))


MISTAKES = [
    (scaled("wheel_rpm", 2 * np.pi / 60), "look like rad/s"),
    (scaled("wheel_rpm", -1.0), "opposite sign"),
    (turned([1, 0, 2]), "look like those of wheels [2, 1, 4]"),
    (turned([2, 1, 0]), "look like those of wheels [4, 2, 1]"),
    (turned([0, 2, 1]), "look like those of wheels [1, 4, 2]"),
    (turned([1, 2, 0]), "look like those of wheels [2, 4, 1]"),
    (conjugate, "look like body → J2000"),
    (scalar_first, "look scalar-first"),
    (scaled("rate_rad_s", 180 / np.pi), "deg/s"),
]


@pytest.mark.parametrize("kind", ["bias", "slew"])
@pytest.mark.parametrize(("mistake", "fragment"), MISTAKES)
def test_a_mistake_is_named(
    honest: dict[str, Event], kind: str, mistake: Change, fragment: str
) -> None:
    """Units, orders and conventions: refused, with the file and the mistake in the message."""
    event, chunk = honest[kind]
    with pytest.raises(InputError) as caught:
        check_momentum(event, [mistake(chunk)], CASSINI, NOMINAL)
    assert fragment in str(caught.value)
    assert "telemetry.csv" in str(caught.value)


def test_an_honest_event_closes(honest: dict[str, Event]) -> None:
    """Without faults the balance closes far inside the bound, at the truth and beside it."""
    for event, chunk in honest.values():
        balance = check_momentum(event, [chunk], CASSINI, NOMINAL)
        assert balance.misfit < 1.0
        assert balance.unexplained < 0.05
        assert balance.rows > 100


FAULTS: list[tuple[dict[str, float], dict[str, Any] | None]] = [
    ({"thrust_common_n": 0.75 * 1.3}, None),
    ({"thrust_common_n": 0.75 * 0.7}, None),
    ({"cm_x_m": 0.23, "cm_y_m": -0.043, "cm_z_m": 1.164}, None),
    ({"rwa1_inertia_kg_m2": 0.161 * 1.05, "rwa2_inertia_kg_m2": 0.16 * 0.95}, None),
    ({"rwa4_tilt_u_rad": 0.0275, "rwa4_tilt_v_rad": -0.0375}, None),
    ({"inertia_xx_kg_m2": 6558 * 1.1, "inertia_xy_kg_m2": 0.0}, None),
    ({"tau_fall_s": 0.12}, None),
    (dict.fromkeys([f"external_torque_{axis}_n_m" for axis in "xyz"], 0.004), None),
    ({}, {"name": "thruster_leak:z3", "parameters": {"leak_n": 0.006}}),
    ({}, {"name": "thruster_degraded:z3", "parameters": {"thrust_factor": 0.6}}),
    ({}, {"name": "time_offset", "parameters": {"time_offset_s": 3.0}}),
    ({}, {"name": "rate_bias:x", "parameters": {"rate_bias_x_rad_s": 1e-5}}),
]


@pytest.mark.parametrize(("truth", "effect"), FAULTS)
def test_an_honest_fault_is_never_refused(
    tmp_path: Path, truth: dict[str, float], effect: dict[str, Any] | None
) -> None:
    """Faults of the spacecraft as large as the diagnosis must find pass, with room to spare."""
    for event, chunk in simulated(tmp_path, truth, effect):
        assert check_momentum(event, [chunk], CASSINI, NOMINAL).misfit < 8.0


def test_a_balance_that_nothing_closes_is_refused(honest: dict[str, Event]) -> None:
    """Wheel rates of another event: the message says how much stays open."""
    event, chunk = honest["bias"]
    swing = 1500.0 * np.sin(np.linspace(0.0, 20.0, chunk.rows))
    wrong = replace(chunk, wheel_rpm=swing[:, None] * np.array([1.0, 0.3, -0.9]))
    with pytest.raises(InputError, match=r"% of the exchanged momentum unexplained"):
        check_momentum(event, [wrong], CASSINI, NOMINAL)


def test_chunks_are_thinned_alike(
    honest: dict[str, Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows kept do not depend on the chunks, stay few, and give the same verdict."""
    event, chunk = honest["bias"]
    monkeypatch.setattr("cassini_bayes.events.plausibility.rows.MOST_ROWS", 200)
    collected = momentum_rows(NOMINAL)
    for part in read_chunks(event, CASSINI, 37):
        collected.add(part)
    by_parts = check_momentum(event, collected, CASSINI, NOMINAL)
    whole = check_momentum(event, [chunk], CASSINI, NOMINAL)
    assert by_parts == whole
    assert 100 <= whole.rows <= 200


def test_too_few_rows_are_not_judged(honest: dict[str, Event]) -> None:
    """Without common rows nothing is checked, and the record says so."""
    event, chunk = honest["slew"]
    blind = replace(chunk, rate_rad_s=np.full_like(chunk.rate_rad_s, np.nan))
    balance = check_momentum(event, [blind], CASSINI, NOMINAL)
    assert balance.rows == 0
    assert np.isnan(balance.misfit)
