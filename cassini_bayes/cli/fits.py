"""`run` and `fit`: posteriors of events."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from cassini_bayes.cli.options import (
    ConsoleReporter,
    Effects,
    FittedEffects,
    GivenSource,
    MaxSteps,
    NoReport,
    Output,
    Plausibility,
    Restart,
    SeedOverride,
    command_line,
)
from cassini_bayes.cli.trends import fit_of_mission
from cassini_bayes.errors import InputError

if TYPE_CHECKING:
    from cassini_bayes.pipeline.run import Outcome
    from cassini_bayes.pipeline.run_file import RunFile


GIVEN = "command line"
"""What messages call settings that come from it, in place of a run file's path."""
PLUS_MINUS = "(± is one standard deviation of the posterior)"


def run_command(
    run_file: Annotated[Path, typer.Argument(metavar="RUN.toml", help="The run file.")],
    *,
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the run.")] = None,
    effects: Effects = None,
    seed: SeedOverride = None,
    max_steps: MaxSteps = None,
    restart: Restart,
    plausibility: Plausibility,
    output: Output,
) -> None:
    """Run the whole pipeline of one run file: posterior, tables, figures, report."""
    from cassini_bayes.pipeline.run_file import read_run_file

    run = read_run_file(run_file, _sampler(seed, max_steps))
    run = run.accepting(plausibility.accept or [], leave_out=plausibility.leave_out)
    folder = out or run_file.parent / (run.output.folder or run_file.stem)
    outcome = _execute(run, run_file, folder, run_file.stem, effects, restart, output)
    _finish(outcome, plausibility, output)


def fit_command(
    events: Annotated[
        list[str],
        typer.Argument(
            metavar="EVENT...",
            help="Event folder (telemetry), totals CSV, or CSV:ID for one of its rows; any mix.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    *,
    priors: Annotated[Path | None, typer.Option("--priors", help="Priors file.")] = None,
    mission: Annotated[
        Path | None,
        typer.Option(
            "--mission",
            metavar="MISSION.toml",
            help="Mission file: events of both branches in one fit, with its facts and priors.",
        ),
    ] = None,
    source: GivenSource = None,
    effect: FittedEffects = None,
    effects: Effects = None,
    seed: SeedOverride = None,
    max_steps: MaxSteps = None,
    restart: Restart,
    plausibility: Plausibility,
    no_report: NoReport = False,
    output: Output,
) -> None:
    """Posterior of events: fit.nc, tables, figures and report."""
    from cassini_bayes.pipeline.run_file import check_run

    if mission is not None:
        others = (*vars(plausibility).values(), *vars(restart).values(), no_report)
        if effect or effects or max_steps or any(others):
            raise InputError(
                "--mission",
                "no option about effects, steps, plausibility, strictness, restarts or the report",
                "one of --effect, --effects, --max-steps, --accept, --leave-out, --strict, "
                "--force, --resume, --no-report",
                "fit events of one branch with it, or leave it out",
            )
        fit_of_mission(mission, events, priors, source, out, seed, output)
    if priors is None:
        raise InputError(
            "--priors", "a priors file, or a mission file that names one", "neither",
            "add --priors FILE, or --mission MISSION.toml",
        )  # fmt: skip
    run = check_run(
        {
            "events": list(events),
            "priors": str(priors),
            **({} if source is None else {"source": source}),
            **plausibility.policy,
            "model": {"effects": effect or []},
            "sampler": _sampler(seed, max_steps),
            "output": {"report": not no_report},
        },
        GIVEN,
    )
    given = Path(GIVEN)
    _finish(_execute(run, given, out, out.name, effects, restart, output), plausibility, output)


def _sampler(seed: int | None, max_steps: int | None) -> dict[str, int]:
    """Settings of the sampler that the command line gives."""
    given = {"seed": seed, "max_steps": max_steps}
    return {name: value for name, value in given.items() if value is not None}


def _execute(
    run: RunFile,
    file: Path,
    folder: Path,
    name: str,
    effects: Effects,
    restart: Restart,
    output: Output,
) -> Outcome:
    from cassini_bayes.effects.registry import read_kinds
    from cassini_bayes.pipeline.run import execute

    return execute(
        run,
        file.parent,
        folder,
        where=str(file),
        name=name,
        command=command_line(),
        reporter=ConsoleReporter(output.quiet),
        **vars(restart),
        kinds=read_kinds(effects or ()),
    )


def _finish(outcome: Outcome, plausibility: Plausibility, output: Output) -> NoReturn:
    """Say what came of a run: the result on standard output, what is amiss on standard error.

    What contradicts stands last, so that nothing scrolls it away, and even with ``--quiet``.
    """
    output.show(lambda: json.dumps(as_record(outcome)), lambda: "\n".join(_lines(outcome)))
    if not outcome.converged:
        say_not_converged(outcome.folder)
    plausibility.end(outcome.review.warnings, converged=outcome.converged)


def say_not_converged(folder: Path) -> None:
    """Where to see what is missing, and what to do, on standard error."""
    typer.echo(
        f"not converged: {folder / 'summary.csv'} lists R-hat and ESS of every scalar; "
        "give the command that made it --resume and a larger --max-steps",
        err=True,
    )


def as_record(outcome: Outcome) -> dict[str, object]:
    """The outcome as plain JSON types."""
    columns = ["name", "unit", "mean", "sd", "hdi_90_low", "hdi_90_high"]
    return {
        "converged": outcome.converged,
        "folder": str(outcome.folder),
        "seconds": round(outcome.seconds, 1),
        "interval": "90 % highest density",
        "summary": outcome.review.summary[columns].to_dict(orient="records"),
        "verdict": list(outcome.verdict),
        "warnings": list(outcome.review.warnings),
    }


def _lines(outcome: Outcome) -> list[str]:
    """The verdict, whether it stands, and where to look next."""
    from cassini_bayes.report.verdict import NOT_CONVERGED

    report = outcome.folder / "report.html"
    where = [str(outcome.folder / "figures"), str(report)]
    if not report.exists():
        where = [str(outcome.folder / "summary.csv")]
    doubt = []
    if not outcome.converged:
        doubt = [NOT_CONVERGED]
    elif outcome.review.warnings:
        doubt = ["WITH WARNINGS, which stand last: read them before you use what follows"]
    return [*doubt, *outcome.verdict, PLUS_MINUS, *where]
