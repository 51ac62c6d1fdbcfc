"""`diagnose`: what the simulation gets wrong."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from cassini_bayes.cli.options import ConsoleReporter, Force, Json, OwnSeed, Quiet
from cassini_bayes.errors import InputError

DEFAULT_SEED = 1


def diagnose_command(
    events: Annotated[
        list[str],
        typer.Argument(help="Event folders, totals CSV or file.csv:ID; or estimates CSV."),
    ],
    priors: Annotated[Path, typer.Option("--priors", help="Priors file.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    effects: Annotated[
        Path | None, typer.Option("--effects", help="Another catalogue of effects.")
    ] = None,
    source: Annotated[str, typer.Option("--source", help="Which rows of a totals CSV.")] = "flight",
    gain: Annotated[bool, typer.Option("--gain/--no-gain", help="Hold events out.")] = True,
    then_fit: Annotated[
        bool, typer.Option("--then-fit", help="Sample the extended model with emcee.")
    ] = False,
    seed: OwnSeed = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show what the simulation gets wrong, name the cause, measure the gain."""
    import numpy as np

    from cassini_bayes.computing.workers import cores
    from cassini_bayes.diagnosis.diagnosis import catalogue_of, diagnose
    from cassini_bayes.diagnosis.estimates import is_estimates
    from cassini_bayes.diagnosis.read import read_case, totals_rows
    from cassini_bayes.report.diagnosis import diagnosis_json, write_diagnosis

    if (out / "diagnosis.json").exists() and not force:
        raise InputError(str(out), "a new folder", "an existing diagnosis", "add --force")
    reporter = ConsoleReporter(quiet)
    number = DEFAULT_SEED if seed is None else seed
    if any(is_estimates(Path(event)) for event in events):
        estimated = _diagnose_estimates(events, priors, out, number)
        typer.echo(diagnosis_json(estimated).rstrip() if as_json else str(out / "report.html"))
        return
    processes = cores()
    case = read_case(events, priors, source, reporter.say)
    catalogue = catalogue_of(case, effects)
    result = diagnose(
        case,
        catalogue,
        np.random.default_rng(number),
        measure_gain=gain,
        rows=totals_rows(events, case.priors, source),
        say=reporter.say,
        workers=processes,
    )
    result.record["seed"] = number
    result.record["command"] = ["cassini-bayes", *sys.argv[1:]]
    write_diagnosis(result, out, out.name, processes)
    if then_fit:
        from cassini_bayes.diagnosis.refit import fit_extended

        fit_extended(result, out / "extended", number, reporter.say)
    if as_json:
        typer.echo(diagnosis_json(result.record).rstrip())
    elif not quiet:
        typer.echo(str(out / "report.html"))


def _diagnose_estimates(
    references: list[str], priors: Path, out: Path, seed: int
) -> dict[str, Any]:
    """Weigh published thrusts and write their diagnosis; the record."""
    import numpy as np

    from cassini_bayes.diagnosis.estimates import (
        diagnose_estimates,
        estimate_case,
        is_estimates,
        read_estimates,
    )
    from cassini_bayes.priors.reader import read_priors
    from cassini_bayes.report.diagnosis import cause_picture, drawn, write_record

    other = [reference for reference in references if not is_estimates(Path(reference))]
    if other:
        raise InputError(other[0], "estimates alone", "another input", "diagnose it on its own")
    read = read_priors(priors)
    thrusters = read.spacecraft.thruster_names(read.branch)
    rows = [row for reference in references for row in read_estimates(Path(reference), thrusters)]
    record = diagnose_estimates(estimate_case(rows, read), np.random.default_rng(seed))
    record |= {"seed": seed, "command": ["cassini-bayes", *sys.argv[1:]]}
    write_record(record, drawn([cause_picture(record)]), out, out.name)
    return record
