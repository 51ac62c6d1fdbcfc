"""Conditions of trials: every level can be flown, strata are told apart, faults are rejected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.computing.arrays import Array
from cassini_bayes.simulation import make_plan
from cassini_bayes.simulation.engine import ramp_duration_s
from cassini_bayes.studies import conditions_calibration, posterior_draws
from cassini_bayes.studies.conditions import LEVELS, Condition, draw_condition, scenario_under
from cassini_bayes.studies.conditions_calibration import SCALARS, ConditionTrials, judged
from cassini_bayes.studies.scenario import draw_truth

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"


def test_every_level_makes_a_scenario() -> None:
    """Each level of each condition, the others at their first, is a scenario that is read."""
    first = {name: levels[0] for name, levels in LEVELS.items()}
    for name, levels in LEVELS.items():
        for level in levels:
            condition = Condition(**{**first, name: level})
            rng = np.random.default_rng(1)
            file = scenario_under(condition, SCENARIO, ROOT / "priors", rng)
            assert file.scenario.event


def test_levels_are_drawn_evenly() -> None:
    """Of 900 draws each level has its share, within five standard deviations."""
    rng = np.random.default_rng(2)
    drawn = [draw_condition(rng).strata for _ in range(900)]
    for name, levels in LEVELS.items():
        for level in levels:
            share = 1.0 / len(levels)
            count = sum(own[name] == level for own in drawn)
            assert abs(count - 900 * share) < 5 * np.sqrt(900 * share * (1 - share))


def test_a_slow_drive_changes_wheel_rates_less_in_the_same_time() -> None:
    """The same wheels and initial rates, a fifteenth of the change, the same duration."""
    first = {name: levels[0] for name, levels in LEVELS.items()}
    flown = []
    for drive in LEVELS["drive"]:
        condition = Condition(**{**first, "drive": drive})
        rng = np.random.default_rng(1)
        file = scenario_under(condition, SCENARIO, ROOT / "priors", rng)
        (event,) = file.scenario.event
        plan = make_plan(file.scenario, file.spacecraft, event, draw_truth(file, 3))
        flown.append((np.array(event.from_rpm), np.array(event.to_rpm), ramp_duration_s(plan)))
    (start, end, duration), (slow_start, slow_end, slow_duration) = flown
    np.testing.assert_array_equal(slow_start, start)
    np.testing.assert_allclose(slow_end - start, (end - start) / 15.0)
    assert slow_duration == pytest.approx(duration, rel=1e-6)


def made_up(rng: np.random.Generator, rows: int = 300) -> dict[str, Array]:
    """Uniform ranks under levels drawn at random; one repetition in fifty declined."""
    ranks = rng.uniform(size=(rows, len(SCALARS)))
    ranks[::50] = np.nan
    sizes = [len(levels) for levels in LEVELS.values()]
    return {"ranks": ranks, "levels": rng.integers(0, sizes, (rows, len(sizes)))}


@pytest.mark.statistical
def test_uniform_ranks_pass_and_a_narrow_stratum_is_named() -> None:
    """Nothing is rejected of uniform ranks; intervals too narrow under one level are (control)."""
    found = made_up(np.random.default_rng(4))
    summary, table = judged(found)
    assert (table["p_holm"] > 0.01).all()
    assert summary["declined"][0] == 6
    assert summary["coverage_90"][0] == pytest.approx(0.9, abs=0.01)
    counters = list(LEVELS).index("counter_step")
    bad = found["levels"][:, counters] == 1
    found["ranks"][bad] = np.where(found["ranks"][bad] < 0.5, 0.01, 0.99)
    _, table = judged(found)
    worst = table.sort_values("p_holm").iloc[0]
    assert (worst["condition"], worst["level"]) == ("counter_step", LEVELS["counter_step"][1])
    assert worst["p_holm"] < 1e-6


def test_a_repetition_is_the_same_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same number gives the same levels and ranks, whatever ran before.

    Few draws, and any are taken: what is asked for are the bits.
    """
    monkeypatch.setattr(conditions_calibration, "EFFORTS", ((15.0, 1, 500),))
    monkeypatch.setattr(posterior_draws, "TRUSTED_K", np.inf)
    trials = ConditionTrials(SCENARIO, ROOT / "priors", seed=5)
    first, again = trials.repetition(2), trials.repetition(2)
    for key, value in first.items():
        np.testing.assert_array_equal(value, again[key])
    assert np.isfinite(np.asarray(first["ranks"])).any()
