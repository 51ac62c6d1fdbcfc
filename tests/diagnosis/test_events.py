"""What is weighed of events together: of an axis that no slew turns about, no inertia."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.diagnosis.events import prepare
from cassini_bayes.diagnosis.hypotheses import none_hypothesis
from cassini_bayes.diagnosis.innovations import innovations
from cassini_bayes.diagnosis.onsets import Beginnings
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.scenario import simulate_file
from cassini_bayes.studies.telemetry_calibration import reduced_simulation

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def priors() -> Priors:
    """The shipped ones."""
    return read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")


def flown(priors: Priors, axes: str, kinds: tuple[str, ...]) -> list[ReducedEvent]:
    """The events of these kinds, with slews about some axes alone."""
    path = ROOT / "runs" / "scenarios" / "calibration.toml"
    document = read_toml(path, "a scenario file")
    slews = next(event for event in document["event"] if event["kind"] == "slew")
    slews["slew"] = [
        slew
        for slew in slews["slew"]
        if "xyz"[max(range(3), key=lambda i: abs(slew["axis"][i]))] in axes
    ]
    document["event"] = [
        next(event for event in document["event"] if event["kind"] == kind) for kind in kinds
    ]
    flight = simulate_file(scenario_of(document, path.parent, str(path)), 3, priors=priors)
    return [reduced_simulation(event, priors) for event in flight.events]


@pytest.mark.parametrize(
    ("axes", "left_out"),
    [("xyz", set()), ("xy", {"zz"}), ("x", {"yy", "zz", "yz"})],
)
def test_slews_alone_weigh_only_the_inertia_that_they_turn(
    priors: Priors, axes: str, left_out: set[str]
) -> None:
    """An element counts if one of its axes is turned about; a finding names the others."""
    events = prepare(flown(priors, axes, ("slew",)), priors)
    weighed = {effect.target for effect in events.catalogue.effects if effect.kind.needs_turns}
    assert {"xx", "yy", "zz", "xy", "xz", "yz"} - weighed == left_out
    assert len(events.findings) == bool(left_out)
    for target in left_out:
        assert f"inertia:{target}" in events.findings[0]


def test_a_bias_tells_the_inertia_of_all_axes(priors: Priors) -> None:
    """Its firings move the body about each."""
    events = prepare(flown(priors, "x", ("bias", "slew")), priors)
    weighed = {effect.target for effect in events.catalogue.effects if effect.kind.needs_turns}
    assert weighed == {"xx", "yy", "zz", "xy", "xz", "yz"}
    assert not events.findings


def test_what_begins_with_slews_is_told_by_their_turns(priors: Priors) -> None:
    """Of a bias and slews about X: from the slews on only what these turn about."""
    events = prepare(flown(priors, "x", ("bias", "slew")), priors)
    full = none_hypothesis(events)
    z = np.zeros(full.dimension)
    weighed = [effect for effect in events.catalogue.effects if effect.kind.needs_turns]
    found = Beginnings.of(full, z, innovations(full, z), weighed, events)
    assert found.order == ("bias-1", "slews")
    each = zip(found.effects, found.factors[:, 1], strict=True)
    assert {effect.target for effect, factor in each if factor} == {"xx", "xy", "xz"}
    assert np.all(found.factors[:, 0] != 0.0)
