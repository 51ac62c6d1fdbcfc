"""`calibrate` and `diagnose-published`: studies that put the inference to the test.

All are started in the same way: ``--trials`` or ``--quick``, ``--jobs`` or ``--dask``, ``--seed``,
``--work`` for finished repetitions, ``--out`` for the page; the same command goes on after a stop.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from inspect import Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cassini_bayes.cli.options import (
    ConsoleReporter,
    Dask,
    Jobs,
    PriorsFile,
    Quiet,
    Seed,
    command_line,
    spread,
)
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import DEFAULT_SEED

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
EventIds = Annotated[str, typer.Option("--events", help="Ids of the scenario's events.")]
PriorsFolder = Annotated[Path, typer.Option("--priors", help="Folder of priors files.")]

WORK = Path("runs/studies")
OUT = WORK / "pages"
FLIGHT = Path("cassini_bayes/published/flight_2009_2010.csv")
TOTALS_PRIORS = Path("priors/cassini_b_branch_2010.toml")
MISSION_PRIORS = Path("priors/cassini_mission.toml")
TELEMETRY_PRIORS = Path("priors/cassini_b_branch_telemetry.toml")
SCENARIO = Path("runs/scenarios/calibration.toml")
PRIORS = Path("priors")
BLIND_EVENTS = "bias-1,slews"
HYBRID_SCENARIO = Path("runs/scenarios/hybrid_2012.toml")
HYBRID_PRIORS = Path("priors/cassini_hybrid_2012.toml")


@dataclass(frozen=True)
class Repetitions:
    """Options that studies with repetitions have in common."""

    trials: Trials = None
    quick: Quick = False
    seed: Seed = 0
    jobs: Jobs = None
    dask: Dask = None
    work: Work = WORK
    out: Out = OUT

    def numbers(self, full: Mapping[str, int], short: Mapping[str, int]) -> Mapping[str, int]:
        """Repetitions of every part of a study."""
        if self.trials is None:
            return short if self.quick else full
        if self.quick:
            both = ("either --trials or --quick", "both")
            raise InputError("--quick", *both, "leave one of them out")
        most = max(full.values())
        return {part: max(1, round(n * self.trials / most)) for part, n in full.items()}


@contextmanager
def _study(page: str, options: Repetitions, quiet: bool) -> Iterator[Study]:
    """A study that is about to run, its workers started; ``page`` is also what it keeps."""
    from cassini_bayes.computing.workers import workers_at
    from cassini_bayes.studies.study import Study

    reporter, work = ConsoleReporter(quiet), options.work / page
    with workers_at(options.jobs, options.dask, reporter.log) as workers:
        path = options.out / f"{page}.md"
        yield Study(options.seed, work, path, workers, command_line(), reporter.count)


@contextmanager
def _at_once(page: str, out: Path, quiet: bool, seed: int = 0) -> Iterator[Study]:
    """A study without repetitions; then says where its page is."""
    with _study(page, Repetitions(seed=seed, jobs=1, out=out), quiet) as study:
        yield study
    typer.echo(str(study.page))


@dataclass(frozen=True)
class Run:
    """A run of a study: the study, and the repetitions of its parts."""

    study: Study
    numbers: Mapping[str, int]


Campaign = Callable[..., bool | None]


def _campaign(name: str, page: str, seed: int, module: str) -> Callable[[Campaign], Campaign]:
    """A study with repetitions as a command: its own options, then those of all.

    The function gets the study with the repetitions of its parts, which ``FULL`` and ``QUICK`` of
    ``module`` (below ``studies``) say, and its own options; it returns whether the study passed, or
    nothing where there is nothing to pass. Seed: that of the page as it is published.
    """

    def register(campaign: Campaign) -> Campaign:
        def command(options: Repetitions, quiet: bool, **given: Any) -> None:
            parts = import_module(f"cassini_bayes.studies.{module}")
            numbers = options.numbers(parts.FULL, parts.QUICK)
            with _study(page, options, quiet) as study:
                passed = campaign(Run(study, numbers), **given)
            typer.echo(str(study.page))
            raise typer.Exit(1 if passed is False else 0)

        _, *own = signature(campaign, eval_str=True).parameters.values()
        shared = signature(_shared, eval_str=True).parameters.values()
        vars(command)["__signature__"] = Signature([*own, *shared])
        command.__doc__ = campaign.__doc__
        app.command(name)(spread(command, seed=seed))
        return campaign

    return register


def _shared(*, options: Repetitions, quiet: Quiet = False) -> None:
    """Options of every campaign, behind its own."""


@_campaign("totals", "totals-sbc", 20_261_121, "totals_campaign")
def totals(run: Run, events: Totals = FLIGHT, priors: PriorsFile = TOTALS_PRIORS) -> bool:
    """Simulation-based calibration of the totals model, with two negative controls."""
    from cassini_bayes.studies.totals_campaign import calibrate_totals

    return calibrate_totals(run.study, events, priors, run.numbers)


@_campaign("sbc", "telemetry-sbc", 20_261_122, "telemetry_campaign")
def sbc(run: Run, scenario: ScenarioFile = SCENARIO, priors: PriorsFile = TELEMETRY_PRIORS) -> bool:
    """Simulation-based calibration of the joint model on closed-loop telemetry."""
    from cassini_bayes.studies.telemetry_campaign import calibrate_telemetry

    return calibrate_telemetry(run.study, scenario, priors, run.numbers)


@_campaign("conditions", "conditions", 20_261_123, "conditions_calibration")
def conditions(run: Run, scenario: ScenarioFile = SCENARIO, priors: PriorsFolder = PRIORS) -> bool:
    """Calibration over conditions: controllers, steps of counters, cadence, noise, events."""
    from cassini_bayes.studies.conditions_calibration import calibrate_conditions

    return calibrate_conditions(run.study, scenario, priors, run.numbers)


@app.command("attitude")
def calibrate_attitude_command(out: Out = OUT, quiet: Quiet = False) -> None:
    """Noise, steps and gyro errors of real attitude records: the source of the noise priors."""
    from cassini_bayes.studies.real_attitude import study_real_attitude

    with _at_once("real-attitude", out, quiet) as study:
        study_real_attitude(study)


@_campaign("perturbations", "perturbation-coverage", 20_120_813, "perturbation_campaign")
def perturbations(run: Run, events: Totals = FLIGHT, priors: PriorsFile = TOTALS_PRIORS) -> bool:
    """Coverage and length of perturbation bars, least squares, Laplace and posterior."""
    from cassini_bayes.studies.perturbation_campaign import compare_error_bars

    return compare_error_bars(run.study, events, priors, run.numbers)


def calibrate_blind_command(
    *,
    scenario: ScenarioFile = SCENARIO,
    priors: Annotated[
        Path | None,
        typer.Option(
            "--priors",
            help="Priors file of the B branch; with --conditions the folder of priors files.",
            show_default=f"{TELEMETRY_PRIORS}, or {PRIORS}",
        ),
    ] = None,
    events: Annotated[
        str | None,
        typer.Option("--events", help="Ids of the scenario's events.", show_default=BLIND_EVENTS),
    ] = None,
    over_conditions: Annotated[
        bool,
        typer.Option(
            "--conditions",
            help="Draw craft, events, cadence, steps, noise, controller, drive in every trial.",
        ),
    ] = False,
    parts: Annotated[
        str | None,
        typer.Option(
            "--parts",
            help="Run trials of these parts alone, e.g. null,clear.",
            show_default="all",
        ),
    ] = None,
    options: Repetitions,
    results_only: Annotated[
        bool, typer.Option("--results-only", help="Write results of the trials that are there.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Hide effects in simulated telemetry and count how often the diagnosis finds them."""
    from cassini_bayes.studies.blind import campaign as blind
    from cassini_bayes.studies.blind.flights import Blind
    from cassini_bayes.studies.blind.strata import OVER_CONDITIONS

    if results_only and parts is not None:
        wanted = "trials to run; with --results-only none are, and the page is of all there are"
        raise InputError("--parts", wanted, parts, "leave one of them out")
    if over_conditions:
        name, full, short = (
            "blind-conditions",
            blind.FULL_OVER_CONDITIONS,
            blind.QUICK_OVER_CONDITIONS,
        )
        folder = priors or PRIORS
        if events is not None:
            both = ("either --events or --conditions, which draws them", "both")
            raise InputError("--events", *both, "leave one of them out")
        if not folder.is_dir():
            found = ("with --conditions a folder of priors files", str(folder))
            raise InputError("--priors", *found, f"give {PRIORS}, or a copy of it")
        campaign = Blind(scenario, folder, options.seed, (), OVER_CONDITIONS, over_conditions=True)
    else:
        name, full, short = "blind", blind.FULL, blind.QUICK
        ids = tuple((events or BLIND_EVENTS).split(","))
        campaign = Blind(scenario, priors or TELEMETRY_PRIORS, options.seed, ids)
    numbers = options.numbers(full, short)
    with _study(name, options, quiet) as started:
        study = replace(started, page=options.out / name / "index.md")
        if not results_only:
            named = () if parts is None else tuple(parts.split(","))
            blind.run_campaign(study, campaign, numbers["trials"], named)
        typer.echo(json.dumps(blind.write_results(study, campaign.strata)))


