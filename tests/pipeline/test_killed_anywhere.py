"""Telemetry runs with a report and diagnoses, killed as they write: the same in the end.

A child kills itself with SIGKILL at its nth write, the half-written file lying there. The run left
alone has one core, those that were killed all there are: neither changes a number.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Sequence
from pathlib import Path

import arviz  # noqa: F401 (imported before forking: two seconds that no child spends again)
import numpy as np
import pytest
import run_cases
import tomli_w
from event_cases import PRIORS, simulated

from cassini_bayes.files import storage
from cassini_bayes.files.storage import digest
from cassini_bayes.results.record import GROUPS, read_fit

SAMPLER = {"ensembles": 2, "walkers": 56, "target_ess": 100, "first_check": 40, "max_steps": 100}


def started(arguments: Sequence[str], log: Path, cores: set[int], kill_at: int = 0) -> int:
    """Exit status of a command in a child on some cores, which dies at its nth write."""
    sync, every, writes = storage._sync, os.sched_getaffinity(0), 0

    def deadly(path: Path) -> None:
        nonlocal writes
        writes += 1
        if writes == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)
        sync(path)

    storage._sync = deadly
    os.sched_setaffinity(0, cores)  # the child's from the start
    try:
        return run_cases.Forked.start(arguments, log).wait()
    finally:
        storage._sync = sync
        os.sched_setaffinity(0, every)


def tables(folder: Path) -> dict[str, str]:
    """Digest of every CSV table in a folder by its name."""
    return {str(path.relative_to(folder)): digest(path) for path in folder.rglob("*.csv")}


def resumed(folder: Path) -> list[str]:
    """How to go on: before the first checkpoint there is nothing to resume or to force."""
    return ["--resume"] if list(folder.glob("checkpoint/*.npz")) else []


@pytest.mark.slow
def test_a_killed_telemetry_run_ends_the_same(tmp_path: Path) -> None:
    """Killed in its first write, its sampling, its tables and its report, then resumed."""
    table = {
        "events": [str(simulated() / "bias")],
        "priors": str(PRIORS),
        "sampler": SAMPLER,
        "output": {"report": True, "draws_per_ensemble": 500, "prior_draws": 500},
    }
    run_file = tmp_path / "run.toml"
    run_file.write_text(tomli_w.dumps(table))
    cores = sorted(os.sched_getaffinity(0))
    alone, killed = tmp_path / "alone", tmp_path / "killed"
    arguments = ["run", str(run_file), "--quiet", "--out"]
    assert started([*arguments, str(alone)], tmp_path / "log", {cores[0]}) in (0, 1)
    for kill_at in (1, 9, 25, 41):
        more = resumed(killed)
        status = started(
            [*arguments, str(killed), *more], tmp_path / "log", set(cores), kill_at=kill_at
        )
        assert status in (-signal.SIGKILL, 0, 1), (tmp_path / "log").read_text()
    status = started([*arguments, str(killed), *resumed(killed)], tmp_path / "log", set(cores))
    assert status in (0, 1), (tmp_path / "log").read_text()
    fits = [read_fit(folder / "fit.nc") for folder in (alone, killed)]
    for name in GROUPS:
        for variable, values in fits[0].groups[name].data_vars.items():
            np.testing.assert_array_equal(values, fits[1].groups[name][variable])
    assert tables(alone) == tables(killed)
    assert (killed / "report.html").exists()
    assert not [path for path in killed.rglob("*") if storage.is_leftover(path)]


def of_totals() -> tuple[list[str], Path]:
    """Rows of the flight, and their priors."""
    return [f"{run_cases.FLIGHT}:{event}" for event in run_cases.EVENTS], Path(run_cases.B_BRANCH)


def of_telemetry() -> tuple[list[str], Path]:
    """A bias with its telemetry, and its priors."""
    return [str(simulated() / "bias")], PRIORS


@pytest.mark.parametrize("given", [of_totals, of_telemetry])
def test_a_killed_diagnosis_ends_the_same(
    tmp_path: Path, given: Callable[[], tuple[list[str], Path]]
) -> None:
    """Killed in its first, a middle and its last write, then started again: the same tables.

    What a killed diagnosis leaves is no diagnosis: no `--force` is asked for, nothing half-written
    stays. A finished one is one.
    """
    cores = sorted(os.sched_getaffinity(0))
    events, priors = given()
    arguments = ["diagnose", *events, "--priors", str(priors), "--no-gain", "--quiet", "--out"]
    alone, killed = tmp_path / "alone", tmp_path / "killed"
    assert started([*arguments, str(alone)], tmp_path / "log", {cores[0]}) == 0
    writes = 2 * len([path for path in alone.rglob("*") if path.is_file()])  # a file, its folder
    for kill_at in (1, writes // 2, writes - 1):
        status = started([*arguments, str(killed)], tmp_path / "log", set(cores), kill_at=kill_at)
        assert status == -signal.SIGKILL, (tmp_path / "log").read_text()
    assert started([*arguments, str(killed)], tmp_path / "log", set(cores)) == 0
    assert not [path for path in killed.rglob("*") if storage.is_leftover(path)]
    assert tables(alone) == tables(killed)
    records = [json.loads((folder / "diagnosis.json").read_text()) for folder in (alone, killed)]
    for record in records:
        del record["command"]  # names the folder
    assert records[0] == records[1]
    assert started([*arguments, str(killed)], tmp_path / "log", set(cores)) == 2
