"""`diagnose`, `diagnose-published` and `calibrate blind`: what the simulation gets wrong."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from cassini_bayes.cli.options import (
    Accept,
    ConsoleReporter,
    Force,
    Json,
    LeaveOut,
    Quiet,
    Seed,
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
    effects: Annotated[
        Path | None, typer.Option("--effects", help="Another catalogue of effects.")
    ] = None,
    source: Annotated[str, typer.Option("--source", help="Which rows of a totals CSV.")] = "flight",
    gain: Annotated[bool, typer.Option("--gain/--no-gain", help="Hold events out.")] = True,
    then_fit: Annotated[
        bool, typer.Option("--then-fit", help="Sample the extended model with emcee.")
    ] = False,
    seed: Seed = None,
    accept: Accept = None,
    leave_out: LeaveOut = False,
    strict: Strict = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show what the simulation gets wrong, name the cause, measure the gain."""
    import numpy as np

    from cassini_bayes.diagnosis.diagnosis import catalogue_of, diagnose
    from cassini_bayes.diagnosis.estimates import is_estimates
    from cassini_bayes.diagnosis.read import read_case, totals_rows
    from cassini_bayes.events.plausibility import Policy
    from cassini_bayes.report.diagnosis import diagnosis_json, write_diagnosis

    if (out / "diagnosis.json").exists() and not force:
        raise InputError(str(out), "a new folder", "an existing diagnosis", "add --force")
    reporter = ConsoleReporter(quiet)
    number = DEFAULT_SEED if seed is None else seed
    if any(is_estimates(Path(event)) for event in events):
        estimated = _diagnose_estimates(events, priors, out, number)
        typer.echo(diagnosis_json(estimated).rstrip() if as_json else str(out / "report.html"))
        return
    cores = len(os.sched_getaffinity(0))
    policy = Policy.of(accept or [], leave_out=leave_out)
    case = read_case(events, priors, source, reporter.say, policy)
    catalogue = catalogue_of(case, effects)
    result = diagnose(
        case,
        catalogue,
        np.random.default_rng(number),
        measure_gain=gain,
        rows=totals_rows(events, case.priors, source),
        say=reporter.say,
        workers=cores,
    )
    result.record["seed"] = number
    result.record["command"] = ["cassini-bayes", *sys.argv[1:]]
    write_diagnosis(result, out, out.name, cores)
    if then_fit:
        from cassini_bayes.diagnosis.refit import fit_extended

        fit_extended(result, out / "extended", number, reporter.say)
    if as_json:
        typer.echo(diagnosis_json(result.record).rstrip())
    elif not quiet:
        typer.echo(str(out / "report.html"))
    for sentence in case.findings:
        typer.echo(f"warning: {sentence}", err=True)
    raise typer.Exit(1 if strict and case.findings else 0)


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


def calibrate_blind_command(
    trials: Annotated[int, typer.Option("--trials", min=1)] = 470,
    seed: Annotated[int, typer.Option("--seed", min=0)] = 20_261_121,
    work: Annotated[Path, typer.Option("--work", help="Folder of finished trials.")] = Path(
        "runs/calibrate-blind"
    ),
    page: Annotated[Path, typer.Option("--page", help="Folder of the results.")] = Path(
        "docs/results/blind"
    ),
    scenario: Annotated[Path, typer.Option("--scenario")] = Path("runs/scenarios/calibration.toml"),
    priors: Annotated[Path, typer.Option("--priors")] = Path(
        "priors/cassini_b_branch_telemetry.toml"
    ),
    events: Annotated[str, typer.Option("--events", help="Ids of the scenario's events.")] = (
        "bias-1,slews"
    ),
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="Worker processes.")] = 2,
    results_only: Annotated[
        bool, typer.Option("--results-only", help="Write results of the trials that are there.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Hide effects in simulated telemetry and count how often the diagnosis finds them."""
    from cassini_bayes.studies.blind.campaign import run_campaign, write_results
    from cassini_bayes.studies.blind.flights import Blind

    reporter = ConsoleReporter(quiet)
    campaign = Blind(scenario, priors, seed, tuple(events.split(",")))
    if not results_only:
        for done, total in run_campaign(campaign, trials, work, jobs):
            reporter.count("blind trials", done, total)
    rates: dict[str, Any] = write_results(work, page, seed, ["cassini-bayes", *sys.argv[1:]])
    typer.echo(json.dumps(rates))


def diagnose_published_command(
    page: Annotated[Path, typer.Option("--page", help="Folder of the results.")] = Path(
        "docs/results"
    ),
    priors: Annotated[Path, typer.Option("--priors", help="Priors of the flight biases.")] = Path(
        "priors/cassini_b_branch_2010.toml"
    ),
    totals: Annotated[Path, typer.Option("--totals", help="The flight biases.")] = Path(
        "cassini_bayes/published/flight_2009_2010.csv"
    ),
    seed: Seed = None,
    quiet: Quiet = False,
) -> None:
    """Diagnose published cases: flight biases and on-times, printed thrusts, test bed, A branch."""
    from cassini_bayes.studies.published_diagnosis import write_published_diagnosis

    reporter = ConsoleReporter(quiet)
    number = DEFAULT_SEED if seed is None else seed
    command = ["cassini-bayes", *sys.argv[1:]]
    found = write_published_diagnosis(page, totals, priors, number, command, reporter.say)
    typer.echo(json.dumps(found))
