"""The command line: exit codes, one line per error, clean output, never a traceback."""

from __future__ import annotations

import csv
import errno
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import run_cases
from run_cases import A_BRANCH, B_BRANCH, EVENTS, FLIGHT, RECORD, small_table

from cassini_bayes import __version__
from cassini_bayes.cli.fits import PLUS_MINUS
from cassini_bayes.errors import CassiniBayesError

pytestmark = pytest.mark.usefixtures("short_warm_start")
Captured = pytest.CaptureFixture[str]


def refused(capsys: Captured, *arguments: str) -> str:
    """The one line on standard error of a command that must end with 2."""
    capsys.readouterr()
    assert run_cases.command(arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith("error: ")
    assert output.err.count("\n") == 1
    assert "Traceback" not in output.err
    return output.err


def test_the_package_starts_as_a_module() -> None:
    """``python -m cassini_bayes`` is the command."""
    command = [sys.executable, "-m", "cassini_bayes", "--version"]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert found.stdout == f"cassini_bayes {__version__}\n"


def fit_refused(capsys: Captured, folder: Path, *arguments: str) -> str:
    """The same of a fit, which must leave no folder behind."""
    message = refused(capsys, "fit", *arguments, "--out", str(folder / "out"), "--quiet")
    assert not (folder / "out").exists()
    return message


def cells() -> list[list[str]]:
    """Header and two flight rows of the published totals."""
    with FLIGHT.open(newline="") as stream:
        header, *lines = csv.reader(stream)
    return [header, *[line for line in lines if line[-1] == "flight"][:2]]


def totals(folder: Path, change: Callable[[list[list[str]]], object]) -> str:
    """A totals file with one mistake in it."""
    content = cells()
    change(content)
    path = folder / "events.csv"
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(content)
    return str(path)


def put(column: str, value: str) -> Callable[[list[list[str]]], object]:
    """Write a value into the first row."""

    def change(content: list[list[str]]) -> None:
        content[1][content[0].index(column)] = value

    return change


def drop(column: str) -> Callable[[list[list[str]]], object]:
    """Leave a column out."""

    def change(content: list[list[str]]) -> None:
        place = content[0].index(column)
        for row in content:
            del row[place]

    return change


def add(column: str) -> Callable[[list[list[str]]], object]:
    """A column too many."""
    return lambda content: [row.append(column) for row in content]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (drop("duration_s"), ["line 1", "'duration_s'", "add the column"]),
        (add("durations_s"), ["line 1", "unknown column 'durations_s'"]),
        (put("on_time_z1_s", "nan"), ["line 2", "on_time_z1_s", "'nan'", "finite number"]),
        (put("on_time_z1_s", "-23.43"), ["on_time_z1_s", "0 or more", "'-23.43'", "sign"]),
        (put("on_time_z1_s", "23430"), ["on_time_z1_s", "no longer than", "23430"]),
        (put("pulses_z1", "1e6"), ["pulses_z1", "s, not ms"]),
        (put("wheels", "1 2 -4"), ["column wheels", "'1 2 -4'", "write e.g. 1 2 3"]),
        (put("wheels", "1,2,4"), ["column wheels", "'1,2,4'"]),
        (put("wheels", "1 2 2"), ["wheels", "list each wheel once"]),
        (put("rwa1_rpm_start", "-117e3"), ["rwa1_rpm_start", "rev/min"]),
        (put("rwa1_rpm_start", ""), ["rwa1_rpm_start", "empty cell"]),
        (put("branch", "C"), ["branch", "'C'"]),
        (put("epoch", "22.8.2009"), ["epoch", "ISO 8601"]),
        (put("duration_s", "0"), ["duration_s", "above 0"]),
        (put("id", "2009-10-05-bias"), ["2009-10-05-bias", "line 2", "rename"]),
        (put("source", "fligth"), ["source", "did you mean 'flight'"]),
        (lambda content: content.__delitem__(slice(1, None)), ["only the header row"]),
        (lambda content: content.clear(), ["empty file"]),
    ],
)
def test_bad_totals(
    capsys: Captured,
    tmp_path: Path,
    change: Callable[[list[list[str]]], object],
    said: list[str],
) -> None:
    """Every mistake of a totals file: file, line, column, expected, got, fix."""
    path = totals(tmp_path, change)
    message = fit_refused(capsys, tmp_path, path, "--priors", str(B_BRANCH))
    for text in (path, *said):
        assert text in message


