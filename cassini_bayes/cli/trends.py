"""`trend`: thrust and health of every thruster over a mission."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from cassini_bayes.cli.options import ConsoleReporter, Json, OwnSeed, Quiet


def trend_command(
    mission_file: Annotated[Path, typer.Argument(metavar="MISSION.toml", help="Mission file.")],
    out: Annotated[Path | None, typer.Option("--out", help="Folder to write.")] = None,
    no_report: Annotated[
        bool, typer.Option("--no-report", help="Tables only: no figures, no page.")
    ] = False,
    seed: OwnSeed = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Thrust of every thruster over a mission; goes on with the same command, with events added."""
    from cassini_bayes.pipeline.by_file import trend

    outcome = trend(
        mission_file,
        out,
        seed=seed,
        report=not no_report,
        reporter=ConsoleReporter(quiet),
        command=["cassini-bayes", *sys.argv[1:]],
    )
    if as_json:
        typer.echo(json.dumps({"folder": str(outcome.folder), **outcome.record}, allow_nan=False))
    elif not quiet:
        typer.echo(str(outcome.folder / ("trend.csv" if no_report else "report.html")))
    raise typer.Exit(0 if outcome.converged else 1)
