"""A run folder: what is written and when, what is refused, and that nothing is lost on the way."""

from __future__ import annotations

import csv
import errno
import json
import os
import shutil
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from prediction_cases import write_earlier
from run_cases import A_BRANCH, B_BRANCH, EVENTS, FLIGHT, RECORD, small_table

import cassini_bayes as cb
from cassini_bayes.computing.arviz_import import arviz, corner
from cassini_bayes.errors import InputError
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.storage import digest
from cassini_bayes.pipeline import diagnoses
from cassini_bayes.pipeline.fits import result_of
from cassini_bayes.pipeline.inputs import read_inputs
from cassini_bayes.pipeline.run import Outcome, execute, prepare_folder, refuse_own_earlier
from cassini_bayes.pipeline.run_file import RunFile, check_run
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.results.exchange import MOST_REPLICATES
from cassini_bayes.results.record import read_fit
from cassini_bayes.sampling.ensembles import ProgressReport

pytestmark = pytest.mark.usefixtures("short_warm_start")
RECORD_OF_A_DIAGNOSIS = 'events = ["e.csv"]\npriors = "p.toml"\nown_effects = []\ngain = true\n'


class Silent:
    """A reporter that keeps what it is told."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.reports: list[ProgressReport] = []

    def log(self, text: str) -> None:
        """Keep a line."""
        self.lines.append(text)

    def progress(self, report: ProgressReport) -> None:
        """Keep a report."""
        self.reports.append(report)


def run_of(**changes: object) -> RunFile:
    """The small run with some of its tables changed."""
    return check_run(small_table() | changes, "test")


def do(run: RunFile, folder: Path, *, force: bool = False, resume: bool = False) -> Outcome:
    """Execute a run quietly."""
    reporter = Silent()
    return execute(
        run,
        Path(),
        folder,
        name="small",
        command=["test"],
        reporter=reporter,
        force=force,
        resume=resume,
    )


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """One small run that several tests look at, and none changes."""
    return do(run_of(), tmp_path_factory.mktemp("finished") / "small")


def test_a_run_folder_is_complete(finished: Outcome) -> None:
    """Settings, provenance, checkpoints, fit and tables, and no leftovers."""
    folder = finished.folder
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "resolved.toml",
        "provenance.json",
        "checkpoint",
        "fit.nc",
        "summary.csv",
        "tables",
    }
    resolved = tomllib.loads((folder / "resolved.toml").read_text())
    assert RunFile.model_validate(resolved) == run_of()
    assert resolved["sampler"]["seed"] == 2010  # a default, filled in
    provenance = json.loads((folder / "provenance.json").read_text())
    assert provenance["sha256"][str(B_BRANCH)] == digest(B_BRANCH)
    assert provenance["sha256"][str(FLIGHT)] == digest(FLIGHT)
    assert provenance["seed"] == 2010
    assert provenance["command"] == ["test"]
    assert {"python", "emcee", "numpy"} <= set(provenance["versions"])
    with (folder / "summary.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    thrusts = [row for row in rows if row["quantity"] == "thrust_n"]
    assert len(thrusts) == len(EVENTS) * 8
    assert read_fit(folder / "fit.nc").posterior.sizes["event"] == len(EVENTS)
    assert not finished.converged  # a hundred steps are not enough, and it says so
    assert "limit" in finished.review.warnings[0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"output": {"draws_per_ensemble": 500}}, "test: output.draws_per_ensemble: expected"),
        ({"sampler": {"ensembles": 2, "walkers": 2, "target_ess": 100}}, "run: sampler.walkers"),
    ],
)
def test_settings_that_cannot_be_used_cost_no_earlier_run(
    finished: Outcome, tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    """With --force they are refused before anything is removed, and name the file they are of."""
    folder = shutil.copytree(finished.folder, tmp_path / "run")
    with pytest.raises(InputError, match=message):
        do(run_of(**{"sampler": {"target_ess": 10_000}, **changes}), folder, force=True)
    assert (folder / "fit.nc").read_bytes() == (finished.folder / "fit.nc").read_bytes()


def test_settings_are_written_before_sampling(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that stops at its first checkpoint has left its settings and provenance."""

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(CheckpointStore, "save", stop)
    with pytest.raises(KeyboardInterrupt):
        do(run_of(), tmp_path / "small")
    assert {path.name for path in (tmp_path / "small").iterdir()} == {
        "resolved.toml",
        "provenance.json",
    }


