"""`diagnose`: what the simulation gets wrong."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from cassini_bayes.cli.options import (
    Accept,
    ConsoleReporter,
    Effects,
    Force,
    Json,
    LeaveOut,
    OwnSeed,
    Quiet,
    Strict,
)
from cassini_bayes.errors import InputError

DEFAULT_SEED = 1


def diagnose_command(
    events: Annotated[
        list[str],
        typer.Argument(help="Event folders, totals CSV or file.csv:ID; or estimates CSV."),
    ],
    priors: Annotated[Path, typer.Option("--priors", help="Priors file.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    effects: Effects = None,
    source: Annotated[str, typer.Option("--source", help="Which rows of a totals CSV.")] = "flight",
    gain: Annotated[bool, typer.Option("--gain/--no-gain", help="Hold events out.")] = True,
    then_fit: Annotated[
        bool, typer.Option("--then-fit", help="Sample the extended model with emcee.")
    ] = False,
    seed: OwnSeed = None,
    accept: Accept = None,
    leave_out: LeaveOut = False,
    strict: Strict = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show what the simulation gets wrong, name the cause, measure the gain."""
    import numpy as np

    from cassini_bayes.computing.workers import cores
    from cassini_bayes.diagnosis.balance_case import BalanceCase
    from cassini_bayes.diagnosis.case import Case
    from cassini_bayes.diagnosis.diagnosis import Diagnosis, diagnose
    from cassini_bayes.diagnosis.estimates import is_estimates
    from cassini_bayes.diagnosis.read import read_estimate_case, read_events
    from cassini_bayes.effects.registry import read_kinds
    from cassini_bayes.events.plausibility import Policy
    from cassini_bayes.files.storage import digest
    from cassini_bayes.model.event_reduction import is_event_folder
    from cassini_bayes.pipeline.inputs import file_of
    from cassini_bayes.pipeline.provenance import library_versions
    from cassini_bayes.report.diagnosis import diagnosis_json, write_diagnosis
    from cassini_bayes.report.diagnosis_pictures import drawings

    if (out / "diagnosis.json").exists() and not force:
        raise InputError(str(out), "a new folder", "an existing diagnosis", "add --force")
    reporter = ConsoleReporter(quiet)
    number, processes = DEFAULT_SEED if seed is None else seed, cores()
    kinds = read_kinds(effects or ())
    case: Case[Any]
    if any(is_estimates(Path(event)) for event in events):
        if then_fit:
            raise InputError("--then-fit", "telemetry or totals", "printed estimates", "drop it")
        case = read_estimate_case(events, priors, kinds)
    else:
        policy = Policy.of(accept or [], leave_out=leave_out)
        case = BalanceCase(read_events(events, priors, source, reporter.say, kinds, policy))
    rng = np.random.default_rng(number)
    result: Diagnosis[Any] = diagnose(
        case, rng, measure_gain=gain, log=reporter.say, workers=processes, drawing=drawings
    )
    result.record["seed"] = number
    result.record["command"] = ["cassini-bayes", *sys.argv[1:]]
    result.record["effects"] = dict(kinds.files)
    tables = [Path(file_of(Path(), e)) for e in events if not is_event_folder(Path(e))]
    result.record["sha256"] = {str(path): digest(path) for path in (priors, *tables)}
    if isinstance(case, BalanceCase):
        telemetry = case.events.telemetry
        result.record["sha256"] |= {f"event {event.id}": event.digest for event in telemetry}
    result.record["versions"] = library_versions()
    write_diagnosis(result, out, out.name, processes)
    if then_fit and isinstance(case, BalanceCase):
        from cassini_bayes.diagnosis.refit import fit_extended

        fit_extended(result, out / "extended", number, reporter.say)
    if as_json:
        typer.echo(diagnosis_json(result.record).rstrip())
    elif not quiet:
        for sentence in result.record["verdict"]:
            typer.echo(sentence)
        typer.echo(str(out / "report.html"))
    for sentence in case.findings:
        typer.echo(f"warning: {sentence}", err=True)
    raise typer.Exit(1 if strict and case.findings else 0)
