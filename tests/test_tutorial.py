"""The tutorial's commands, run as they stand there, end in the cause that its recording hides."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest
from totals_cases import ROOT
from typer.testing import CliRunner

from cassini_bayes.cli import app
from cassini_bayes.errors import InputError
from cassini_bayes.report import diagnosis_pictures

pytestmark = pytest.mark.usefixtures("short_warm_start")
PAGE = ROOT / "docs" / "tutorial" / "from-your-csv.md"
EXAMPLE = ROOT / "docs" / "examples" / "own_csv"
TRUTH = 0.75
COMMANDS = tuple(
    line
    for block in re.findall(r"^```sh\n(.*?)^```", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    for line in block.splitlines()
)
# A short chain in place of the page's long ones: every command runs, on less.
SHORT = """[sampler]
ensembles = 2
walkers = 64
first_check = 100
max_steps = 100
target_ess = 100
seed = 1

[output]
draws_per_ensemble = 500
prior_draws = 500
report = false
"""
THERE = {command.name for command in app.registered_commands}
# `check`, and `predict` from a fit of telemetry, come together.
LATER = () if "check" in THERE else ("cassini-bayes check", "cassini-bayes predict")


def shortened(run_file: Path) -> None:
    """The run file with a short chain and no report."""
    head, _, _ = run_file.read_text().partition("[sampler]")
    run_file.write_text(head + SHORT)


def run(command: str) -> None:
    """One line of the page: this package's commands in this process, others by a shell."""
    words = shlex.split(command)
    if words[0] != "cassini-bayes":
        subprocess.run(["bash", "-c", command], check=True)
        return
    result = CliRunner().invoke(app, words[1:])
    assert result.exit_code == 0 or "not converged" in result.output.lower(), result.output
    if words[1] == "init":
        shortened(Path("mine/run.toml"))


def test_the_page_has_every_step() -> None:
    """init, check, run, diagnose, run again, predict, in this order."""
    own = [words[1] for words in map(shlex.split, COMMANDS) if words[0] == "cassini-bayes"]
    assert own == ["init", "check", "run", "diagnose", "run", "predict"]


@pytest.mark.slow
def test_the_tutorial_names_the_cause_and_gains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hidden loss is named with its size, the extended model gains, and its fit finds it too;
    before the map is corrected, the recording is refused.
    """
    monkeypatch.setattr(diagnosis_pictures, "_drawn", lambda _: None)
    monkeypatch.chdir(tmp_path)
    shutil.copytree(EXAMPLE, tmp_path / "docs" / "examples" / "own_csv")
    for command in COMMANDS:
        if not command.startswith(LATER):
            run(command)
    record = json.loads(Path("mine/diagnosis/diagnosis.json").read_text())
    cause = record["causes"][0]
    assert cause["name"] == "thruster_degraded:z3"
    assert cause["probability"] > 0.95
    size = cause["parameters"]["thrust_factor"]
    stated = re.search(
        r"probability ([\d.]+) .*?delivers ([\d.]+) ± ([\d.]+) %",
        PAGE.read_text("utf-8"),
        re.DOTALL,
    )
    assert stated is not None
    probability, mean, sd = map(float, stated.groups())
    assert abs(cause["probability"] - probability) < 3e-4
    assert abs(100.0 * size["mean"] - mean) < 0.2 * sd
    assert 100.0 * size["sd"] == pytest.approx(sd, rel=0.1)
    assert abs(size["mean"] - TRUTH) < 3.0 * size["sd"]
    gain = record["extended"]["log_evidence"] - record["baseline"]["log_evidence"]
    assert gain > 10.0
    summary = pd.read_csv("mine/extended/summary.csv").set_index("name")
    fitted = summary.filter(like="thrust_factor", axis=0).iloc[0]
    assert abs(fitted["mean"] - TRUTH) < 3.0 * fitted["sd"]
    before = pd.read_csv("mine/run/summary.csv").set_index("name")
    assert not len(before.filter(like="thrust_factor", axis=0))


def test_the_map_as_proposed_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control: without its two corrections the page's recording is not read."""
    from cassini_bayes.events.telemetry import load_event, read_event
    from cassini_bayes.spacecraft import load_spacecraft

    monkeypatch.chdir(tmp_path)
    shutil.copytree(EXAMPLE, tmp_path / "docs" / "examples" / "own_csv")
    for command in COMMANDS:
        if "per_interval" not in command and command.startswith(("cassini-bayes init", "sed -i")):
            run(command)
    cassini = load_spacecraft("cassini")
    with pytest.raises(InputError, match='kind = "per_interval"'):
        load_event(read_event("mine/events/may", cassini), cassini)
