"""The reference is true: examples are read, tables name the keys and columns that code has."""

from __future__ import annotations

import ast
import inspect
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

from cassini_bayes.cli import calibrations
from cassini_bayes.diagnosis import diagnosis
from cassini_bayes.effects import registry
from cassini_bayes.events.plausibility import MISTAKES
from cassini_bayes.events.telemetry import channel_map, read_event
from cassini_bayes.events.telemetry.columns import KINDS, NEEDED, channel_columns
from cassini_bayes.events.telemetry.event import _KEYS as EVENT_KEYS
from cassini_bayes.events.telemetry.reader import load_event
from cassini_bayes.events.totals import read_totals, totals_columns
from cassini_bayes.model.mission import mission_file as mission
from cassini_bayes.pipeline import diagnoses, run_file
from cassini_bayes.pipeline.listings import causes
from cassini_bayes.pipeline.run import WRITTEN
from cassini_bayes.pipeline.starting import write_starting_files
from cassini_bayes.priors.reader import known_parameters, read_priors
from cassini_bayes.results.record import GROUPS
from cassini_bayes.simulation import settings as scenario
from cassini_bayes.simulation.reader import read_scenario
from cassini_bayes.spacecraft import check_axis_pairs, load_spacecraft
from cassini_bayes.spacecraft import reader as spacecraft_file
from cassini_bayes.spacecraft.attitude import direction_cosines
from cassini_bayes.spacecraft.parameters import generic_parameters

ROOT = Path(__file__).parents[1]
REFERENCE = ROOT / "docs" / "reference"
EXAMPLES = ROOT / "docs" / "examples"
CASSINI = load_spacecraft("cassini")


def first_cells(page: str, heading: str) -> list[str]:
    """First cells of the first table under a heading of a reference page."""
    text = (REFERENCE / page).read_text("utf-8")
    section = re.search(
        rf"^#+ {re.escape(heading)}\n(.*?)(?=^#|\Z)", text, re.DOTALL | re.MULTILINE
    )
    assert section is not None, f"{page} has no heading {heading!r}"
    rows = re.search(r"(?:^\|.*\n)+", section[1], re.MULTILINE)
    assert rows is not None
    return [line.split("|")[1].strip() for line in rows[0].splitlines()[2:]]


def names(page: str, heading: str) -> list[str]:
    """Names in backticks of those cells."""
    return [name for cell in first_cells(page, heading) for name in re.findall(r"`([^`]+)`", cell)]


def expanded(cells: list[str], known: list[str]) -> set[str]:
    """Column names of a table's cells, with ``a`` … ``z`` as all known ones from a to z."""
    found: set[str] = set()
    for cell in cells:
        own = re.findall(r"`([^`]+)`", cell)
        if "…" in cell:
            first, last = (known.index(name) for name in own)
            own = known[first : last + 1]
        found.update(own)
    return found


@pytest.mark.parametrize(
    ("page", "heading", "model"),
    [
        ("run-file.md", "Keys of the file", run_file.RunFile),
        ("run-file.md", "Keys of `[model]`", run_file.ModelTable),
        ("run-file.md", "Keys of `[sampler]`", run_file.SamplerTable),
        ("run-file.md", "Keys of `[output]`", run_file.OutputTable),
        ("mission-format.md", "Keys of the file", mission.MissionTable),
        ("mission-format.md", "Keys of `[[dated]]`", mission.DatedTable),
        ("mission-format.md", "Keys of a change", mission.ChangeTable),
        ("mission-format.md", "Keys of `[pressure]`", mission.PressureTable),
        ("mission-format.md", "Keys of `[pressure.blowdown]`", mission.BlowdownTable),
        ("mission-format.md", "Keys of `[propellant]`", mission.PropellantTable),
        ("mission-format.md", "Keys of `[trend]`", mission.TrendTable),
        ("mission-format.md", "Keys of `[[trend.forecast]]`", mission.ForecastTable),
        ("scenario-format.md", "Keys of the file", scenario.Scenario),
        ("scenario-format.md", "Keys of `[spacecraft]`", scenario.SpacecraftSettings),
        ("scenario-format.md", "Keys of `[[event]]`", scenario.EventSettings),
        ("scenario-format.md", "Keys of `[[event.slew]]`", scenario.Slew),
        ("scenario-format.md", "Keys of `hybrid`", scenario.HybridSettings),
        ("scenario-format.md", "Keys of `[rcs]`", scenario.RcsSettings),
        ("scenario-format.md", "Keys of `[rwa]`", scenario.RwaSettings),
        ("scenario-format.md", "Keys of `[wheels]`", scenario.WheelSettings),
        ("scenario-format.md", "Keys of `[propulsion]`", scenario.PropulsionSettings),
        ("scenario-format.md", "Keys of `[[appendage]]`", scenario.Appendage),
        ("scenario-format.md", "Keys of `[start]`", scenario.StartSettings),
        ("scenario-format.md", "Keys of `[telemetry]`", scenario.TelemetrySettings),
        ("scenario-format.md", "Keys of `[[effect]]`", scenario.EffectRequest),
        ("spacecraft-format.md", "Keys of the file", spacecraft_file._File),
        ("spacecraft-format.md", "Keys of `[parameters.NAME]`", spacecraft_file._ParameterTable),
        ("spacecraft-format.md", "Keys of `[[wheel]]`", spacecraft_file._WheelTable),
        ("spacecraft-format.md", "Keys of `articulation`", spacecraft_file._ArticulationTable),
        ("spacecraft-format.md", "Keys of `[[thruster]]`", spacecraft_file._ThrusterTable),
    ],
)
def test_a_table_names_the_keys_that_are_read(
    page: str, heading: str, model: type[BaseModel]
) -> None:
    """Every key of a file has its row, and no row is of a key that is not read."""
    assert sorted(names(page, heading)) == sorted(model.model_fields)


