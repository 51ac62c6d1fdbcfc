"""`calibrate` and `diagnose-published`: studies that put the inference to the test.

All are started in the same way: ``--trials`` or ``--quick``, ``--jobs`` or ``--dask``, ``--seed``,
``--work`` for finished repetitions, ``--out`` for the page; the same command goes on after a stop.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cassini_bayes.cli.options import ConsoleReporter, Dask, Jobs, PriorsFile, Quiet, Seed
from cassini_bayes.errors import InputError

if TYPE_CHECKING:
    from cassini_bayes.studies.study import Study

app = typer.Typer(help="Calibration studies: long, resumable, in parallel.")

Trials = Annotated[
    int | None,
    typer.Option("--trials", min=1, help="Repetitions of the largest part; others in proportion."),
]
Quick = Annotated[
    bool, typer.Option("--quick", help="Few repetitions: only gross faults would show.")
]
Work = Annotated[Path, typer.Option("--work", help="Folder of finished repetitions.")]
Out = Annotated[Path, typer.Option("--out", help="Folder of the results page.")]
Totals = Annotated[Path, typer.Option("--events", help="Template totals CSV.")]
ScenarioFile = Annotated[Path, typer.Option("--scenario", help="Scenario that is flown.")]

WORK = Path("runs/studies")
OUT = Path("docs/results")
FLIGHT = Path("cassini_bayes/published/flight_2009_2010.csv")
TOTALS_PRIORS = Path("priors/cassini_b_branch_2010.toml")
MISSION_PRIORS = Path("priors/cassini_mission.toml")
TELEMETRY_PRIORS = Path("priors/cassini_b_branch_telemetry.toml")
SCENARIO = Path("runs/scenarios/calibration.toml")
PRIORS = Path("priors")
HYBRID_SCENARIO = Path("runs/scenarios/hybrid_2012.toml")
HYBRID_PRIORS = Path("priors/cassini_hybrid_2012.toml")


@contextmanager
def _study(
    page: Path, seed: int, work: Path, quiet: bool, jobs: int | None = 1, dask: str | None = None
) -> Iterator[Study]:
    """A study that is about to run, its workers started; ``work`` keeps its repetitions."""
    from cassini_bayes.computing.workers import workers_at
    from cassini_bayes.studies.study import Study

    reporter = ConsoleReporter(quiet)
    command = ("cassini-bayes", *sys.argv[1:])
    with workers_at(jobs, dask, reporter.say) as workers:
        yield Study(seed, work, page, workers, command, reporter.count)


def _numbers(
    full: Mapping[str, int], short: Mapping[str, int], trials: int | None, quick: bool
) -> Mapping[str, int]:
    """Repetitions of every part of a study."""
    if trials is None:
        return short if quick else full
    if quick:
        raise InputError("--quick", "either --trials or --quick", "both", "leave one of them out")
    most = max(full.values())
    return {part: max(1, round(number * trials / most)) for part, number in full.items()}


def _end(page: Path, passed: bool = True) -> None:
    typer.echo(str(page))
    raise typer.Exit(0 if passed else 1)


@app.command("totals")
def calibrate_totals_command(
    events: Totals = FLIGHT,
    priors: PriorsFile = TOTALS_PRIORS,
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 20_261_121,
    jobs: Jobs = None,
    dask: Dask = None,
    work: Work = WORK,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Simulation-based calibration of the totals model, with two negative controls."""
    from cassini_bayes.studies.totals_campaign import FULL, QUICK, calibrate_totals

    numbers = _numbers(FULL, QUICK, trials, quick)
    page = out / "totals-sbc.md"
    with _study(page, seed, work / page.stem, quiet, jobs, dask) as study:
        passed = calibrate_totals(study, str(events), str(priors), numbers)
    _end(page, passed)


