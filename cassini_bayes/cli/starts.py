"""`init`: the first files for a spacecraft and its telemetry."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer


def init_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write.")],
    spacecraft: Annotated[
        str, typer.Option("--spacecraft", help="Name of a built-in one, or a spacecraft file.")
    ],
    data: Annotated[
        list[Path] | None,
        typer.Option("--from", help="Telemetry: CSV, Parquet, HDF5 or .mat; may be repeated."),
    ] = None,
    branch: Annotated[
        str | None, typer.Option("--branch", help="Thruster branch (default: the last).")
    ] = None,
) -> None:
    """Write starting priors, run, event and channel files; no file is ever replaced."""
    from cassini_bayes.pipeline.starting import write_starting_files

    log = partial(typer.echo, err=True)
    for path in write_starting_files(folder, spacecraft, data or (), branch, log):
        typer.echo(str(path))
