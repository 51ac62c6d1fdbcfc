"""`causes`, `parameters`, `quantities`: what can be named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from cassini_bayes.cli.options import Effects, Json
from cassini_bayes.errors import InputError
from cassini_bayes.files.tables import frame_records

if TYPE_CHECKING:
    import pandas as pd

PRIORS: Final = Path("priors/cassini_b_branch_telemetry.toml")


def causes_command(
    priors: Annotated[
        Path, typer.Option("--priors", help="Priors file: its spacecraft gives the targets.")
    ] = PRIORS,
    effects: Effects = None,
    as_json: Json = False,
) -> None:
    """Causes that a diagnosis weighs, and effects that a fit takes by name, with their priors."""
    from cassini_bayes.pipeline.listings import causes

    if priors == PRIORS and not priors.exists():
        wanted = "a priors file, whose spacecraft has the targets"
        raise InputError("--priors", wanted, f"none, and no {PRIORS} here", "name one")
    _show(causes(priors, effect_files=effects or ()), as_json)


def parameters_command(
    priors: Annotated[
        Path | None, typer.Option("--priors", help="Priors file: its priors beside the names.")
    ] = None,
    spacecraft: Annotated[
        str, typer.Option("--spacecraft", help="Without --priors: a spacecraft's name or file.")
    ] = "cassini",
    as_json: Json = False,
) -> None:
    """Parameters that a priors file may give, with unit, meaning and prior."""
    from cassini_bayes.pipeline.listings import parameters
    from cassini_bayes.spacecraft import load_spacecraft

    table = parameters(load_spacecraft(spacecraft) if priors is None else priors)
    _show(table, as_json, leave_out=("source",))


def quantities_command(
    fit: Annotated[Path, typer.Argument(metavar="FIT_DIR", help="Folder of a run, or its fit.nc.")],
    as_json: Json = False,
) -> None:
    """Quantities of a fit by the names that sweep, plan and summary take."""
    from cassini_bayes.pipeline.listings import quantities

    _show(quantities(fit), as_json)


def _show(table: pd.DataFrame, as_json: bool, leave_out: tuple[str, ...] = ()) -> None:
    """The table as JSON, or as text without the columns that are too long for a terminal."""
    if as_json:
        typer.echo(json.dumps(frame_records(table), ensure_ascii=False))
        return
    shown = table.drop(columns=[name for name in leave_out if name in table]).map(_cell)
    widths = [max(map(len, [name, *shown[name]])) for name in shown]
    for row in [list(shown.columns), *shown.to_numpy().tolist()]:
        line = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        typer.echo(line.rstrip())


def _cell(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
