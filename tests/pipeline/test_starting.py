"""`init`: files that are valid at once, propose in comments alone, and replace nothing."""

from __future__ import annotations

import os
import re
import shutil
import tomllib
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from event_folder_cases import CASSINI
from typer.testing import CliRunner

from cassini_bayes.cli import app
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry import load_event, read_channel_map, read_event
from cassini_bayes.events.telemetry.matches import matches, sample_of
from cassini_bayes.model import log_posterior
from cassini_bayes.model.nominal import nominal_values
from cassini_bayes.pipeline.models import build_model
from cassini_bayes.pipeline.run_file import read_run_file
from cassini_bayes.pipeline.starting import PROPOSED, write_starting_files
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.spacecraft.parameters import CLOSE_SHARE

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "docs" / "examples" / "own_csv"
RECORDING = EXAMPLE / "may.csv"
TWELVE = ROOT / "tests" / "data" / "spacecraft" / "twelve.toml"


@pytest.mark.parametrize("spacecraft", ["cassini", str(TWELVE)])
def test_the_files_are_valid_at_once(tmp_path: Path, spacecraft: str) -> None:
    """Priors with all that telemetry needs, a run file, an empty channel map, event keys."""
    folder = tmp_path / "mine"
    files = write_starting_files(folder, spacecraft)
    priors = read_priors(folder / "priors.toml")
    assert nominal_values(priors)
    run = read_run_file(folder / "run.toml")
    assert [str(folder / event / "event.toml") for event in run.events] == [str(files[2])]
    assert read_channel_map(folder / "channels.toml").channels == {}
    event = tomllib.loads(files[2].read_text())
    assert (event["branch"], tuple(event["wheels"])) == (priors.branch, priors.wheels)
    shown = (folder / "channels.toml").read_text()
    assert all(name in shown for name in priors.spacecraft.thruster_names(priors.branch))


@pytest.mark.parametrize("spacecraft", ["cassini", str(TWELVE)])
def test_a_share_that_it_writes_stays_one_in_a_sweep(tmp_path: Path, spacecraft: str) -> None:
    """The share of close pulses is bounded in the file: made wider it allows no more than 1."""
    write_starting_files(tmp_path / "mine", spacecraft)
    wide = read_priors(tmp_path / "mine" / "priors.toml").scaled([CLOSE_SHARE], width=2.0)
    found = wide.parameters[CLOSE_SHARE].distribution
    assert found is not None
    assert found.support == (0.0, 1.0)


def test_every_declared_parameter_has_a_placeholder(tmp_path: Path) -> None:
    """Other wheels and the other branch can be chosen in the file that is there."""
    place = tmp_path / "mine" / "priors.toml"
    write_starting_files(place.parent, str(TWELVE))
    priors = read_priors(place)
    assert (priors.branch, priors.wheels) == ("R", (1, 2, 3))
    own = {spec.name: spec.unit for spec in priors.spacecraft.parameters}
    assert {name: priors.parameters[name].spec.unit for name in own} == own
    text = place.read_text().replace("wheels = [1, 2, 3]", "wheels = [2, 3, 5]")
    place.write_text(text.replace('branch = "R"', 'branch = "P"'))
    other = read_priors(place)
    other.require(other.spacecraft.wheel_parameters(other.wheels), "telemetry")
    assert nominal_values(other).keys() >= own.keys()


def test_parameters_of_other_wheels_stand_unused(tmp_path: Path) -> None:
    """A model is that of the same file without the wheel that no event has; no platform turns."""
    craft = tmp_path / "craft.toml"
    built_in = resources.files("cassini_bayes.spacecraft") / "cassini.toml"
    craft.write_bytes(built_in.read_bytes())
    write_starting_files(tmp_path / "mine", str(craft), [RECORDING])
    shutil.copy(EXAMPLE / "channels.toml", tmp_path / "mine")
    place = tmp_path / "mine" / "priors.toml"
    assert read_priors(place).wheels == (1, 2, 4)
    assert "rwa4_articulation_rad" not in read_priors(place).parameters
    name = "rwa3_inertia_kg_m2"
    whole = place.read_text()
    tables = re.split(r"(?m)^(?=\[)", whole)
    without = [table for table in tables if not table.startswith(f"[parameters.{name}]")]
    assert len(without) == len(tables) - 1
    (place.parent / "without.toml").write_text("".join(without))
    event = tmp_path / "mine" / "events" / "may"
    models = [build_model(event, path) for path in (place, place.parent / "without.toml")]
    assert models[0].space.names == models[1].space.names
    assert name not in models[0].space.names
    start = np.zeros((1, len(models[0].space.names)))
    one, other = (log_posterior(model, start) for model in models)
    assert np.isfinite(one).all()
    np.testing.assert_array_equal(one, other)


