"""What a fit says at its end, and the status it ends with."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
import run_cases

from cassini_bayes.pipeline.run_file import RunFile

CONTRADICTIONS = ("first: pulled", "second: pulled")


@pytest.mark.parametrize(
    ("warnings", "options", "status"),
    [
        (CONTRADICTIONS, [], 0),
        (CONTRADICTIONS, ["--strict"], 1),
        ((), ["--strict"], 0),
    ],
)
def test_contradictions_stand_last(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    warnings: tuple[str, ...],
    options: list[str],
    status: int,
) -> None:
    """Printed last, even when quiet; a failure with --strict, only where there are any."""
    outcome = SimpleNamespace(
        folder=tmp_path, converged=True, verdict=(), review=SimpleNamespace(warnings=warnings)
    )
    monkeypatch.setattr("cassini_bayes.pipeline.run.execute", lambda *_, **__: outcome)
    run_file = str(run_cases.write_run(tmp_path))
    fit = ["fit", str(run_cases.FLIGHT), "--priors", "p", "--out", str(tmp_path)]
    for command in (["run", run_file], fit):
        assert run_cases.command([*command, "--quiet", *options]) == status
        error = capsys.readouterr().err
        assert error.splitlines() == [f"warning: {line}" for line in warnings]


def test_a_sweep_accepts_what_its_run_accepted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Mistakes accepted on the command line of a run are accepted again, said last, and strict."""
    given = []

    def execute(run: RunFile, *_: object, **__: object) -> SimpleNamespace:
        given.append(run)
        return SimpleNamespace(
            folder=tmp_path, findings=("accepted (wheel-order)",), converged=True
        )

    monkeypatch.setattr("cassini_bayes.pipeline.by_file.execute_sweep", execute)
    run_file = str(run_cases.write_run(tmp_path))
    sweep = ["sweep", run_file, "--accept", "wheel-order", "--leave-out", "--quiet"]
    assert run_cases.command(sweep) == 0
    assert run_cases.command([*sweep, "--strict"]) == 1
    assert {(tuple(run.accept), run.leave_out) for run in given} == {(("wheel-order",), True)}
    assert capsys.readouterr().err.splitlines() == ["warning: accepted (wheel-order)"] * 2


@pytest.mark.parametrize(("rule", "status"), [("all criteria met", 0), ("R-hat", 1)])
def test_an_extended_fit_that_has_not_converged_is_no_success(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    rule: str,
    status: int,
) -> None:
    """`diagnose --then-fit` says so, with what did not hold, and ends with 1."""
    table = pd.DataFrame()
    table.attrs["stop_rule"] = rule
    result = SimpleNamespace(record={"findings": []}, sentences=["nothing"], fit=lambda **_: table)
    monkeypatch.setattr("cassini_bayes.pipeline.diagnoses.diagnose", lambda *_, **__: result)
    events = str(run_cases.FLIGHT)
    diagnose = ["diagnose", events, "--priors", "p", "--out", str(tmp_path), "--then-fit"]
    assert run_cases.command(diagnose) == status
    assert ("NOT CONVERGED: R-hat" in capsys.readouterr().err) == (status == 1)


@pytest.mark.parametrize("findings", [[], ["t.csv: accepted (wheel-order)"]])
def test_findings_of_a_diagnosis_stand_last(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    findings: list[str],
) -> None:
    """Also when quiet; with --strict they are the exit status 1."""
    result = SimpleNamespace(record={"findings": findings}, sentences=["nothing"])
    monkeypatch.setattr("cassini_bayes.pipeline.diagnoses.diagnose", lambda *_, **__: result)
    diagnose = ["diagnose", "t.csv", "--priors", "p", "--out", str(tmp_path), "--quiet"]
    assert run_cases.command(diagnose) == 0
    assert run_cases.command([*diagnose, "--strict"]) == (1 if findings else 0)
    assert capsys.readouterr().err.splitlines() == [f"warning: {line}" for line in findings] * 2


@pytest.mark.parametrize("warnings", [(), ("t.csv: accepted (wheel-order)",)])
def test_what_a_check_finds_stands_last(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    warnings: tuple[str, ...],
) -> None:
    """Likewise before sampling."""
    result = SimpleNamespace(warnings=warnings)
    monkeypatch.setattr("cassini_bayes.pipeline.checks.check", lambda *_, **__: result)
    check = ["check", "t.csv", "--priors", "p", "--quiet"]
    assert run_cases.command(check) == 0
    assert run_cases.command([*check, "--strict"]) == (1 if warnings else 0)
    assert capsys.readouterr().err.splitlines() == [f"warning: {line}" for line in warnings] * 2
