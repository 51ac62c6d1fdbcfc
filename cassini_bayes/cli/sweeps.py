"""`sweep`: how much a finished run leans on its priors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cassini_bayes.cli.fits import say_not_converged
from cassini_bayes.cli.options import (
    ConsoleReporter,
    Dask,
    Jobs,
    Output,
    Plausibility,
    command_line,
)
from cassini_bayes.files.tables import frame_records

if TYPE_CHECKING:
    from cassini_bayes.pipeline.sweep_run import SweepOutcome


def sweep_command(
    run_file: Annotated[Path, typer.Argument(metavar="RUN.toml", help="The run file.")],
    *,
    spec: Annotated[
        Path | None, typer.Option("--spec", help="Sweep file (.toml); without one, every block.")
    ] = None,
    quantity: Annotated[
        list[str] | None,
        typer.Option("--quantity", help="Quantity to watch, as in summary.csv; may be repeated."),
    ] = None,
    fit: Annotated[
        Path | None, typer.Option("--fit", help="Folder of the finished run (with fit.nc).")
    ] = None,
    refit: Annotated[
        str | None, typer.Option("--refit", help="auto, always or never (overrides the file).")
    ] = None,
    jobs: Jobs = None,
    dask: Dask = None,
    no_report: Annotated[
        bool, typer.Option("--no-report", help="Tables only: no figures, report left alone.")
    ] = False,
    page: Annotated[
        Path | None, typer.Option("--page", help="Also write a results page (.md).")
    ] = None,
    plausibility: Plausibility,
    output: Output,
) -> None:
    """Sweep the priors of a finished run; go on with the same command after a stop."""
    from cassini_bayes.pipeline.by_file import sweep

    outcome = sweep(
        run_file,
        spec=spec,
        quantities=quantity,
        refit=refit,
        fit=fit,
        **plausibility.policy,
        jobs=jobs,
        dask=dask,
        report=not no_report,
        page=page,
        reporter=ConsoleReporter(output.quiet),
        command=command_line(),
    )
    output.show(
        lambda: json.dumps(as_record(outcome), allow_nan=False),
        lambda: str(outcome.folder / "sweep.csv"),
    )
    if not outcome.converged:
        say_not_converged(outcome.folder.parent)
    plausibility.end(outcome.findings, converged=outcome.converged)


def as_record(outcome: SweepOutcome) -> dict[str, Any]:
    """The outcome as plain JSON types; what is not finite becomes null."""
    tables = {name: frame_records(table) for name, table in outcome.tables.files().items()}
    return {
        "folder": str(outcome.folder),
        "converged": outcome.converged,
        "cells": outcome.cells,
        "seconds": round(outcome.seconds, 1),
        "interval": "central 90 %",
        "warnings": list(outcome.findings),
        **tables,
    }