def test_the_numbers_of_defaults_are_those_of_the_code() -> None:
    """Defaults of the sampler and of the thruster controller, as far as they are numbers."""
    for page, heading, model in (
        ("run-file.md", "Keys of `[sampler]`", run_file.SamplerTable),
        ("scenario-format.md", "Keys of `[rcs]`", scenario.RcsSettings),
        ("scenario-format.md", "Keys of `[telemetry]`", scenario.TelemetrySettings),
        ("mission-format.md", "Keys of `[trend]`", mission.TrendTable),
    ):
        text = (REFERENCE / page).read_text("utf-8").partition(f"## {heading}\n")[2]
        for name, default in re.findall(
            r"^\| `(\w+)` \| ([\d.e-]+) \|", text.partition("\n## ")[0], re.M
        ):
            assert float(default) == model.model_fields[name].default, name


def test_the_tables_of_an_event_are_those_of_the_reader() -> None:
    """Keys of event.toml; columns of every channel, their order left open; channels of a kind."""
    page = "telemetry-format.md"
    assert sorted(names(page, "Keys of `event.toml`")) == sorted(EVENT_KEYS)
    wheels = [wheel.number for wheel in CASSINI.wheels]
    thrusters = list(dict.fromkeys(thruster.name for thruster in CASSINI.thrusters))
    channels = channel_columns(CASSINI, wheels, thrusters)
    known = [name for columns in channels.values() for name in columns]
    assert expanded(first_cells(page, "Columns of the telemetry"), known) == set(known)
    text = (REFERENCE / page).read_text("utf-8")
    for kind in KINDS:
        row = re.search(rf"^\| `{kind}` \| ([^|]+)\|", text, re.MULTILINE)
        assert row is not None
        assert {"time", *NEEDED[kind]} <= set(re.findall(r"\w+", row[1]))


def test_the_tables_of_a_channel_map_are_those_of_its_reader() -> None:
    """Keys of a channel and of the whole map, in the how-to that has them."""
    page = "../how-to/own-columns.md"
    assert set(names(page, "Keys")) >= set(channel_map.ChannelTable.model_fields)
    of_map = set(channel_map._File.model_fields) - {"channels"}
    assert set(names(page, "Keys of the whole map")) >= of_map
    text = (REFERENCE / page).read_text("utf-8")
    assert all(f"| `{channel}` |" in text for channel in channel_map.UNITS)


def test_the_table_of_totals_is_that_of_the_reader() -> None:
    """Every column of a totals CSV has its row."""
    known = list(totals_columns(CASSINI))
    assert expanded(first_cells("telemetry-format.md", "The totals CSV"), known) == set(known)


def test_the_parameters_of_the_priors_format_are_those_of_the_reader() -> None:
    """Names, units and blocks of all parameters, generic ones and Cassini's."""
    page = "priors-format.md"
    generic = names(page, "Parameters of every spacecraft")
    own = names(page, "Parameters of Cassini's file")
    assert generic == [spec.name for spec in generic_parameters()]
    assert [*generic, *own] == list(known_parameters(CASSINI))
    text = (REFERENCE / page).read_text("utf-8")
    for spec in known_parameters(CASSINI).values():
        unit = "–" if spec.unit == "1" else spec.unit
        assert f"| `{spec.name}` | {unit} | {spec.block} | {spec.meaning} |" in text


def test_the_tables_of_results_name_what_is_written() -> None:
    """Groups of fit.nc and the files of a run folder."""
    page = "results-format.md"
    assert sorted(names(page, "Groups")) == sorted(GROUPS)
    assert {name.rstrip("/") for name in names(page, "A run folder")} >= set(WRITTEN)
    diagnosed = first_cells(page, "The folder of a diagnosis")
    named = {name.rstrip("/") for cell in diagnosed for name in re.findall(r"`([^`]+)`", cell)}
    assert named == set(diagnoses.WRITTEN)


def test_every_study_has_its_row() -> None:
    """What `calibrate` runs, by the names of its commands."""
    studies = [command.name for command in calibrations.app.registered_commands]
    assert sorted(names("commands.md", "calibrate")) == sorted(map(str, studies))


