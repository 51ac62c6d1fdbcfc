"""Sweeps from the command line: killed and resumed, on Dask, in the report, as JSON."""

from __future__ import annotations

import itertools
import json
import os
import signal
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import tomli_w
from numpy.typing import NDArray
from run_cases import B_BRANCH, FLIGHT, Forked, command, small_table, write_run
from sweep_cases import small_fit, toy_baseline

import cassini_bayes as cb
from cassini_bayes.computing.log import silent
from cassini_bayes.computing.workers import LocalWorkers, workers_at
from cassini_bayes.errors import InputError
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.pieces import finished as finished_cell
from cassini_bayes.files.pieces import run_pieces
from cassini_bayes.files.storage import digest, is_leftover
from cassini_bayes.pipeline import by_file
from cassini_bayes.pipeline.provenance import recorded
from cassini_bayes.pipeline.run import write_results
from cassini_bayes.report.sweep import BEGIN, END, section_in, with_section
from cassini_bayes.results.record import save_fit
from cassini_bayes.sweep.cells import cell_arrays
from cassini_bayes.sweep.specification import SweepFile, check_sweep, read_sweep_file
from cassini_bayes.sweep.variations import Variation

ROOT = Path(__file__).parents[2]
PAGE = """<html><ol>
<li><a href="#provenance">Provenance</a></li>
</ol><main>
<section>
<h2 id="provenance">Provenance</h2>
</section>
</main></html>"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run file and its finished run (fit.nc and a report)."""
    folder = tmp_path_factory.mktemp("sweep")
    write_run(folder, small_table())
    run = folder / "small"
    run.mkdir()
    save_fit(small_fit()[1], run / "fit.nc")
    (run / "report.html").write_text(PAGE)
    return folder


def write_spec(folder: Path, name: str = "spec.toml", **changes: object) -> Path:
    """A sweep of two blocks and some quantities."""
    table = {
        "quantities": ["thrust_level_n[z1]", "tau_fall_s"],
        "blocks": ["tail-off", "wheel alignment"],
        "draws": 1_000,
        "grid": {"widths": [0.5, 4.0], "families": ["uniform"]},
        **changes,
    }
    path = folder / name
    path.write_text(tomli_w.dumps(table))
    return path


def sweep(folder: Path, spec: Path, *more: str) -> int:
    """Exit status of a sweep of the finished run."""
    return command(["sweep", str(folder / "small.toml"), "--spec", str(spec), *more])


def test_sweep_writes_tables_figures_and_a_section_of_the_report(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One command: JSON on stdout, CSV files, figures, and the report's section, once."""
    spec = write_spec(finished)
    assert sweep(finished, spec, "--jobs", "1", "--json", "--quiet") == 0
    told = json.loads(capsys.readouterr().out)
    target = finished / "small" / "sweep"
    table = pd.read_csv(target / "sweep.csv")
    assert told["cells"] * 2 == int(table["reported"].sum())
    assert len(told["sweep"]) == len(table)
    assert {"reweighted", "re-fitted"} <= set(table["estimate"])
    assert table["pareto_k"].notna().all()
    for name in ("baseline", "scaling", "knowledge", "data_worth", "conflict"):
        assert (target / f"{name}.csv").exists()
        assert told[name]
    assert {"tornado_1.png", "overlay_2.svg", "worth.png"} <= {
        path.name for path in (target / "figures").iterdir()
    }
    html = (finished / "small" / "report.html").read_text()
    assert html.count(BEGIN) == html.count('<a href="#sweep">') == 1
    assert html.index('id="sweep"') < html.index('id="provenance"')


def finished_cells(cells: Path) -> set[Path]:
    """Files of finished cells, without what a killed write left behind."""
    return {path for path in cells.glob("*/*.npz") if not is_leftover(path)}


def kill_in_the_middle(monkeypatch: pytest.MonkeyPatch, cell: int, *, half_written: bool) -> None:
    """Let this process, or its child, kill itself at a cell, before or while it is stored."""
    save, stored = CheckpointStore.save, itertools.count(1)

    def deadly(
        store: CheckpointStore, name: str, arrays: Mapping[str, NDArray[np.generic]]
    ) -> None:
        if next(stored) < cell:
            save(store, name, arrays)
            return
        if half_written:
            monkeypatch.setattr(Path, "replace", lambda *_: os.kill(os.getpid(), signal.SIGKILL))
            save(store, name, arrays)
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(CheckpointStore, "save", deadly)


def killed_sweep(folder: Path) -> list[str]:
    """Arguments of the sweep that is killed: few cells, with a seed of their own."""
    grid = {"widths": [0.5, 4.0], "shifts": [1.0], "families": []}
    spec = write_spec(folder, "killed.toml", seed=77, grid=grid)
    arguments = ["sweep", str(folder / "small.toml"), "--spec", str(spec), "--jobs", "1"]
    return [*arguments, "--no-report", "--quiet"]


@pytest.fixture(scope="module")
def uninterrupted(finished: Path) -> bytes:
    """Table of that sweep left alone; its cells are taken away again."""
    cells = finished / "small" / "sweep" / "cells"
    before = finished_cells(cells)
    assert command(killed_sweep(finished)) == 0
    for path in finished_cells(cells) - before:
        path.unlink()
    return (finished / "small" / "sweep" / "sweep.csv").read_bytes()


@pytest.mark.parametrize("half_written", [False, True], ids=["between", "within"])
def test_killed_sweep_goes_on_without_redoing_finished_cells(
    finished: Path, uninterrupted: bytes, monkeypatch: pytest.MonkeyPatch, half_written: bool
) -> None:
    """Killed at a random cell: finished ones stay as they are, the table is the uninterrupted one.

    The child kills itself, so that where it dies does not depend on how fast the machine is.
    """
    arguments = killed_sweep(finished)
    cells = finished / "small" / "sweep" / "cells"
    before = finished_cells(cells)
    last = int(np.random.default_rng(11 + half_written).integers(3, 9))
    with monkeypatch.context() as patch:
        kill_in_the_middle(patch, last, half_written=half_written)
        child = Forked.start(arguments, finished / "killed.log")
        assert child.wait() == -signal.SIGKILL
    done = {path: path.stat().st_mtime_ns for path in finished_cells(cells) - before}
    assert len(done) == last - 1
    assert any(is_leftover(path) for path in cells.rglob("*")) == half_written
    assert command(arguments) == 0
    every = finished_cells(cells) - before
    assert len(every) > len(done)
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in done.items())
    assert not any(is_leftover(path) for path in cells.rglob("*"))
    assert (finished / "small" / "sweep" / "sweep.csv").read_bytes() == uninterrupted
    for path in every:
        path.unlink()


