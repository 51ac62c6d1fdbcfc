"""From a scenario file to event folders: draws the truth, simulates, writes.

Above the simulation, because a truth may be drawn from a priors file, which the simulation does
not know.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from cassini_bayes.errors import InputError
from cassini_bayes.events import TotalsEvent, write_totals
from cassini_bayes.priors import ZERO_CENTRED, Priors, read_priors
from cassini_bayes.simulation import (
    ScenarioFile,
    SimulatedEvent,
    Truth,
    check_complete,
    event_text,
    make_plan,
    read_scenario,
    required_parameters,
    simulate_plan,
    stream,
    telemetry_text,
    totals_row,
    truth_text,
)
from cassini_bayes.storage import write_text

TRUTH_FILE: Final = "truth.json"
TOTALS_FILE: Final = "totals.csv"


class Reporter(Protocol):
    """Where progress goes."""

    def say(self, text: str) -> None:
        """Take one line of progress."""


@dataclass(frozen=True)
class Simulation:
    """Everything that one seed of a scenario gives, before it is written."""

    file: ScenarioFile
    seed: int
    events: tuple[SimulatedEvent, ...]

    def truth_text(self) -> str:
        """Content of ``truth.json``."""
        plans = [event.plan for event in self.events]
        return truth_text(self.seed, plans, self.file.effects)

    def totals(self) -> tuple[TotalsEvent, ...]:
        """Totals of the biases among the events."""
        settings = self.file.scenario.telemetry
        return tuple(
            TotalsEvent(**totals_row(event.plan, event.motion, settings, self.seed))
            for event in self.events
            if event.plan.event.kind == "bias"
        )


def draw_truth(file: ScenarioFile, seed: int) -> Truth:
    """The truth of a scenario: what it gives, and the rest drawn from its priors file.

    Every parameter has a random stream of its own, so that giving one does not change the others.
    Departures of thrust are drawn per thruster, per event, and per event and thruster.

    Raises
    ------
    InputError
        The priors file is bad or of another branch, or a parameter that is needed is in neither
        file.
    """
    scenario, spacecraft = file.scenario, file.spacecraft
    ids = [event.id for event in scenario.event]
    thrusters = spacecraft.thruster_names(scenario.spacecraft.branch)
    priors = None if file.draw_from is None else _priors_of(file)
    given = file.given()
    drawn: dict[str, float] = {}
    if priors is not None:
        for name in priors.parameters:
            if name not in given and name not in ZERO_CENTRED:
                drawn[name] = _draw(priors, name, seed)
    individual = file.individual_n()
    events = {event.id: dict(event.truth) for event in scenario.event}
    jitter: dict[str, dict[str, float]] = {}
    if priors is not None:
        if not individual and "thrust_individual_n" in priors.parameters:
            individual = {k: _draw(priors, "thrust_individual_n", seed, k) for k in thrusters}
        if "thrust_event_n" in priors.parameters:
            for event in ids:
                events[event].setdefault(
                    "thrust_event_n", _draw(priors, "thrust_event_n", seed, event)
                )
        if "thrust_jitter_n" in priors.parameters:
            jitter = {
                event: {k: _draw(priors, "thrust_jitter_n", seed, event, k) for k in thrusters}
                for event in ids
            }
    truth = Truth({**drawn, **given}, events, individual, jitter)
    needed = required_parameters(spacecraft, scenario.spacecraft.branch, scenario.spacecraft.wheels)
    check_complete(truth, needed, ids, str(file.path))
    return truth


def _priors_of(file: ScenarioFile) -> Priors:
    assert file.draw_from is not None
    priors = read_priors(file.draw_from)
    wanted = file.scenario.spacecraft
    for key, own, other in (
        ("spacecraft", file.spacecraft.digest, priors.spacecraft.digest),
        ("branch", wanted.branch, priors.branch),
    ):
        if own != other:
            raise InputError(
                f"{file.path}: truth.draw_from",
                f"priors of the scenario's own {key}",
                f"{priors.path}, for another {key}",
                "draw from a priors file made for it",
            )
    return priors


def _draw(priors: Priors, name: str, seed: int, *labels: str) -> float:
    prior = priors.parameters[name]
    if prior.distribution is None:
        assert prior.fixed is not None
        return prior.fixed
    rng = stream(seed, "truth", name, *labels)
    return float(prior.distribution.sample(rng, 1)[0])


def simulate_file(file: ScenarioFile, seed: int, reporter: Reporter | None = None) -> Simulation:
    """Simulate every event of a scenario, in order, without writing anything."""
    truth = draw_truth(file, seed)
    events = []
    for event in file.scenario.event:
        plan = make_plan(file.scenario, file.spacecraft, event, truth, file.effects)
        _check_physical(file, plan.thrust_n.items())
        done = simulate_plan(plan, file.scenario, seed)
        if reporter is not None:
            reporter.say(f"{event.id}: {done.motion.duration_s:.0f} s of {event.kind} simulated")
        events.append(done)
    return Simulation(file, seed, tuple(events))


def _check_physical(file: ScenarioFile, thrusts: Iterable[tuple[str, float]]) -> None:
    for name, thrust in thrusts:
        if thrust <= 0.0:
            raise InputError(
                f"{file.path}: truth",
                f"a thrust of {name} above 0",
                f"{thrust:.3g} N",
                "check thrust_common_n and the departures from it",
            )


def simulate_scenario(
    path: str | Path,
    out: str | Path,
    seed: int,
    reporter: Reporter | None = None,
    force: bool = False,
) -> Simulation:
    """Simulate a scenario file and write its event folders, ``totals.csv`` and ``truth.json``.

    Parameters
    ----------
    path, out
        The scenario file, and the folder to write.
    seed
        The same scenario and seed give the same bytes.
    reporter
        Told of every event.
    force
        Replace what an earlier simulation left in ``out``.

    Raises
    ------
    InputError
        Anything wrong with the scenario, or a folder that holds something already.
    """
    if seed < 0:
        raise InputError("--seed", "a whole number from 0", str(seed), "choose another seed")
    file = read_scenario(path)
    folder = Path(out)
    if folder.exists() and not folder.is_dir():
        raise InputError(str(folder), "a folder", "a file", "choose another --out")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise InputError(
            str(folder),
            "a new or empty folder",
            "one with files in it",
            "choose another, or --force",
        )
    simulation = simulate_file(file, seed, reporter)
    for event in simulation.events:
        target = folder / event.plan.event.id
        if target.is_dir():
            shutil.rmtree(target)
        write_text(target / "event.toml", event_text(event.plan, file.scenario.telemetry))
        write_text(target / "telemetry.csv", telemetry_text(event.telemetry))
    (folder / TOTALS_FILE).unlink(missing_ok=True)
    totals = simulation.totals()
    if totals:
        write_totals(folder / TOTALS_FILE, totals, file.spacecraft)
    write_text(folder / TRUTH_FILE, simulation.truth_text())
    return simulation
