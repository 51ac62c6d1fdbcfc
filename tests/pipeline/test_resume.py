"""A run that is killed again and again ends with the draws of one left alone, bit for bit."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import run_cases

from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.results.record import read_fit, save_fit

pytestmark = pytest.mark.usefixtures("short_warm_start")


def killing() -> ModuleType:
    """The script that kills the full flight run; here it kills a small one."""
    path = run_cases.ROOT / "benchmarks" / "kill_and_resume.py"
    spec = importlib.util.spec_from_file_location("kill_and_resume", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_kills_change_no_bit(tmp_path: Path) -> None:
    """SIGKILL at random moments in warm start, sampling and writing: fit.nc is the same."""
    script = killing()
    run_file = run_cases.write_run(tmp_path)
    # what this process has loaded and compiled no child has to again
    run_cases.logged(["run", str(run_file), "--out", str(tmp_path / "first")], tmp_path / "log")
    result = script.kill_and_resume(
        run_cases.Forked.start,
        ["run", str(run_file)],
        tmp_path,
        np.random.default_rng(1),
        kills=(0, 1, 2),
        log=lambda _: None,
        latest=0.3,  # the machine may be three times as fast by then
    )
    assert len(result.kills) == 3
    assert {kill.stage for kill in result.kills} >= {"sampling", "writing results"}
    assert result.identical, result.different
    assert result.variables > 50
    assert result.posterior_sha256[0] == result.posterior_sha256[1]
    assert_damage_costs_blocks_only(script, tmp_path, run_file)
    assert_one_bit_is_seen(script, tmp_path)


def assert_damage_costs_blocks_only(script: ModuleType, work: Path, run_file: Path) -> None:
    """A checkpoint truncated after the fact, and a lost warm start, are computed again."""
    killed = work / "killed"
    block = killed / "checkpoint" / "block_0001.npz"
    block.write_bytes(block.read_bytes()[:1000])
    (killed / "checkpoint" / "warmstart.npz").unlink()
    (killed / "fit.nc").unlink()
    status = run_cases.Forked.start(
        ["run", str(run_file), "--out", str(killed), "--resume"], work / "damage.log"
    ).wait()
    assert status in (0, 1)
    assert script.compare(work / "alone", killed, ()).identical


def assert_one_bit_is_seen(script: ModuleType, work: Path) -> None:
    """Negative control: one thrust that differs in its last bit is found."""
    fit = read_fit(work / "killed" / "fit.nc")
    values = fit.groups["posterior"]["thrust_n"].values
    values[0, 0, 0, 0] = np.nextafter(values[0, 0, 0, 0], 1.0)
    save_fit(fit, work / "killed" / "fit.nc")
    comparison = script.compare(work / "alone", work / "killed", ())
    assert comparison.different == ("posterior/thrust_n",)
    assert comparison.posterior_sha256[0] != comparison.posterior_sha256[1]
    assert not comparison.identical


def test_ctrl_c_says_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SIGINT in a run: one line, exit 130, no traceback, nothing half-written.

    The child interrupts itself as it keeps its first block, however fast the machine is.
    """
    run_file = run_cases.write_run(tmp_path)
    log, folder = tmp_path / "log", tmp_path / "small"
    save = CheckpointStore.save

    def interrupted(*arguments: Any) -> None:
        save(*arguments)
        # a shell that started the tests in the background has made its children deaf to it
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.kill(os.getpid(), signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(CheckpointStore, "save", interrupted)
        child = run_cases.Forked.start(["run", str(run_file)], log)
    assert child.wait() == 130
    text = log.read_text()
    assert "Traceback" not in text
    assert text.splitlines()[-1].startswith("stopped")
    assert "--resume" in text.splitlines()[-1]
    assert (folder / "resolved.toml").exists()
    assert list((folder / "checkpoint").iterdir())
    assert not [path for path in folder.rglob("*") if path.name.startswith(".")]


def test_a_run_that_gave_up_goes_on(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """With more steps, and from those that it has: its draws are as they were."""
    run_file = run_cases.write_run(tmp_path)
    assert run_cases.command(["run", str(run_file), "--quiet"]) == 1
    assert "--resume and a larger --max-steps" in capfd.readouterr().err
    blocks = tmp_path / "small" / "checkpoint"
    before = {path.name: path.read_bytes() for path in blocks.glob("block_*.npz")}
    assert run_cases.command(["run", str(run_file), "--resume", "--max-steps", "120"]) == 1
    fit = read_fit(tmp_path / "small" / "fit.nc")
    assert fit.attributes["steps"] == 120
    after = {path.name: path.read_bytes() for path in blocks.glob("block_*.npz")}
    assert len(after) == len(before) + 1
    assert before.items() <= after.items()
    assert "max_steps = 120" in (tmp_path / "small" / "resolved.toml").read_text()


def test_a_longer_fit_leaves_no_old_page_and_no_shorter_one_replaces_it(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Without a report the earlier one goes, and is not pointed to; fewer steps are refused."""
    run_file, folder = run_cases.write_run(tmp_path), tmp_path / "small"
    resume = ["run", str(run_file), "--resume", "--max-steps"]
    assert run_cases.command(["run", str(run_file), "--quiet"]) == 1
    (folder / "report.html").write_text("of the fit with 100 steps")
    for name in ("figures", "sweep"):
        (folder / name).mkdir()
        (folder / name / "old.png").write_text("")
    capfd.readouterr()
    assert run_cases.command([*resume, "120"]) == 1
    assert capfd.readouterr().out.splitlines()[-1] == str(folder / "summary.csv")
    left = {path.name for path in folder.iterdir()}
    assert left.isdisjoint({"report.html", "figures"})
    assert "sweep" in left
    before = {name: (folder / name).read_bytes() for name in ("fit.nc", "resolved.toml")}
    assert run_cases.command([*resume, "110"]) == 2
    error = capfd.readouterr().err
    assert "max_steps of at least 120, the steps kept there, got 110" in error
    assert "use --max-steps 120 or more" in error
    assert {name: (folder / name).read_bytes() for name in before} == before
    assert run_cases.command([*resume, "120"]) == 1  # control: as many as there are
    assert (folder / "fit.nc").read_bytes() == before["fit.nc"]


def test_what_changed_is_not_resumed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other settings or data than the run began with: refused before anything is touched."""
    run_file = run_cases.write_run(tmp_path)

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(CheckpointStore, "save", stop)
        assert run_cases.command(["run", str(run_file), "--quiet"]) == 130
    resolved = (tmp_path / "small" / "resolved.toml").read_bytes()
    table = run_cases.small_table()
    table["source"] = "fsds"
    run_cases.write_run(tmp_path, table)
    capfd.readouterr()
    assert run_cases.command(["run", str(run_file), "--resume"]) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert "provenance.json" in error
    assert "got others: source = fsds (was flight);" in error
    assert "--force" in error
    assert (tmp_path / "small" / "resolved.toml").read_bytes() == resolved
