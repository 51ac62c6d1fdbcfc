"""`check`: all that is known before sampling, on one page."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from cassini_bayes.cli.options import (
    Accept,
    ConsoleReporter,
    Effects,
    FittedEffects,
    Json,
    LeaveOut,
    PriorsFile,
    Quiet,
    Source,
    Strict,
)


def check_command(
    events: Annotated[
        list[str],
        typer.Argument(
            metavar="EVENT...", help="Event folder, totals CSV, or CSV:ID for one of its rows."
        ),
    ],
    priors: PriorsFile,
    source: Source = "flight",
    effect: FittedEffects = None,
    effects: Effects = None,
    accept: Accept = None,
    leave_out: LeaveOut = False,
    strict: Strict = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Before sampling: plausibility, rows used, what these events can see, conflicts, time."""
    from cassini_bayes.pipeline.checks import check

    reporter = ConsoleReporter(quiet)
    result = check(
        events,
        priors,
        effects=effect or (),
        effect_files=effects or (),
        source=source,
        accept=accept or [],
        leave_out=leave_out,
        log=reporter.log,
    )
    if as_json:
        typer.echo(json.dumps(result.as_record()))
    elif not quiet:
        typer.echo(repr(result))
    if quiet or as_json:
        for sentence in result.warnings:
            typer.echo(f"warning: {sentence}", err=True)
    raise typer.Exit(1 if strict and result.warnings else 0)
