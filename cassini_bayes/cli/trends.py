"""`trend`: thrust and health of every thruster over a mission."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from cassini_bayes.cli.options import (
    ConsoleReporter,
    Output,
    Plausibility,
    SeedOverride,
    command_line,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cassini_bayes.pipeline.trend_run import TrendOutcome


def trend_command(
    mission_file: Annotated[Path, typer.Argument(metavar="MISSION.toml", help="Mission file.")],
    *,
    out: Annotated[Path | None, typer.Option("--out", help="Folder to write.")] = None,
    no_report: Annotated[
        bool, typer.Option("--no-report", help="Tables only: no figures, no page.")
    ] = False,
    seed: SeedOverride = None,
    plausibility: Plausibility,
    output: Output,
) -> None:
    """Thrust of every thruster over a mission; goes on with the same command, with events added."""
    from cassini_bayes.pipeline.by_file import trend

    outcome = trend(
        mission_file,
        out,
        seed=seed,
        **plausibility.policy,
        report=not no_report,
        reporter=ConsoleReporter(output.quiet),
        command=command_line(),
    )
    _finish(outcome, "trend.csv" if no_report else "report.html", plausibility, output)


def fit_of_mission(
    mission_file: Path,
    events: Sequence[str],
    priors: Path | None,
    source: str | None,
    out: Path,
    seed: int | None,
    output: Output,
) -> NoReturn:
    """``fit --mission``: the given events, of either branch, with the facts of a mission file."""
    from cassini_bayes.model.mission.mission_file import read_mission_file
    from cassini_bayes.pipeline.trend_run import execute_trend
    from cassini_bayes.results.record import FIT_FILE

    mission = read_mission_file(mission_file)
    changes: dict[str, object] = {"events": [str(Path(event).absolute()) for event in events]}
    if source is not None:
        changes["source"] = source
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
        command=command_line(),
        reporter=ConsoleReporter(output.quiet),
        report=False,
        fit_record=True,
    )
    _finish(outcome, FIT_FILE, Plausibility(), output)


def _finish(
    outcome: TrendOutcome, file: str, plausibility: Plausibility, output: Output
) -> NoReturn:
    output.show(
        lambda: json.dumps({"folder": str(outcome.folder), **outcome.record}, allow_nan=False),
        lambda: str(outcome.folder / file),
    )
    plausibility.end(outcome.warnings, converged=outcome.converged)