def priors(folder: Path, old: str, new: str) -> str:
    """The B-branch priors with one change."""
    content = B_BRANCH.read_text()
    assert old in content
    path = folder / "priors.toml"
    path.write_text(content.replace(old, new, 1))
    return str(path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[parameters.cm_x_m]", "[parameters.cmx_m]", ["cmx_m", "did you mean 'cm_x_m'"]),
        ("[parameters.tau_fall_s]", "[parameters.mass_kg]", ["mass_kg.unit", "'kg'", "'s'"]),
        ("loc = 0.050", "loc = -0.050", ["tau_fall_s", "low"]),
        ("scale = 0.020", "scale = -0.020", ["tau_fall_s.scale"]),
        ("scale = 0.020", "scale = nan", ["tau_fall_s.scale", "nan"]),
        ("scale = 0.020", "sclae = 0.020", ["tau_fall_s", "sclae", "scale"]),
        ("fixed = 0.005", "fixed = -0.005", ["tau_delay_s.fixed", "0 or more"]),
        ('dist = "norm"', 'dist = "normal"', ["thrust_common_n.dist", "norm"]),
        ('unit = "N"', 'unit = "mN"', ["thrust_common_n.unit", "'N'", "'mN'"]),
        ("wheels = [1, 2, 4]", "wheels = [1, 2, 5]", ["wheels"]),
        ("wheels = [1, 2, 4]", "wheels = [1, 2, 3]", ["wheels", "[1, 2, 4]"]),
        ("[spacecraft]", "[spacecraft", ["TOML", "line"]),
    ],
)
def test_bad_priors(capsys: Captured, tmp_path: Path, old: str, new: str, said: list[str]) -> None:
    """Misspelt, missing or out of bounds: file, dotted key, expected, got, nearest name."""
    path = priors(tmp_path, old, new)
    message = fit_refused(capsys, tmp_path, str(FLIGHT), "--priors", path)
    for text in (path, *said):
        assert text in message


def test_a_missing_parameter(capsys: Captured, tmp_path: Path) -> None:
    """A parameter that the model needs and the file lacks."""
    path = tmp_path / "priors.toml"
    head, _, rest = B_BRANCH.read_text().partition("[parameters.tau_fall_s]")
    path.write_text(head + rest[rest.index("[parameters.") :])
    message = fit_refused(capsys, tmp_path, str(FLIGHT), "--priors", str(path))
    assert f"{path}: parameters.tau_fall_s" in message
    assert "add [parameters.tau_fall_s]" in message


def test_files_that_are_not_there(capsys: Captured, tmp_path: Path) -> None:
    """A missing file gets the nearest name; a folder is no file."""
    flight, good = str(FLIGHT), str(B_BRANCH)
    wrong = flight.replace("flight_2009_2010", "fligth_2009_2010")
    assert "did you mean 'flight_2009_2010.csv'" in fit_refused(
        capsys, tmp_path, wrong, "--priors", good
    )
    assert "cassini_b_branch_2010.toml" in fit_refused(
        capsys, tmp_path, flight, "--priors", good.replace("2010", "2011")
    )
    assert "write event.toml" in fit_refused(capsys, tmp_path, str(tmp_path), "--priors", good)
    assert "a folder" in fit_refused(capsys, tmp_path, flight, "--priors", str(tmp_path))
    unknown = fit_refused(capsys, tmp_path, f"{flight}:2009-08-23", "--priors", good)
    assert f"{flight}:2009-08-23" in unknown
    assert "no such file" in refused(capsys, "run", str(tmp_path / "none.toml"))


def test_events_that_do_not_go_together(capsys: Captured, tmp_path: Path) -> None:
    """Another branch's priors, the same event twice, no pulse counts."""
    flight = str(FLIGHT)
    assert "branch B" in fit_refused(capsys, tmp_path, flight, "--priors", str(A_BRANCH))
    assert "once" in fit_refused(capsys, tmp_path, flight, flight, "--priors", str(B_BRANCH))
    ideal = ("--source", "gsw_ideal", "--priors", str(B_BRANCH))
    assert "pulses" in fit_refused(capsys, tmp_path, flight, *ideal)


def test_run_files_with_mistakes(capsys: Captured, tmp_path: Path) -> None:
    """Bad TOML, an unknown key, an unknown pulse shape: the file is named, nothing is made."""
    path = tmp_path / "bad.toml"
    for text, said in (
        ("events = [", "TOML"),
        ('priors = "p"\nevents = ["e"]\nsead = 1', "sead"),
        ('priors = "p"\nevents = ["e"]\n[model]\npulse_shape = "square"', "rectangular"),
    ):
        path.write_text(text)
        message = refused(capsys, "run", str(path))
        assert message.startswith(f"error: {path}")
        assert said in message
    assert [entry.name for entry in tmp_path.iterdir()] == ["bad.toml"]


