"""Telemetry runs with a report and diagnoses, killed as they write: the same in the end.

A child kills itself with SIGKILL at its nth write, the half-written file lying there. The run left
alone has one core, those that were killed have two: neither changes a number.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import run_cases
import tomli_w
from event_cases import PRIORS, simulated
from made_up_review import blank

from cassini_bayes.files import storage
from cassini_bayes.files.storage import digest
from cassini_bayes.report import sections
from cassini_bayes.results.record import GROUPS, read_fit

pytestmark = pytest.mark.usefixtures("short_warm_start")
SAMPLER = {"ensembles": 2, "walkers": 56, "target_ess": 100, "first_check": 64, "max_steps": 100}


def alone_on_one_core(arguments: Sequence[str], log: Path) -> int:
    """Exit status of a command left alone, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "sched_getaffinity", lambda _: {0})
        return run_cases.logged(arguments, log)


def started(arguments: Sequence[str], log: Path, kill_at: int = 0) -> int:
    """Exit status of a command in a child on two cores, which dies at its nth write."""
    sync, writes = storage._sync, 0

    def deadly(path: Path) -> None:
        nonlocal writes
        writes += 1
        if writes == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)
        sync(path)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(storage, "_sync", deadly)
        patch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
        return run_cases.Forked.start(arguments, log).wait()


def tables(folder: Path) -> dict[str, str]:
    """Digest of every CSV table in a folder by its name."""
    return {str(path.relative_to(folder)): digest(path) for path in folder.rglob("*.csv")}


def resumed(folder: Path) -> list[str]:
    """How to go on: before the first checkpoint there is nothing to resume or to force."""
    return ["--resume"] if list(folder.glob("checkpoint/*.npz")) else []


def test_a_killed_telemetry_run_ends_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed in its first write, its warm start, its tables and its figures, then resumed.

    Of slews: those without thrusters take half as long; tables of thrusts are test_resume's.
    """
    monkeypatch.setattr(sections, "draw_encoded", blank)
    table = {
        "events": [str(simulated() / "slews")],
        "priors": str(PRIORS),
        "sampler": SAMPLER,
        "output": {"report": True, "draws_per_ensemble": 500, "prior_draws": 500},
    }
    run_file = tmp_path / "run.toml"
    run_file.write_text(tomli_w.dumps(table))
    alone, killed = tmp_path / "alone", tmp_path / "killed"
    arguments = ["run", str(run_file), "--quiet", "--out"]
    assert alone_on_one_core([*arguments, str(alone)], tmp_path / "log") in (0, 1)
    for kill_at in (1, 9, 25, 41):
        more = resumed(killed)
        status = started([*arguments, str(killed), *more], tmp_path / "log", kill_at)
        assert status in (-signal.SIGKILL, 0, 1), (tmp_path / "log").read_text()
    status = started([*arguments, str(killed), *resumed(killed)], tmp_path / "log")
    assert status in (0, 1), (tmp_path / "log").read_text()
    fits = [read_fit(folder / "fit.nc") for folder in (alone, killed)]
    for name in GROUPS:
        for variable, values in fits[0].groups[name].data_vars.items():
            np.testing.assert_array_equal(values, fits[1].groups[name][variable])
    assert tables(alone) == tables(killed)
    assert (killed / "report.html").exists()
    assert not [path for path in killed.rglob("*") if storage.is_leftover(path)]


def test_a_killed_diagnosis_ends_the_same(tmp_path: Path) -> None:
    """Killed in its first write, its searches, its draws and its measures; nothing done is redone.

    The same tables, and the same record to the last bit; other settings are refused.
    """
    rows = [f"{run_cases.FLIGHT}:{event}" for event in run_cases.EVENTS]
    arguments = ["diagnose", *rows, "--priors", str(run_cases.B_BRANCH), "--quiet", "--out"]
    alone, killed = tmp_path / "alone", tmp_path / "killed"
    assert alone_on_one_core([*arguments, str(alone)], tmp_path / "log") == 0
    arguments.append(str(killed))
    finished: dict[Path, int] = {}
    for kill_at in (1, 21, 81, 61):
        status = started([*arguments, *resumed(killed)], tmp_path / "log", kill_at)
        assert status == -signal.SIGKILL, (tmp_path / "log").read_text()
        kept = {path: path.stat().st_mtime_ns for path in killed.glob("checkpoint/stage_*.npz")}
        assert finished.items() <= kept.items()
        finished = kept
    assert not (killed / "diagnosis.json").exists()
    other = [*arguments, "--seed", "2", "--resume"]
    assert started(other, tmp_path / "log") == 2
    assert "that this run began with" in (tmp_path / "log").read_text()
    assert started([*arguments, "--resume"], tmp_path / "log") == 0
    assert finished.items() <= {p: p.stat().st_mtime_ns for p in finished}.items()
    assert tables(alone) == tables(killed)
    records = [json.loads((folder / "diagnosis.json").read_text()) for folder in (alone, killed)]
    for record in records:
        del record["command"]  # names the folder
    assert records[0] == records[1]
    assert not [path for path in killed.rglob("*") if storage.is_leftover(path)]
    assert started(arguments, tmp_path / "log") == 2
    assert "an existing diagnosis" in (tmp_path / "log").read_text()
