"""What can be told of an effect in a recorded flight: size and group, by another program's σ.

Flights and their own σ are those of ``tests/data/basilisk``, whose linear balance shares no code
with the package.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import pytest

from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import none_hypothesis
from cassini_bayes.diagnosis.read import read_events
from cassini_bayes.errors import InputError
from cassini_bayes.studies.blind.recorded import what_can_be_told
from cassini_bayes.studies.blind.sizes import path_to, size_on

DATA: Final = Path(__file__).parents[1] / "data" / "basilisk"
MUTUAL: Final = 0.25
"""By which two linear reckonings of one size may differ: rows are chosen and smoothed unlike."""


def recording(name: str, *events: str) -> tuple[Events, dict[str, Any]]:
    """Events of a recording, and its truth."""
    folder = DATA / name
    truth = json.loads((folder / "truth.json").read_text("utf-8"))
    return read_events([folder / event for event in events], folder / "priors.toml"), truth


@pytest.mark.parametrize(
    ("name", "events", "others"),
    [
        ("degraded-thruster", ("1-bias", "2-bias"), {"thrust_scale"}),
        ("leak", ("1-bias", "2-slew"), set()),
    ],
)
def test_sizes_are_those_of_another_program(
    name: str, events: tuple[str, ...], others: set[str]
) -> None:
    """Counters are as good as exact there, which the other one takes them for.

    A thruster that fires most, and the scale of all with own departures, may be as likely.
    """
    own, truth = recording(name, *events)
    hidden = truth["effects"][0]
    told = what_can_be_told(own, hidden["name"], hidden["parameters"], truth["parameters"])
    assert told.sigma == pytest.approx(hidden["sigma"], rel=MUTUAL)
    assert told.group[0] == hidden["name"]
    assert set(told.group[1:]) == others


def test_a_leak_where_nothing_fires_is_a_steady_torque() -> None:
    """Slews know no thrusters: no leak is in their catalogue, and its torque is."""
    own, truth = recording("leak", "2-slew")
    told = what_can_be_told(own, "thruster_leak:y2", {"leak_n": 5e-5}, truth["parameters"])
    assert told.sigma is None
    assert told.group == ("thruster_leak:y2", "external_torque")


def test_what_has_no_name_is_refused() -> None:
    """No cause of the catalogue drifts."""
    own, truth = recording("leak", "2-slew")
    with pytest.raises(InputError, match="drifting_torque: expected one of"):
        what_can_be_told(own, "drifting_torque", {}, truth["parameters"])


def test_a_path_has_the_values_at_size_one() -> None:
    """Departures count from the truth without the effect, factors from one."""
    own, truth = recording("leak", "1-bias")
    catalogue, flown = own.catalogue, truth["parameters"]
    value = flown["tau_fall_s"] + 0.03
    path = path_to(catalogue.effect("tail_off"), {"tau_fall_s": value}, flown)
    assert path.values(1.0) == pytest.approx({"tau_fall_s": 0.03})
    path = path_to(catalogue.effect("thruster_degraded:z3"), {"thrust_factor": 0.7}, flown)
    assert path.values(1.0) == pytest.approx({"thrust_factor": 0.7})
    assert path.values(0.0) == pytest.approx({"thrust_factor": 1.0})
    warm = {"warmup_deficit": 0.1, "warmup_time_s": 4.0}
    path = path_to(catalogue.effect("thrust_warmup"), warm, flown)
    assert path.constant == {"warmup_time_s": 4.0}


@pytest.mark.parametrize(("name", "least"), [("inertia:xx", 6.5), ("inertia:xz", 6.0)])
def test_what_slews_tell_very_well_is_sized_right(name: str, least: float) -> None:
    """Data tell the sum of a departure and its parameter, and nothing beyond the parameter's prior.

    A departure of seven of its standard deviations has 7 σ at most. Moments of inertia are known
    far better than the step in a departure by which that is found out is long.
    """
    own, truth = recording("misaligned-thruster", "3-slew")
    effect, flown = own.catalogue.effect(name), truth["parameters"]
    (parameter,) = effect.parameters
    space = none_hypothesis(own).model.space
    prior = space.distributions[space.names.index(parameter.baseline)]
    # the slew is as it was flown: what is hidden in this recording acts in its biases
    value = flown[parameter.baseline]
    without = {**flown, parameter.baseline: value - 7.0 * prior.sd()}
    size = size_on(own, path_to(effect, {parameter.key: value}, without), 1.0)
    assert least < size <= 7.0
