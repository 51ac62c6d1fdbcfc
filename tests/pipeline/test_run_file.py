"""Run files: defaults filled in, and every mistake named with file, key and fix."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
import run_cases
import tomli_w

from cassini_bayes.errors import InputError
from cassini_bayes.pipeline.run_file import RunFile, check_run, read_run_file
from cassini_bayes.sampling.ensembles import SamplerSettings

LEAST = 'events = ["two.csv"]\npriors = "b.toml"\n'


def refusal(folder: Path, text: str) -> InputError:
    """The error that a run file of this text raises."""
    path = folder / "run.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_run_file(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return caught.value


def test_defaults_are_filled_in(tmp_path: Path) -> None:
    """Two lines are a run file; every default is there, and the sampler's is the sampler's own."""
    path = tmp_path / "run.toml"
    path.write_text(LEAST)
    run = read_run_file(path)
    assert run.events == ["two.csv"]
    assert run.source == "flight"
    assert run.model.delta_v == "as-declared"
    assert run.output.report
    assert run.sampler.settings() == SamplerSettings()


def test_what_is_resolved_reads_back(tmp_path: Path) -> None:
    """resolved.toml is a run file that means the same."""
    run = check_run(run_cases.small_table(), "here")
    path = tmp_path / "resolved.toml"
    path.write_text(tomli_w.dumps(run.model_dump()))
    assert read_run_file(path) == run


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    """Editors that write one are forgiven."""
    path = tmp_path / "run.toml"
    path.write_bytes(b"\xef\xbb\xbf" + LEAST.encode())
    assert read_run_file(path).priors == "b.toml"


def test_the_flight_run_file_is_good() -> None:
    """The run file of `make demo` is read, and its files are there."""
    path = run_cases.ROOT / "runs" / "flight_2009_2010.toml"
    run = read_run_file(path)
    assert isinstance(run, RunFile)
    assert all((path.parent / name).is_file() for name in (*run.events, run.priors))
    assert run.sampler.target_ess >= 2_000


@pytest.mark.parametrize(
    ("text", "place", "expected", "got", "fix"),
    [
        ('event = ["x"]\npriors = "b"', "event", "events", "unknown key", "'events'"),
        (f"{LEAST}[samplers]\n", "samplers", "sampler", "unknown key", "'sampler'"),
        (f"{LEAST}[sampler]\nwalker = 3", "sampler.walker", "walkers", "unknown", "'walkers'"),
        (f"{LEAST}[model]\npulseshape = 1", "model.pulseshape", "pulse", "unknown", "pulse_shape"),
        (f"{LEAST}[output]\nzzz = 1", "output.zzz", "folder", "unknown", "choose one"),
        ('events = ["two.csv"]', "priors", "a value", "nothing", "add priors"),
        ('priors = "b"', "events", "a value", "nothing", "add events"),
        ('priors = "b"\nevents = []', "events", "at least one", "[]", "file.csv"),
        ('priors = "b"\nevents = "x.csv"', "events", "list", "'x.csv'", 'events = ["x.csv"]'),
        ('priors = "b"\nevents = 4', "events", "list", "4", "brackets"),
        ('priors = "b"\nevents = [3]', "events[1]", "text", "3", "change events[1]"),
        ('priors = 5\nevents = ["a"]', "priors", "text", "5", "change priors"),
        (f"model = 3\n{LEAST}", "model", "a table [model]", "3", "[model]"),
        (f"{LEAST}[sampler]\nensembles = '4'", "sampler.ensembles", "whole", "'4'", "change"),
        (f"{LEAST}[sampler]\nensembles = 1", "sampler.ensembles", "equal to 2", "1", "change"),
        (f"{LEAST}[sampler]\nensembles = true", "sampler.ensembles", "whole", "True", "change"),
        (f"{LEAST}[sampler]\nseed = -1", "sampler.seed", "equal to 0", "-1", "change"),
        (f"{LEAST}[sampler]\nseed = 1.0", "sampler.seed", "whole number", "1.0", "change"),
        (f"{LEAST}[sampler]\ntarget_ess = 5", "sampler.target_ess", "100", "5", "change"),
        (
            f"{LEAST}[sampler]\nindependence_share = nan",
            "sampler.independence_share",
            "a finite number",
            "nan",
            "change",
        ),
        (
            f"{LEAST}[sampler]\nindependence_share = 0.95",
            "sampler.independence_share",
            "0.9",
            "0.95",
            "change",
        ),
        (
            f"{LEAST}[sampler]\nfirst_check = 500\nmax_steps = 400",
            "sampler.first_check",
            "no more steps than max_steps, 400",
            "500",
            "lower it",
        ),
        (f"{LEAST}[output]\nreport = 'yes'", "output.report", "boolean", "'yes'", "change"),
        (
            f"{LEAST}[model]\ndelta_v = 'as_declared'",
            "model.delta_v",
            "ignore",
            "as_declared",
            "did you mean 'as-declared'",
        ),
        (
            f"{LEAST}[model]\npulse_shape = 'firstorder'",
            "model.pulse_shape",
            "rectangular",
            "'firstorder'",
            "did you mean 'first_order'",
        ),
    ],
)
def test_mistakes_are_named(
    tmp_path: Path, text: str, place: str, expected: str, got: str, fix: str
) -> None:
    """Unknown keys with the nearest one, missing keys, wrong types, values out of range."""
    error = refusal(tmp_path, text)
    assert error.where.endswith(f"run.toml: {place}")
    assert expected in error.expected
    assert got in error.got
    assert fix in error.fix


def test_bad_toml_names_the_line(tmp_path: Path) -> None:
    """A syntax error says where."""
    error = refusal(tmp_path, f"{LEAST}[sampler]\nseed = = 3\n")
    assert "line 4" in error.got


def test_other_bytes_are_no_run_file(tmp_path: Path) -> None:
    """A file in another encoding, or a binary one."""
    path = tmp_path / "run.toml"
    path.write_bytes(b"# \xe9v\xe9nement\n")
    with pytest.raises(InputError, match="UTF-8"):
        read_run_file(path)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    """A misspelt name gets the nearest one; a folder is no run file."""
    (tmp_path / "flight.toml").write_text(LEAST)
    with pytest.raises(InputError, match=r"did you mean 'flight\.toml'"):
        read_run_file(tmp_path / "fligth.toml")
    with pytest.raises(InputError, match="no such file"):
        read_run_file(tmp_path / "nowhere" / "run.toml")
    with pytest.raises(InputError, match="a folder"):
        read_run_file(tmp_path)


def test_every_documented_key_is_accepted() -> None:
    """Each key of each table is read back as given: nothing is accepted and ignored."""
    table = run_cases.small_table() | {"source": "fsds"}
    run = check_run(tomllib.loads(tomli_w.dumps(table)), "here")
    resolved = run.model_dump()
    for key, value in table.items():
        if isinstance(value, dict):
            assert {name: resolved[key][name] for name in value} == value
        else:
            assert resolved[key] == value


@pytest.mark.parametrize(
    ("path", "what", "fix"),
    [
        ("runs/cassini_mission.toml", "a mission file", "trend"),
        ("runs/scenarios/fsds_2005.toml", "a scenario file", "simulate"),
        ("priors/cassini_b_branch_2010.toml", "a priors file", "--priors"),
    ],
)
def test_a_file_of_another_command_is_told_which(path: str, what: str, fix: str) -> None:
    """And not that its tables are unknown keys."""
    with pytest.raises(InputError, match="expected a run file") as caught:
        read_run_file(Path(__file__).parents[2] / path)
    assert caught.value.got == what
    assert fix in caught.value.fix
