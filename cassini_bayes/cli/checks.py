"""`check`: all that is known before sampling, on one page."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from cassini_bayes.cli.options import (
    ConsoleReporter,
    Effects,
    FittedEffects,
    Output,
    Plausibility,
    PriorsFile,
    Source,
)


def check_command(
    events: Annotated[
        list[str],
        typer.Argument(
            metavar="EVENT...", help="Event folder, totals CSV, or CSV:ID for one of its rows."
        ),
    ],
    priors: PriorsFile,
    *,
    source: Source = "flight",
    effect: FittedEffects = None,
    effects: Effects = None,
    plausibility: Plausibility,
    output: Output,
) -> None:
    """Before sampling: plausibility, rows used, what these events can see, conflicts, time."""
    from cassini_bayes.pipeline.checks import check

    result = check(
        events,
        priors,
        effects=effect or (),
        effect_files=effects or (),
        source=source,
        **plausibility.policy,
        log=ConsoleReporter(output.quiet).log,
    )
    output.show(lambda: json.dumps(result.as_record()), lambda: repr(result))
    plausibility.end(result.warnings, said=not (output.quiet or output.as_json))
