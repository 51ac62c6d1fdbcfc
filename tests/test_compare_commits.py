"""The script that compares two commits: what it calls equal, rounding, chance, and different."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.stats import norm

ROOT = Path(__file__).parents[1]
DRAWS = 2_000


@cache
def script() -> ModuleType:
    """The script as a module."""
    spec = importlib.util.spec_from_file_location(
        "compare_commits", ROOT / "benchmarks" / "compare_commits.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def drawn(seed: int, shift: float = 0.0, width: float = 1.0, draws: int = DRAWS) -> xr.Dataset:
    """Draws of three quantities of four events and of one number; data that are no draws."""
    rng = np.random.default_rng(seed)
    thrust = 0.76 + 0.02 * rng.standard_normal((2, draws, 4))
    tail = 0.06 + 0.01 * (shift + width * rng.standard_normal((2, draws)))
    return xr.Dataset(
        {
            "thrust_n": (("chain", "draw", "event"), thrust),
            "tau_fall_s": (("chain", "draw"), tail),
            "duration_s": (("event",), np.array([1.0, 2.0, 3.0, 4.0])),
        },
        coords={"event": ["a", "b", "c", "d"], "chain": [0, 1], "draw": np.arange(draws)},
    )


def verdicts(findings: Any) -> dict[str, str]:
    """Verdicts by name."""
    return {own.name: own.verdict for own in findings}


def agrees(*findings: Any) -> bool:
    """Whether one part with these findings agrees."""
    return bool(script().Comparison({"part": list(findings)}).agrees)


def test_a_sum_in_another_order_is_rounding() -> None:
    """The same terms added backwards: reported as rounding, and no difference."""
    terms = np.random.default_rng(1).standard_normal((5, 1_000))
    forwards = np.array([sum(row) for row in terms])
    backwards = np.array([sum(row[::-1]) for row in terms])
    assert not np.array_equal(forwards, backwards)
    verdict, size = script().compare_arrays(forwards, backwards)
    assert verdict == "rounding"
    assert 0.0 < size < 1e-12
    assert script().compare_arrays(forwards, forwards.copy()) == ("equal", 0.0)
    assert script().compare_arrays(forwards, forwards * (1.0 + 1e-8))[0] == "different"


def test_what_is_not_finite_has_to_be_the_same() -> None:
    """NaN equals NaN in its place, and nothing else."""
    values = np.array([1.0, np.nan, np.inf])
    assert script().compare_arrays(values, values + np.array([1e-15, 0.0, 0.0]))[0] != "different"
    assert script().compare_arrays(values, np.array([1.0, 2.0, np.inf]))[0] == "different"
    assert script().compare_arrays(values, np.array([np.nan, np.nan, np.inf]))[0] == "different"
    assert script().compare_arrays(values, values[:2])[0] == "different"


@pytest.mark.statistical
def test_draws_of_another_seed_agree() -> None:
    """Independent draws of one distribution part by chance alone, whatever their number."""
    for other in (drawn(2), drawn(3, draws=1_500)):
        findings = script().compare_datasets("fit", drawn(1), other)
        own = verdicts(findings)
        assert own["thrust_n"] == own["tau_fall_s"] == "draws"
        assert own["duration_s"] == own["event"] == "equal"
        assert sum(finding.scalars for finding in findings) == 2 * (4 + 1)
        assert agrees(*findings)


@pytest.mark.parametrize(("shift", "width"), [(0.5, 1.0), (0.0, 1.3)])
def test_a_variable_that_moved_is_flagged(shift: float, width: float) -> None:
    """Negative control: half a standard deviation off, or a third wider, and no more agreement."""
    findings = script().compare_datasets("fit", drawn(1), drawn(2, shift, width))
    assert not agrees(*findings)
    result = script().Comparison({"part": findings})
    failed = [own.name for own in findings if result.fails("part", own)]
    assert failed == ["tau_fall_s"]
    assert "FAILED fit: tau_fall_s" in script().details(result)[0]
    assert script().sentence(result).endswith("DIFFERENT: 1.")


def test_data_that_moved_are_flagged_whatever_the_draws_do() -> None:
    """What is no draw has no chance in it: another duration, a variable that is gone."""
    moved = drawn(2).assign(duration_s=("event", np.array([1.0, 2.0, 3.0, 4.1])))
    assert not agrees(*script().compare_datasets("fit", drawn(1), moved))
    lost = drawn(1).drop_vars("tau_fall_s")
    findings = script().compare_datasets("fit", drawn(1), lost)
    assert verdicts(findings)["tau_fall_s"] == "one side"
    assert not agrees(*findings)


def test_fewer_effective_draws_have_larger_errors() -> None:
    """The summary's effective draws make the errors of a posterior, not those of a prior."""
    summary = pd.DataFrame({"quantity": ["tau_fall_s"], "ess_bulk": [40.0], "ess_tail": [50.0]})
    groups = {"/posterior": drawn(1)}, {"/posterior": drawn(2)}
    sizes = []
    for name, found in (("/posterior", (summary, summary)), ("/prior", (summary, summary))):
        one, other = ({name: next(iter(side.values()))} for side in groups)
        findings = script().compare_fits("fit.nc", one, other, found)
        sizes.append(next(own.size for own in findings if own.name == "tau_fall_s"))
    assert sizes[1] == pytest.approx(sizes[0] * np.sqrt(2 * DRAWS / 40.0))


