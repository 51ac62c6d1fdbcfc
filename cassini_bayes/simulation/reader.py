"""Reading a scenario file, every value checked at the door."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known, finite_number
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.files.validated import validated
from cassini_bayes.simulation.effects import EFFECTS, ChosenEffect, Effect, choose_effect
from cassini_bayes.simulation.limits import Limit, is_angle, is_not_negative, is_positive, limited
from cassini_bayes.simulation.settings import SMALLEST, EventSettings, RcsSettings, Scenario, Vector
from cassini_bayes.simulation.telemetry import record_interval_s
from cassini_bayes.spacecraft import Spacecraft, load_spacecraft
from cassini_bayes.spacecraft.parameters import generic_parameters
from cassini_bayes.spacecraft.reader import check_either

DRAW_FROM: Final = "draw_from"
_BY_THRUSTER: Final = ("thrust_individual_n", "thrust_jitter_n")
SEVERAL: Final = ("flexible_mode",)  # every one is an appendage; of all others the last would act
_LIMITS: Final = (
    Limit(".*_rad", is_angle, "an angle in rad, within a turn", "convert degrees"),
    Limit(
        "thrust_common_n|mass_kg|mass_factor|accelerometer_scale_m_s"
        "|inertia_(xx|yy|zz)_kg_m2|.*_inertia_kg_m2",
        *(is_positive, "a number above 0", "check sign and unit"),
    ),
    Limit(
        "tau_.*|.*_noise_(rad_s|rpm|rad|m_s)|.*_resolution_(s|rpm|m_s)",
        *(is_not_negative, "0 or more", "check the sign"),
    ),
)


@dataclass(frozen=True)
class ScenarioFile:
    """A scenario that was checked, with the spacecraft and the effects that it names.

    ``where`` is what messages call it (the path of its file), ``folder`` where its relative paths
    start.
    """

    where: str
    folder: Path
    scenario: Scenario
    spacecraft: Spacecraft
    effects: tuple[ChosenEffect, ...]

    @property
    def draw_from(self) -> Path | None:
        """The priors file that the truth is drawn from, if there is one."""
        reference = self.scenario.truth.get(DRAW_FROM)
        return None if reference is None else self.folder / str(reference)

    def given(self) -> dict[str, float]:
        """Parameters that the scenario itself gives, common to all events."""
        return {
            name: float(value)
            for name, value in self.scenario.truth.items()
            if name != DRAW_FROM and not isinstance(value, dict)
        }

    def individual_n(self) -> dict[str, float]:
        """Departures of single thrusters that the scenario gives."""
        table = self.scenario.truth.get("thrust_individual_n", {})
        return dict(table) if isinstance(table, dict) else {}


def read_scenario(
    path: str | Path, own: Mapping[str, Effect] = MappingProxyType({})
) -> ScenarioFile:
    """Read and check a scenario file (``docs/reference/scenario-format.md`` has the format).

    ``own`` are effects by name beyond those that there are.

    Raises
    ------
    InputError
        Names the file, the dotted key, what was expected, what was found and the nearest name.
    """
    path = Path(path)
    return scenario_of(read_toml(path, "a scenario file"), path.parent, str(path), own)


def scenario_of(
    document: Mapping[str, Any],
    folder: str | Path = ".",
    where: str = "scenario",
    own: Mapping[str, Effect] = MappingProxyType({}),
    craft: Spacecraft | None = None,
) -> ScenarioFile:
    """Check a scenario that is at hand as a mapping, as TOML gives it; no file needed.

    Parameters
    ----------
    document
        The tables of a scenario file.
    folder
        Where its relative paths start (priors to draw from, spacecraft file).
    where
        What error messages call it.
    own
        Effects by name beyond those that there are.
    craft
        The spacecraft, in place of that which the scenario names.

    Raises
    ------
    InputError
        As :func:`read_scenario`.
    """
    scenario = validated(Scenario, document, where)
    folder = Path(folder)
    spacecraft = craft or _spacecraft(where, folder, scenario)
    scenario = _with_cycle(where, scenario, spacecraft.control_cycle_s)
    _check_wheels(where, scenario, spacecraft)
    ids = _check_events(where, scenario, spacecraft.highest_wheel_rpm)
    for appendage in scenario.appendage:
        _check_direction(f"{where}: appendage.{appendage.name}.axis", appendage.axis)
    _check_truth(where, scenario, spacecraft)
    _check_platforms(where, scenario, spacecraft)
    record_interval_s(scenario.telemetry)
    effects = _effects(where, scenario, spacecraft, ids, {**EFFECTS, **own})
    return ScenarioFile(where, folder, scenario, spacecraft, effects)


def _check_events(where: str, scenario: Scenario, highest_rpm: float) -> tuple[str, ...]:
    """Check every event; their ids."""
    seen: list[str] = []
    taken = ("totals.csv", "truth.json", "figures")
    for event in scenario.event:
        place = f"{where}: event.{event.id}"
        _check_event(place, event, scenario, highest_rpm)
        if event.id in taken:
            expected = f"a name other than {', '.join(taken)}"
            fix = "rename it: these stand beside the event folders"
            raise InputError(f"{place}.id", expected, repr(event.id), fix)
        if event.id in seen:
            raise InputError(f"{place}.id", "each id once", f"{event.id!r} again", "rename it")
        seen.append(event.id)
    return tuple(seen)


def _effects(
    where: str,
    scenario: Scenario,
    spacecraft: Spacecraft,
    ids: tuple[str, ...],
    known: Mapping[str, Effect],
) -> tuple[ChosenEffect, ...]:
    """The requested effects, checked against the catalogue, the spacecraft and the events."""
    effects: list[ChosenEffect] = []
    for request in scenario.effect:
        place = f"{where}: effect.{request.name}"
        for name in request.events or ():
            check_known(f"{place}.events", name, sorted(ids), "ids of events")
        table = scenario.spacecraft
        chosen = choose_effect(request, spacecraft, table.branch, table.wheels, place, known)
        _check_beside(place, chosen, effects, ids)
        effects.append(chosen)
    return tuple(effects)


def _check_beside(
    place: str, chosen: ChosenEffect, others: list[ChosenEffect], ids: tuple[str, ...]
) -> None:
    """Refuse an effect in place of which, or with which, one before it would not act as told."""
    for other in others:
        shared = [event for event in ids if chosen.acts_in(event) and other.acts_in(event)]
        if shared and other.name == chosen.name and chosen.name not in SEVERAL:
            expected, got = "an effect once in an event", f"it again in {shared[0]}"
            raise InputError(place, expected, got, "leave one out, or tell them other events")
        starts = [each.values.get("start_s", 0.0) for each in (other, chosen)]
        is_leak = other.effect.name == chosen.effect.name == "thruster_leak"
        if shared and is_leak and starts[0] != starts[1]:
            raise InputError(
                f"{place}.parameters.start_s",
                f"{starts[0]:g}, as of {other.name}: leaks in {shared[0]} begin at once",
                f"{starts[1]:g}",
                "give both the same start_s, or tell them other events",
            )


def _spacecraft(where: str, folder: Path, scenario: Scenario) -> Spacecraft:
    table = scenario.spacecraft
    check_either(f"{where}: spacecraft", table.name is not None, table.file is not None)
    if table.name is not None:
        return load_spacecraft(table.name, f"{where}: spacecraft.name")
    return load_spacecraft(folder / str(table.file))


def _with_cycle(where: str, scenario: Scenario, cycle_s: float) -> Scenario:
    """The scenario with its spacecraft's control cycle, and pulses of at most that where unsaid."""
    if "cycle_s" in scenario.model_fields_set and scenario.cycle_s != cycle_s:
        raise InputError(
            f"{where}: cycle_s",
            f"{cycle_s:g} s, control_cycle_s of the spacecraft file, which inference counts with",
            f"{scenario.cycle_s:g} s",
            "leave cycle_s out, or correct control_cycle_s",
        )

    def of_cycle(rcs: RcsSettings) -> RcsSettings:
        is_given = "pulse_max_s" in rcs.model_fields_set
        return rcs if is_given else rcs.model_copy(update={"pulse_max_s": cycle_s})

    events = tuple(
        each if each.rcs is None else each.model_copy(update={"rcs": of_cycle(each.rcs)})
        for each in scenario.event
    )
    changed = {"cycle_s": cycle_s, "rcs": of_cycle(scenario.rcs), "event": events}
    return scenario.model_copy(update=changed)


