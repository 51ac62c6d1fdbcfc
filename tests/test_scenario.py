"""From a scenario file to event folders: repeatable, complete, and strict at the door."""

from __future__ import annotations

import json
import tomllib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cassini_bayes.errors import InputError
from cassini_bayes.events import read_totals
from cassini_bayes.priors import read_priors
from cassini_bayes.scenario import draw_truth, simulate_file, simulate_scenario
from cassini_bayes.simulation import read_scenario, scenario_of
from cassini_bayes.spacecraft import load_spacecraft

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "runs" / "scenarios"
TEXT = """\
step_s = 0.005

[spacecraft]
name = "cassini"
branch = "B"
wheels = [1, 2, 4]

[truth]
draw_from = "PRIORS"
mass_kg = 2380.0
tau_fall_s = 0.05

[telemetry]
rate_noise_rad_s = 1e-6
wheel_noise_rpm = 0.2
delta_v = "measured"

[[event]]
id = "one"
kind = "bias"
epoch = 2010-05-01T00:00:00Z
from_rpm = [-300.0, 200.0, 100.0]
to_rpm = [100.0, -100.0, 50.0]

[[event]]
id = "two"
kind = "slew"
epoch = 2010-05-02T00:00:00Z
from_rpm = [100.0, -100.0, 50.0]
settle_s = 50.0

[[event.slew]]
start_s = 10.0
axis = [1.0, 0.0, 0.0]
angle_rad = 0.05
rate_rad_s = 1e-3
acceleration_rad_s2 = 1e-5
"""
EFFECT = """
[[effect]]
name = "thruster_leak:z3"
parameters = { leak_n = 0.004 }
"""


def written(folder: Path, text: str = TEXT) -> Path:
    """A scenario file in a folder, with the real priors file behind it."""
    path = folder / "scenario.toml"
    priors = ROOT / "priors" / "cassini_b_branch_2010.toml"
    path.write_text(text.replace("PRIORS", priors.as_posix()), encoding="utf-8")
    return path


def files(folder: Path) -> dict[str, bytes]:
    """Content of every file below a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    """Twice the same scenario and seed; another seed differs."""
    path = written(tmp_path)
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        simulate_scenario(path, tmp_path / name, seed)
    first, second, third = (files(tmp_path / name) for name in "abc")
    assert first == second
    assert set(first) == {
        "one/event.toml",
        "one/telemetry.csv",
        "two/event.toml",
        "two/telemetry.csv",
        "totals.csv",
        "truth.json",
    }
    assert first["one/telemetry.csv"] != third["one/telemetry.csv"]


def columns_of(document: dict[str, Any], folder: str, seed: int) -> dict[str, Array]:
    """Telemetry of the first event, simulated in memory; can run in a worker process."""
    file = scenario_of(document, folder)
    return dict(simulate_file(file, seed).events[0].telemetry.columns)


def test_a_scenario_in_memory_is_the_one_of_the_file(tmp_path: Path) -> None:
    """A mapping gives the file's arrays, here and in another process, and leaves no file behind."""
    path = written(tmp_path)
    document = tomllib.loads(path.read_text("utf-8"))
    expected = dict(simulate_file(read_scenario(path), 5).events[0].telemetry.columns)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as workers:
        away = workers.submit(columns_of, document, str(tmp_path), 5).result()
    for found in (columns_of(document, str(tmp_path), 5), away):
        assert set(found) == set(expected)
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values)
    assert [entry.name for entry in tmp_path.iterdir()] == ["scenario.toml"]


def test_a_truth_at_hand_is_used_and_checked(tmp_path: Path) -> None:
    """Given parameters are those simulated; a missing one, or a thrust below 0, is refused."""
    file = read_scenario(written(tmp_path))
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_2010.toml")
    truth = draw_truth(file, 1, priors)
    assert truth == draw_truth(file, 1)
    moved = replace(truth, parameters={**truth.parameters, "cm_x_m": 0.2})
    simulation = simulate_file(file, 1, truth=moved)
    assert simulation.truth()["parameters"]["cm_x_m"] == 0.2
    without = {name: value for name, value in moved.parameters.items() if name != "cm_x_m"}
    with pytest.raises(InputError, match="cm_x_m"):
        simulate_file(file, 1, truth=replace(truth, parameters=without))
    weak = replace(truth, individual_n=dict.fromkeys(truth.individual_n, -1.0))
    with pytest.raises(InputError, match="above 0"):
        simulate_file(file, 1, truth=weak)


