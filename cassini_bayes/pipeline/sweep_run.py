"""The pipeline of one sweep: a run's fit, the cells in parallel, then tables, figures, report.

``<run>/sweep/`` holds ``resolved.toml``, ``cells/<identity>/`` (one file per finished cell),
``sweep.csv``, ``baseline.csv``, ``scaling.csv``, ``knowledge.csv``, ``data_worth.csv``,
``conflict.csv`` and ``figures/``; the run's ``report.html`` gets a section.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
import tomli_w

from cassini_bayes import __version__
from cassini_bayes.computing.workers import workers_at
from cassini_bayes.errors import InputError
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.code import code_digest
from cassini_bayes.files.storage import digest, remove_leftovers, write_text
from cassini_bayes.files.tables import frame_csv
from cassini_bayes.pipeline.inputs import Inputs, read_inputs
from cassini_bayes.pipeline.provenance import changed_inputs
from cassini_bayes.pipeline.run import REPORT, SWEEP, Reporter
from cassini_bayes.pipeline.run_file import RunFile
from cassini_bayes.prediction.sources import PROVENANCE, RESOLVED
from cassini_bayes.report.shown import html_of, with_interval
from cassini_bayes.results.fitting import stop_rule_held
from cassini_bayes.results.record import FIT_FILE, Fit, read_fit
from cassini_bayes.sweep.models import Factory
from cassini_bayes.sweep.plan import Sweep, plan, reported_quantiles
from cassini_bayes.sweep.specification import SweepFile
from cassini_bayes.sweep.tables import SweepTables, tables_of

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure


@dataclass(frozen=True, eq=False, repr=False)
class SweepOutcome:
    """What a sweep produced, and how long it took (cells already stored take none)."""

    folder: Path
    tables: SweepTables
    cells: int
    seconds: float
    findings: tuple[str, ...] = ()  # mistakes that were accepted, and what fits nothing known
    converged: bool = True  # the fit whose priors are varied

    def summary(self) -> pd.DataFrame:
        """One row per quantity and cell: its mean and sd, shift and width against the baseline."""
        return with_interval(self.tables.sweep, "central 90 %")

    def _state(self) -> str:
        quantities = self.tables.baseline["quantity"].nunique()
        doubt = "" if self.converged else "the fit has NOT CONVERGED: this is no result yet; "
        return f"{doubt}{self.cells} cells, {quantities} quantities; in {self.folder}"

    def __repr__(self) -> str:
        return f"SweepOutcome: {self._state()}"

    def _repr_html_(self) -> str:
        return html_of("Sweep of priors", [self._state()], self.tables.baseline)


def execute_sweep(
    run: RunFile,
    base: Path,
    folder: Path,
    sweep: SweepFile,
    where: str,
    *,
    jobs: int | None,
    dask: str | None,
    report: bool,
    reporter: Reporter,
    page: Path | None = None,
    command: Sequence[str] = (),
) -> SweepOutcome:
    """Sweep the priors of a finished run.

    Parameters
    ----------
    run, base
        The run file and the folder its paths are relative to.
    folder
        The run's folder, with ``fit.nc``.
    sweep, where
        The sweep file, and its name for messages.
    jobs, dask
        Local processes, or the address of a Dask scheduler.
    report
        Whether to draw figures and write into the run's report.
    page, command
        A results page to write (.md), with the command line in it.

    Raises
    ------
    InputError
        No fit there, one of another model, or a sweep file that does not fit the model.
    """
    began = time.monotonic()
    if run.model.effects:
        raise InputError(
            f"{folder / RESOLVED}: model.effects",
            "a run of the standard physics",
            f"one with {', '.join(run.model.effects)}",
            "sweep a run without effects: sweeps vary the parameters of the priors file",
        )
    inputs, fit = _read(run, base, folder, reporter)
    factory = factory_of(run, inputs)
    changed = changed_inputs(folder / PROVENANCE, inputs.digests)
    planned = plan(factory, fit, sweep, where, str(folder / FIT_FILE), changed)
    target = folder / SWEEP
    store = _store(planned, target, inputs)
    write_text(target / RESOLVED, tomli_w.dumps(sweep.model_dump()))
    reporter.log(f"{len(planned.cells)} cells, {len(planned.baseline.names)} quantities")
    with workers_at(jobs, dask, reporter.log) as workers:
        for done, total in planned.run(store, workers):
            reporter.count("cells", done, total)
    reporter.log("tables")
    tables = tables_of(planned, store, factory, fit)
    for name, table in tables.files().items():
        write_text(target / f"{name}.csv", frame_csv(table))
    if report or page is not None:
        reporter.log("figures")
        figures = _figures(planned, store, tables)
        names, seed = planned.baseline.names, planned.baseline.seed
        if report:
            facts = f"{len(planned.cells)} cells, cassini_bayes {__version__}, seed {seed}"
            _write_report(tables, names, figures, folder, facts)
        if page is not None:
            from cassini_bayes.report.sweep_page import write_sweep_page

            title = f"Prior sensitivity of the run {folder.name}"
            write_sweep_page(page, title, tables, names, figures, command, seed)
    seconds = time.monotonic() - began
    reporter.log(f"done in {seconds:.0f} s: {target}")
    found = (len(planned.cells), seconds, inputs.findings, stop_rule_held(fit))
    return SweepOutcome(target, tables, *found)


def _read(run: RunFile, base: Path, folder: Path, reporter: Reporter) -> tuple[Inputs, Fit]:
    path = folder / FIT_FILE
    if not path.exists():
        raise InputError(str(path), "the fit of this run", "no such file", "run it first")
    return read_inputs(run, base, folder, reporter.log), read_fit(path)


def _store(sweep: Sweep, target: Path, inputs: Inputs) -> CheckpointStore:
    """Where finished cells are kept; other code, data or settings have a folder of their own."""
    if target.exists():
        remove_leftovers(target)
    identity = sweep.identity(
        f"{code_digest('sweep.plan', 'pipeline.inputs')} {sorted(inputs.digests.items())}"
    )
    return CheckpointStore(target / "cells" / identity[:12], identity)


def factory_of(run: RunFile, inputs: Inputs) -> Factory:
    """The factory that builds the run's model with other priors."""
    return Factory(inputs.model.sources, inputs.priors, run.model.pulse_shape, run.model.delta_v)


def _figures(sweep: Sweep, store: CheckpointStore, tables: SweepTables) -> dict[str, Figure]:
    from cassini_bayes.report.plots.sweep import sweep_figures

    names = sweep.baseline.names
    stored = reported_quantiles(sweep, store)
    base = {
        name: (unit, sweep.baseline.values[:, j])
        for j, (name, unit) in enumerate(zip(names, sweep.units, strict=True))
    }
    cells = [
        (c.group, c.kind, c.label, {n: stored[key][:, j] for j, n in enumerate(names)})
        for key, c in sweep.cells.items()
    ]
    return sweep_figures(tables.sweep, base, cells, tables.knowledge, tables.data_worth)


def _write_report(
    tables: SweepTables,
    names: Sequence[str],
    figures: Mapping[str, Figure],
    folder: Path,
    facts: str,
) -> None:
    from cassini_bayes.report.plots import save_figures
    from cassini_bayes.report.sweep import write_sweep_section

    save_figures(figures, folder / SWEEP / "figures")
    page = folder / REPORT
    if page.exists():
        write_sweep_section(page, tables, names, figures, facts, digest(folder / FIT_FILE))