def test_matches_are_proposed_and_not_in_force(tmp_path: Path) -> None:
    """The map of the recording is empty until the user takes the marks away and corrects it."""
    folder = tmp_path / "mine"
    write_starting_files(folder, "cassini", [RECORDING])
    place = folder / "channels.toml"
    assert read_channel_map(place).channels == {}
    with pytest.raises(InputError, match=r"\[channels.time\]"):
        read_event(folder / "events" / "may", CASSINI)
    text = place.read_text().replace(PROPOSED, "")
    text = text.replace('"inertial_to_body"', '"body_to_inertial"')
    place.write_text(text.replace('"cumulative"', '"per_interval"'))
    event = read_event(folder / "events" / "may", CASSINI)
    assert load_event(event, CASSINI).time_s[0] == 0.0  # the epoch was taken from the data
    finished = read_channel_map(EXAMPLE / "channels.toml")
    assert read_channel_map(place).channels == finished.channels


def test_all_wheels_that_have_columns_are_chosen(tmp_path: Path) -> None:
    """Twelve has four wheels and data of all: the fourth was left out, and proposed to be ignored.

    A wheel or a thruster that matches nothing is named, for the user to decide on; with no data the
    first three wheels are chosen.
    """
    path = tmp_path / "data.csv"
    path.write_text("T,WHEEL1,WHEEL2,WHEEL3,WHEEL5,THR_9_CNT,P1_ON,MODE\n0,1,2,3,4,5,6,7\n")
    said: list[str] = []
    write_starting_files(tmp_path / "new", str(TWELVE), [path], log=said.append)
    assert read_priors(tmp_path / "new" / "priors.toml").wheels == (1, 2, 3, 5)
    assert said[0].startswith("wheels 1, 2, 3, 5 have columns in data.csv")
    text = (tmp_path / "new" / "channels.toml").read_text()
    assert f'{PROPOSED}ignore = ["MODE"]' in text
    assert f'{PROPOSED}source = ["WHEEL1", "WHEEL2", "WHEEL3", "WHEEL5"]' in text
    assert "map or ignore THR_9_CNT, P1_ON." in text
    write_starting_files(tmp_path / "bare", str(TWELVE))
    assert read_priors(tmp_path / "bare" / "priors.toml").wheels == (1, 2, 3)


def test_what_cannot_be_printed_breaks_no_file(tmp_path: Path) -> None:
    """Line breaks and control characters in names of columns and files, and in cells, are escaped:
    the files are valid at once, and name the same once the marks are away.
    """
    columns = {
        "time\n": ["a\rb = 1"],
        "P1_\x7fON": ["1"],
        "MO\nDE\x01": ["x\ny = 3"],
        "🛰\t": ["\x85"],
    }
    rates = {f"rate\n{axis}": ["0"] for axis in "xyz"}
    data = tmp_path / "da\nta\x7f🛰.parquet"
    pd.DataFrame(columns | rates).to_parquet(data)
    craft = tmp_path / "🛰\x7f.toml"
    craft.write_bytes(TWELVE.read_bytes())
    folder = tmp_path / "mine"
    files = write_starting_files(folder, str(craft), [data])
    tables = {path.name: tomllib.loads(path.read_text("utf-8")) for path in files}
    assert (folder / tables["priors.toml"]["spacecraft"]["file"]).resolve() == craft
    assert (files[2].parent / tables["event.toml"]["telemetry"]).resolve() == data
    text = (folder / "channels.toml").read_text("utf-8")
    assert "map or ignore P1_\\U0000007fON." in text
    assert all(line.isprintable() for line in text.split("\n"))
    proposed = tomllib.loads(text.replace(PROPOSED, ""))
    assert proposed["ignore"] == ["MO\nDE\x01", "🛰\t"]
    assert proposed["channels"]["time"]["source"] == "time\n"
    assert proposed["channels"]["rate"]["source"] == list(rates)