app.command("blind")(spread(calibrate_blind_command, seed=20_261_121))


@_campaign("two-wheels", "two-wheels", 20_120_223, "blind.two_wheels")
def two_wheels(
    run: Run,
    scenario: ScenarioFile = HYBRID_SCENARIO,
    priors: PriorsFile = HYBRID_PRIORS,
    events: EventIds = "mosaic",
) -> None:
    """Hide a platform's angle or a leak in events of two wheels, and count what is named."""
    from cassini_bayes.studies.blind.two_wheels import run_two_wheels

    run_two_wheels(run.study, scenario, priors, events.split(","), run.numbers["trials"])


@_campaign("mistakes", "mistakes", 20_261_122, "mistakes")
def mistakes(run: Run, scenario: ScenarioFile = SCENARIO, priors: PriorsFolder = PRIORS) -> bool:
    """Hide mistakes in telemetry and totals; count what is named, and what honest data get."""
    from cassini_bayes.studies.mistakes import run_mistakes

    return run_mistakes(run.study, scenario, priors, run.numbers)


@_campaign("missions", "missions", 19_971_015, "missions")
def missions(run: Run, events: Totals = FLIGHT, priors: PriorsFile = MISSION_PRIORS) -> bool:
    """Simulated missions with known failures: names, onsets, false alarms, delays."""
    from cassini_bayes.studies.missions import study_missions

    return study_missions(run.study, events, priors, run.numbers)