def test_the_table_of_a_diagnosis_names_what_is_recorded() -> None:
    """Keys of diagnosis.json, from the one place that makes it."""
    tree = ast.parse(inspect.getsource(diagnosis._record))
    (made,) = (node.value for node in ast.walk(tree) if isinstance(node, ast.Return))
    assert isinstance(made, ast.Dict)
    keys = [key.value for key in made.keys if isinstance(key, ast.Constant)]
    assert sorted(names("results-format.md", "Keys of the record")) == sorted(keys)


def test_every_cause_has_its_row() -> None:
    """The kinds of effects, by the names that diagnoses and fits give them."""
    text = (REFERENCE / "causes.md").read_text("utf-8")
    cells = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    listed = {name for cell in cells for name in re.findall(r"`([a-z_]+)(?::<[^`]+>)?`", cell)}
    assert listed == {kind.name for kind in registry.KINDS}


def test_the_row_of_a_recording_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the how-to runs for counters too coarse: on-times are what the counters gained."""
    shutil.copytree(EXAMPLES / "2010-01-01-bias", tmp_path / "events" / "may")
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "how-to" / "fitting-telemetry.md").read_text("utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    exec(block, {})  # noqa: S102
    (row,) = read_totals(tmp_path / "totals.csv", CASSINI)
    assert row.on_time_s.sum() == pytest.approx(1.336 + 1.798 + 1.798)


def test_every_mistake_has_its_row() -> None:
    """The how-to names the mistakes that the checks can name."""
    text = (ROOT / "docs" / "how-to" / "mistakes-in-telemetry.md").read_text("utf-8")
    listed = {name for line in text.splitlines() if line.startswith("| `") for name in
              re.findall(r"`([a-z-]+)`", line.split("|")[1])}  # fmt: skip
    assert listed == set(MISTAKES)


def test_the_example_of_telemetry_is_read() -> None:
    """Five rows: rates in all, attitude and counters in every second one."""
    event = read_event(EXAMPLES / "2010-01-01-bias", CASSINI)
    chunk = load_event(event, CASSINI)
    assert (event.id, event.kind, event.wheels) == ("2010-01-01-bias", "bias", (1, 2, 4))
    assert chunk.rows == 5
    assert np.isfinite(chunk.rate_rad_s).all()
    assert np.isnan(chunk.attitude[:, 0]).tolist() == [False, True, False, True, False]
    assert chunk.on_time_s[-1].sum() == pytest.approx(1.336 + 1.798 + 1.798)


def test_the_examples_of_other_files_are_read() -> None:
    """Totals, priors, run file, scenario, mission and spacecraft, each by its own reader."""
    rows = read_totals(EXAMPLES / "totals.csv", CASSINI)
    assert len(rows) == 5
    priors = read_priors(EXAMPLES / "priors.toml")
    assert len(priors.parameters) == 4
    assert priors.parameters["tau_delay_s"].fixed == 0.005
    assert len(run_file.read_run_file(EXAMPLES / "run.toml").events) == 2
    assert len(read_scenario(EXAMPLES / "scenario.toml").effects) == 1
    assert mission.read_mission_file(EXAMPLES / "mission.toml").trend.alarm == 0.95


def test_the_axis_pairs_of_the_example_spacecraft_turn_the_right_way() -> None:
    """The values of the how-to."""
    observer = load_spacecraft(EXAMPLES / "observer.toml")
    values = {"arm_m": 0.5, "girth_m": 0.4, "cm_x_m": 0.0, "cm_y_m": 0.0, "cm_z_m": 0.1}
    check_axis_pairs(observer, "main", values)


def test_the_example_spacecraft_has_the_causes_of_its_wheels(tmp_path: Path) -> None:
    """With the priors that init writes: three wheels of one inertia, none that tilts."""
    write_starting_files(tmp_path / "new", str(EXAMPLES / "observer.toml"))
    table = causes(tmp_path / "new" / "priors.toml")
    of_wheels = [name for name in table["name"] if name.startswith("wheel_")]
    assert of_wheels == [f"wheel_inertia:{number}" for number in (1, 2, 3)]


def test_the_worked_quaternion_is_right() -> None:
    """Turned by 30° about Z: matrix, star and the next sample, as the page has them."""
    half = np.deg2rad(15.0)
    q = np.array([0.0, 0.0, np.sin(half), np.cos(half)])
    assert q[2:] == pytest.approx([0.258819, 0.965926], abs=5e-7)
    matrix = direction_cosines(q[None])[0]
    assert matrix[:2, :2].ravel() == pytest.approx([0.866025, 0.5, -0.5, 0.866025], abs=5e-7)
    assert matrix @ [1.0, 0.0, 0.0] == pytest.approx([0.866025, -0.5, 0.0], abs=5e-7)
    later = np.sin(half + 0.0005)  # a turn of 0.001 rad more
    assert later == pytest.approx(0.259302, abs=5e-7)
