"""Simulated biases beside the printed columns of paper 001, and what the comparison reports."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.published import published_constants, wheel_bias_tables
from cassini_bayes.simulation import read_scenario
from cassini_bayes.studies.bias_comparison import (
    ROWS,
    Comparison,
    mean_absolute_differences,
    printed_rows,
    signature,
    simulate_biases,
)

FILE = read_scenario(Path(__file__).parents[2] / "runs" / "scenarios" / "biases_2009_2010.toml")
TABLES = wheel_bias_tables()


@pytest.fixture(scope="module")
def simulated() -> Comparison:
    """All eight events, three seeds, at a coarser step (thrust is exact at any)."""
    scenario = FILE.scenario.model_copy(update={"step_s": 0.0125})
    scenario = scenario.model_copy(
        update={"telemetry": scenario.telemetry.model_copy(update={"delta_v": "none"})}
    )
    return simulate_biases(replace(FILE, scenario=scenario), TABLES, (1, 2, 3))


def test_the_calibrated_column_has_the_skill_that_paper_001_prints(simulated: Comparison) -> None:
    """0.59 s, 0.79 mm/s, 1.05 g: the averaging is the paper's own."""
    skill = mean_absolute_differences(simulated, "calibrated")
    printed = published_constants()
    for kind, key in (
        ("on_time", "on_time_s"),
        ("delta_v_z", "delta_v_z_mm_s"),
        ("hydrazine", "hydrazine_g"),
    ):
        assert skill[kind] == pytest.approx(printed.value("paper_001_skill", key), abs=0.01)


def test_flight_differs_from_itself_by_nothing(simulated: Comparison) -> None:
    """The zero of the scale."""
    assert set(mean_absolute_differences(simulated, "flight").values()) == {0.0}


def test_the_simulation_is_closer_to_flight_than_the_published_one(simulated: Comparison) -> None:
    """On-times, pulses and ΔV are nearer to flight than FSDS; hydrazine needs its own I_sp."""
    own = mean_absolute_differences(simulated, "simulation")
    fsds = mean_absolute_differences(simulated, "fsds")
    for kind in ("on_time", "pulses", "delta_v_z"):
        assert own[kind] < fsds[kind]
    assert own["on_time"] < 0.45


def test_every_thruster_leads_where_it_leads_in_flight(simulated: Comparison) -> None:
    """In each event the unit with the longest on-time is flight's."""
    for table in TABLES:
        flight = printed_rows(table, "flight")[:6]
        assert np.argmax(simulated.mean(table.event)[:6]) == np.argmax(flight)
        assert np.all(simulated.spread(table.event) >= 0.0)


def test_a_signature_counts_what_it_says(simulated: Comparison) -> None:
    """Flight: mean width, rare pulses and unpaired firings added up by hand from the tables."""
    found = signature(simulated, "flight")
    rows = np.array([printed_rows(table, "flight") for table in TABLES])
    on_time, pulses = rows[:, :6], rows[:, 6:12]
    many = pulses >= 25
    assert found.mean_width_ms == pytest.approx(1e3 * on_time[many].sum() / pulses[many].sum())
    assert found.minor_pulses == pulses[pulses < 10].sum() == 85.0
    unpaired = on_time[:, 2] + on_time[:, 4] - on_time[:, 3] - on_time[:, 5]
    assert found.shared_s == pytest.approx(np.abs(unpaired).sum())
    assert len(ROWS) == rows.shape[1]


def test_unpaired_on_time_is_always_that_of_the_common_thruster() -> None:
    """Paper 001's tables: where Z1+Z3 ≠ Z2+Z4 the surplus is of the thruster that the two dominant
    demands share, in flight and FSDS alike: both demands at once fire it alone.
    """
    seen = 0
    for table in TABLES:
        for column in ("flight", "fsds"):
            z = printed_rows(table, column)[2:6]
            surplus = z[0] + z[2] - z[1] - z[3]
            if abs(surplus) < 0.5:
                continue
            seen += 1
            common = int(np.argmax(z))
            assert (surplus > 0) == (common in (0, 2))
    assert seen == 6
