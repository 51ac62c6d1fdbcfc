"""The command line. Exit status: 0 done, 1 not converged or a check failed, 2 bad input."""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from cassini_bayes import __version__
from cassini_bayes.configuration import RunFile, check_run, read_run_file
from cassini_bayes.errors import CassiniBayesError
from cassini_bayes.run import Outcome, execute
from cassini_bayes.sampling import ProgressReport

app = typer.Typer(
    name="cassini-bayes",
    help="Bayesian posteriors of a spacecraft's thruster forces from wheel-bias telemetry.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it; typer turns the interrupt into it."""

Seed = Annotated[
    int | None, typer.Option("--seed", min=0, help="Random seed (overrides the run file).")
]
Json = Annotated[bool, typer.Option("--json", help="Machine-readable result on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress, only errors.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing run.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint.")]


class ConsoleReporter:
    """Progress on standard error: a live line in a terminal, plain lines elsewhere."""

    def __init__(self, quiet: bool) -> None:
        self._console = Console(stderr=True, quiet=quiet, highlight=False, soft_wrap=True)
        self._began = time.monotonic()
        self._first: dict[str, tuple[float, int]] = {}

    def say(self, text: str) -> None:
        """A line with the seconds since the start."""
        self._console.print(f"[{time.monotonic() - self._began:6.1f} s] {text}", markup=False)

    def progress(self, report: ProgressReport) -> None:
        """Steps done, steps and time left, and what is still missing."""
        if report.failed:
            seconds = report.seconds_left
            duration = "" if math.isnan(seconds) else f", {seconds:.0f} s"
            self.say(
                f"step {report.step}: about {report.steps_left} steps{duration} left; "
                f"waiting for {', '.join(report.failed)}"
            )
        else:
            self.say(f"step {report.step}: stop rule met")

    def count(self, what: str, done: int, total: int) -> None:
        """Repetitions done of a campaign, and the time left."""
        now = time.monotonic()
        if what not in self._first:
            self._first[what] = (now, done)
        since, already = self._first[what]
        left = (total - done) * (now - since) / (done - already) if done > already else float("nan")
        rest = f", {left:.0f} s left" if left == left else ""
        self.say(f"{what}: {done} of {total}{rest}")


@app.command("run")
def run_command(
    run_file: Annotated[Path, typer.Argument(metavar="RUN.toml", help="The run file.")],
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the run.")] = None,
    seed: Seed = None,
    force: Force = False,
    resume: Resume = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run the whole pipeline of one run file: posterior, tables, figures, report."""
    run = read_run_file(run_file)
    if seed is not None:
        run = run.model_copy(update={"sampler": run.sampler.model_copy(update={"seed": seed})})
    folder = out or run_file.parent / (run.output.folder or run_file.stem)
    _finish(
        execute(
            run,
            run_file.parent,
            folder,
            name=run_file.stem,
            command=["cassini-bayes", *sys.argv[1:]],
            reporter=ConsoleReporter(quiet),
            force=force,
            resume=resume,
        ),
        as_json=as_json,
        quiet=quiet,
    )


@app.command("fit")
def fit_command(
    events: Annotated[
        list[str], typer.Argument(metavar="EVENT...", help="Totals CSV, or CSV:ID for one row.")
    ],
    priors: Annotated[Path, typer.Option("--priors", help="Priors file.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    source: Annotated[str, typer.Option("--source", help="Which rows of a totals CSV.")] = "flight",
    seed: Seed = None,
    force: Force = False,
    resume: Resume = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Posterior only: fit.nc and tables, no report."""
    sampler: dict[str, Any] = {} if seed is None else {"seed": seed}
    run: RunFile = check_run(
        {
            "events": list(events),
            "priors": str(priors),
            "source": source,
            "sampler": sampler,
            "output": {"report": False},
        },
        "command line",
    )
    _finish(
        execute(
            run,
            Path(),
            out,
            name=out.name,
            command=["cassini-bayes", *sys.argv[1:]],
            reporter=ConsoleReporter(quiet),
            force=force,
            resume=resume,
        ),
        as_json=as_json,
        quiet=quiet,
    )


@app.command("simulate")
def simulate_command(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.toml", help="The scenario file.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="Random seed.")],
    plot: Annotated[bool, typer.Option("--plot", help="Draw every event.")] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a scenario: event folders, totals.csv and truth.json."""
    from cassini_bayes.scenario import simulate_scenario  # numba takes a moment to import

    simulation = simulate_scenario(scenario, out, seed, ConsoleReporter(quiet), force)
    if plot:
        from cassini_bayes.plots import save_figures
        from cassini_bayes.plots.simulation import motion_figure

        figures = {event.plan.event.id: motion_figure(event) for event in simulation.events}
        save_figures(figures, out / "figures")
    folders = [str(out / event.plan.event.id) for event in simulation.events]
    typer.echo(json.dumps({"seed": seed, "events": folders}) if as_json else "\n".join(folders))


calibrate = typer.Typer(help="Calibration campaigns: long, resumable, in parallel.")
app.add_typer(calibrate, name="calibrate")


@calibrate.command("totals")
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
    from cassini_bayes.campaigns import calibrate_totals

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


def _finish(outcome: Outcome, *, as_json: bool, quiet: bool) -> None:
    """Say what came of a run: the result on standard output, what is amiss on standard error."""
    if as_json:
        columns = ["name", "unit", "mean", "sd", "hdi_90_low", "hdi_90_high"]
        result = {
            "converged": outcome.converged,
            "folder": str(outcome.folder),
            "seconds": round(outcome.seconds, 1),
            "interval": "90 % highest density",
            "summary": outcome.review.summary[columns].to_dict(orient="records"),
            "warnings": list(outcome.review.warnings),
        }
        typer.echo(json.dumps(result))
    elif not quiet:
        report = outcome.folder / "report.html"
        typer.echo(str(report if report.exists() else outcome.folder / "summary.csv"))
    if not outcome.converged:
        typer.echo(
            f"not converged: {outcome.folder / 'summary.csv'} lists R-hat and ESS of every scalar; "
            "raise max_steps under [sampler] in a run file and run it with --force",
            err=True,
        )
    raise typer.Exit(0 if outcome.converged else 1)


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        typer.echo(f"cassini_bayes {__version__}")
        raise typer.Exit


def main() -> None:
    """Entry point: errors become one line on standard error, never a traceback."""
    try:
        app()
    except CassiniBayesError as error:
        _say_error(str(error))
        sys.exit(error.exit_code)
    except OSError as error:
        place = error.filename or "the system"
        reason = error.strerror or str(error)
        _say_error(f"{place}: {reason}; check the path, its permissions and the free space")
        sys.exit(2)
    except SystemExit as stop:
        if stop.code == INTERRUPTED:
            typer.echo(
                "stopped; a run or fit goes on with the same command and --resume, a campaign with "
                "the same command",
                err=True,
            )
        raise


def _say_error(text: str) -> None:
    typer.echo(f"error: {' '.join(text.split())}", err=True)
