"""`simulate`: scenarios to event folders."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from cassini_bayes.cli.options import ConsoleReporter, Effects, Force, Output, Seed


def simulate_command(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.toml", help="The scenario file.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    seed: Seed,
    *,
    plot: Annotated[bool, typer.Option("--plot", help="Draw every event.")] = False,
    effects: Effects = None,
    force: Force = False,
    output: Output,
) -> None:
    """Simulate a scenario: event folders, totals.csv and truth.json."""
    # numba takes a moment to import
    from cassini_bayes.studies.flight import simulate

    simulation = simulate(
        scenario,
        out,
        seed=seed,
        effect_files=effects or (),
        force=force,
        log=ConsoleReporter(output.quiet).log,
    )
    if plot:
        from cassini_bayes.report.plots import save_figures

        save_figures(simulation.plot_motion(), out / "figures")
    folders = [str(out / event.plan.event.id) for event in simulation.events]
    typer.echo(
        json.dumps({"seed": seed, "events": folders}) if output.as_json else "\n".join(folders)
    )
