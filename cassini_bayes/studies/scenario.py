"""From a scenario file to event folders: draws the truth, simulates, writes.

Above the simulation, because a truth may be drawn from a priors file, which the simulation does
not know.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics import Samples
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.effects.tables import Place, read_table
from cassini_bayes.effects.user_files import guarded, load_module
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.event import DESCRIPTION
from cassini_bayes.events.totals import TotalsEvent, write_totals
from cassini_bayes.files.checks import check_seed
from cassini_bayes.files.reading import exists
from cassini_bayes.files.storage import write_text
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.priors.reader import OF_CONTROLLERS, ZERO_CENTRED, Priors, read_priors
from cassini_bayes.simulation import (
    TORQUE_NOISE,
    Effect,
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
    truth_fields,
    truth_text,
)
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

TRUTH_FILE: Final = "truth.json"
TOTALS_FILE: Final = "totals.csv"
MOST_RPM: Final = 1_000.0  # of wheel rates drawn anew


@dataclass(frozen=True, eq=False)
class Simulation:
    """Everything that one seed of a scenario gives, before it is written."""

    file: ScenarioFile
    seed: int
    events: tuple[SimulatedEvent, ...]

    def truth(self) -> dict[str, Any]:
        """The content of ``truth.json``: parameters, thrusts (effects applied), the effects."""
        plans = [event.plan for event in self.events]
        return truth_fields(self.seed, plans, self.file.effects)

    def truth_text(self) -> str:
        """Content of ``truth.json``."""
        plans = [event.plan for event in self.events]
        return truth_text(self.seed, plans, self.file.effects)

    def totals(self) -> tuple[TotalsEvent, ...]:
        """Totals of the biases among the events but hybrid ones, whose rates are not commanded."""
        settings = self.file.scenario.telemetry
        return tuple(
            TotalsEvent(**totals_row(event.plan, event.motion, settings, self.seed))
            for event in self.events
            if event.plan.event.kind == "bias" and event.plan.event.hybrid is None
        )


def draw_wheel_rates(events: Iterable[dict[str, Any]], rng: np.random.Generator) -> None:
    """Give the events of a scenario's document other wheel rates, uniform within ±1,000 rpm.

    Not where two wheels hold a spinning body: what its spin does follows from their rates.
    """
    for event in events:
        if event.get("hybrid", {}).get("controller") == "dfpw":
            continue
        for key in ("from_rpm", "to_rpm"):
            if key in event:
                event[key] = [float(x) for x in rng.uniform(-MOST_RPM, MOST_RPM, len(event[key]))]


def simulated_samples(event: SimulatedEvent) -> tuple[Samples, tuple[str, ...]]:
    """A simulated event's telemetry as samples, wheel rates in rad/s, and its thrusters' names."""
    columns = event.telemetry.columns
    rows = len(event.telemetry.time_s)
    thrusters = tuple(name for name in event.motion.pulses if f"pulses_{name}" in columns)

    def stacked(names: list[str]) -> NDArray[np.float64]:
        return np.stack([columns[name] for name in names], 1) if names else np.empty((rows, 0))

    wheels = [event.plan.spacecraft.wheel(number).name for number in event.plan.wheel_numbers]
    return Samples(
        np.asarray(event.telemetry.time_s),
        stacked(["q1", "q2", "q3", "q4"]),
        stacked([f"rate_{axis}_rad_s" for axis in "xyz"]),
        RAD_S_PER_RPM * stacked([f"{name}_rpm" for name in wheels]),
        stacked([f"on_time_{name}_s" for name in thrusters]),
        stacked([f"pulses_{name}" for name in thrusters]),
    ), thrusters


def draw_truth(file: ScenarioFile, seed: int, priors: Priors | None = None) -> Truth:
    """The truth of a scenario: what it gives, and the rest drawn from its priors file.

    Every parameter has a random stream of its own, so that giving one does not change the others.
    Departures of thrust are drawn per thruster, per event, and per event and thruster.

    Parameters
    ----------
    file
        The scenario.
    seed
        Of all draws.
    priors
        Drawn from instead of the file's ``draw_from``: read once for many draws.

    Raises
    ------
    InputError
        The priors file is bad or of another branch, or a parameter that is needed is in neither
        file.
    """
    scenario, spacecraft = file.scenario, file.spacecraft
    ids = [event.id for event in scenario.event]
    thrusters = spacecraft.thruster_names(scenario.spacecraft.branch)
    if priors is None and file.draw_from is not None:
        priors = read_priors(file.draw_from)
    given, individual = file.given(), file.individual_n()
    events = {event.id: dict(event.truth) for event in scenario.event}
    drawn: dict[str, float] = {}
    jitter: dict[str, dict[str, float]] = {}
    if priors is not None:
        _check_priors(file, priors)
        draw, known = partial(_draw, priors, seed), priors.parameters
        kept = {*given, *ZERO_CENTRED, *OF_CONTROLLERS}
        drawn = {name: draw(name) for name in known if name not in kept}
        if not individual and "thrust_individual_n" in known:
            individual = {k: draw("thrust_individual_n", k) for k in thrusters}
        if "thrust_event_n" in known and "thrust_event_n" not in given:
            for event in ids:
                events[event].setdefault("thrust_event_n", draw("thrust_event_n", event))
        if "thrust_jitter_n" in known:
            jitter = {
                event: {k: draw("thrust_jitter_n", event, k) for k in thrusters} for event in ids
            }
    truth = Truth({**drawn, **given}, events, individual, jitter)
    _check_truth(file, truth)
    return truth


def _check_truth(file: ScenarioFile, truth: Truth) -> None:
    table = file.scenario.spacecraft
    needed = [*required_parameters(file.spacecraft, table.branch, table.wheels)]
    needed += [TORQUE_NOISE] if file.scenario.torque_noise else []
    check_complete(truth, needed, [event.id for event in file.scenario.event], file.where)


def _check_priors(file: ScenarioFile, priors: Priors) -> None:
    wanted = file.scenario.spacecraft
    for key, wanted_value, other in (
        ("spacecraft", file.spacecraft.digest, priors.spacecraft.digest),
        ("branch", wanted.branch, priors.branch),
    ):
        if wanted_value != other:
            raise InputError(
                f"{file.where}: truth.draw_from",
                f"priors of the scenario's own {key}",
                f"{priors.path}, for another {key}",
                "draw from a priors file made for it",
            )


def _draw(priors: Priors, seed: int, name: str, *labels: str) -> float:
    prior = priors.parameters[name]
    if prior.distribution is None:
        assert prior.fixed is not None
        return prior.fixed
    rng = stream(seed, "truth", name, *labels)
    return float(prior.distribution.sample(rng, 1)[0])


def simulate_file(
    file: ScenarioFile,
    seed: int,
    log: Log = silent,
    truth: Truth | None = None,
    priors: Priors | None = None,
) -> Simulation:
    """Simulate every event of a scenario, in order, in memory: nothing is written.

    Parameters
    ----------
    file
        A checked scenario, from a file or a mapping.
    seed
        Of all draws: the same scenario, truth and seed give the same arrays in any process.
    log
        Told of every event.
    truth
        The parameters, instead of drawing them.
    priors
        Drawn from instead of the scenario's ``draw_from``, if there is no ``truth``.

    Raises
    ------
    InputError
        A parameter is missing, or one that no spacecraft can have.
    """
    if truth is None:
        truth = draw_truth(file, seed, priors)
    else:
        _check_truth(file, truth)
    events = []
    for event in file.scenario.event:
        plan = make_plan(file.scenario, file.spacecraft, event, truth, file.effects)
        _check_physical(file, plan.thrust_n.items())
        done = simulate_plan(plan, file.scenario, seed)
        log(f"{event.id}: {done.motion.duration_s:.0f} s of {event.kind} simulated")
        events.append(done)
    return Simulation(file, seed, tuple(events))


def _check_physical(file: ScenarioFile, thrusts: Iterable[tuple[str, float]]) -> None:
    for name, thrust in thrusts:
        if thrust <= 0.0:
            raise InputError(
                f"{file.where}: truth",
                f"a thrust of {name} above 0",
                f"{thrust:.3g} N",
                "check thrust_common_n and the departures from it",
            )


def simulate_scenario(
    path: str | Path,
    out: str | Path,
    seed: int,
    log: Log = silent,
    force: bool = False,
    own: Mapping[str, Effect] = MappingProxyType({}),
) -> Simulation:
    """Simulate a scenario file and write its event folders, ``totals.csv`` and ``truth.json``.

    Parameters
    ----------
    path, out
        The scenario file, and the folder to write.
    seed
        The same scenario and seed give the same bytes.
    log
        Told of every event.
    force
        Replace what an earlier simulation left in ``out``.
    own
        Effects by name beyond those that there are (:func:`simulated_sides`).

    Raises
    ------
    InputError
        Anything wrong with the scenario, or a folder that holds something already; with ``force``,
        something of an event's name that is no event.
    """
    seed = check_seed(seed, "--seed")
    file = read_scenario(path, own)
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
    _check_replaceable(folder, [event.id for event in file.scenario.event])
    simulation = simulate_file(file, seed, log)
    write_simulation(simulation, folder)
    return simulation


def _check_replaceable(folder: Path, events: Sequence[str]) -> None:
    """Refuse a place for events or totals where something else stands, which would be lost."""
    for target in (folder / event for event in events):
        is_event = exists(target / DESCRIPTION) and not target.is_symlink()
        if exists(target) and not is_event:
            raise _occupied(target, f"an event folder of an earlier simulation, with {DESCRIPTION}")
    if exists(folder / TOTALS_FILE) and not exists(folder / TRUTH_FILE):
        raise _occupied(folder / TOTALS_FILE, f"that of an earlier simulation, with {TRUTH_FILE}")


def _occupied(target: Path, expected: str) -> InputError:
    return InputError(
        str(target),
        f"nothing, or {expected}",
        "something else of that name",
        "move it away, or choose another --out",
    )


def simulated_sides(files: Sequence[Path]) -> dict[str, Effect]:
    """The simulated sides of effects that a user brings, by name.

    A Python file may have a function ``simulate(plan, target, values)``, from a plan
    (:mod:`cassini_bayes.simulation.plan`) to one with the effect; its parameters and targets are
    those of its table.

    Raises
    ------
    InputError
        A mistake in one of the files: file and line or dotted key are named.
    """
    result = {}
    for path in files:
        module = load_module(path) if path.suffix == ".py" else None
        if module is not None and hasattr(module, "simulate"):
            beside = path.with_suffix(".toml")
            table = read_table(read_toml(beside, "a table of effects"), Place(beside))
            keys = tuple(parameter.key for parameter in table.parameters)
            targets = None if table.targets == "none" else table.targets
            change = guarded(path, "simulate", module.simulate)
            result[path.stem] = Effect(path.stem, keys, targets, change)
    return result


def write_simulation(simulation: Simulation, folder: Path) -> None:
    """Write event folders, ``totals.csv`` (if there are biases) and ``truth.json``."""
    file = simulation.file
    for event in simulation.events:
        target = folder / event.plan.event.id
        if target.is_dir():
            shutil.rmtree(target)
        write_text(target / DESCRIPTION, event_text(event.plan, file.scenario.telemetry))
        write_text(target / "telemetry.csv", telemetry_text(event.telemetry))
    (folder / TOTALS_FILE).unlink(missing_ok=True)
    # before the totals: a folder with totals alone is not one of ours
    write_text(folder / TRUTH_FILE, simulation.truth_text())
    totals = simulation.totals()
    if totals:
        write_totals(folder / TOTALS_FILE, totals, file.spacecraft)
