"""What is said of events as they are gathered for a model."""

from __future__ import annotations

from pathlib import Path

import pytest
from event_cases import document
from event_cases import priors as event_priors

from cassini_bayes.events.plausibility import STRICT
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.model.gather import Read, together
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.scenario import simulate_file
from cassini_bayes.studies.telemetry_calibration import reduced_simulation

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("axes", ["xy", "xyz"])
def test_an_axis_about_which_no_slew_turns_is_named(axes: str) -> None:
    """Slews about X and Y say nothing of I_zz but what noise says; with one about Z nothing is."""
    path = ROOT / "runs" / "scenarios" / "calibration.toml"
    document = read_toml(path, "a scenario file")
    slews = next(event for event in document["event"] if event["kind"] == "slew")
    about = {"xyz"[max(range(3), key=lambda i: abs(slew["axis"][i]))] for slew in slews["slew"]}
    assert about == {"x", "y", "z"}
    slews["slew"] = [slew for slew in slews["slew"] if axes == "xyz" or slew["axis"][2] == 0.0]
    document["event"] = [slews]
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
    flight = simulate_file(scenario_of(document, path.parent, str(path)), 3, priors=priors)
    reads = [Read.of_reduced(reduced_simulation(event, priors)) for event in flight.events]
    warnings = together(reads, priors, STRICT)[1]
    if axes == "xyz":
        assert not warnings
        return
    (warning,) = warnings
    assert "none turns about Z" in warning
    assert "inertia_zz_kg_m2" in warning
    known = priors.with_fixed("inertia_zz_kg_m2", 4_000.0)
    assert not together(reads, known, STRICT)[1]


@pytest.mark.parametrize(("noise", "named"), [(2e-6, False), (1e-6, True)])
def test_rates_in_steps_beside_which_their_noise_is_small_are_named(
    noise: float, named: bool
) -> None:
    """Steps of 5e-6 rad/s: noise of 0.4 of a step dithers them, 0.2 does not."""
    content = document()
    content["event"] = content["event"][:1]
    content["telemetry"] |= {"rate_noise_rad_s": noise, "rate_resolution_rad_s": 5e-6}
    flight = simulate_file(scenario_of(content), 3, priors=event_priors())
    read = Read.of_reduced(reduced_simulation(flight.events[0], event_priors()))
    warnings = together([read], event_priors(), STRICT)[1]
    assert [("steps of 5e-06 rad/s" in said) for said in warnings] == [True] * named