@app.command("sbc")
def calibrate_sbc_command(
    scenario: ScenarioFile = SCENARIO,
    priors: PriorsFile = TELEMETRY_PRIORS,
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 20_261_122,
    jobs: Jobs = None,
    dask: Dask = None,
    work: Work = WORK,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Simulation-based calibration of the joint model on closed-loop telemetry."""
    from cassini_bayes.studies.telemetry_campaign import FULL, QUICK, calibrate_telemetry

    numbers = _numbers(FULL, QUICK, trials, quick)
    page = out / "telemetry-sbc.md"
    with _study(page, seed, work / page.stem, quiet, jobs, dask) as study:
        passed = calibrate_telemetry(study, str(scenario), str(priors), numbers)
    _end(page, passed)


@app.command("conditions")
def calibrate_conditions_command(
    scenario: ScenarioFile = SCENARIO,
    priors: Annotated[Path, typer.Option("--priors", help="Folder of priors files.")] = PRIORS,
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 20_261_123,
    jobs: Jobs = None,
    dask: Dask = None,
    work: Work = WORK,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Calibration over conditions: controllers, steps of counters, cadence, noise, events."""
    from cassini_bayes.studies.conditions_calibration import FULL, QUICK, calibrate_conditions

    numbers = _numbers(FULL, QUICK, trials, quick)
    page = out / "conditions.md"
    with _study(page, seed, work / page.stem, quiet, jobs, dask) as study:
        passed = calibrate_conditions(study, str(scenario), str(priors), numbers)
    _end(page, passed)


@app.command("attitude")
def calibrate_attitude_command(out: Out = OUT, quiet: Quiet = False) -> None:
    """Noise, steps and gyro errors of real attitude records: the source of the noise priors."""
    from cassini_bayes.studies.real_attitude import study_real_attitude

    page = out / "real-attitude.md"
    with _study(page, 0, WORK, quiet) as study:
        study_real_attitude(study)
    _end(page)


@app.command("perturbations")
def calibrate_perturbations_command(
    events: Totals = FLIGHT,
    priors: PriorsFile = TOTALS_PRIORS,
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 20_120_813,
    jobs: Jobs = None,
    dask: Dask = None,
    work: Work = WORK,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Coverage and length of perturbation bars, least squares, Laplace and posterior."""
    from cassini_bayes.studies.perturbation_campaign import FULL, QUICK, compare_error_bars

    numbers = _numbers(FULL, QUICK, trials, quick)
    page = out / "perturbation-coverage.md"
    with _study(page, seed, work / page.stem, quiet, jobs, dask) as study:
        passed = compare_error_bars(study, str(events), str(priors), numbers)
    _end(page, passed)


@app.command("blind")
def calibrate_blind_command(
    scenario: ScenarioFile = SCENARIO,
    priors: PriorsFile = TELEMETRY_PRIORS,
    events: Annotated[str, typer.Option("--events", help="Ids of the scenario's events.")] = (
        "bias-1,slews"
    ),
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 20_261_121,
    jobs: Jobs = None,
    dask: Dask = None,
    work: Work = WORK,
    out: Out = OUT,
    results_only: Annotated[
        bool, typer.Option("--results-only", help="Write results of the trials that are there.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Hide effects in simulated telemetry and count how often the diagnosis finds them."""
    from cassini_bayes.studies.blind.campaign import FULL, QUICK, run_campaign, write_results
    from cassini_bayes.studies.blind.flights import Blind

    numbers = _numbers(FULL, QUICK, trials, quick)
    campaign = Blind(scenario, priors, seed, tuple(events.split(",")))
    with _study(out / "blind" / "index.md", seed, work / "blind", quiet, jobs, dask) as study:
        if not results_only:
            run_campaign(study, campaign, numbers["trials"])
        typer.echo(json.dumps(write_results(study)))


@app.command("two-wheels")
def calibrate_two_wheels_command(
    scenario: ScenarioFile = HYBRID_SCENARIO,
    priors: PriorsFile = HYBRID_PRIORS,
    events: Annotated[str, typer.Option("--events", help="Ids of the scenario's events.")] = (
        "mosaic"
    ),
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 20_120_223,
    jobs: Jobs = None,
    dask: Dask = None,
    work: Work = WORK,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Hide a platform's angle or a leak in events of two wheels, and count what is named."""
    from cassini_bayes.studies.blind.two_wheels import FULL, QUICK, run_two_wheels

    numbers = _numbers(FULL, QUICK, trials, quick)
    page = out / "two-wheels.md"
    with _study(page, seed, work / page.stem, quiet, jobs, dask) as study:
        run_two_wheels(study, scenario, priors, events.split(","), numbers["trials"])
    _end(page)


@app.command("mistakes")
def calibrate_mistakes_command(
    scenario: ScenarioFile = SCENARIO,
    priors: Annotated[Path, typer.Option("--priors", help="Folder of priors files.")] = PRIORS,
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 20_261_122,
    jobs: Jobs = None,
    dask: Dask = None,
    work: Work = WORK,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Hide mistakes in telemetry and totals; count what is named, and what honest data get."""
    from cassini_bayes.studies.mistakes import FULL, QUICK, run_mistakes

    numbers = _numbers(FULL, QUICK, trials, quick)
    page = out / "mistakes.md"
    with _study(page, seed, work / page.stem, quiet, jobs, dask) as study:
        passed = run_mistakes(study, scenario, priors, numbers)
    _end(page, passed)


@app.command("missions")
def calibrate_missions_command(
    events: Totals = FLIGHT,
    priors: PriorsFile = MISSION_PRIORS,
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 19_971_015,
    jobs: Jobs = None,
    dask: Dask = None,
    work: Work = WORK,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Simulated missions with known failures: names, onsets, false alarms, delays."""
    from cassini_bayes.studies.missions import FULL, QUICK, study_missions

    numbers = _numbers(FULL, QUICK, trials, quick)
    page = out / "missions.md"
    with _study(page, seed, work / page.stem, quiet, jobs, dask) as study:
        passed = study_missions(study, str(events), str(priors), numbers)
    _end(page, passed)


@app.command("prediction")
def calibrate_prediction_command(
    events: Totals = FLIGHT,
    priors: PriorsFile = TOTALS_PRIORS,
    seed: Seed = 20_100_329,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Leave one flight event out at a time, predict it, and compare with the published columns."""
    from cassini_bayes.studies.prediction import prediction_results

    page = out / "prediction.md"
    with _study(page, seed, WORK, quiet) as study:
        prediction_results(study, str(events), str(priors))
    _end(page)


@app.command("simulation")
def calibrate_simulation_command(
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 1,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Hold the simulation against printed figures: momentum, impulse, biases, hydrazine."""
    from cassini_bayes.studies.simulation import FULL, QUICK, simulation_results

    numbers = _numbers(FULL, QUICK, trials, quick)
    page = out / "simulation.md"
    with _study(page, seed, WORK, quiet) as study:
        simulation_results(study, numbers)
    _end(page)


@app.command("leaks")
def calibrate_leaks_command(
    scenario: ScenarioFile = SCENARIO,
    priors: PriorsFile = TELEMETRY_PRIORS,
    calibrated: Annotated[
        bool, typer.Option("--calibrated", help="Thrusters known to a tenth of their priors.")
    ] = False,
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 20_050_128,
    jobs: Jobs = None,
    dask: Dask = None,
    work: Work = WORK,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Hide leaks in simulated biases: two monitors at equal false-alarm rates."""
    from cassini_bayes.studies.leak_campaign import FULL, QUICK, compare_leak_monitors

    numbers = _numbers(FULL, QUICK, trials, quick)
    page = out / ("leaks-calibrated.md" if calibrated else "leaks.md")
    with _study(page, seed, work / page.stem, quiet, jobs, dask) as study:
        compare_leak_monitors(study, scenario, priors, numbers, calibrated=calibrated)
    _end(page)


@app.command("hybrid")
def calibrate_hybrid_command(
    scenario: ScenarioFile = HYBRID_SCENARIO,
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = 0,
    jobs: Jobs = None,
    dask: Dask = None,
    work: Work = WORK,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Fly the controllers of two wheels, and compare with the published closed-loop figures."""
    from cassini_bayes.studies.hybrid import FULL, QUICK, fly_hybrid

    numbers = _numbers(FULL, QUICK, trials, quick)
    page = out / "hybrid.md"
    with _study(page, seed, work / page.stem, quiet, jobs, dask) as study:
        fly_hybrid(study, scenario, numbers)
    _end(page)


def diagnose_published_command(
    totals: Totals = FLIGHT,
    priors: PriorsFile = TOTALS_PRIORS,
    seed: Seed = 1,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Diagnose published cases: flight biases and on-times, printed thrusts, test bed, A branch."""
    from cassini_bayes.studies.published_diagnosis import NAME, write_published_diagnosis

    say = ConsoleReporter(quiet).say
    with _study(out / f"{NAME}.md", seed, WORK, quiet) as study:
        typer.echo(json.dumps(write_published_diagnosis(study, totals, priors, say)))