def _check_wheels(where: str, scenario: Scenario, spacecraft: Spacecraft) -> None:
    table = scenario.spacecraft
    spacecraft.check_branch(f"{where}: spacecraft.branch", table.branch)
    known = spacecraft.wheel_numbers
    for i, number in enumerate(table.wheels):
        if number not in known or number in table.wheels[:i]:
            raise InputError(
                f"{where}: spacecraft.wheels[{i + 1}]",
                f"different wheels out of {known}",
                str(number),
                f"write e.g. wheels = {known[:3]}",
            )


def _check_event(where: str, event: EventSettings, scenario: Scenario, highest_rpm: float) -> None:
    wheels = scenario.spacecraft.wheels
    if event.epoch.tzinfo is None:
        raise InputError(f"{where}.epoch", "a time in UTC", str(event.epoch), "add Z to it")
    for key in ("from_rpm", "to_rpm"):
        value = getattr(event, key)
        if value is not None and len(value) != len(wheels):
            raise InputError(
                f"{where}.{key}",
                f"{len(wheels)} rates, of wheels {list(wheels)}",
                f"{len(value)}",
                "give one rate per prime wheel",
            )
        if value is not None and max(map(abs, value)) > highest_rpm:
            raise InputError(
                f"{where}.{key}",
                f"wheel rates within ±{highest_rpm:g} rev/min, or no telemetry of them is read",
                str(list(value)),
                "check the unit (rev/min); faster wheels have highest_wheel_rpm in their spacecraft"
                " file",
            )
    needed = {"bias": "to_rpm", "slew": "slew", "delta_v": "delta_v_m_s"}.get(event.kind)
    if event.hybrid is not None:
        _check_hybrid(where, event)
        needed = None
    if needed is not None and not getattr(event, needed):
        raise InputError(
            f"{where}.{needed}", f"a value for a {event.kind} event", "nothing", f"add {needed}"
        )
    if event.kind in ("quiescent", "delta_v"):
        _check_duration(where, event, f"a {event.kind} event")
    for i, slew in enumerate(event.slew, start=1):
        _check_direction(f"{where}.slew[{i}].axis", slew.axis)
    in_time = sorted(event.slew, key=lambda slew: slew.start_s)
    for first, second in itertools.pairwise(in_time):
        end = first.start_s + first.duration_s
        if second.start_s < end:
            raise InputError(
                f"{where}.slew[{event.slew.index(second) + 1}].start_s",
                f"a start after the end of the slew before, at {end:.1f} s",
                f"{second.start_s:g} s",
                "start it later, or make that slew shorter or faster",
            )
    if abs(math.hypot(*event.attitude) - 1.0) > 1e-6:
        raise InputError(
            f"{where}.attitude",
            "a quaternion of unit norm, scalar last",
            str(event.attitude),
            "divide it by its norm",
        )