def test_arviz_takes_a_fit_of_totals(finished: Outcome) -> None:
    """Summary, trace, replicates, leaving one out with a k̂ an event, sensitivity, corner."""
    az, own = arviz(), result_of(finished.review).to_arviz()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert np.isfinite(az.summary(own, var_names=["thrust_n"])["mean"]).all()
        az.plot_trace(own, var_names=["tau_fall_s"])
        assert (
            own.posterior_predictive.sizes["draw"] <= MOST_REPLICATES < own.posterior.sizes["draw"]
        )
        az.plot_ppc(own, var_names=["on_time_s"], num_pp_samples=3)
        assert az.loo(own, pointwise=True).pareto_k.sizes == {"event": len(EVENTS)}
        for component in ("prior", "likelihood"):
            found = az.psens(own, component=component, var_names=["tau_fall_s"])
            assert np.isfinite(float(found))
        corner().corner(own, var_names=["thrust_common_n", "tau_fall_s"])


def test_an_existing_run_is_refused_and_untouched(finished: Outcome) -> None:
    """Neither --force nor --resume: refused with both named, not a byte changed."""
    before = {path: path.stat().st_mtime_ns for path in finished.folder.rglob("*")}
    with pytest.raises(InputError, match="--resume to go on") as caught:
        do(run_of(), finished.folder)
    assert "--force" in caught.value.fix
    assert {path: path.stat().st_mtime_ns for path in finished.folder.rglob("*")} == before


@pytest.mark.parametrize(
    "changes",
    [
        {"priors": str(A_BRANCH)},
        {"priors": "missing.toml"},
        {"events": ["missing.csv"]},
        {"source": "gsw_ideal"},
        {"sampler": {"walkers": 4}},
    ],
)
def test_force_costs_nothing_when_the_inputs_are_bad(
    tmp_path: Path, changes: dict[str, object]
) -> None:
    """An old run is removed only once everything that can be checked has been."""
    folder = tmp_path / "small"
    folder.mkdir()
    (folder / "resolved.toml").write_text(RECORD)
    with pytest.raises(InputError):
        do(run_of(**changes), folder, force=True)
    assert (folder / "resolved.toml").read_text() == RECORD


def test_a_finished_run_resumed_has_the_same_file(finished: Outcome, tmp_path: Path) -> None:
    """Byte by byte: what was made of the fit, such as a sweep's section, is still of it."""
    folder = shutil.copytree(finished.folder, tmp_path / "run")
    do(run_of(), folder, resume=True)
    assert (folder / "fit.nc").read_bytes() == (finished.folder / "fit.nc").read_bytes()


def test_force_replaces_runs_only(tmp_path: Path) -> None:
    """--force clears a run; a folder of something else, or a file, is refused and kept."""
    old = tmp_path / "old"
    (old / "checkpoint").mkdir(parents=True)
    (old / "resolved.toml").write_text(RECORD)
    (old / "checkpoint" / "block_0000.npz").write_text("")
    (old / "sweep").mkdir()
    (old / "sweep" / "sweep.csv").write_text("of the fit that goes")
    prepare_folder(old, force=True, resume=False)
    assert list(old.iterdir()) == []
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "chapter.tex").write_text("years of work")
    for force in (True, False):
        with pytest.raises(InputError, match="only replaces a run"):
            prepare_folder(other, force=force, resume=False)
        with pytest.raises(InputError, match="a file"):
            prepare_folder(other / "chapter.tex", force=force, resume=False)
    assert (other / "chapter.tex").read_text() == "years of work"


def test_force_keeps_the_fit_that_the_priors_begin_with(tmp_path: Path) -> None:
    """Neither a run nor a diagnosis goes into its folder; into another (control) they may."""
    folder, priors = tmp_path / "run", tmp_path / "next.toml"
    earlier = write_earlier(folder / "fit.nc")
    (folder / "resolved.toml").write_text(RECORD)
    priors.write_text(f'from_fit = "run/fit.nc"\n{B_BRANCH.read_text()}')
    before = earlier.read_bytes()
    with pytest.raises(InputError, match=r"that the priors begin with, got .*run/fit\.nc"):
        do(run_of(priors=str(priors)), folder, force=True)
    with pytest.raises(InputError, match="choose another --out"):
        cb.diagnose(f"{FLIGHT}:{EVENTS[0]}", priors, folder=folder, force=True)
    assert earlier.read_bytes() == before
    assert (folder / "resolved.toml").read_text() == RECORD
    refuse_own_earlier(read_priors(priors), tmp_path / "other")


