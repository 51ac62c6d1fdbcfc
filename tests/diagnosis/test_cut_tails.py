"""Single cut tails: which pairs of pulses may have one, and what it leaves in the balance."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.balance.linearised import fitted_away
from cassini_bayes.balance.statistics import Samples
from cassini_bayes.balance.telemetry_terms import cut_probability
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.cut_tails import ACROSS_S, chance_across, losses, single_cuts
from cassini_bayes.diagnosis.innovations import with_unknowns
from cassini_bayes.diagnosis.p_value import slow_statistic
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.simulation import PulseLog, scenario_of
from cassini_bayes.studies.blind.flights import CHANNEL_NOISE, reduced
from cassini_bayes.studies.blind.shift import View, at_truth
from cassini_bayes.studies.scenario import draw_truth, simulate_file

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
SEED = 9
DURATION_S = 80.0
TIME = np.arange(DURATION_S + 1.0)


def samples(log: PulseLog) -> Samples:
    """Telemetry at 1 Hz of one thruster; the motion does not matter."""
    n = len(TIME)
    counts = (log.on_time_s(TIME)[:, None], log.pulses(TIME)[:, None])
    return Samples(TIME, np.ones((n, 4)), np.zeros((n, 3)), np.zeros((n, 3)), *counts)


def pulses(*start_s: float) -> PulseLog:
    """Pulses of 125 ms."""
    return PulseLog(np.array(start_s), np.full(len(start_s), 0.125))


def test_pair_across_a_reading_is_a_step_after_it() -> None:
    """Pulses at 9.8 and 10.05 s may lose one tail from 11 s on; single pulses lose none."""
    found = losses(samples(pulses(9.8, 10.05, 30.5)), (0,), TIME, DURATION_S, 1.0)
    assert found.profile == pytest.approx((TIME >= 11.0)[:, None].astype(float))
    assert found.variance == pytest.approx([ACROSS_S * (1.0 - ACROSS_S)])
    assert found.mean == pytest.approx(ACROSS_S * (TIME >= 11.0))
    apart = losses(samples(pulses(9.8, 11.05, 30.5)), (0,), TIME, DURATION_S, 1.0)
    assert apart.profile.shape == (len(TIME), 0)
    assert not np.any(apart.mean)


def test_pairs_of_a_quarter_add_up_to_what_the_likelihood_has() -> None:
    """Step of one pair is the mean share of all, which the likelihood has, and what is added."""
    log = pulses(2.1, 2.4, 6.1, 6.4, 12.1, 12.35, 30.1, 30.6)
    found = losses(samples(log), (0,), TIME, DURATION_S, 1.0)
    chance = cut_probability(1.0)
    assert found.variance == pytest.approx(np.full(3, chance * (1.0 - chance)))
    assert not np.any(found.mean)
    together = np.stack([end <= TIME for end in (3.0, 7.0, 13.0)]).sum(0)
    for i, end in enumerate((3.0, 7.0, 13.0)):
        assert together / 3.0 + found.profile[:, i] == pytest.approx((end <= TIME).astype(float))
    alone = losses(samples(pulses(2.1, 2.4)), (0,), TIME, DURATION_S, 1.0)
    assert alone.profile.shape == (len(TIME), 0)


def test_chance_of_a_pair_across_a_reading_falls_with_the_interval() -> None:
    """3.5 % at 1 Hz, a tenth of that at 10 s; none without counters."""
    assert chance_across(1.0) == pytest.approx(0.035)
    assert chance_across(10.0) == pytest.approx(0.0035)
    assert chance_across(0.0) == 0.0


@cache
def quiet_flight() -> View:
    """A bias without channel noise, with long tails, one of them cut across a reading."""
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    document["event"] = [e for e in document["event"] if e["id"] == "bias-1"]
    file = scenario_of(document, SCENARIO.parent)
    drawn = draw_truth(file, SEED, PRIORS)
    truth = replace(drawn, parameters={**drawn.parameters, "tau_fall_s": 0.075})
    still = {**truth.parameters, **dict.fromkeys(CHANNEL_NOISE, 0.0)}
    flight = simulate_file(file, SEED, truth=replace(truth, parameters=still), priors=PRIORS)
    return at_truth(reduced(flight, PRIORS), truth)


def slow_left(view: View, cuts: tuple[Array, Array, Array]) -> float:
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
    found, variance, mean = single_cuts(view.none, view.point, 0)
    none = (found[:, :, :0], variance[:0], 0.0 * mean)
    before = slow_left(view, none)
    assert before > 50.0
    assert slow_left(view, (found, variance, mean)) < 0.05 * before
    assert slow_left(view, (found[::-1], variance, mean)) > 0.5 * before
