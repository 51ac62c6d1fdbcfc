"""Events of a mission: read, checked, and put beside what the mission has to know of each."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import Policy
from cassini_bayes.events.telemetry import read_event
from cassini_bayes.events.telemetry.event import event_path
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.event_reduction import (
    EventRows,
    ReducedEvent,
    is_event_folder,
    reduce_event,
    store_reduction,
)
from cassini_bayes.model.gather import Read, together
from cassini_bayes.model.mission.circumstances import EventFacts, circumstances_of
from cassini_bayes.model.mission.losses import LossPrior, loss_prior
from cassini_bayes.model.mission.mission_file import MissionTable
from cassini_bayes.model.mission.model import MissionModel, build_mission
from cassini_bayes.model.nominal import check_rows
from cassini_bayes.model.posterior import Event
from cassini_bayes.priors.reader import Priors, read_priors


@dataclass(frozen=True)
class MissionInputs:
    """A mission's priors and events, beliefs on losses, and its model; digests are of the files.

    ``findings`` are mistakes that were accepted, and what fits nothing known.
    """

    priors: Priors
    model: MissionModel
    losses: LossPrior
    on_time_s: Mapping[str, Array]  # event → (K,)
    digests: Mapping[str, str]  # event → SHA-256 of where it came from
    findings: tuple[str, ...]


def read_mission(
    mission: MissionTable,
    base: Path,
    where: str,
    cache: Path | None = None,
    log: Log = silent,
) -> MissionInputs:
    """Read priors and events that a mission file names, relative to ``base``.

    Parameters
    ----------
    cache
        Folder of reduced telemetry, taken from there where nothing changed and kept there.

    Raises
    ------
    InputError
        Anything wrong with priors, events or their circumstances; another spacecraft than the
        priors'; a fact of a branch that it has not; an id twice, or data under two; a mistake that
        explains what no fault of a spacecraft does (it is named).
    """
    priors = read_priors(base / mission.priors)
    losses = loss_prior(priors)
    name = mission.spacecraft.name or priors.spacecraft.name
    if name != priors.spacecraft.name:
        raise InputError(
            f"{where}: spacecraft.name",
            f"{priors.spacecraft.name!r}, as in {mission.priors}",
            repr(name),
            "use the priors of that spacecraft",
        )
    for number, dated in enumerate(mission.dated, start=1):
        if dated.branch is not None:
            priors.spacecraft.check_branch(f"{where}: dated[{number}].branch", dated.branch)
    reads: list[Read] = []
    facts: list[EventFacts] = []
    digests: dict[str, str] = {}
    policy = Policy.of(mission.accept, leave_out=mission.leave_out, where=f"{where}: accept")
    for reference in mission.events:
        place = Path(event_path(base / reference))
        if is_event_folder(place):
            reduced, fact = _telemetry(place, priors, mission.pulse_shape, cache, log, policy)
            reads.append(Read.of_reduced(reduced, str(place)))
            result = [(fact, reduced.digest)]
        else:
            rows = read_totals(str(place), priors.spacecraft, mission.source)
            findings: list[str] = []
            for branch in sorted({row.branch for row in rows}):
                of_branch = priors.for_branch(branch)
                findings += check_rows(rows, of_branch, str(place), policy, steady=False)
            reads.append(Read.of_rows(rows, findings, str(place)))
            result = [
                (EventFacts(row.id, row.epoch, row.branch, True, None), _row_digest(row))
                for row in rows
            ]
        for fact, content in result:
            if fact.id in digests:
                raise InputError(
                    f"{where}: event {fact.id}",
                    "each event once in a mission",
                    "the same id twice",
                    "leave one out, or rename one",
                )
            digests[fact.id] = content
            facts.append(fact)
    events, findings_of_all = together(reads, priors, policy)
    circumstances = circumstances_of(mission, facts, where)
    model = build_mission(mission, priors, events, circumstances, where)
    on_times = {event.id: _on_times(event) for event in events}
    return MissionInputs(priors, model, losses, on_times, digests, findings_of_all)


def _telemetry(
    folder: Path, priors: Priors, pulse_shape: str, cache: Path | None, log: Log, policy: Policy
) -> tuple[ReducedEvent, EventFacts]:
    """A folder of telemetry, reduced; its tank pressure is the mean of its readings."""
    described = read_event(folder, priors.spacecraft)
    of_branch = priors.for_branch(described.branch)
    reduced = reduce_event(folder, of_branch, pulse_shape, cache, log, policy)
    if cache is not None:
        store_reduction(reduced, cache)
    readings = [
        chunk.tank_pressure_kpa[np.isfinite(chunk.tank_pressure_kpa)]
        for chunk in EventRows(described, priors.spacecraft).chunks()
    ]
    values = np.concatenate(readings)
    pressure = float(values.mean()) if len(values) else None
    fact = EventFacts(reduced.id, described.epoch, described.branch, reduced.fires, pressure)
    return reduced, fact


def _on_times(event: Event) -> Array:
    """Commanded on-time of every thruster in an event, s."""
    if isinstance(event, TotalsEvent):
        return event.on_time_s
    return np.asarray(event.reading.on_time_s, dtype=np.float64)


def _row_digest(row: TotalsEvent) -> str:
    """SHA-256 of what a totals row says: other rows of its file do not matter."""
    values = (getattr(row, field.name) for field in fields(row))
    text = repr([v.tolist() if isinstance(v, np.ndarray) else v for v in values])
    return hashlib.sha256(text.encode()).hexdigest()
