"""The page of results is made whole by its command, in small."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from study_cases import study_in

from cassini_bayes.report.plots.simulation import motion_figure
from cassini_bayes.report.study_page import markdown_table
from cassini_bayes.simulation import read_scenario
from cassini_bayes.simulation.settings import PropulsionSettings
from cassini_bayes.studies.simulation import biases, mechanics, page, simulation_results
from cassini_bayes.studies.simulation.cases import simulated
from cassini_bayes.studies.simulation.fsds import fsds_section, naive_thrust_n
from cassini_bayes.studies.simulation.mechanics import (
    SHAPES,
    impulse_error,
    in_memory_s,
    integrator_orders,
)
from cassini_bayes.studies.simulation.propellant import (
    PrintedHydrazine,
    fit_specific_impulse,
    hydrazine_g,
    propellant_section,
)

ROOT = Path(__file__).parents[2]


@cache
def fsds() -> tuple[str, list[list[str]]]:
    """The section on the FSDS case, eight flights of it, made once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        return fsds_section()


def mean(cell: str) -> float:
    """The mean of a cell that reads mean ± standard deviation."""
    return float(cell.split(" ± ")[0])


def test_the_fsds_case_gives_the_naive_thrust_of_paper_000() -> None:
    """0.98 N for a truth of 0.75 N, and the truth once divided by effective over commanded time."""
    _, rows = fsds()
    header, paper, first = rows[0], rows[1], rows[2]
    naive, corrected = header.index("naive thrust [N]"), header.index("corrected [N]")
    assert paper[naive] == "0.98"
    assert mean(first[naive]) == pytest.approx(0.98, abs=0.02)
    assert mean(first[corrected]) == pytest.approx(0.75, abs=0.005)
    assert mean(first[1]) == pytest.approx(float(paper[1]), rel=0.03)


def test_only_the_y2_y4_pair_works_in_the_fsds_case() -> None:
    """Y1 and Y3 never fire; Z thrusters only in their limit cycle, each less than 12 % of Y2."""
    (event,) = simulated(read_scenario(ROOT / "runs" / "scenarios" / "fsds_2005.toml"), 1)
    on_time = {name: float(log.width_s.sum()) for name, log in event.motion.pulses.items()}
    assert on_time["y2"] == on_time["y4"] > 20.0
    assert on_time["y1"] == on_time["y3"] == 0.0
    assert max(on_time[f"z{i}"] for i in range(1, 5)) < 0.12 * on_time["y2"]
    assert naive_thrust_n(event.motion, ("y1", "y3", "y2", "y4"), 1.234) > 0.9


def test_the_y_bias_hardly_uses_the_z_thrusters() -> None:
    """Equal changes of all wheels: momentum along Z, as paper 003 proposes."""
    (event,) = simulated(read_scenario(ROOT / "runs" / "scenarios" / "y_bias_2012.toml"), 1)
    on_time = {name: float(log.width_s.sum()) for name, log in event.motion.pulses.items()}
    assert max(on_time[f"z{i}"] for i in range(1, 5)) < 0.2 * on_time["y2"]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("width_s", [0.007, 0.125, 0.75])
def test_the_impulse_error_is_far_below_what_is_asked(
    width_s: float, shape: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1e-6 is asked for; the integral over a step is exact."""
    monkeypatch.chdir(ROOT)
    assert impulse_error(width_s, shape) < 1e-12


def test_the_order_on_the_page_is_the_fourth() -> None:
    """Two halvings, each about sixteen-fold."""
    orders = integrator_orders(read_scenario(ROOT / "runs" / "scenarios" / "biases_2009_2010.toml"))
    assert len(orders) == 2
    assert all(3.7 < order < 4.4 for order in orders)


def test_an_event_in_memory_takes_less_than_a_second() -> None:
    """A wheel bias of some 20 minutes, to its telemetry."""
    file = read_scenario(ROOT / "runs" / "scenarios" / "biases_2009_2010.toml")
    assert in_memory_s(file, 0) < 1.0


def test_the_specific_impulse_is_found_again_from_its_own_hydrazine() -> None:
    """Made-up masses of known coefficients give the coefficients back; a constant does not fit."""
    true = np.array([180.0, 25.0, 60.0])
    rng = np.random.default_rng(1)
    made = []
    for _ in range(16):
        bare = PrintedHydrazine(rng.uniform(0.0, 25.0, 6), 0.75, rng.uniform(200.0, 1400.0), 0.0)
        made.append(
            PrintedHydrazine(bare.on_time_s, 0.75, bare.duration_s, hydrazine_g(bare, true))
        )
    found = fit_specific_impulse(made, (170.0, 10.0, 100.0))
    assert found.coefficients == pytest.approx(true, rel=1e-4)
    assert fit_specific_impulse(made, (170.0,)).rms_g > 100.0 * found.rms_g


def test_the_hydrazine_of_one_column_by_hand() -> None:
    """Two thrusters of a pair for 10 s and one for 4 s at 1 N and 200 s: 24/(9.80665 · 200) kg."""
    printed = PrintedHydrazine(np.array([10.0, 0.0, 4.0, 0.0, 0.0, 0.0]), 1.0, 1000.0, 0.0)
    assert hydrazine_g(printed, np.array([200.0])) == pytest.approx(24e3 / (9.80665 * 200.0))


def test_the_ground_software_uses_a_duty_cycle_and_the_default_is_its_curve() -> None:
    """With the duty cycle its hydrazine is met to the rounding of print, without it not."""
    _, rows = propellant_section()
    header, ground = rows[0], rows[1]
    constant, full = (float(ground[i]) for i, name in enumerate(header) if name == "rms [g]")
    assert full < 0.06 < 0.1 < constant
    fitted = [float(ground[header.index(name)]) for name in ("P0 [s]", "P1 [s]", "P2")]
    assert PropulsionSettings().isp_s[:3] == pytest.approx(fitted, abs=0.051)


@pytest.mark.slow
def test_the_page_is_written_with_its_tables_and_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One seed, one setting: page, CSV files and PNG files, each referred to by the page.

    What is timed is flown once: the best of several is of use to the page alone.
    """
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(mechanics, "SPEED_RUNS", 1)
    monkeypatch.setattr(mechanics, "MEMORY_RUNS", 1)
    monkeypatch.setattr(biases, "SCAN", {"as in the scenario": {}})
    monkeypatch.setattr(biases, "TAIL_OFFS_S", ())
    monkeypatch.setattr(page, "fsds_section", fsds)
    study = study_in(tmp_path, tmp_path / "simulation.md", seed=1)
    simulation_results(study, {"eight wheel biases": 1, "scan of settings": 1})
    text = (tmp_path / "simulation.md").read_text("utf-8")
    for name in ("simulation_biases.png", "simulation_event.png"):
        assert name in text
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    with (tmp_path / "simulation_biases.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 8 * 14
    assert all(np.isfinite(float(row["simulated_mean"])) for row in rows)


def test_a_picture_of_a_slew_has_no_firings() -> None:
    """Every kind of event can be drawn."""
    events = simulated(read_scenario(ROOT / "runs" / "scenarios" / "slews_2000.toml"), 1)
    for event in events:
        figure = motion_figure(event)
        assert len(figure.axes) == 5
        marks = [c for c in figure.axes[4].collections if isinstance(c, LineCollection)]
        assert marks
        assert not any(c.get_segments() for c in marks)


def test_a_markdown_table_is_one() -> None:
    """Header, rule, rows."""
    assert markdown_table(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"
