"""A simulation as its user holds it: what flew, as a table and as figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.files.checks import check_seed
from cassini_bayes.report.shown import html_of, names_shown
from cassini_bayes.simulation import read_scenario
from cassini_bayes.studies.scenario import (
    Simulation,
    simulate_file,
    simulate_scenario,
    simulated_sides,
)

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Flight(Simulation):
    """A simulation that shows itself: a table, figures, a line of text."""

    def summary(self) -> pd.DataFrame:
        """One row per event: its kind, duration, rows of telemetry, on-time and pulses."""
        rows = []
        for event in self.events:
            logs = event.motion.pulses.values()
            rows.append(
                {
                    "event": event.plan.event.id,
                    "kind": event.plan.event.kind,
                    "duration_s": float(event.motion.duration_s),
                    "rows": len(event.telemetry.time_s),
                    "on_time_s": float(sum(log.width_s.sum() for log in logs)),
                    "pulses": int(sum(log.width_s.size for log in logs)),
                }
            )
        return pd.DataFrame(rows)

    def plot_motion(self) -> dict[str, Figure]:
        """A figure per event: attitude, rates, wheel rates, firings."""
        from cassini_bayes.report.plots import draw
        from cassini_bayes.report.plots.simulation import motion_figure

        return draw({event.plan.event.id: partial(motion_figure, event) for event in self.events})

    def __repr__(self) -> str:
        effects = ", ".join(effect.name for effect in self.file.scenario.effect) or "no effect"
        names = names_shown([event.plan.event.id for event in self.events])
        return f"Simulation of {names}: seed {self.seed}, {effects} hidden"

    def _repr_html_(self) -> str:
        return html_of("Simulation", [repr(self)], self.summary())


def simulate(
    scenario: str | Path,
    folder: str | Path | None = None,
    *,
    seed: int,
    effect_files: Sequence[str | Path] = (),
    force: bool = False,
    log: Log = silent,
) -> Flight:
    """Fly a scenario in closed loop: telemetry of wheel biases, slews, burns, with hidden effects.

    Parameters
    ----------
    scenario
        The scenario file.
    folder
        Where to write event folders, ``totals.csv`` and ``truth.json``; nothing without it.
    seed
        The same scenario and seed give the same bytes.
    effect_files
        Files of effects that are not of this package.
    force
        Replace what an earlier simulation left in ``folder``.
    log
        Told of every event.

    Raises
    ------
    InputError
        Anything wrong with the scenario, or a folder that holds something already.
    """
    seed = check_seed(seed)
    sides = simulated_sides([Path(path) for path in effect_files])
    if folder is None:
        flown = simulate_file(read_scenario(scenario, sides), seed, log)
    else:
        flown = simulate_scenario(scenario, folder, seed, log, force, sides)
    return Flight(flown.file, flown.seed, flown.events)
