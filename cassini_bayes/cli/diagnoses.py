"""`diagnose`, `diagnose-published` and `calibrate blind`: what the simulation gets wrong."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from cassini_bayes.cli.options import ConsoleReporter, Effects, Force, Json, Quiet, Seed
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
    seed: Seed = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show what the simulation gets wrong, name the cause, measure the gain."""
    import numpy as np

    from cassini_bayes.diagnosis.balance_case import BalanceCase
    from cassini_bayes.diagnosis.case import Case
    from cassini_bayes.diagnosis.diagnosis import Diagnosis, diagnose
    from cassini_bayes.diagnosis.estimates import is_estimates
    from cassini_bayes.diagnosis.read import read_estimate_case, read_events
    from cassini_bayes.effects.registry import read_kinds
    from cassini_bayes.report.diagnosis import diagnosis_json, write_diagnosis

    if (out / "diagnosis.json").exists() and not force:
        raise InputError(str(out), "a new folder", "an existing diagnosis", "add --force")
    reporter = ConsoleReporter(quiet)
    number, cores = DEFAULT_SEED if seed is None else seed, len(os.sched_getaffinity(0))
    kinds = read_kinds(effects or ())
    case: Case[Any]
    if any(is_estimates(Path(event)) for event in events):
        if then_fit:
            raise InputError("--then-fit", "telemetry or totals", "printed estimates", "drop it")
        case = read_estimate_case(events, priors, kinds)
    else:
        case = BalanceCase(read_events(events, priors, source, reporter.say, kinds))
    rng = np.random.default_rng(number)
    result: Diagnosis[Any] = diagnose(case, rng, measure_gain=gain, log=reporter.say, workers=cores)
    result.record["seed"] = number
    result.record["command"] = ["cassini-bayes", *sys.argv[1:]]
    result.record["effects"] = dict(kinds.files)
    write_diagnosis(result, out, out.name, cores)
    if then_fit and isinstance(case, BalanceCase):
        from cassini_bayes.diagnosis.refit import fit_extended

        fit_extended(result, out / "extended", number, reporter.say)
    if as_json:
        typer.echo(diagnosis_json(result.record).rstrip())
    elif not quiet:
        typer.echo(str(out / "report.html"))


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
    sections = write_published_diagnosis(page, totals, priors, number, command, reporter.say)
    typer.echo(json.dumps(sections))