@pytest.mark.statistical
def test_replicates_are_no_more_than_they_are() -> None:
    """Fifty replicates of a posterior of thousands of effective draws have the errors of fifty."""
    rng = np.random.default_rng(5)
    one, other = (
        xr.Dataset({"rate": (("replicate", "sample"), rng.standard_normal((50, 400)))})
        for _ in range(2)
    )
    assert agrees(*script().compare_datasets("fit", one, other, lambda _: (5e3, 5e3)))
    assert not agrees(*script().compare_datasets("fit", one, other + 1.5, lambda _: (5e3, 5e3)))


def test_bound_is_that_of_the_largest_of_many() -> None:
    """Šidák: the largest of n independent normal differences exceeds it once in a thousand."""
    for n in (1, 20, 500):
        inside = 1.0 - 2.0 * norm.sf(script().bound(n))
        assert inside**n == pytest.approx(1.0 - script().LEVEL, rel=1e-9)


TABLE = [
    ["name", "unit", "mean", "mcse_mean", "median", "sentence"],
    ["thrust", "N", "0.76", "0.001", "0.761", "the data pull by 0.3 σ"],
    ["tail", "s", "0.06", "0.0005", "0.0601", "the data pull by 1.2 σ"],
]


def changed(row: int, name: str, cell: str) -> list[list[str]]:
    """The table with one cell changed."""
    found = [list(own) for own in TABLE]
    found[row][TABLE[0].index(name)] = cell
    return found


def test_tables_are_judged_by_their_errors() -> None:
    """A mean moves by its error and the median and text follow; ten errors are too many."""
    compare = script().compare_tables
    assert set(verdicts(compare("t", TABLE, TABLE)).values()) == {"equal"}
    near = changed(2, "mean", "0.0607")
    near[2][4], near[2][5] = "0.0609", "the data pull by 1.3 σ"
    findings = compare("t", TABLE, near)
    own = {finding.name: finding for finding in findings}
    assert own["mean"].size == pytest.approx(0.0007 / np.hypot(0.0005, 0.0005))
    assert own["median"].verdict == own["sentence"].verdict == "no error"
    assert agrees(*findings)
    assert not agrees(*compare("t", TABLE, changed(2, "mean", "0.067")))
    # a median alone has no draws to follow
    assert not agrees(*compare("t", TABLE, changed(2, "median", "0.0609")))
    assert not agrees(*compare("t", TABLE, changed(2, "unit", "ms")))


def test_ranks_may_move_where_draws_differ_by_rounding() -> None:
    """R-hat is made of ranks: beside rounding it is told, alone it fails."""
    header = ["name", "mean", "mcse_mean", "rhat"]
    old = [header, ["thrust", "0.76", "0.001", "1.0010"]]
    compare = script().compare_tables
    assert agrees(*compare("t", old, [header, ["thrust", "0.7600000000000002", "0.001", "1.0011"]]))
    assert not agrees(*compare("t", old, [header, ["thrust", "0.76", "0.001", "1.0011"]]))


def test_rows_in_another_order_are_matched_by_their_texts() -> None:
    """The same rows in another order are equal; a row of one side only is told."""
    compare = script().compare_tables
    assert agrees(*compare("t", TABLE, [TABLE[0], TABLE[2], TABLE[1]]))
    findings = compare("t", TABLE, TABLE[:2])
    assert [own.note for own in findings if own.verdict == "one side"] == ["old only"]
    assert not agrees(*findings)


TREE = {
    "causes": [
        {"name": "none", "log_bayes_factor": 0.0, "log_evidence_se": None},
        {"name": "leak", "log_bayes_factor": 9.0, "log_evidence_se": 0.02, "mean": 2e-4},
    ],
    "verdict": "gain",
    "command": ["old"],
}


def with_leak(**values: Any) -> dict[str, Any]:
    """The tree with other values of the leak, made by another command."""
    tree = json.loads(json.dumps(TREE))
    tree["causes"][1] |= values
    return {**tree, "command": ["new"]}


def test_trees_are_compared_leaf_by_leaf() -> None:
    """Evidence moves within its error, and a size follows; a verdict or far evidence does not."""
    compare = script().compare_trees
    assert agrees(*compare("d", TREE, with_leak()))
    assert agrees(*compare("d", TREE, with_leak(log_bayes_factor=9.05, mean=2.1e-4)))
    assert not agrees(*compare("d", TREE, with_leak(log_bayes_factor=9.5)))
    assert not agrees(*compare("d", TREE, with_leak(mean=2.1e-4)))
    assert not agrees(*compare("d", TREE, {**TREE, "verdict": "no gain"}))
    assert not agrees(*compare("d", TREE, {**TREE, "more": 1}))
    turned = {**TREE, "causes": TREE["causes"][::-1]}
    assert verdicts(compare("d", TREE, turned))["causes in order"] == "no error"
    moved = compare(
        "d", TREE, {**turned, "causes": [with_leak(log_bayes_factor=9.05)["causes"][1]]}
    )
    assert "one side" in verdicts(moved).values()


