"""`calibrate`: campaigns that put the inference to the test."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from cassini_bayes.cli.options import ConsoleReporter, Quiet

app = typer.Typer(help="Calibration campaigns: long, resumable, in parallel.")


@app.command("totals")
def calibrate_totals_command(
    page: Annotated[Path, typer.Option("--page", help="Results page to write (.md).")] = Path(
        "docs/results/totals-sbc.md"
    ),
    work: Annotated[Path, typer.Option("--work", help="Folder of finished repetitions.")] = Path(
        "runs/calibrate-totals"
    ),
    events: Annotated[str, typer.Option("--events", help="Template totals CSV.")] = (
        "cassini_bayes/published/flight_2009_2010.csv"
    ),
    priors: Annotated[str, typer.Option("--priors", help="Priors file.")] = (
        "priors/cassini_b_branch_2010.toml"
    ),
    repetitions: Annotated[int, typer.Option("--repetitions", min=20)] = 2_000,
    controls: Annotated[
        int, typer.Option("--controls", min=20, help="Repetitions of each negative control.")
    ] = 200,
    quick: Annotated[
        bool, typer.Option("--quick", help="200 repetitions, 60 per control.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", min=0)] = 20_261_121,
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="Worker processes.")] = 2,
    quiet: Quiet = False,
) -> None:
    """Simulation-based calibration of the totals model, with two negative controls."""
    from cassini_bayes.studies.totals_campaign import calibrate_totals

    reporter = ConsoleReporter(quiet)
    passed = calibrate_totals(
        events,
        priors,
        seed=seed,
        repetitions=200 if quick else repetitions,
        control_repetitions=60 if quick else controls,
        folder=work,
        page=page,
        jobs=jobs,
        command=["cassini-bayes", *sys.argv[1:]],
        progress=reporter.count,
    )
    typer.echo(str(page))
    raise typer.Exit(0 if passed else 1)


@app.command("sbc")
def calibrate_sbc_command(
    page: Annotated[Path, typer.Option("--page", help="Results page to write (.md).")] = Path(
        "docs/results/telemetry-sbc.md"
    ),
    work: Annotated[Path, typer.Option("--work", help="Folder of finished repetitions.")] = Path(
        "runs/calibrate-sbc"
    ),
    scenario: Annotated[str, typer.Option("--scenario", help="Scenario that is flown.")] = (
        "runs/scenarios/calibration.toml"
    ),
    priors: Annotated[str, typer.Option("--priors", help="Priors file.")] = (
        "priors/cassini_b_branch_telemetry.toml"
    ),
    quick: Annotated[
        bool, typer.Option("--quick", help="15 repetitions of every variant, 40 joint ones.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", min=0)] = 20_261_122,
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="Worker processes.")] = 2,
    quiet: Quiet = False,
) -> None:
    """Simulation-based calibration of the joint model on closed-loop telemetry."""
    from cassini_bayes.studies.telemetry_campaign import QUICK, REPETITIONS, calibrate_telemetry

    reporter = ConsoleReporter(quiet)
    passed = calibrate_telemetry(
        scenario,
        priors,
        seed=seed,
        repetitions=QUICK if quick else REPETITIONS,
        folder=work,
        page=page,
        jobs=jobs,
        command=["cassini-bayes", *sys.argv[1:]],
        progress=reporter.count,
    )
    typer.echo(str(page))
    raise typer.Exit(0 if passed else 1)


@app.command("mistakes")
def calibrate_mistakes_command(
    page: Annotated[Path, typer.Option("--page", help="Results page to write (.md).")] = Path(
        "docs/results/mistakes.md"
    ),
    work: Annotated[Path, typer.Option("--work", help="Folder of finished sets.")] = Path(
        "runs/calibrate-mistakes"
    ),
    priors: Annotated[Path, typer.Option("--priors", help="Priors file.")] = Path(
        "priors/cassini_b_branch_telemetry.toml"
    ),
    sets: Annotated[int, typer.Option("--sets", min=1, help="Sets of events.")] = 240,
    mistaken: Annotated[
        int, typer.Option("--mistaken", min=0, help="How many of them get every mistake too.")
    ] = 3,
    seed: Annotated[int, typer.Option("--seed", min=0)] = 20_261_122,
    quiet: Quiet = False,
) -> None:
    """Hide mistakes in simulated telemetry; count what is named, and what honest events get."""
    from cassini_bayes.studies.mistakes import Campaign, run_campaign, write_page

    reporter = ConsoleReporter(quiet)
    for done in run_campaign(Campaign(priors, seed, sets, mistaken), work):
        reporter.count("sets", done, sets)
    write_page(work, page, ["cassini-bayes", *sys.argv[1:]])
    typer.echo(str(page))