@dataclass(frozen=True)
class OfFlight:
    """Options of studies of the flight biases that have no repetitions."""

    events: Totals = FLIGHT
    priors: PriorsFile = TOTALS_PRIORS
    seed: Seed = 20_100_329
    out: Out = OUT
    quiet: Quiet = False

    def started(self, page: str) -> AbstractContextManager[Study]:
        """The study whose page has this name."""
        return _at_once(page, self.out, self.quiet, self.seed)


def calibrate_prediction_command(options: OfFlight) -> None:
    """Leave one flight event out at a time, predict it, and compare with the published columns."""
    from cassini_bayes.studies.prediction import prediction_results

    with options.started("prediction") as study:
        prediction_results(study, str(options.events), str(options.priors))


app.command("prediction")(spread(calibrate_prediction_command))


def calibrate_papers_command(options: OfFlight) -> None:
    """Thrust against pressure, Table 1 of paper 003, inertia by date, other beliefs."""
    from cassini_bayes.studies.papers_over_years import study_papers

    with options.started("papers-over-years") as study:
        study_papers(study, options.events, options.priors)


app.command("papers")(spread(calibrate_papers_command))


@app.command("simulation")
def calibrate_simulation_command(
    trials: Trials = None,
    quick: Quick = False,
    seed: Seed = DEFAULT_SEED,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Hold the simulation against printed figures: momentum, impulse, biases, hydrazine."""
    from cassini_bayes.studies.simulation import FULL, QUICK, simulation_results

    numbers = Repetitions(trials, quick).numbers(FULL, QUICK)
    with _at_once("simulation", out, quiet, seed) as study:
        simulation_results(study, numbers)


def calibrate_leaks_command(
    *,
    scenario: ScenarioFile = SCENARIO,
    priors: PriorsFile = TELEMETRY_PRIORS,
    calibrated: Annotated[
        bool, typer.Option("--calibrated", help="Thrusters known to a tenth of their priors.")
    ] = False,
    options: Repetitions,
    quiet: Quiet = False,
) -> None:
    """Hide leaks in simulated biases: two monitors at equal false-alarm rates."""
    from cassini_bayes.studies.leak_campaign import FULL, QUICK, compare_leak_monitors

    numbers = options.numbers(FULL, QUICK)
    with _study("leaks-calibrated" if calibrated else "leaks", options, quiet) as study:
        compare_leak_monitors(study, scenario, priors, numbers, calibrated=calibrated)
    typer.echo(str(study.page))


app.command("leaks")(spread(calibrate_leaks_command, seed=20_050_128))


@_campaign("hybrid", "hybrid", 0, "hybrid")
def hybrid(run: Run, scenario: ScenarioFile = HYBRID_SCENARIO) -> None:
    """Fly the controllers of two wheels, and compare with the published closed-loop figures."""
    from cassini_bayes.studies.hybrid import fly_hybrid

    fly_hybrid(run.study, scenario, run.numbers)


def diagnose_published_command(
    totals: Totals = FLIGHT,
    priors: PriorsFile = TOTALS_PRIORS,
    seed: Seed = DEFAULT_SEED,
    out: Out = OUT,
    quiet: Quiet = False,
) -> None:
    """Diagnose published cases: flight biases and on-times, printed thrusts, test bed, A branch."""
    from cassini_bayes.studies.published_diagnosis import NAME, write_published_diagnosis

    log = ConsoleReporter(quiet).log
    with _study(NAME, Repetitions(seed=seed, jobs=1, out=out), quiet) as study:
        typer.echo(json.dumps(write_published_diagnosis(study, totals, priors, log)))