def test_priors_of_another_branch_are_refused(tmp_path: Path) -> None:
    """Negative control of the ``priors`` argument."""
    other = read_priors(ROOT / "priors" / "cassini_a_branch_2005.toml")
    with pytest.raises(InputError, match="another branch"):
        draw_truth(read_scenario(written(tmp_path)), 1, other)


def test_the_truth_is_told_beside_the_events_and_not_in_them(tmp_path: Path) -> None:
    """truth.json has format, seed, parameters and effects; no event folder names the effect."""
    simulation = simulate_scenario(written(tmp_path, TEXT + EFFECT), tmp_path / "out", 7)
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    assert truth["format"] == 1
    assert truth["seed"] == 7
    assert truth["effects"] == [{"name": "thruster_leak:z3", "parameters": {"leak_n": 0.004}}]
    assert truth["parameters"]["tau_fall_s"] == 0.05
    plan = simulation.events[0].plan
    assert truth["events"]["one"]["thrust_n"] == dict(plan.thrust_n)
    assert truth["parameters"]["cm_x_m"] == plan.parameters["cm_x_m"]
    for name, content in files(tmp_path / "out").items():
        if name != "truth.json":
            assert b"leak" not in content


def test_an_effect_does_not_change_what_is_drawn(tmp_path: Path) -> None:
    """Truth, start and rate noise are the same with and without an effect."""
    plain = simulate_file(read_scenario(written(tmp_path)), 3)
    leaky = simulate_file(read_scenario(written(tmp_path, TEXT + EFFECT)), 3)
    for a, b in zip(plain.events, leaky.events, strict=True):
        assert a.plan.parameters == b.plan.parameters
        assert a.plan.thrust_n == b.plan.thrust_n
        np.testing.assert_array_equal(a.motion.attitude[0], b.motion.attitude[0])
        noise = [e.telemetry.columns["rate_x_rad_s"] - e.motion.rate_rad_s[:, 0] for e in (a, b)]
        np.testing.assert_allclose(noise[0], noise[1], atol=1e-15)
        assert np.std(noise[0]) > 5e-7


def test_a_given_value_is_not_drawn_and_changes_no_other(tmp_path: Path) -> None:
    """Every parameter has its own stream; departures of thrust differ by thruster and event."""
    drawn = draw_truth(read_scenario(written(tmp_path)), 11)
    given = draw_truth(
        read_scenario(written(tmp_path, TEXT.replace("mass_kg", "cm_x_m = 0.2\nmass_kg"))), 11
    )
    assert given.parameters["cm_x_m"] == 0.2
    different = {
        name for name, value in drawn.parameters.items() if given.parameters[name] != value
    }
    assert different == {"cm_x_m"}
    assert len(set(drawn.individual_n.values())) == 8
    assert drawn.events["one"]["thrust_event_n"] != drawn.events["two"]["thrust_event_n"]
    assert drawn.jitter_n["one"]["z1"] != drawn.jitter_n["two"]["z1"]


def test_totals_can_be_read_back(tmp_path: Path) -> None:
    """totals.csv is a totals file of source ``simulation``, with the counters of telemetry."""
    simulation = simulate_scenario(written(tmp_path), tmp_path / "out", 1)
    (event,) = read_totals(
        tmp_path / "out" / "totals.csv", load_spacecraft("cassini"), source="simulation"
    )
    log = simulation.events[0].motion.pulses["z1"]
    assert event.id == "one"
    assert event.pulses is not None
    assert event.pulses[0] == log.width_s.size
    assert event.on_time_s[0] == pytest.approx(float(log.width_s.sum()), abs=0.006)