def test_a_part_without_findings_is_no_agreement() -> None:
    """Nothing compared is nothing shown, though commands have ended alike."""
    assert not agrees()
    status = script().Finding(script().STATUS, "part", "equal")
    assert not agrees(status)
    found = script().sentence(script().Comparison({"part": [status]}))
    assert found == "NOT COMPARED: part; DIFFERENT: 0."


def test_parts_bring_what_they_need() -> None:
    """A diagnosis needs simulated telemetry; a part that is none is refused by name."""
    assert script().chosen_parts("diagnosis") == ["leaking", "diagnosis"]
    assert script().chosen_parts("sweep, prediction") == ["flight", "sweep", "prediction"]
    assert script().chosen_parts("") == list(script().PARTS)
    with pytest.raises(SystemExit, match="nothing: not among simulated"):
        script().chosen_parts("nothing")


PACKAGE = """
import pathlib, sys
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
out.mkdir(parents=True)
(out / "summary.csv").write_text("name,mean,mcse_mean\\nthrust,{mean},0.001\\n")
(out / "resolved.toml").write_text(f'events = "{{pathlib.Path(__file__).parent}}"')
(out / "report.html").write_text("made in {seconds} s by {maker}")
{end}
"""


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository whose package writes a summary, and a script with one step that calls it."""
    folder = tmp_path / "repository"
    folder.mkdir()
    monkeypatch.setattr(script(), "ROOT", folder)
    subprocess.run(["git", "init", "--quiet", str(folder)], check=True)
    step = lambda side, _: ["run", "--out", str(side.out / "part" / "run")]  # noqa: E731
    monkeypatch.setattr(script(), "PARTS", {"part": (step,)})
    monkeypatch.setattr(script(), "NEEDS", {})
    return folder


def commit(folder: Path, tag: str, **values: Any) -> None:
    """A commit whose package writes other values."""
    package = folder / "cassini_bayes"
    package.mkdir(exist_ok=True)
    (package / "__init__.py").touch()
    own = {"mean": 0.76, "seconds": 1, "maker": "us", "end": "", **values}
    (package / "__main__.py").write_text(PACKAGE.format(**own))
    identity = ["-c", "user.name=test", "-c", "user.email=test@example.com"]
    for command in (["add", "."], [*identity, "commit", "-qm", tag], ["tag", tag]):
        subprocess.run(["git", "-C", str(folder), *command], check=True)


def compared(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """Exit status of the script."""
    monkeypatch.setattr(sys, "argv", ["compare_commits.py", *arguments])
    with pytest.raises(SystemExit) as stop:
        script().main()
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_two_commits_are_compared_and_leave_nothing_behind(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """Equal, within error, beyond it, and a command that fails: status, page, no worktree left."""
    commit(repository, "first")
    commit(repository, "slower", seconds=2, maker="them")
    commit(repository, "near", mean=0.761)
    commit(repository, "far", mean=0.80)
    commit(repository, "broken", end="sys.exit('no')")
    commit(repository, "wrong", end="raise ValueError")
    out = tmp_path / "out"
    assert compared(monkeypatch, "first", "slower", "--out", str(out)) == 0
    assert "equal bit for bit" in (out / "comparison.md").read_text()
    assert "page or figure that differs: part/run/report.html" in capsys.readouterr().out
    assert compared(monkeypatch, "first", "near") == 0
    assert "0.71 Monte Carlo standard errors" in capsys.readouterr().out
    assert compared(monkeypatch, "first", "far", "--keep", str(tmp_path / "kept")) == 1
    assert "FAILED part/run/summary.csv: mean" in capsys.readouterr().out
    assert (tmp_path / "kept" / "new" / "part" / "run" / "summary.csv").exists()
    assert compared(monkeypatch, "first", "broken") == 1
    assert "new ended with 1: no" in capsys.readouterr().out
    assert compared(monkeypatch, "wrong", "wrong") == 1
    assert "old ended with 1: ValueError" in capsys.readouterr().out
    listed = script().git("worktree", "list").splitlines()
    assert len(listed) == 1


def test_an_interrupt_removes_the_worktrees(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C in the middle of the work: no worktree is left, and no child."""
    commit(repository, "first")

    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(script(), "compare_sides", interrupted)
    monkeypatch.setattr(sys, "argv", ["compare_commits.py", "first", "first"])
    monkeypatch.setattr(script().tempfile, "mkdtemp", lambda **_: str(tmp_path / "work"))
    with pytest.raises(KeyboardInterrupt):
        script().main()
    assert not (tmp_path / "work").exists()
    assert len(script().git("worktree", "list").splitlines()) == 1
