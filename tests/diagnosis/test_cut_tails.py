"""Single cut tails: what they leave in the balance, and that columns for each explain it."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.balance.linearised import fitted_away
from cassini_bayes.balance.telemetry_noise import open_scales
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.cut_tails import single_cuts
from cassini_bayes.diagnosis.hypotheses import Hypothesis, none_hypothesis
from cassini_bayes.diagnosis.innovations import with_unknowns
from cassini_bayes.diagnosis.p_value import slow_statistic
from cassini_bayes.diagnosis.read import read_events
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.blind.flights import CHANNEL_NOISE, reduced
from cassini_bayes.studies.blind.shift import View, at_truth
from cassini_bayes.studies.scenario import draw_truth, simulate_file

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
RECORDING = ROOT / "tests" / "data" / "basilisk" / "pulse-frequency-noisy-rates"
PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
SEED = 9
FINE = {"rate_noise_rad_s": 2e-6, "attitude_noise_rad": 2e-5}


@cache
def quiet_flight() -> View:
    """A bias without channel noise, with long tails, one of them cut across a reading."""
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    document["event"] = [e for e in document["event"] if e["id"] == "bias-1"]
    file = scenario_of(document, SCENARIO.parent)
    drawn = draw_truth(file, SEED, PRIORS)
    truth = replace(drawn, parameters={**drawn.parameters, "tau_fall_s": 0.075, **FINE})
    still = {**truth.parameters, **dict.fromkeys(CHANNEL_NOISE, 0.0)}
    flight = simulate_file(file, SEED, truth=replace(truth, parameters=still), priors=PRIORS)
    return at_truth(reduced(flight, PRIORS), truth)


def slow_left(view: View, cuts: tuple[Array, Array]) -> float:
    """Slow part of what a flight without noise leaves, with these columns fitted away as well."""
    own = replace(view.linear, target=view.left)
    linear = with_unknowns(own, [cuts], view.factors)
    left = fitted_away(linear, linear.target)
    return float(
        slow_statistic(
            linear, left[:, None], [own.usable_rows.time_s for own in view.events.telemetry]
        )[0]
    )


def test_single_cuts_explain_what_a_flight_without_noise_leaves() -> None:
    """Drifts of many deviations vanish with single cuts, and stay with steps at other times."""
    view = quiet_flight()
    found, variance = single_cuts(view.none, view.point, 0)
    before = slow_left(view, (found[:, :, :0], variance[:0]))
    assert before > 50.0
    assert slow_left(view, (found, variance)) < 0.05 * before
    assert slow_left(view, (found[::-1], variance)) > 0.5 * before


def long_squares(none: Hypothesis, point: Array) -> float:
    """Sum of the squares of the model's columns of long roundings in the rows of its event."""
    (term,) = none.model.telemetry
    scales = open_scales(term.balance, term.physics(none.model.points(point[None])))
    long = term.event.statistics.counters.long_levels
    gained = scales.pulse_weights[0] @ term.balance.pattern.level_slopes.T
    torque = scales.torque_n_m[0][:, long.couple] * gained
    assert len(long.couples) > 0
    return float(((long.at(term.event.usable_rows.time_s)[:, None] * torque) ** 2).sum())


def test_roundings_are_as_large_as_they_are() -> None:
    """A factor that makes what is open smaller in bands leaves single roundings alone.

    The longest are unknowns of the model, with that factor; what it takes is among single ones.
    """
    events = read_events([str(RECORDING / "1-bias")], RECORDING / "priors.toml")
    none = none_hypothesis(events)
    space, squares = none.model.space, []
    for factor in (0.1, 1.0, 4.0):
        values = {**space.centre(), "open_counter_factor": factor}
        point = space.to_standard({name: np.array([value]) for name, value in values.items()})[0]
        columns, variance = single_cuts(none, point, 0)
        squares.append(float((columns**2 @ variance).sum()) + long_squares(none, point))
    small, usual, large = squares
    assert small == pytest.approx(usual, rel=1e-9)
    assert large > 1.5 * usual
