"""The trend of a mission: read, fit or go on with earlier draws, tables, figures, report.

A trend folder holds ``checkpoint/`` (densities and reduced telemetry: a killed trend goes on with
the same command, further events go on from the draws), then ``trend.nc``, ``trend.csv``,
``trend.json``, ``figures/``, ``report.html`` and ``provenance.json``.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from cassini_bayes import __version__
from cassini_bayes.errors import InputError
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.code import code_digest
from cassini_bayes.files.storage import remove_leftovers, write_text
from cassini_bayes.files.tables import finite, frame_csv, frame_records
from cassini_bayes.model.mission.inputs import MissionInputs, read_mission
from cassini_bayes.model.mission.mission_file import MissionTable
from cassini_bayes.pipeline.provenance import library_versions
from cassini_bayes.pipeline.run import CHECKPOINT, Reporter
from cassini_bayes.prediction.sources import PROVENANCE, RESOLVED
from cassini_bayes.report.shown import html_of, names_shown, with_interval
from cassini_bayes.results.exchange import draws_as_inference_data
from cassini_bayes.results.mission.fitting import MissionFit, fit_mission
from cassini_bayes.results.mission.groups import mission_fit_record
from cassini_bayes.results.mission.record import (
    earlier_draws,
    kept_fit,
    save_state,
    save_trend,
    trend_draws,
)
from cassini_bayes.results.mission.trend import Trend, proportional_odds, trend_of
from cassini_bayes.results.record import FIT_FILE, save_fit

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure

DRAWN_BY: Final = ("model.mission.inputs", "results.mission.fitting")
"""Modules whose code, with all that they import, the draws of a trend depend on."""


@dataclass(frozen=True, eq=False, repr=False)
class TrendOutcome:
    """What a trend produced; ``fit.converged`` decides the exit code."""

    folder: Path
    fit: MissionFit
    trend: Trend
    record: Mapping[str, Any]
    seconds: float
    dated: Mapping[str, str] = field(default_factory=dict)  # facts by epoch, in words
    warnings: tuple[str, ...] = ()  # mistakes that were accepted, and what fits nothing known

    @property
    def converged(self) -> bool:
        """Whether the draws can be relied upon."""
        return self.fit.converged

    def summary(self) -> pd.DataFrame:
        """One row per event and thruster: thrust (N) with its central 90 % interval."""
        return with_interval(self.trend.thrust, "90 % central")

    def health(self) -> pd.DataFrame:
        """One row per thruster: probability that it fails, its loss, the alarm."""
        return with_interval(self.trend.health, "90 % central")

    def forecast(self) -> pd.DataFrame:
        """Thrusts at the dates that the mission file asks for."""
        return with_interval(self.trend.forecast, "90 % central")

    def plot_trends(self) -> dict[str, Figure]:
        """Three figures of every branch: thrust, normalised thrust, losses."""
        from cassini_bayes.report.plots import draw
        from cassini_bayes.report.plots.mission import mission_drawings

        trend = self.trend
        return draw(mission_drawings(trend.thrust, trend.health, trend.onsets, self.dated))

    def to_arviz(self) -> Any:  # ArviZ carries no types
        """Thrusts of all events and what was walked as the posterior of ``InferenceData``."""
        draws = trend_draws(self.fit, self.trend)
        return draws_as_inference_data({str(k): v for k, v in draws.data_vars.items()}, "posterior")

    def _state(self) -> str:
        state = "converged" if self.converged else "NOT CONVERGED"
        return f"{state}; events {names_shown(tuple(self.record['events']))}; in {self.folder}"

    def __repr__(self) -> str:
        rows = self.trend.health.to_dict(orient="records")
        failing = [f"{r['branch']} {r['thruster']}" for r in rows if r["alarm"]]
        return f"TrendOutcome: {self._state()}; alarms: {', '.join(failing) or 'none'}"

    def _repr_html_(self) -> str:
        return html_of("Trend of a mission", [self._state()], self.health())


def execute_trend(
    mission: MissionTable,
    where: str,
    base: Path,
    folder: Path,
    *,
    name: str,
    command: Sequence[str],
    reporter: Reporter,
    report: bool = True,
    fit_record: bool = False,
) -> TrendOutcome:
    """Work out the trend of a mission and write it to ``folder``.

    The same command goes on where a killed one stopped, has the same draws where one has ended, and
    updates those of a shorter mission where events have been added.

    Parameters
    ----------
    where, base
        The mission file for messages, and the folder that its paths are relative to.
    fit_record
        Whether to write ``fit.nc`` too, in the layout of a fit of one branch.

    Raises
    ------
    InputError
        Anything wrong with the inputs or the folder.
    """
    from cassini_bayes.report.mission import write_trend_report
    from cassini_bayes.report.plots import draw, save_figures
    from cassini_bayes.report.plots.mission import mission_drawings

    began = time.monotonic()
    _refuse_run(folder)
    inputs = read_mission(mission, base, where, folder / CHECKPOINT / "statistics", reporter.log)
    if folder.is_dir():
        remove_leftovers(folder)
    laws = _laws(mission, inputs)
    fit = _fitted(mission, inputs, laws, folder / CHECKPOINT, reporter)
    trend = trend_of(fit, mission, inputs.on_time_s, np.random.default_rng([mission.trend.seed, 1]))
    record = _record(mission, inputs, fit, trend, laws)
    save_trend(fit, trend, folder / "trend.nc")
    if fit_record:
        rng = np.random.default_rng([mission.trend.seed, 2])
        save_fit(mission_fit_record(fit, trend.draws, rng), folder / FIT_FILE)
    write_text(folder / "trend.csv", frame_csv(trend.thrust, digits=6))
    write_text(folder / "trend.json", json.dumps(record, indent=1, allow_nan=False) + "\n")
    write_text(folder / PROVENANCE, json.dumps(_provenance(inputs, laws, command), indent=2) + "\n")
    dated = {str(fact.epoch): fact.what.replace("_", " ") for fact in mission.dated}
    if report:
        figures = draw(mission_drawings(trend.thrust, trend.health, trend.onsets, dated))
        save_figures(figures, folder / "figures")
        made = f"Made by {' '.join(command)} with cassini_bayes {__version__}."
        write_trend_report(folder / "report.html", name, fit, mission, trend, figures, made)
    seconds = time.monotonic() - began
    reporter.log(f"{'done' if fit.converged else 'NOT CONVERGED'} in {seconds:.0f} s: {folder}")
    return TrendOutcome(folder, fit, trend, record, seconds, dated, inputs.findings)


def _refuse_run(folder: Path) -> None:
    """A run or diagnosis stays what it says it is of: a trend would replace half of its files."""
    if (folder / RESOLVED).exists():
        raise InputError(
            str(folder),
            "a new folder, or that of an earlier trend",
            f"a run or diagnosis (with {RESOLVED})",
            "choose another --out",
        )


def _fitted(
    mission: MissionTable, inputs: MissionInputs, laws: str, work: Path, reporter: Reporter
) -> MissionFit:
    """The fit that was kept of these events, else one from the draws of a shorter mission."""
    content = _hash(laws, *(f"{event} {value}" for event, value in inputs.digests.items()))
    densities = work / content[:16]

    def store_of(label: str) -> CheckpointStore:
        return CheckpointStore(densities / _hash(label)[:16], _hash(content, label))

    state = CheckpointStore(work / f"draws_{laws[:16]}", laws)
    kept = kept_fit(inputs.model, inputs.losses, inputs.digests, state)
    if kept is not None:
        reporter.log("draws as they were kept: the same events")
        return kept
    earlier = earlier_draws(inputs.digests, state)
    if earlier is not None:
        reporter.log("going on from the draws of an earlier trend")
    fit = fit_mission(
        inputs.model,
        inputs.losses,
        np.random.default_rng([mission.trend.seed, 0]),
        draws=mission.trend.draws,
        proposals=mission.trend.proposals,
        earlier=earlier,
        store_of=store_of,
        log=reporter.log,
    )
    if fit.converged:
        save_state(fit, inputs.digests, state)
    return fit


def _laws(mission: MissionTable, inputs: MissionInputs) -> str:
    """Hash of all that the draws depend on beside the events."""
    table = mission.model_dump(
        mode="json", exclude={"events": True, "accept": True, "trend": {"forecast"}}
    )
    return _hash(
        json.dumps(table, sort_keys=True),
        inputs.priors.digest,
        inputs.priors.spacecraft.digest,
        code_digest(*DRAWN_BY),
        json.dumps(library_versions(), sort_keys=True),
    )


def _hash(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _provenance(inputs: MissionInputs, laws: str, command: Sequence[str]) -> dict[str, Any]:
    return {
        "format": 1,
        "package": {"cassini_bayes": __version__, "code_sha256": code_digest("cli")},
        "versions": library_versions(),
        "sha256": {inputs.priors.path: inputs.priors.digest, **inputs.digests},
        "identity": laws,
        "command": list(command),
    }


def _record(
    mission: MissionTable, inputs: MissionInputs, fit: MissionFit, trend: Trend, laws: str
) -> dict[str, Any]:
    """``trend.json``: health, alarms, forecast and how the draws were made."""
    names, values = fit.model.space.names, fit.model.space.to_parameters(trend.draws.z)
    record = {
        "format": 1,
        "identity": laws,
        "events": list(inputs.digests),
        "converged": fit.converged,
        "warnings": list(inputs.findings),
        "log_evidence": fit.log_evidence_total,
        "log_evidence_se": fit.log_evidence_se,
        "pareto_k": fit.pareto_k,
        "log_bayes_proportional_law": proportional_odds(fit.model, trend.draws.z),
        "slopes": {
            branch: {
                "mean_n_per_year": float(branch_draws.slope.mean()),
                "sd_n_per_year": float(branch_draws.slope.std()),
                "below_zero": float((branch_draws.slope < 0).mean()),
            }
            for branch, branch_draws in trend.draws.branches.items()
        },
        "alarm_above": mission.trend.alarm,
        "health": frame_records(trend.health),
        "onsets": frame_records(trend.onsets),
        "forecast": frame_records(trend.forecast),
        "parameters": {
            name: {
                "mean": float(np.mean(values[name])),
                "sd": float(np.std(values[name])),
                "unit": fit.model.units[name],
            }
            for name in names
        },
    }
    result: dict[str, Any] = finite(record)  # Pareto k̂ of few draws is not
    return result
