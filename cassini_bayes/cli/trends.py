"""`trend`: thrust and health of every thruster over a mission."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from cassini_bayes.cli.options import (
    Accept,
    ConsoleReporter,
    Json,
    LeaveOut,
    Quiet,
    SeedOverride,
    Strict,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cassini_bayes.pipeline.trend_run import TrendOutcome


def trend_command(
    mission_file: Annotated[Path, typer.Argument(metavar="MISSION.toml", help="Mission file.")],
    out: Annotated[Path | None, typer.Option("--out", help="Folder to write.")] = None,
    no_report: Annotated[
        bool, typer.Option("--no-report", help="Tables only: no figures, no page.")
    ] = False,
    seed: SeedOverride = None,
    accept: Accept = None,
    leave_out: LeaveOut = False,
    strict: Strict = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Thrust of every thruster over a mission; goes on with the same command, with events added."""
    from cassini_bayes.pipeline.by_file import trend

    outcome = trend(
        mission_file,
        out,
        seed=seed,
        accept=accept or [],
        leave_out=leave_out,
        report=not no_report,
        reporter=ConsoleReporter(quiet),
        command=["cassini-bayes", *sys.argv[1:]],
    )
    _finish(outcome, "trend.csv" if no_report else "report.html", as_json, quiet, strict)


def fit_of_mission(
    mission_file: Path,
    events: Sequence[str],
    priors: Path | None,
    source: str,
    out: Path,
    seed: int | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """``fit --mission``: the given events, of either branch, with the facts of a mission file."""
    from cassini_bayes.model.mission.mission_file import read_mission_file
    from cassini_bayes.pipeline.trend_run import execute_trend

    mission = read_mission_file(mission_file)
    changes: dict[str, object] = {
        "events": [str(Path(event).absolute()) for event in events],
        "source": source,
    }
    if priors is not None:
        changes["priors"] = str(priors.absolute())
    if seed is not None:
        changes["trend"] = mission.trend.model_copy(update={"seed": seed})
    outcome = execute_trend(
        mission.model_copy(update=changes),
        str(mission_file),
        mission_file.parent,
        out,
        name=out.name,
        command=["cassini-bayes", *sys.argv[1:]],
        reporter=ConsoleReporter(quiet),
        report=False,
        fit_record=True,
    )
    _finish(outcome, "fit.nc", as_json, quiet, strict=False)


def _finish(outcome: TrendOutcome, file: str, as_json: bool, quiet: bool, strict: bool) -> NoReturn:
    if as_json:
        typer.echo(json.dumps({"folder": str(outcome.folder), **outcome.record}, allow_nan=False))
    elif not quiet:
        typer.echo(str(outcome.folder / file))
    for sentence in outcome.warnings:
        typer.echo(f"warning: {sentence}", err=True)
    raise typer.Exit(0 if outcome.converged and not (strict and outcome.warnings) else 1)