@pytest.mark.slow
def test_two_dask_workers_give_the_same_cells(tmp_path: Path) -> None:
    """A local cluster of two worker processes gives bit for bit what this process gives."""
    distributed = pytest.importorskip("distributed")
    baseline = toy_baseline(500)
    names = ("cm_x_m", "cm_y_m")
    cells = {
        cell.key: (cell, "auto")
        for cell in (
            Variation("pair", "width", names, amount=0.5),
            Variation("pair", "width", names, amount=4.0),
            Variation("pair", "shift", ("cm_x_m",), amount=1.0),
        )
    }
    local = CheckpointStore(tmp_path / "local", "same")
    here = LocalWorkers(1)
    assert list(run_pieces(cell_arrays, baseline, cells, local, here))[-1] == (3, 3)
    remote = CheckpointStore(tmp_path / "dask", "same")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        workers_at(1, cluster.scheduler_address) as there,
    ):
        assert list(run_pieces(cell_arrays, baseline, cells, remote, there))[-1] == (3, 3)
    for name in cells:
        ours, theirs = finished_cell(local, name), finished_cell(remote, name)
        assert ours.keys() == theirs.keys()
        assert all(np.array_equal(ours[key], theirs[key]) for key in ours)


def test_processes_give_the_same_cells(tmp_path: Path) -> None:
    """Two local processes give what one thread gives; a second run works out nothing."""
    baseline = toy_baseline(2_000)
    cell = Variation("pair", "width", ("cm_x_m", "cm_y_m"), amount=0.5)
    cells = {cell.key: (cell, "auto"), "same-again": (cell, "auto")}
    stores = [CheckpointStore(tmp_path / str(jobs), "same") for jobs in (1, 2)]
    for jobs, store in enumerate(stores, start=1):
        workers = LocalWorkers(jobs)
        assert list(run_pieces(cell_arrays, baseline, cells, store, workers))[-1] == (2, 2)
        assert list(run_pieces(cell_arrays, baseline, cells, store, workers)) == [(2, 2)]
    ours, theirs = (finished_cell(store, cell.key) for store in stores)
    assert all(np.array_equal(ours[key], theirs[key]) for key in ours)