@pytest.mark.parametrize("text", ["", "a = [", 'title = "how a dispute was resolved"\n'])
@pytest.mark.parametrize("force", [True, False])
def test_a_file_of_the_same_name_makes_no_run(tmp_path: Path, force: bool, text: str) -> None:
    """A user's own resolved.toml, and what lies beside it under names that runs use, stay."""
    (tmp_path / "resolved.toml").write_text(text)
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "mine.png").write_text("weeks of work")
    with pytest.raises(InputError, match="only replaces a run"):
        prepare_folder(tmp_path, force=force, resume=False)
    assert (tmp_path / "resolved.toml").read_text() == text
    assert (tmp_path / "figures" / "mine.png").exists()


@pytest.mark.parametrize("how", [{}, {"force": True}, {"resume": True}])
def test_runs_and_diagnoses_leave_each_other_alone(tmp_path: Path, how: dict[str, bool]) -> None:
    """A diagnosis does not go into a run's folder, nor a run into that of a diagnosis."""
    run, diagnosis = tmp_path / "run", tmp_path / "diagnosis"
    for folder, record, result in (
        (run, RECORD, "fit.nc"),
        (diagnosis, RECORD_OF_A_DIAGNOSIS, "diagnosis.json"),
    ):
        folder.mkdir()
        (folder / "resolved.toml").write_text(record)
        (folder / result).write_text("days of work")
    what = "to resume, got none there" if how.get("resume") else "something else; --force only"
    with pytest.raises(InputError, match=what):
        do(run_of(), diagnosis, **how)
    with pytest.raises(InputError, match=what):
        cb.diagnose(f"{FLIGHT}:{EVENTS[0]}", B_BRANCH, folder=run, **how)
    assert (run / "resolved.toml").read_text() == RECORD
    assert (diagnosis / "resolved.toml").read_text() == RECORD_OF_A_DIAGNOSIS
    assert {path.name for path in tmp_path.glob("*/*")} == {
        "resolved.toml", "fit.nc", "diagnosis.json"
    }  # fmt: skip
    if "force" in how:  # control: each replaces its own
        prepare_folder(run, force=True, resume=False)
        kind = {"result": "diagnosis.json", "written": diagnoses.WRITTEN}
        prepare_folder(diagnosis, force=True, resume=False, own_key=diagnoses.OWN_KEY, **kind)
        assert not list(tmp_path.glob("*/*"))


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    """A folder with nothing in it, or with a killed write's leftover, is as good as new."""
    (tmp_path / ".resolved.toml.x8.partial.toml").write_text("half")
    prepare_folder(tmp_path, force=False, resume=False)
    assert not list(tmp_path.iterdir())


