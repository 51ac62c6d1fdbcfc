"""`diagnose`: what the simulation gets wrong."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from cassini_bayes.cli.options import (
    Accept,
    ConsoleReporter,
    Effects,
    Force,
    Json,
    LeaveOut,
    PriorsFile,
    Quiet,
    Resume,
    SeedOverride,
    Source,
    Strict,
)
from cassini_bayes.errors import InputError

DEFAULT_SEED = 1


def diagnose_command(
    events: Annotated[
        list[str],
        typer.Argument(help="Event folders, totals CSV or file.csv:ID; or estimates CSV."),
    ],
    priors: PriorsFile,
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    effects: Effects = None,
    source: Source = "flight",
    gain: Annotated[bool, typer.Option("--gain/--no-gain", help="Hold events out.")] = True,
    then_fit: Annotated[
        bool, typer.Option("--then-fit", help="Sample the extended model with emcee.")
    ] = False,
    seed: SeedOverride = None,
    accept: Accept = None,
    leave_out: LeaveOut = False,
    strict: Strict = False,
    force: Force = False,
    resume: Resume = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show what the simulation gets wrong, name the cause, measure the gain."""
    from cassini_bayes.pipeline.diagnoses import diagnose
    from cassini_bayes.report.diagnosis import diagnosis_json

    reporter = ConsoleReporter(quiet)
    if then_fit:
        refuse_estimates(events)
    result = diagnose(
        events,
        priors,
        effect_files=effects or (),
        source=source,
        gain=gain,
        accept=accept or [],
        leave_out=leave_out,
        seed=DEFAULT_SEED if seed is None else seed,
        folder=out,
        force=force,
        resume=resume,
        log=reporter.log,
        progress=reporter.count,
        command=["cassini-bayes", *sys.argv[1:]],
    )
    if then_fit:
        result.fit(log=reporter.log)
    if as_json:
        typer.echo(diagnosis_json(result.record).rstrip())
    elif not quiet:
        typer.echo("\n".join([*result.sentences, str(out / "report.html")]))
    findings = result.record["findings"]
    for sentence in findings:
        typer.echo(f"warning: {sentence}", err=True)
    raise typer.Exit(1 if strict and findings else 0)


def refuse_estimates(events: Sequence[str]) -> None:
    """Printed estimates have no model to sample: say so before anything is searched."""
    from cassini_bayes.diagnosis.estimates import is_estimates

    if any(is_estimates(Path(event)) for event in events):
        raise InputError("--then-fit", "telemetry or totals", "printed estimates", "drop it")