def test_a_path_that_toml_cannot_have_is_refused(tmp_path: Path) -> None:
    """A name of other bytes than UTF-8: one line, and nothing is written."""
    data = tmp_path / os.fsdecode(b"d\xff.csv")
    data.write_text("time,x\n0,1\n")
    with pytest.raises(InputError, match=r"d\\udcff\.csv: expected a path of UTF-8 characters"):
        write_starting_files(tmp_path / "mine", "cassini", [data])
    assert not (tmp_path / "mine").exists()


def test_nothing_is_replaced(tmp_path: Path) -> None:
    """One file in the way, and none is written."""
    (tmp_path / "run.toml").write_text("mine")
    with pytest.raises(InputError, match=r"run\.toml"):
        write_starting_files(tmp_path, "cassini")
    assert [path.name for path in tmp_path.iterdir()] == ["run.toml"]


NAMES = {
    "rate": (["wx", "wy", "wz"], ["omega.x [deg/s]", "omega.y [deg/s]", "omega.z [deg/s]"]),
    "wheel": (["wheel1", "wheel2", "wheel4"], ["RWA1 rate", "RWA2 rate", "RWA4 rate"]),
    "time": (["t"], ["Time (s)"]),
    "attitude": (["q_x", "q_y", "q_z", "q_w"], ["att1", "att2", "att3", "att4"]),
}


@pytest.mark.parametrize("style", [0, 1])
def test_likely_columns_are_found(tmp_path: Path, style: int) -> None:
    """Other styles of names, and none for columns that are something else."""
    header = [name for names in NAMES.values() for name in names[style]]
    path = tmp_path / "data.parquet"
    pd.DataFrame({name: [0.0] for name in [*header, "temperature"]}).to_parquet(path)
    found = {m.channel: m.sources for m in matches(sample_of(path), CASSINI, (1, 2, 4), "B")}
    assert found == {channel: tuple(names[style]) for channel, names in NAMES.items()}


def test_an_on_time_is_not_taken_for_the_time(tmp_path: Path) -> None:
    """Columns of thrusters stand before that of the time; alone they give no proposal for it."""
    path = tmp_path / "data.csv"
    for names in ("ON_TIME_{}_S", "time_{}", "sec_on_{}"):
        on_times = [names.format(name) for name in CASSINI.thruster_names("B")]
        for own in (["utc"], []):
            path.write_text(",".join([*on_times, *own]) + "\n")
            found = {m.channel: m.sources for m in matches(sample_of(path), CASSINI, (1, 2), "B")}
            expected = {"time": tuple(own)} if own else {}
            assert found == expected | {"on_time": tuple(on_times)}


def test_dates_of_a_parquet_file_are_known_as_such(tmp_path: Path) -> None:
    """Its first row says what its columns hold, so dates are mapped as dates and give the epoch."""
    path = tmp_path / "data.parquet"
    start = pd.Timestamp("2010-05-01T06:00:00")
    pd.DataFrame({"UTC": [start], "wx": [0.25]}).to_parquet(path)
    sample = sample_of(path)
    assert sample.first == {"UTC": "2010-05-01T06:00:00", "wx": "0.25"}
    (time, *_) = matches(sample, CASSINI, (1, 2, 4), "B")
    assert time.keys == {"time_system": '"iso8601"'}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--spacecraft", "casini"], "did you mean 'cassini'"),
        (["--spacecraft", "cassini", "--branch", "C"], "--branch"),
        (["--spacecraft", "cassini", "--from", "nowhere.csv"], "nowhere.csv"),
    ],
)
def test_bad_arguments_are_one_line(tmp_path: Path, arguments: list[str], said: str) -> None:
    """Another spacecraft, branch or file is named; nothing is written."""
    result = CliRunner().invoke(app, ["init", str(tmp_path / "new"), *arguments])
    assert isinstance(result.exception, InputError)
    assert said in str(result.exception)
    assert not (tmp_path / "new").exists()


def test_the_starting_priors_are_those_of_the_repository() -> None:
    """One text: what init writes for a built-in spacecraft is the priors file of this project."""
    starting = ROOT / "cassini_bayes" / "priors" / "starting"
    for branch in "ab":
        kept = ROOT / "priors" / f"cassini_{branch}_branch_telemetry.toml"
        assert (starting / f"cassini_{branch}.toml").read_bytes() == kept.read_bytes()