def test_force_cut_short_can_be_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A removal that fails half-way leaves what makes it a run, so --force works again."""
    folder = tmp_path / "old"
    (folder / "checkpoint").mkdir(parents=True)
    (folder / "resolved.toml").write_text(RECORD)

    def fail(*_: object) -> None:
        raise OSError(errno.EACCES, os.strerror(errno.EACCES))

    with monkeypatch.context() as patch:
        patch.setattr("cassini_bayes.pipeline.run.shutil.rmtree", fail)
        with pytest.raises(OSError, match="denied"):
            prepare_folder(folder, force=True, resume=False)
    assert (folder / "resolved.toml").exists()
    prepare_folder(folder, force=True, resume=False)
    assert list(folder.iterdir()) == []


def test_a_start_without_draws_is_no_run(tmp_path: Path) -> None:
    """What a start left that never got to a checkpoint needs no --force, and can be resumed."""
    (tmp_path / "resolved.toml").write_text(RECORD)
    (tmp_path / "provenance.json").write_text("{}")
    prepare_folder(tmp_path, force=False, resume=True)
    prepare_folder(tmp_path, force=False, resume=False)
    assert not list(tmp_path.iterdir())
    (tmp_path / "resolved.toml").write_text(RECORD)
    (tmp_path / "checkpoint").mkdir()
    (tmp_path / "checkpoint" / "warmstart.npz").write_text("")
    with pytest.raises(InputError, match="existing run"):
        prepare_folder(tmp_path, force=False, resume=False)


def test_force_keeps_what_no_run_wrote(tmp_path: Path) -> None:
    """A user's own file in a run's folder stays where it is."""
    for name in ("resolved.toml", "fit.nc", "notes.txt"):
        (tmp_path / name).write_text(RECORD)
    prepare_folder(tmp_path, force=True, resume=False)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_resume_wants_a_run(tmp_path: Path) -> None:
    """Nothing there to resume: said, nothing made."""
    with pytest.raises(InputError, match="without --resume"):
        prepare_folder(tmp_path / "none", force=False, resume=True)
    assert not list(tmp_path.iterdir())


def test_resume_wins_over_force(finished: Outcome, tmp_path: Path) -> None:
    """The command that replaced a run goes on with it once --resume is added."""
    (finished.folder / ".fit.nc.k1ll.partial.nc").write_text("half")
    prepare_folder(finished.folder, force=True, resume=True)
    assert (finished.folder / "fit.nc").exists()
    assert not list(finished.folder.glob(".*"))


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    """A file stands where a folder is needed."""
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="can be written"):
        do(run_of(), tmp_path / "file" / "small")


@pytest.mark.parametrize("written", ["warmstart.npz", "block_0001.npz", "fit.nc"])
def test_a_full_disk_loses_nothing(
    finished: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: str
) -> None:
    """ENOSPC at any file: one line; resumed with space, the same draws."""
    folder = tmp_path / "small"
    replace: Callable[[Path, Path], Path] = Path.replace

    def full(self: Path, target: Path) -> Path:
        if target.name == written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", full)
        with pytest.raises(InputError, match="No space left") as caught:
            do(run_of(), folder)
    assert caught.value.where.endswith(written)
    assert not list(folder.rglob(".*"))
    assert not list(folder.rglob(written))
    if written != "warmstart.npz":  # the others take seconds each, and go the same way
        return
    do(run_of(), folder, resume=True)
    one, other = (read_fit(path / "fit.nc").posterior for path in (finished.folder, folder))
    assert one.identical(other)


def rows(source: str = "flight") -> list[list[str]]:
    """Header and first two rows of a source."""
    with FLIGHT.open(newline="") as stream:
        header, *lines = csv.reader(stream)
    return [header, *[line for line in lines if line[-1] == source][:2]]


def write_rows(path: Path, cells: list[list[str]]) -> str:
    """A totals file of these cells."""
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(cells)
    return str(path)


def test_ids_are_unique_across_files(tmp_path: Path) -> None:
    """The same event from two files, or twice from one, is refused with both names."""
    one = write_rows(tmp_path / "one.csv", rows())
    two = write_rows(tmp_path / "two.csv", rows()[:2])
    for events in ([one, two], [one, one], [one, f"{one}:{EVENTS[0]}"]):
        with pytest.raises(InputError, match=EVENTS[0]) as caught:
            read_inputs(run_of(events=events), Path())
        assert "once" in caught.value.expected
        assert events[0] in caught.value.got
    assert len(read_inputs(run_of(events=[f"{one}:{id_}" for id_ in EVENTS]), Path()).events) == 2


def test_ids_and_files_may_hold_colons(tmp_path: Path) -> None:
    """file.csv:ID with colons in either is one file in the provenance."""
    cells = rows()
    cells[1][0] = "2009:bias"
    path = write_rows(tmp_path / "a:b.csv", cells)
    inputs = read_inputs(run_of(events=[f"{path}:2009:bias"]), Path())
    assert [event.id for event in inputs.events] == ["2009:bias"]
    assert inputs.digests[path] == digest(Path(path))


def test_the_base_of_relative_paths(tmp_path: Path) -> None:
    """Paths of a run file are relative to it."""
    write_rows(tmp_path / "one.csv", rows())
    (tmp_path / "b.toml").write_bytes(B_BRANCH.read_bytes())
    run = run_of(events=["one.csv"], priors="b.toml")
    assert len(read_inputs(run, tmp_path).events) == 2
    with pytest.raises(InputError):
        read_inputs(run, tmp_path / "elsewhere")


def test_events_of_a_branch_need_priors_of_that_branch() -> None:
    """B-branch events with A-branch priors: refused, both named."""
    with pytest.raises(InputError, match="branch B") as caught:
        read_inputs(run_of(priors=str(A_BRANCH)), Path())
    assert "branch A" in caught.value.expected


def test_wheels_must_be_in_the_priors_file(tmp_path: Path) -> None:
    """An event on wheel 3 with priors for wheels 1, 2 and 4."""
    cells = rows()
    at = cells[0].index
    cells[1][at("wheels")] = "1 2 3"
    for end in ("start", "end"):
        moved = at(f"rwa4_rpm_{end}")
        cells[1][at(f"rwa3_rpm_{end}")], cells[1][moved] = cells[1][moved], ""
    path = write_rows(tmp_path / "one.csv", cells)
    with pytest.raises(InputError, match="wheels") as caught:
        read_inputs(run_of(events=[path]), Path())
    assert "[1, 2, 3]" in caught.value.got
    assert str(B_BRANCH) in caught.value.expected


def test_pulse_counts_are_needed() -> None:
    """The ideal rows of the tables have none: refused, with what to choose instead."""
    with pytest.raises(InputError, match="pulses") as caught:
        read_inputs(run_of(source="gsw_ideal"), Path())
    assert "gsw_ideal" in caught.value.got