def test_no_scheduler_and_no_fit_are_said(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An address where nothing answers, and a run that has no fit yet, end with status 2."""
    pytest.importorskip("distributed")
    spec = write_spec(finished)
    assert sweep(finished, spec, "--fit", str(tmp_path), "--quiet") == 2
    assert "run it first" in capsys.readouterr().err
    with pytest.raises(InputError, match="Dask scheduler"), workers_at(1, "nonsense://nowhere"):
        pass


def test_a_changed_input_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Priors edited since the fit are named; without a record of the run (control) none are."""
    priors, run = tmp_path / "priors.toml", tmp_path / "small"
    priors.write_bytes(B_BRANCH.read_bytes())
    write_run(tmp_path, small_table() | {"priors": "priors.toml"})
    run.mkdir()
    save_fit(small_fit()[1], run / "fit.nc")
    record = run / "provenance.json"
    digests = {"priors.toml": digest(priors), str(FLIGHT): digest(FLIGHT)}
    record.write_text(recorded({}, digests, 1, ()).as_json())
    arguments = (tmp_path, write_spec(tmp_path), "--jobs", "1", "--quiet", "--no-report")
    text = priors.read_text("utf-8")
    old = '[parameters.tau_fall_s]\ndist = "norm"\nloc = 0.050'
    assert old in text
    priors.write_text(text.replace(old, old.replace("0.050", "0.060")), "utf-8")
    assert sweep(*arguments) == 2
    assert "fit again: the content of priors.toml changed since" in capsys.readouterr().err
    record.unlink()
    assert sweep(*arguments) == 2
    assert "fit again: its data or the model changed since" in capsys.readouterr().err


def test_sweep_files_are_checked() -> None:
    """The shipped file reads; a misspelt key, a wrong width, an unknown family are refused."""
    shipped = read_sweep_file(ROOT / "runs" / "sweeps" / "flight_2009_2010.toml")
    assert shipped == SweepFile(quantities=["thrust_level_n", "thrust_common_n", "tau_fall_s"])
    for table, message in (
        ({"quantites": ["x"]}, "did you mean 'quantities'"),
        ({"grid": {"widhts": [2.0]}}, "did you mean 'widths'"),
        ({"grid": {"widths": [-1.0]}}, "a factor above 0"),
        ({"grid": {"families": ["cauchy"]}}, "families"),
        ({"refit": "maybe"}, "refit"),
        ({"group": [{"name": "own"}]}, "parameters"),
        ({"quantities": []}, "a list of at least one"),
        ({"grid": 3}, "a table"),
        ({"blocks": ["mass", "mass"]}, "differ from each other"),
        ({"blocks": ["mass"], "group": [{"name": "mass", "parameters": ["a"]}]}, "differ"),
        ({"group": [{"name": "events", "parameters": ["a"]}]}, "kept for leaving events out"),
        ({"group": [{"name": "own", "parameters": ["a", "a"]}]}, "each parameter once"),
    ):
        with pytest.raises(InputError, match=message):
            check_sweep(table, "spec.toml")


def test_the_section_replaces_an_earlier_one() -> None:
    """Twice into the same page is once; a page without the report's marks gets it at its end."""
    once = with_section(PAGE, f"{BEGIN}\nfirst\n{END}\n")
    twice = with_section(once, f"{BEGIN}\nsecond\n{END}\n")
    assert "first" in once
    assert twice == once.replace("first", "second")
    assert with_section("<main><p>old</p></main>", "NEW") == "<main><p>old</p>NEW</main>"


def test_a_sweep_of_a_fit_that_has_not_converged_ends_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As what else is made of such a fit does; its tables are there all the same."""
    write_run(tmp_path, small_table())
    (tmp_path / "small").mkdir()
    fit = small_fit()[1]
    worse = replace(fit, attributes={**fit.attributes, "stop_rule": "R-hat 1.08"})
    save_fit(worse, tmp_path / "small" / "fit.nc")
    assert sweep(tmp_path, write_spec(tmp_path), "--jobs", "1", "--json", "--no-report") == 1
    shown = capsys.readouterr()
    assert json.loads(shown.out)["converged"] is False
    assert "not converged: " in shown.err


def test_the_page_made_again_keeps_the_section_of_its_own_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Written anew, the page has it where it was; once the fit is another one it has none."""
    run, fit = tmp_path / "small", small_fit()[1]
    write_run(tmp_path, small_table())
    run.mkdir()
    save_fit(fit, run / "fit.nc")
    (run / "report.html").write_text(PAGE)
    grid = {"widths": [2.0], "shifts": [], "families": [], "events": False}
    spec = write_spec(tmp_path, blocks=["tail-off"], grid=grid)
    assert sweep(tmp_path, spec, "--jobs", "1", "--quiet") == 0
    swept = (run / "report.html").read_text()
    assert section_in(swept, digest(run / "fit.nc"))
    # what the page says besides, and its pictures, take seconds
    monkeypatch.setattr("cassini_bayes.report.render_report", lambda *_: PAGE)
    monkeypatch.setattr("cassini_bayes.pipeline.run.sections_of", lambda _: [])
    review: Any = SimpleNamespace(summary=pd.DataFrame())
    write_results(review, run, silent, report=True)
    assert (run / "report.html").read_text() == swept
    save_fit(replace(fit, attributes={**fit.attributes, "walkers": 2}), run / "fit.nc")
    write_results(review, run, silent, report=True)
    assert (run / "report.html").read_text() == PAGE


def test_quantities_may_be_a_tuple(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Any sequence is; a name alone is none, and refused as before."""
    seen: list[SweepFile] = []

    def execute(*given: object, **_: object) -> None:
        found = given[3]
        assert isinstance(found, SweepFile)
        seen.append(found)

    monkeypatch.setattr(by_file, "execute_sweep", execute)
    run_file = write_run(tmp_path, small_table())
    cb.sweep(run_file, quantities=("tau_fall_s", "thrust_n"))
    assert seen[-1].quantities == ["tau_fall_s", "thrust_n"]
    with pytest.raises(InputError, match="quantities"):
        cb.sweep(run_file, quantities="tau_fall_s")
