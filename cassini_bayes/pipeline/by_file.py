"""Sweeps of a finished run and trends of a mission, by the file that asks for them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cassini_bayes.files.checks import check_seed
from cassini_bayes.model.gather import PathLike
from cassini_bayes.model.mission.mission_file import read_mission_file
from cassini_bayes.pipeline.run import Quiet, Reporter
from cassini_bayes.pipeline.run_file import read_run_file
from cassini_bayes.pipeline.sweep_run import SweepOutcome, execute_sweep
from cassini_bayes.pipeline.trend_run import TrendOutcome, execute_trend
from cassini_bayes.sweep.specification import SweepFile, check_sweep, read_sweep_file


def sweep(
    run_file: PathLike,
    *,
    spec: PathLike | None = None,
    quantities: Sequence[str] | None = None,
    refit: str | None = None,
    fit: PathLike | None = None,
    accept: Sequence[str] = (),
    leave_out: bool = False,
    jobs: int | None = None,
    dask: str | None = None,
    report: bool = True,
    page: PathLike | None = None,
    reporter: Reporter | None = None,
    command: Sequence[str] = ("cassini_bayes.sweep",),
) -> SweepOutcome:
    """How much a finished run leans on its priors: widths and centres of every block changed.

    Draws are weighted by prior ratio p'(θ) / p(θ) where Pareto k̂ allows it, fitted anew elsewhere.
    The same call goes on after a stop.

    Parameters
    ----------
    run_file
        The run file.
    spec
        Sweep file; without one, every block.
    quantities
        Which to watch, names or patterns as in ``summary.csv``.
    refit
        ``auto``, ``always`` or ``never``.
    fit
        Folder of the finished run, if it is not where the run file says.
    accept, leave_out
        Mistakes that the caller accepts, and whether bad cells are left out.
    jobs, dask
        Processes, or the address of a Dask scheduler.
    report
        Whether to draw figures and add a section to the run's page.
    page
        A results page to write (.md).
    reporter, command
        Told of progress; what goes into the page.

    Raises
    ------
    InputError
        No fit there, or one of another model; an unknown block or quantity.
    """
    path = Path(run_file)
    run = read_run_file(path).accepting(accept, leave_out=leave_out)
    where = "command line" if spec is None else str(spec)
    # a name alone stays one, and is refused as no list
    watched = quantities if isinstance(quantities, str) else list(quantities or ())
    wanted = _sweep_file(spec, where, {"quantities": watched or None, "refit": refit})
    return execute_sweep(
        run,
        path.parent,
        Path(fit) if fit is not None else path.parent / (run.output.folder or path.stem),
        wanted,
        where,
        jobs=jobs,
        dask=dask,
        report=report,
        reporter=reporter or Quiet(),
        page=None if page is None else Path(page),
        command=command,
    )


def _sweep_file(spec: PathLike | None, where: str, options: dict[str, Any]) -> SweepFile:
    """The sweep file, or the defaults without one, with the options that were given."""
    wanted = SweepFile() if spec is None else read_sweep_file(Path(spec))
    given = {key: value for key, value in options.items() if value is not None}
    return check_sweep({**wanted.model_dump(), **given}, where) if given else wanted


def trend(
    mission_file: PathLike,
    folder: PathLike | None = None,
    *,
    seed: int | None = None,
    accept: Sequence[str] = (),
    leave_out: bool = False,
    report: bool = True,
    reporter: Reporter | None = None,
    command: Sequence[str] = ("cassini_bayes.trend",),
) -> TrendOutcome:
    """Thrust and health of every thruster over a mission.

    The same call goes on where a killed one stopped, and with events added.

    Parameters
    ----------
    mission_file
        Mission file.
    folder
        Where to write; beside the mission file by default.
    seed
        Overrides that of the file.
    accept, leave_out
        Mistakes that data were refused for and that are none; whether bad cells are left out.
    report
        Whether to draw figures and write the page.
    reporter, command
        Told of stages; what goes into the record.

    Raises
    ------
    InputError
        Bad mission file, events or priors.
    """
    path = Path(mission_file)
    mission = read_mission_file(path).accepting(accept, leave_out=leave_out)
    if seed is not None:
        table = mission.trend.model_copy(update={"seed": check_seed(seed)})
        mission = mission.model_copy(update={"trend": table})
    return execute_trend(
        mission,
        str(path),
        path.parent,
        Path(folder) if folder is not None else path.parent / path.stem,
        name=path.stem,
        command=command,
        reporter=reporter or Quiet(),
        report=report,
    )
