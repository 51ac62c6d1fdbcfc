"""Rows and turns together: an oscillation that attitudes alone show is found, and none in noise."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import compact, none_hypothesis
from cassini_bayes.diagnosis.innovations import innovations
from cassini_bayes.diagnosis.modes import find_mode
from cassini_bayes.effects.appendage import known_motion
from cassini_bayes.effects.effect import Remainder
from cassini_bayes.effects.flexible_mode import search
from cassini_bayes.effects.line_search import find_oscillation
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.blind.flights import reduced
from cassini_bayes.studies.scenario import simulate_file

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
CHANNELS = ("attitude_every_s", "rate_every_s", "wheel_every_s")
AS_FLOWN = {"rate_noise_rad_s": 2e-5, "attitude_noise_rad": 1e-5}
# Half a standard deviation of the gyro's rows.
LINE = {
    "frequency_hz": 0.02,
    "damping": 0.001,
    "axis": 1.0,
    "amplitude_rad_s": 6e-7,
    "inertia_fraction": 1e-4,
}


def flown(*effects: dict[str, Any]) -> tuple[Events, Remainder]:
    """Slews with noise and cadence as flown, and what a model without a cause leaves of them."""
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    document["event"] = [e for e in document["event"] if e["id"] == "slews"]
    document["truth"] |= AS_FLOWN
    document["telemetry"] |= dict.fromkeys(CHANNELS, 4.0)
    document["effect"] = list(effects)
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
    scenario = scenario_of(document, SCENARIO.parent)
    events = reduced(simulate_file(scenario, 11, priors=priors), priors)
    none = compact(none_hypothesis(events))
    mode = find_mode(none.log_density, none.dimension)
    return events, innovations(none, mode.point)


def priors_of(events: Events) -> dict[str, Any]:
    """Of the oscillation's size."""
    effect = events.catalogue.effect("flexible_mode")
    return {own.key: own.distribution for own in effect.parameters}


def test_a_line_that_attitudes_alone_show_is_found() -> None:
    """Frequency and axis; control: of the gyro's rows alone another line has the most evidence."""
    events, left = flown({"name": "flexible_mode", "parameters": LINE})
    priors = priors_of(events)
    line = search(left, priors)
    assert line is not None
    assert line.log_gain > line.log_looks + 10.0
    assert line.direction == (0.0, 1.0, 0.0)
    assert line.frequency_hz == pytest.approx(LINE["frequency_hz"], abs=0.5 / line.span_s)
    motions = [known_motion(s.time_s, s.rate_rad_s) for s in left.samples]
    inertia = np.array([left.parameters[f"inertia_{axis}{axis}_kg_m2"] for axis in "xyz"])
    scales = priors["cosine_rad_s"].scale, priors["inertia_fraction"].scale
    by_gyro = find_oscillation(left.rows, motions, left.linear, inertia, scales)
    assert by_gyro is not None
    assert by_gyro.log_gain < by_gyro.log_looks


def test_what_is_left_of_turns_is_white_where_nothing_is_hidden() -> None:
    """Turns centred over pieces have the variance of their noise, and no line pays its search."""
    events, left = flown()
    _, (_, turns) = left.with_turns()
    assert turns.turns is not None
    contrasts = len(turns.time_s) - (len(turns.turns.pieces.ends) - 1)
    # the fit takes up some of it; torque noise and rounding are not in one number
    assert (turns.white**2).sum(0) / contrasts == pytest.approx(np.ones(3), abs=0.18)  # 3 σ
    line = search(left, priors_of(events))
    assert line is not None
    assert line.log_gain < line.log_looks
