"""Every command that reads events refuses the same mistake by the same name, before it computes."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Callable, Mapping
from datetime import date
from pathlib import Path

import pandas as pd
import pytest
import tomli_w
from event_cases import PRIORS, simulated
from prediction_cases import write_run_folder
from run_cases import B_BRANCH, EVENTS, FLIGHT, ROOT, command

from cassini_bayes.cli import app

MISSION = ROOT / "priors" / "cassini_mission.toml"
Captured = pytest.CaptureFixture[str]
READ_NO_EVENTS = {
    *("init", "simulate", "causes", "parameters", "quantities"),
    "report",  # what a run has read: other events are refused by their digests
    "diagnose-published",  # those of the package
}


def fit(events: str, priors: str, folder: Path) -> list[str]:
    """Arguments of ``fit``."""
    return ["fit", events, "--priors", priors, "--out", str(folder / "out")]


def diagnose(events: str, priors: str, folder: Path) -> list[str]:
    """Arguments of ``diagnose``."""
    return ["diagnose", events, "--priors", priors, "--out", str(folder / "out")]


def check(events: str, priors: str, _: Path) -> list[str]:
    """Arguments of ``check``."""
    return ["check", events, "--priors", priors]


def run(events: str, priors: str, folder: Path) -> list[str]:
    """Arguments of ``run``."""
    return ["run", str(written(folder, {"events": [events], "priors": priors}))]


def sweep(events: str, priors: str, folder: Path) -> list[str]:
    """Arguments of ``sweep``."""
    fitted = write_run_folder(folder)
    table = {"events": [events], "priors": priors}
    return ["sweep", str(written(folder, table)), "--fit", str(fitted.parent)]


def trend(events: str, priors: str, folder: Path) -> list[str]:
    """Arguments of ``trend``, with what telemetry needs besides the priors of a mission."""
    of_mission, own = (tomllib.loads(Path(path).read_text()) for path in (MISSION, priors))
    of_mission["parameters"] = own["parameters"] | of_mission["parameters"]
    (folder / "priors.toml").write_text(tomli_w.dumps(of_mission))
    swap = {"epoch": date(2009, 3, 12), "what": "branch_swap", "branch": "B", "source": "paper 001"}
    table = {
        "events": [events],
        "priors": "priors.toml",
        "dated": [swap],
        "trend": {"reference_epoch": date(2010, 1, 1)},
    }
    return ["trend", str(written(folder, table)), "--out", str(folder / "out")]


def predict(events: str, priors: str, folder: Path) -> list[str]:
    """Arguments of ``predict``."""
    fitted = ["--fit", str(write_run_folder(folder))]
    return ["predict", *fitted, "--bias", "rwa1: 0 -> 500", "--events", events, "--priors", priors]


def plan(events: str, priors: str, folder: Path) -> list[str]:
    """Arguments of ``plan``."""
    fitted = ["--fit", str(write_run_folder(folder)), "--quantity", "thrust_common_n"]
    return ["plan", *fitted, "--from", "rwa1: 0", "--events", events, "--priors", priors]


COMMANDS: Mapping[str, Callable[[str, str, Path], list[str]]] = {
    make.__name__: make for make in (check, run, fit, diagnose, sweep, trend, predict, plan)
}


def written(folder: Path, table: Mapping[str, object]) -> Path:
    """A file of settings."""
    path = folder / "settings.toml"
    path.write_text(tomli_w.dumps(table))
    return path


def wrong_totals(folder: Path) -> tuple[str, str, str]:
    """Flight biases with wheels 1 and 2 exchanged, their priors, and what that is called."""
    header, *rows = FLIGHT.read_text().splitlines()
    header = header.replace("rwa1", "rwa0").replace("rwa2", "rwa1").replace("rwa0", "rwa2")
    chosen = [row for row in rows if row.startswith(EVENTS) and row.endswith("flight")]
    path = folder / "wrong.csv"
    path.write_text("\n".join([header, *chosen]) + "\n")
    return str(path), str(B_BRANCH), "wheel-order"


def wrong_telemetry(folder: Path) -> tuple[str, str, str]:
    """A recorded bias with body rates of zero, likewise."""
    path = folder / "wrong"
    shutil.copytree(simulated() / "bias", path)
    rows = pd.read_csv(path / "telemetry.csv")
    rows[[name for name in rows if name.startswith("rate_")]] = 0.0
    rows.to_csv(path / "telemetry.csv", index=False)
    return str(path), str(PRIORS), "rate-silent"


CASES = [
    (name, wrong)
    for name in COMMANDS
    for wrong in (wrong_totals, wrong_telemetry)
    # a prediction reads the events of its fit, which is one of totals here
    if wrong is wrong_totals or name not in ("predict", "plan")
]


@pytest.mark.parametrize(("name", "wrong"), CASES)
def test_a_mistake_is_refused_by_name(
    capsys: Captured, tmp_path: Path, name: str, wrong: Callable[[Path], tuple[str, str, str]]
) -> None:
    """One line, status 2, the file, the name to accept; nothing is written."""
    events, priors, mistake = wrong(tmp_path)
    arguments = COMMANDS[name](events, priors, tmp_path)
    capsys.readouterr()
    assert command(arguments) == 2
    printed = capsys.readouterr()
    error = printed.err.splitlines()[-1]
    assert error.startswith(f"error: {events}")
    assert error.endswith(f"--accept {mistake}")
    assert printed.out == ""
    assert not (tmp_path / "out").exists()


def test_every_command_is_asked() -> None:
    """A new command either reads no events or stands in the table above."""
    names = {str(info.name) for info in app.registered_commands}
    assert names == set(COMMANDS) | READ_NO_EVENTS