def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    """A folder with files in it is refused; --force replaces."""
    path = written(tmp_path)
    simulate_scenario(path, tmp_path / "out", 1)
    with pytest.raises(InputError, match="--force"):
        simulate_scenario(path, tmp_path / "out", 2)
    simulate_scenario(path, tmp_path / "out", 2, force=True)
    assert json.loads((tmp_path / "out" / "truth.json").read_text())["seed"] == 2


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_the_shipped_scenarios_can_be_read(path: Path) -> None:
    """Every scenario of the repository passes the door and has a complete truth."""
    draw_truth(read_scenario(path), 1)


BAD = (
    ("[truth]", "[truht]", "truth"),
    ('kind = "bias"', 'kind = "bais"', "bias"),
    ('id = "two"', 'id = "one"', "rename"),
    ("to_rpm = [100.0, -100.0, 50.0]", "to_rpm = [100.0, -100.0]", "3 rates"),
    ("to_rpm = [100.0, -100.0, 50.0]\n", "", "add to_rpm"),
    ("tau_fall_s = 0.05", "tau_fal_s = 0.05", "tau_fall_s"),
    ("tau_fall_s = 0.05", "tau_fall_s = nan", "finite"),
    ("tau_fall_s = 0.05", "tau_fall_s = -0.05", "0 or more"),
    ("tau_fall_s = 0.05", 'tau_fall_s = "50 ms"', "number"),
    ("mass_kg = 2380.0\n", "", "add mass_kg"),
    ("wheel_noise_rpm = 0.2", "wheel_noise_rmp = 0.2", "wheel_noise_rpm"),
    ("wheel_noise_rpm = 0.2", "wheel_noise_rpm = -0.2", "greater than or equal"),
    ('branch = "B"', 'branch = "C"', "branch"),
    ('branch = "B"', 'branch = "A"', "another branch"),
    ("wheels = [1, 2, 4]", "wheels = [1, 2, 2]", "different wheels"),
    ('name = "cassini"', 'name = "casini"', "cassini"),
    ('name = "cassini"\n', "", "neither"),
    ("axis = [1.0, 0.0, 0.0]", "axis = [0.0, 0.0, 0.0]", "give an axis"),
    ("angle_rad = 0.05", "angle_deg = 0.05", "angle_rad"),
    ("step_s = 0.005", "step_s = 0.007", "divides"),
    ("2010-05-01T00:00:00Z", "2010-05-01T00:00:00", "UTC"),
    ('draw_from = "PRIORS"', 'draw_from = "nowhere.toml"', "no such file"),
    ("step_s = 0.005", "step_s = = 3", "TOML"),
)


@pytest.mark.parametrize(("old", "new", "hint"), BAD)
def test_a_bad_scenario_is_one_line_that_says_what_to_mend(
    tmp_path: Path, old: str, new: str, hint: str
) -> None:
    """File, dotted key, expected, found, fix; nothing is written."""
    assert old in TEXT
    path = written(tmp_path, TEXT.replace(old, new, 1))
    with pytest.raises(InputError, match=hint) as caught:
        simulate_scenario(path, tmp_path / "out", 1)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2
    assert not (tmp_path / "out").exists()


def test_a_missing_file_names_its_neighbours(tmp_path: Path) -> None:
    """A misspelt path gets the nearest file."""
    written(tmp_path)
    with pytest.raises(InputError, match=r"scenario\.toml"):
        read_scenario(tmp_path / "scenaro.toml")


def test_an_unknown_event_of_an_effect_is_refused(tmp_path: Path) -> None:
    """Effects may be confined to events that exist."""
    text = TEXT + EFFECT + 'events = ["onw"]\n'
    with pytest.raises(InputError, match="one"):
        read_scenario(written(tmp_path, text))


def test_a_negative_seed_is_refused(tmp_path: Path) -> None:
    """Seeds are whole numbers from 0."""
    with pytest.raises(InputError, match="from 0"):
        simulate_scenario(written(tmp_path), tmp_path / "out", -1)