def test_folders_that_cannot_be_used(capsys: Captured, tmp_path: Path) -> None:
    """An existing run, another folder, a file, a place below a file."""
    run_file = str(run_cases.write_run(tmp_path))
    old = tmp_path / "old"
    (old / "checkpoint").mkdir(parents=True)
    (old / "resolved.toml").write_text(RECORD)
    (old / "checkpoint" / "warmstart.npz").write_text("")
    message = refused(capsys, "run", run_file, "--out", str(old))
    assert "--resume" in message
    assert "--force" in message
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    (thesis / "chapter.tex").write_text("words")
    for option in ([], ["--force"]):
        assert "another" in refused(capsys, "run", run_file, "--out", str(thesis), *option)
        assert "a file" in refused(capsys, "run", run_file, "--out", run_file, *option)
    assert "written" in refused(capsys, "run", run_file, "--out", f"{run_file}/below")
    assert "without --resume" in refused(
        capsys, "run", run_file, "--resume", "--out", str(tmp_path / "none")
    )
    assert (thesis / "chapter.tex").read_text() == "words"


def test_a_checkpoint_of_another_run(capsys: Captured, tmp_path: Path) -> None:
    """Blocks that belong to other inputs are refused even where the record was lost."""
    run_file, folder = run_cases.write_run(tmp_path), tmp_path / "small"
    (folder / "checkpoint").mkdir(parents=True)
    (folder / "resolved.toml").write_text(RECORD)
    from cassini_bayes.files.checkpoint import CheckpointStore

    CheckpointStore(folder / "checkpoint", "other").save("warmstart", {})
    message = refused(capsys, "run", str(run_file), "--resume", "--quiet")
    assert "warmstart.npz" in message
    assert "--force" in message