def _check_hybrid(where: str, event: EventSettings) -> None:
    if event.kind not in ("slew", "bias"):
        raise InputError(
            f"{where}.hybrid",
            "a slew (two wheels alone) or a bias (thrusters hold the third axis)",
            f"a {event.kind} event",
            "change kind, or leave hybrid out",
        )
    if event.to_rpm is not None:
        raise InputError(
            f"{where}.to_rpm",
            "nothing: the wheels go where holding the attitude takes them",
            str(list(event.to_rpm)),
            "leave to_rpm out, or hybrid",
        )
    if not event.slew:
        _check_duration(where, event, "an event without slews")


def _check_duration(where: str, event: EventSettings, of: str) -> None:
    if event.duration_s is None:
        place, expected = f"{where}.duration_s", f"the duration of {of}"
        raise InputError(place, expected, "nothing", "add duration_s = …")


def _check_direction(where: str, axis: Vector) -> None:
    if math.hypot(*axis) < SMALLEST:
        raise InputError(where, "a direction", str(axis), "give an axis, of any length but zero")


def _check_truth(where: str, scenario: Scenario, spacecraft: Spacecraft) -> None:
    names = [spec.name for spec in (*generic_parameters(), *spacecraft.parameters)]
    thrusters = spacecraft.thruster_names(scenario.spacecraft.branch)
    for key, value in scenario.truth.items():
        place = f"{where}: truth.{key}"
        if key == DRAW_FROM:
            if not isinstance(value, str) or not value:
                raise InputError(place, "the path of a priors file", repr(value), "name the file")
        elif key == "thrust_individual_n" and isinstance(value, dict):
            for thruster, departure in value.items():
                check_known(f"{place}.{thruster}", thruster, thrusters, "a thruster of the branch")
                finite_number(f"{place}.{thruster}", departure, "N")
        else:
            _check_value(place, key, value, names)
    for event in scenario.event:
        for key, value in event.truth.items():
            _check_value(f"{where}: event.{event.id}.truth.{key}", key, value, names)


def _check_platforms(where: str, scenario: Scenario, spacecraft: Spacecraft) -> None:
    wheels = scenario.spacecraft.wheels
    spacecraft.with_platforms(scenario.truth).check_platforms(wheels, f"{where}: truth")
    for event in scenario.event:
        place = f"{where}: event.{event.id}.truth"
        spacecraft.with_platforms(event.truth).check_platforms(wheels, place)


def _check_value(place: str, key: str, value: object, names: list[str]) -> None:
    if key in _BY_THRUSTER:
        raise InputError(
            place,
            "departures by thruster, which only thrust_individual_n of [truth] gives",
            repr(value),
            "write e.g. thrust_individual_n = { z3 = -0.05 } under [truth]",
        )
    check_known(place, key, names, "the name of a parameter")
    limited(place, key, value, _LIMITS)
