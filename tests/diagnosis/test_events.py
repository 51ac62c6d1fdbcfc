"""What is weighed of events together: of an axis that no slew turns about, no inertia."""

from __future__ import annotations

import numpy as np
import pytest
from event_cases import ROOT, at_rest, priors, turned_about

from cassini_bayes.diagnosis.events import prepare
from cassini_bayes.diagnosis.hypotheses import none_hypothesis
from cassini_bayes.diagnosis.innovations import innovations
from cassini_bayes.diagnosis.onsets import Beginnings
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.model.gather import unturned
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.scenario import simulate_file
from cassini_bayes.studies.telemetry_calibration import reduced_simulation


@pytest.mark.parametrize(
    ("axes", "left_out"),
    [("xyz", set()), ("xy", {"zz"}), ("x", {"yy", "zz", "yz"})],
)
def test_slews_alone_weigh_only_the_inertia_that_they_turn(axes: str, left_out: set[str]) -> None:
    """An element counts if one of its axes is turned about; a finding names the others."""
    events = prepare(turned_about(axes), priors())
    weighed = {effect.target for effect in events.catalogue.effects if effect.kind.needs_turns}
    assert {"xx", "yy", "zz", "xy", "xz", "yz"} - weighed == left_out
    assert len(events.findings) == bool(left_out)
    for target in left_out:
        assert f"inertia:{target}" in events.findings[0]


@pytest.mark.parametrize("axes", ["xyz", "x"])
def test_what_is_weighed_has_all_that_causes_have(axes: str) -> None:
    """What these slews cannot show leaves its share to what they can, kind by kind."""
    catalogue = prepare(turned_about(axes), priors()).catalogue
    shares: dict[str, list[float]] = {}
    for effect in catalogue.effects:
        shares.setdefault(effect.kind.name, []).append(effect.prior_probability)
    of_kind = catalogue.odds.catalogued / len(shares)
    for own in shares.values():
        assert own == pytest.approx([of_kind / len(own)] * len(own))


def test_a_bias_tells_the_inertia_of_all_axes() -> None:
    """Its firings move the body about each."""
    events = prepare(turned_about("x", ("bias", "slew")), priors())
    weighed = {effect.target for effect in events.catalogue.effects if effect.kind.needs_turns}
    assert weighed == {"xx", "yy", "zz", "xy", "xz", "yz"}
    assert not events.findings


def test_what_begins_with_slews_is_told_by_their_turns() -> None:
    """Of a bias and slews about X: from the slews on only what these turn about."""
    events = prepare(turned_about("x", ("bias", "slew")), priors())
    full = none_hypothesis(events)
    z = np.zeros(full.dimension)
    weighed = [effect for effect in events.catalogue.effects if effect.kind.needs_turns]
    found = Beginnings.of(full, z, innovations(full, z), weighed, events)
    assert found.order == ("bias-1", "slews")
    each = zip(found.effects, found.factors[:, 1], strict=True)
    assert {effect.target for effect, factor in each if factor} == {"xx", "xy", "xz"}
    assert np.all(found.factors[:, 0] != 0.0)


def test_a_body_at_rest_says_nothing_of_its_inertia() -> None:
    """A quiescent event alone, with nothing hidden, had an inertia of 390 ± 50 for 5,232 kg m²."""
    scenario = ROOT / "runs" / "scenarios" / "calibration.toml"
    content = read_toml(scenario, "a scenario file")
    content["event"] = [at_rest(900.0)]
    flight = simulate_file(scenario_of(content, scenario.parent), 1, priors=priors())
    event = reduced_simulation(flight.events[0], priors())
    events = prepare([event], priors())
    assert not any(effect.kind.needs_turns for effect in events.catalogue.effects)
    assert "inertia:zz" in events.findings[0]
    (warning,) = unturned([event], priors())
    assert "nothing turns the body" in warning
    assert unturned(turned_about("x", ("bias",)), priors()) == ()