def test_system_errors_are_one_line(
    capsys: Captured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error of the system that nobody foresaw: its place and reason, exit 2."""

    def broken(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO), "/dev/disk")

    monkeypatch.setattr("cassini_bayes.pipeline.run.execute", broken)
    message = refused(capsys, "run", str(run_cases.write_run(tmp_path)))
    assert "/dev/disk" in message
    assert os.strerror(errno.EIO) in message


def test_too_little_memory_is_one_line(
    capsys: Captured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is asked for does not fit: said, with what to ask less of, exit 2."""

    def broken(*_: object, **__: object) -> None:
        np.empty(10**18)

    monkeypatch.setattr("cassini_bayes.pipeline.run.execute", broken)
    message = refused(capsys, "run", str(run_cases.write_run(tmp_path)))
    assert "not enough memory" in message
    assert "fewer draws or walkers" in message


def test_other_errors_of_the_package_end_with_one(
    capsys: Captured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error that is not the input's fault: one line as well, exit 1."""

    def broken(*_: object, **__: object) -> None:
        raise CassiniBayesError("log density is nan\nat z = [1]")

    monkeypatch.setattr("cassini_bayes.pipeline.run.execute", broken)
    assert run_cases.command(["run", str(run_cases.write_run(tmp_path))]) == 1
    assert capsys.readouterr().err == "error: log density is nan at z = [1]\n"


@pytest.mark.parametrize(("cause", "status"), [(KeyboardInterrupt(), 130), (None, None)])
def test_an_interrupt_of_compiled_code_is_one_line(
    capsys: Captured,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    cause: BaseException | None,
    status: int | None,
) -> None:
    """Numba turns a Ctrl-C into a SystemError; any other SystemError is a defect, and is shown."""

    def interrupted(*_: object, **__: object) -> None:
        raise SystemError("returned a result with an exception set") from cause

    monkeypatch.setattr("cassini_bayes.pipeline.run.execute", interrupted)
    arguments = ["run", str(run_cases.write_run(tmp_path)), "--quiet"]
    if status is None:
        with pytest.raises(SystemError):
            run_cases.command(arguments)
        return
    assert run_cases.command(arguments) == status
    error = capsys.readouterr().err
    assert error.startswith("stopped")
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ["frobnicate"],
        ["run"],
        ["run", "x.toml", "--sed", "3"],
        ["run", "x.toml", "--seed", "three"],
        ["run", "x.toml", "--seed", "-1"],
        ["fit", "--priors", "p", "--out", "o"],
    ],
)
def test_usage_errors(capsys: Captured, arguments: list[str]) -> None:
    """Unknown commands and options, missing ones, values of the wrong kind: exit 2, usage."""
    assert run_cases.command(arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert "Usage" in output.err
    assert "Traceback" not in output.err


def test_help_and_version(capsys: Captured) -> None:
    """Both end with 0; the help names the commands."""
    assert run_cases.command(["--version"]) == 0
    assert capsys.readouterr().out == f"cassini_bayes {__version__}\n"
    assert run_cases.command(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ("run", "fit", "calibrate"))
    assert run_cases.command(["run", "--help"]) == 0


def test_output_of_a_fit(capsys: Captured, tmp_path: Path) -> None:
    """--json: one JSON document is all of stdout; --quiet: no progress; resumed and loud: both."""
    table = small_table()
    run_file = str(run_cases.write_run(tmp_path, table))
    assert run_cases.command(["run", run_file, "--json", "--quiet", "--seed", "7"]) == 1
    output = capsys.readouterr()
    result = json.loads(output.out)
    assert result["converged"] is False
    assert result["folder"] == str(tmp_path / "small")
    names = [row["name"] for row in result["summary"]]
    assert f"thrust_n[{EVENTS[0]},z1]" in names
    assert len(set(names)) == len(names)
    assert all(row["hdi_90_low"] <= row["hdi_90_high"] for row in result["summary"])
    assert result["warnings"]
    # what is amiss is said even when quiet, and nothing else
    assert output.err.startswith("not converged: ")
    assert output.err.splitlines()[1:] == [f"warning: {line}" for line in result["warnings"]]
    provenance = json.loads((tmp_path / "small" / "provenance.json").read_text())
    assert provenance["seed"] == 7
    assert run_cases.command(["run", run_file, "--seed", "7", "--resume"]) == 1
    output = capsys.readouterr()
    doubt, *verdict, interval, place = output.out.splitlines()
    assert doubt.startswith("NOT CONVERGED: ")
    assert interval == PLUS_MINUS
    assert verdict == result["verdict"]
    assert verdict[0].startswith("Thrust ")
    assert " than the prior, " in verdict[0]
    assert place == str(tmp_path / "small" / "summary.csv")
    assert "warm start" in output.err
    assert "step 100" in output.err


@pytest.mark.parametrize(("converged", "status"), [(True, 0), (False, 1)])
def test_exit_status_tells_convergence(
    capsys: Captured,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    converged: bool,
    status: int,
) -> None:
    """0 when converged, 1 when not; the result is there when quiet, too, and what it lacks."""
    from cassini_bayes.pipeline.run import Outcome

    def done(*_: object, **__: object) -> Outcome:
        nothing_amiss = SimpleNamespace(warnings=())
        return Outcome(tmp_path, nothing_amiss, converged, 1.0)  # type: ignore[arg-type]

    monkeypatch.setattr("cassini_bayes.pipeline.run.execute", done)
    run_file = str(run_cases.write_run(tmp_path))
    assert run_cases.command(["run", run_file, "--quiet"]) == status
    output = capsys.readouterr()
    lines = [PLUS_MINUS, str(tmp_path / "summary.csv")]
    assert output.out.splitlines()[-2:] == lines
    assert output.out.startswith("NOT CONVERGED: ") is not converged
    assert (output.err == "") is converged
    assert run_cases.command(["run", run_file]) == status
    assert capsys.readouterr().out == output.out


def started(folder: Path, module: str, source: str, *arguments: str) -> tuple[int, str]:
    """Exit status and standard error of a new process that finds another ``module`` first."""
    (folder / f"{module}.py").write_text(source)
    done = subprocess.run(
        [sys.executable, "-m", "cassini_bayes", *arguments],
        env={**os.environ, "PYTHONPATH": f"{folder}:{run_cases.ROOT}"},
        capture_output=True,
        text=True,
        cwd=folder,
    )
    return done.returncode, done.stderr


# typer is imported at the start, numpy by a command, arviz in the middle of a report
@pytest.mark.parametrize("module", ["typer", "numpy"])
def test_an_interrupt_of_an_import_is_one_line(tmp_path: Path, module: str) -> None:
    """Ctrl-C while libraries are loaded: exit 130, no traceback."""
    arguments = ("run", str(run_cases.write_run(tmp_path)))
    status, said = started(tmp_path, module, "raise KeyboardInterrupt", *arguments)
    assert status == 130
    assert said.startswith("stopped")
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("module", "error"),
    [
        ("numpy", "ImportError('no such symbol', name='numpy')"),
        ("numpy", "OSError('half')"),
        ("arviz", "AttributeError('too old')"),
    ],
)
def test_a_library_that_cannot_be_imported_is_one_line(
    tmp_path: Path, module: str, error: str
) -> None:
    """A half-installed library: exit 2, its name and what to do."""
    arguments = ("run", str(run_cases.write_run(tmp_path)), "--quiet")
    status, said = started(tmp_path, module, f"raise {error}", *arguments)
    assert status == 2, said
    assert said.startswith("error: ")
    assert said.count("\n") == 1
