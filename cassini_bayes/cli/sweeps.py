"""`sweep`: how much a finished run leans on its priors."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cassini_bayes.cli.options import (
    Accept,
    ConsoleReporter,
    Dask,
    Jobs,
    Json,
    LeaveOut,
    Quiet,
    Strict,
)

if TYPE_CHECKING:
    import pandas as pd

    from cassini_bayes.pipeline.sweep_run import SweepOutcome


def sweep_command(
    run_file: Annotated[Path, typer.Argument(metavar="RUN.toml", help="The run file.")],
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
    accept: Accept = None,
    leave_out: LeaveOut = False,
    strict: Strict = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Sweep the priors of a finished run; go on with the same command after a stop."""
    from cassini_bayes.pipeline.by_file import sweep

    outcome = sweep(
        run_file,
        spec=spec,
        quantities=quantity,
        refit=refit,
        fit=fit,
        accept=accept or [],
        leave_out=leave_out,
        jobs=jobs,
        dask=dask,
        report=not no_report,
        page=page,
        reporter=ConsoleReporter(quiet),
        command=["cassini-bayes", *sys.argv[1:]],
    )
    if as_json:
        typer.echo(json.dumps(as_record(outcome), allow_nan=False))
    elif not quiet:
        typer.echo(str(outcome.folder / "sweep.csv"))
    for finding in outcome.findings:
        typer.echo(f"warning: {finding}", err=True)
    if strict and outcome.findings:
        raise typer.Exit(1)


def as_record(outcome: SweepOutcome) -> dict[str, Any]:
    """The outcome as plain JSON types; what is not finite becomes null."""
    tables = {name: _records(table) for name, table in outcome.tables.files().items()}
    return {
        "folder": str(outcome.folder),
        "cells": outcome.cells,
        "seconds": round(outcome.seconds, 1),
        "interval": "central 90 %",
        "warnings": list(outcome.findings),
        **tables,
    }


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [
        {
            key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in row.items()
        }
        for row in json.loads(table.to_json(orient="records", double_precision=10))
    ]
