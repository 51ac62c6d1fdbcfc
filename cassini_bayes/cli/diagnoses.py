"""`diagnose`: what the simulation gets wrong."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from cassini_bayes.cli.options import (
    ConsoleReporter,
    Effects,
    Output,
    Plausibility,
    PriorsFile,
    Restart,
    Seed,
    Source,
    command_line,
    warn,
)
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import DEFAULT_SEED


def diagnose_command(
    events: Annotated[
        list[str],
        typer.Argument(
            metavar="EVENT...", help="Event folders, totals CSV or file.csv:ID; or estimates CSV."
        ),
    ],
    priors: PriorsFile,
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    *,
    effects: Effects = None,
    source: Source = "flight",
    gain: Annotated[bool, typer.Option("--gain/--no-gain", help="Hold events out.")] = True,
    then_fit: Annotated[
        bool, typer.Option("--then-fit", help="Sample the extended model with emcee.")
    ] = False,
    seed: Seed = DEFAULT_SEED,
    plausibility: Plausibility,
    restart: Restart,
    output: Output,
) -> None:
    """Show what the simulation gets wrong, name the cause, measure the gain."""
    from cassini_bayes.pipeline.diagnoses import diagnose
    from cassini_bayes.report.diagnosis import diagnosis_json
    from cassini_bayes.results.fitting import ALL_MET

    reporter = ConsoleReporter(output.quiet)
    if then_fit:
        refuse_estimates(events)
    result = diagnose(
        events,
        priors,
        effect_files=effects or (),
        source=source,
        gain=gain,
        **plausibility.policy,
        seed=seed,
        folder=out,
        **vars(restart),
        log=reporter.log,
        progress=reporter.count,
        command=command_line(),
    )
    converged = True
    if then_fit:
        stop_rule = result.fit(log=reporter.log).attrs["stop_rule"]
        converged = stop_rule == ALL_MET
        if not converged:
            warn([f"the extended model has NOT CONVERGED: {stop_rule}"])
    output.show(
        lambda: diagnosis_json(result.record).rstrip(),
        lambda: "\n".join([*result.sentences, str(out / "report.html")]),
    )
    plausibility.end(result.record["findings"], converged=converged)


def refuse_estimates(events: Sequence[str]) -> None:
    """Printed estimates have no model to sample: say so before anything is searched."""
    from cassini_bayes.diagnosis.estimates import is_estimates

    if any(is_estimates(Path(event)) for event in events):
        raise InputError("--then-fit", "telemetry or totals", "printed estimates", "drop it")
