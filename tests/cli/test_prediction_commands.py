"""`predict` and `plan` as commands: what they write, what they say last, how they end."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from prediction_cases import write_run_folder
from run_cases import command

Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """fit.nc in a run folder that no test changes."""
    return write_run_folder(tmp_path_factory.mktemp("run"))


def test_the_cheapest_bias_is_written_too(fit: Path, tmp_path: Path, capsys: Captured) -> None:
    """``--out`` of ``plan --minimise`` holds what ``--json`` prints."""
    asked = [
        "plan",
        "--fit",
        str(fit),
        "--minimise",
        "z_throughput",
        "--to",
        "rwa1: 400, rwa4: 700",
    ]
    assert command([*asked, "--json", "--out", str(tmp_path / "out")]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8")) == printed


@pytest.mark.parametrize(
    "asked", [["predict", "--bias", "rwa1: 0 -> 500"], ["plan", "--quantity", "cm_x_m"]]
)
def test_a_fit_that_has_not_converged_ends_with_1(
    fit: Path, tmp_path: Path, capsys: Captured, asked: list[str]
) -> None:
    """As ``run`` and ``fit`` do, and said last, with ``--quiet`` too; others end with 0."""
    worse = write_run_folder(tmp_path, stop_rule="R-hat 1.08")
    capsys.readouterr()
    assert command([*asked, "--fit", str(fit), "--quiet"]) == 0
    assert "CONVERGED" not in capsys.readouterr().err
    assert command([*asked, "--fit", str(worse), "--quiet"]) == 1
    shown = capsys.readouterr()
    assert shown.out
    assert shown.err.splitlines()[-1].startswith("warning: NOT CONVERGED: ")
