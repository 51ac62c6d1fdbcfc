"""Sizes of causes: intervals hold what was hidden, what counters leave open included."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.criticism.blind_flights import source_of
from cassini_bayes.criticism.diagnosis import catalogue_of
from cassini_bayes.criticism.evidence import Weighed, weigh_beside
from cassini_bayes.criticism.extended import Case, compact, extend, none_hypothesis, prepare
from cassini_bayes.criticism.modes import baseline_mode
from cassini_bayes.criticism.sizes import (
    LATE,
    effect_draws,
    effect_values,
    size_draws,
    weighted_interval,
    with_unresolved,
)
from cassini_bayes.priors import read_priors
from cassini_bayes.scenario import simulate_file
from cassini_bayes.simulation import scenario_of
from cassini_bayes.telemetry_terms import CONTROL_CYCLE_S

ROOT = Path(__file__).parents[1]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
LATE_S = 0.19  # late in its control cycle: 0.125 s shows the same records
SEED = 7


@cache
def late_records() -> tuple[Case, Weighed]:
    """A bias whose counters are late, and the cause that says so, weighed."""
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    document["event"] = [e for e in document["event"] if e["id"] == "bias-1"]
    document["effect"] = [{"name": "time_offset", "parameters": {LATE: LATE_S}}]
    simulation = simulate_file(scenario_of(document, SCENARIO.parent), SEED, priors=priors)
    case = prepare([source_of(event) for event in simulation.events], priors)
    catalogue = catalogue_of(case)
    full = none_hypothesis(case, catalogue)
    none = compact(full)
    base = baseline_mode(none.log_density, none.dimension)
    cause = compact(extend(full, [catalogue.effect("time_offset")], case))
    (weighed,) = weigh_beside([cause], base, lambda _: None)
    return case, weighed


def test_late_records_are_late_by_what_was_hidden() -> None:
    """Its 90 % interval holds 0.19 s; that of the likelihood alone is too narrow and does not."""
    case, weighed = late_records()
    values, weights = size_draws(case, weighed, np.random.default_rng(1))
    low, high = weighted_interval(values[LATE], weights)
    assert low < LATE_S < high
    z, alone = effect_draws(weighed, np.random.default_rng(1))
    narrow = weighted_interval(effect_values(weighed, z)[LATE], alone, 0.998)
    assert not narrow[0] < LATE_S < narrow[1]
    assert high - low > 3.0 * (narrow[1] - narrow[0])


def test_draws_are_widened_never_narrowed() -> None:
    """Σ' − Σ has no negative part; the same generator gives the same draws."""
    case, weighed = late_records()
    mode = weighed.mode.point
    still = np.tile(mode, (4_000, 1))
    own = with_unresolved(case, weighed.hypothesis, mode, still, np.random.default_rng(2))
    again = with_unresolved(case, weighed.hypothesis, mode, still, np.random.default_rng(2))
    assert own == pytest.approx(again)
    places = {name: i for i, name in enumerate(weighed.hypothesis.model.space.names)}
    (late,) = (p.name for p in weighed.hypothesis.effects[0].parameters)
    own_sd = np.sqrt((weighed.mode.factor[places[late]] ** 2).sum())
    assert own[:, places[late]].std() > own_sd  # what is open says more than the noise
    level = places["rate_noise_rad_s"]
    assert np.ptp(own[:, level]) < 1e-6  # rows' columns do not speak of noise


def test_a_control_cycle_is_left_open() -> None:
    """Draws of an offset are spread over the cycle that records cannot tell."""
    case, weighed = late_records()
    rng = np.random.default_rng(3)
    z, _ = effect_draws(weighed, np.random.default_rng(3))
    values, _ = size_draws(case, weighed, rng)
    moved = with_unresolved(
        case, weighed.hypothesis, weighed.mode.point, z, np.random.default_rng(4)
    )
    before = effect_values(weighed, moved)[LATE]
    assert values[LATE].mean() - before.mean() == pytest.approx(0.5 * CONTROL_CYCLE_S, abs=0.01)


def test_shortest_interval_of_a_weighted_sample() -> None:
    """Weights count: the tenth that weighs nothing is outside."""
    values = np.arange(10.0)
    weights = np.array([0.0, *[1.0] * 9])
    assert weighted_interval(values, weights, 1.0) == (1.0, 9.0)
