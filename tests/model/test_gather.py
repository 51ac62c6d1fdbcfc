"""What is said of events as they are gathered for a model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from event_cases import document, priors, turned_about

from cassini_bayes.events.plausibility import STRICT
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.gather import Read, each_event, gather, together
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.scenario import simulate_file
from cassini_bayes.studies.telemetry_calibration import reduced_simulation

ELEMENTS = ("xx", "xy", "xz", "yy", "yz", "zz")
EVENT = Path(__file__).parents[1] / "data" / "basilisk" / "leak" / "1-bias"


def test_an_event_may_be_given_by_its_file() -> None:
    """``event.toml`` stands for its folder."""
    known = read_priors(EVENT.parent / "priors.toml")
    one, other = (gather(at, known)[0][0] for at in (EVENT, EVENT / "event.toml"))
    assert isinstance(one, ReducedEvent)
    assert isinstance(other, ReducedEvent)
    np.testing.assert_array_equal(one.statistics.gram, other.statistics.gram)


def test_events_named_by_their_file_are_recorded_as_folders() -> None:
    """So that what a run or a diagnosis writes down is found again; all else stays as it is."""
    others = (str(EVENT), "./totals.csv:one", turned_about("x")[0])
    assert each_event([EVENT / "event.toml", *others]) == (str(EVENT), *others)
    assert each_event(str(EVENT / "event.toml")) == (str(EVENT),)


@pytest.mark.parametrize("axes", ["xy", "xyz"])
def test_an_axis_about_which_no_slew_turns_is_named(axes: str) -> None:
    """Slews about X and Y say nothing of I_zz but what noise says; with one about Z nothing is."""
    reads = [Read.of_reduced(event) for event in turned_about(axes)]
    assert len(reads) == 1
    warnings = together(reads, priors(), STRICT)[1]
    if axes == "xyz":
        assert not warnings
        return
    (warning,) = warnings
    assert "none turns about Z" in warning
    assert "inertia_zz_kg_m2" in warning
    known = priors().with_fixed("inertia_zz_kg_m2", 4_000.0)
    assert not together(reads, known, STRICT)[1]


@pytest.mark.parametrize(
    ("axes", "where", "drawn"),
    [
        ("xy", "about (-0.43, -0.29, 0.86) in body axes", ["xz", "yz", "zz"]),
        ("x", "any direction but (0.86, -0.43, 0.29)", ["xy", "xz", "yy", "yz", "zz"]),
        ("xyz", "", []),
    ],
)
def test_a_direction_between_the_axes_is_named(axes: str, where: str, drawn: list[str]) -> None:
    """Two slews leave one direction at rest and one slew leaves two, about whatever they turn.

    Every axis of the body moves then: the slews' rates are turned to another frame. By noise alone
    inertias of a flight of another simulator were six standard deviations off for it.
    """
    (event,) = turned_about(axes)
    turn = np.array([[6.0, -3.0, 2.0], [2.0, 6.0, 3.0], [-3.0, -2.0, 6.0]]) / 7.0
    gram, places = event.statistics.gram.copy(), event.statistics.layout.rate
    gram[:, :, places, places] = turn.T @ gram[:, :, places, places] @ turn
    turned = replace(event, statistics=replace(event.statistics, gram=gram))
    warnings = together([Read.of_reduced(turned)], priors(), STRICT)[1]
    assert len(warnings) == bool(drawn)
    for warning in warnings:
        assert where in warning
        assert drawn == [own for own in ELEMENTS if f"inertia_{own}_kg_m2" in warning]


@pytest.mark.parametrize(("noise", "named"), [(2e-6, False), (1e-6, True)])
def test_rates_in_steps_beside_which_their_noise_is_small_are_named(
    noise: float, named: bool
) -> None:
    """Steps of 5e-6 rad/s: noise of 0.4 of a step dithers them, 0.2 does not."""
    content = document()
    content["event"] = content["event"][:1]
    content["telemetry"] |= {"rate_noise_rad_s": noise, "rate_resolution_rad_s": 5e-6}
    flight = simulate_file(scenario_of(content), 3, priors=priors())
    read = Read.of_reduced(reduced_simulation(flight.events[0], priors()))
    warnings = together([read], priors(), STRICT)[1]
    assert [("steps of 5e-06 rad/s" in said) for said in warnings] == [True] * named
