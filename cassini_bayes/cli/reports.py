"""`report`: tables, figures and page of a finished run, made again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cassini_bayes.cli.fits import say_not_converged
from cassini_bayes.cli.options import ConsoleReporter, Effects, Plausibility, Quiet


def report_command(
    fit: Annotated[Path, typer.Argument(metavar="FIT_DIR", help="Folder of a run, or its fit.nc.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder to write (default: the run's own).")
    ] = None,
    base: Annotated[
        Path | None,
        typer.Option("--base", help="Folder that the run's paths are relative to, if they moved."),
    ] = None,
    effects: Effects = None,
    quiet: Quiet = False,
) -> None:
    """Write summary, tables, figures and report.html of a finished run or fit."""
    from cassini_bayes.pipeline.fits import read_fit, report
    from cassini_bayes.results.review import is_converged

    result = read_fit(fit, base=base, effect_files=effects or ())
    page = report(result, out, reporter=ConsoleReporter(quiet))
    typer.echo(str(page))
    converged = is_converged(result.review)
    if not converged:
        say_not_converged(page.parent)
    Plausibility().end(result.review.warnings, converged=converged)
