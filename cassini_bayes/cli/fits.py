"""`run` and `fit`: posteriors of events."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cassini_bayes.cli.options import (
    Accept,
    ConsoleReporter,
    Effects,
    FittedEffects,
    Force,
    Json,
    LeaveOut,
    NoReport,
    Quiet,
    Resume,
    SeedOverride,
    Source,
    Strict,
)
from cassini_bayes.cli.trends import fit_of_mission
from cassini_bayes.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cassini_bayes.pipeline.run import Outcome
    from cassini_bayes.pipeline.run_file import RunFile


def run_command(
    run_file: Annotated[Path, typer.Argument(metavar="RUN.toml", help="The run file.")],
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the run.")] = None,
    effects: Effects = None,
    seed: SeedOverride = None,
    force: Force = False,
    resume: Resume = False,
    accept: Accept = None,
    leave_out: LeaveOut = False,
    strict: Strict = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run the whole pipeline of one run file: posterior, tables, figures, report."""
    from cassini_bayes.pipeline.run_file import read_run_file

    run = read_run_file(run_file)
    if seed is not None:
        run = run.model_copy(update={"sampler": run.sampler.model_copy(update={"seed": seed})})
    run = run.accepting(accept or [], leave_out=leave_out)
    folder = out or run_file.parent / (run.output.folder or run_file.stem)
    outcome = _execute(
        run, run_file.parent, folder, run_file.stem, effects or (), force, resume, quiet
    )
    _finish(outcome, as_json, quiet, strict)


def fit_command(
    events: Annotated[
        list[str],
        typer.Argument(
            metavar="EVENT...",
            help="Event folder (telemetry), totals CSV, or CSV:ID for one of its rows; any mix.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    priors: Annotated[Path | None, typer.Option("--priors", help="Priors file.")] = None,
    mission: Annotated[
        Path | None,
        typer.Option(
            "--mission",
            metavar="MISSION.toml",
            help="Mission file: events of both branches in one fit, with its facts and priors.",
        ),
    ] = None,
    source: Source = "flight",
    effect: FittedEffects = None,
    effects: Effects = None,
    seed: SeedOverride = None,
    force: Force = False,
    resume: Resume = False,
    accept: Accept = None,
    leave_out: LeaveOut = False,
    strict: Strict = False,
    no_report: NoReport = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Posterior of events: fit.nc, tables, figures and report."""
    from cassini_bayes.pipeline.run_file import check_run

    if mission is not None:
        if effect or effects or accept or leave_out or strict:
            raise InputError(
                "--mission",
                "no option about effects, plausibility or strictness beside it",
                "one of --effect, --effects, --accept, --leave-out, --strict",
                "fit events of one branch with it, or leave it out",
            )
        fit_of_mission(mission, events, priors, source, out, seed, as_json, quiet)
    if priors is None:
        raise InputError(
            "--priors", "a priors file, or a mission file that names one", "neither",
            "add --priors FILE, or --mission MISSION.toml",
        )  # fmt: skip
    sampler: dict[str, Any] = {} if seed is None else {"seed": seed}
    run = check_run(
        {
            "events": list(events),
            "priors": str(priors),
            "source": source,
            "accept": accept or [],
            "leave_out": leave_out,
            "model": {"effects": effect or []},
            "sampler": sampler,
            "output": {"report": not no_report},
        },
        "command line",
    )
    outcome = _execute(run, Path(), out, out.name, effects or (), force, resume, quiet)
    _finish(outcome, as_json, quiet, strict)


def _execute(
    run: RunFile,
    base: Path,
    folder: Path,
    name: str,
    effects: Sequence[Path],
    force: bool,
    resume: bool,
    quiet: bool,
) -> Outcome:
    from cassini_bayes.effects.registry import read_kinds
    from cassini_bayes.pipeline.run import execute

    return execute(
        run,
        base,
        folder,
        name=name,
        command=["cassini-bayes", *sys.argv[1:]],
        reporter=ConsoleReporter(quiet),
        force=force,
        resume=resume,
        kinds=read_kinds(effects),
    )


def _finish(outcome: Outcome, as_json: bool, quiet: bool, strict: bool) -> None:
    """Say what came of a run: the result on standard output, what is amiss on standard error.

    What contradicts stands last, so that nothing scrolls it away, and even with ``--quiet``.
    """
    warnings = outcome.review.warnings
    if as_json:
        columns = ["name", "unit", "mean", "sd", "hdi_90_low", "hdi_90_high"]
        result = {
            "converged": outcome.converged,
            "folder": str(outcome.folder),
            "seconds": round(outcome.seconds, 1),
            "interval": "90 % highest density",
            "summary": outcome.review.summary[columns].to_dict(orient="records"),
            "verdict": list(outcome.verdict),
            "warnings": list(warnings),
        }
        typer.echo(json.dumps(result))
    elif not quiet:
        for sentence in outcome.verdict:
            typer.echo(sentence)
        report, figures = outcome.folder / "report.html", outcome.folder / "figures"
        if report.exists():
            typer.echo(str(figures))
        typer.echo(str(report if report.exists() else outcome.folder / "summary.csv"))
    if not outcome.converged:
        typer.echo(
            f"not converged: {outcome.folder / 'summary.csv'} lists R-hat and ESS of every scalar; "
            "raise max_steps under [sampler] in a run file and run it with --force",
            err=True,
        )
    for sentence in warnings:
        typer.echo(f"warning: {sentence}", err=True)
    raise typer.Exit(0 if outcome.converged and not (strict and warnings) else 1)
