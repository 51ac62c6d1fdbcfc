"""Sizes of causes: intervals hold what was hidden, what counters leave open included."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest

from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.evidence import Candidate, weigh_extensions
from cassini_bayes.diagnosis.hypotheses import compact, extend, none_hypothesis
from cassini_bayes.diagnosis.modes import find_mode
from cassini_bayes.diagnosis.search import newton_search
from cassini_bayes.diagnosis.sizes import (
    effect_draws,
    effect_values,
    size_draws,
    weighted_interval,
    with_unresolved,
)
from cassini_bayes.effects.time_offset import LAG_S, PULSE_S
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.spacecraft.description import CONTROL_CYCLE_S
from cassini_bayes.studies.blind.flights import reduced
from cassini_bayes.studies.conditions import CONTROLLERS
from cassini_bayes.studies.scenario import simulate_file

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
LATE_S = 0.19  # within its control cycle: 0.125 s shows the same records
SEED = 7
LATE = "time_offset_s"
TAIL, TAIL_S = "tau_fall_s", 0.2
Weighing = tuple[Events, Candidate]


@cache
def flown(name: str, key: str, value: float, controller: str = "hysteresis") -> Weighing:
    """A bias in which a cause acts, and that cause weighed."""
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    document["event"] = [e for e in document["event"] if e["id"] == "bias-1"]
    document["rcs"] |= CONTROLLERS[controller]
    document["effect"] = [{"name": name, "parameters": {key: value}}]
    simulation = simulate_file(scenario_of(document, SCENARIO.parent), SEED, priors=priors)
    events = reduced(simulation, priors)
    full = none_hypothesis(events)
    none = compact(full)
    base = find_mode(none.log_density, none.dimension)
    cause = compact(extend(full, [events.catalogue.effect(name)]))
    (weighed,) = weigh_extensions([cause], [newton_search(cause, base)], base, lambda _: None)
    return events, weighed


def late_records() -> Weighing:
    """A bias whose counters are late, and the cause that says so, weighed."""
    return flown("time_offset", LATE, LATE_S)


def test_late_records_are_late_by_what_was_hidden() -> None:
    """Its 90 % interval holds 0.19 s, and is twice as wide as the likelihood's alone and more.

    Taken as delivered at once, as if rows were the usual pulse's mean time later, it would be more
    than twice as far off.
    """
    _, weighed = late_records()
    values, weights = size_draws(weighed, np.random.default_rng(1))
    low, high = weighted_interval(values[LATE], weights)
    assert low < LATE_S < high
    z, alone = effect_draws(weighed, np.random.default_rng(1))
    narrow = weighted_interval(effect_values(weighed.hypothesis, z)[LATE], alone)
    assert high - low > 2.0 * (narrow[1] - narrow[0])
    mean = np.average(values[LATE], weights=weights)
    assert abs(mean - LAG_S - 0.5 * PULSE_S - LATE_S) > 2.0 * abs(mean - LATE_S)


def test_an_offset_is_known_as_a_binomial_share_is() -> None:
    """What is open alone: n pulses, each seen or not, leave √(f (1 − f)/n) and somewhat more."""
    events, weighed = late_records()
    mode = weighed.mode.point
    still = np.tile(mode, (4_000, 1))
    own = with_unresolved(weighed.hypothesis, mode, still, np.random.default_rng(2))
    share = effect_values(weighed.hypothesis, own)[LATE]  # of an interval of 1 s
    mean, sd = share.mean(), share.std()
    (event,) = events.telemetry
    pulses = event.samples.pulses[-1].sum() - event.samples.pulses[0].sum()
    least = np.sqrt(mean * (1.0 - mean) / pulses)
    assert least < sd < 3.0 * least  # couples fire together, and with unlike momenta
    own_sd = np.std(
        effect_values(weighed.hypothesis, effect_draws(weighed, np.random.default_rng(2))[0])[LATE]
    )
    assert sd > 0.5 * own_sd  # as much again as the likelihood's own width
    again = with_unresolved(weighed.hypothesis, mode, still, np.random.default_rng(2))
    assert own == pytest.approx(again)
    level = weighed.hypothesis.model.space.names.index("rate_noise_rad_s")
    assert np.ptp(own[:, level]) < 1e-6  # rows' columns do not speak of noise


def test_every_cause_and_size_goes_with_events_that_fire_nothing() -> None:
    """Slews on wheels: each cause of the catalogue has a density, and nothing is left open."""
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    document["event"] = [e for e in document["event"] if e["id"] == "slews"]
    simulation = simulate_file(scenario_of(document, SCENARIO.parent), SEED, priors=priors)
    events = reduced(simulation, priors)
    assert events.telemetry[0].thrusters == ()
    none = none_hypothesis(events)
    for effect in events.catalogue.effects:
        if not effect.needs_search:
            hypothesis = extend(none, [effect])
            assert np.isfinite(hypothesis.log_density(np.zeros((1, hypothesis.dimension)))).all()
    z = np.random.default_rng(5).standard_normal((3, none.dimension))
    own = with_unresolved(none, 0.0 * z[0], z, np.random.default_rng(6))
    assert own == pytest.approx(z, abs=1e-6)


def test_two_control_cycles_are_left_open() -> None:
    """Draws of an offset are spread evenly over the cycles that rows cannot tell, about it."""
    _, weighed = late_records()
    z, _ = effect_draws(weighed, np.random.default_rng(3))
    values, _ = size_draws(weighed, np.random.default_rng(3))
    # the same generator: the same draws, then what is open, then the cycle
    rng = np.random.default_rng(3)
    z, _ = effect_draws(weighed, rng)
    moved = with_unresolved(weighed.hypothesis, weighed.mode.point, z, rng)
    added = values[LATE] - effect_values(weighed.hypothesis, moved)[LATE]
    assert kstest(added / (2.0 * CONTROL_CYCLE_S) + 0.5, "uniform").pvalue > 1e-3


def test_the_cycles_that_are_left_open_are_those_of_the_spacecraft() -> None:
    """With a control cycle twice as long, draws are spread twice as far."""
    _, weighed = late_records()
    hypothesis = weighed.hypothesis
    slower = replace(hypothesis.model.spacecraft, control_cycle_s=2.0 * CONTROL_CYCLE_S)
    other = replace(hypothesis, model=replace(hypothesis.model, spacecraft=slower))
    ours, theirs = (
        size_draws(replace(weighed, hypothesis=own), np.random.default_rng(3))[0][LATE]
        for own in (hypothesis, other)
    )
    assert (theirs - ours).min() == pytest.approx(-CONTROL_CYCLE_S, rel=0.01)
    assert (theirs - ours).max() == pytest.approx(CONTROL_CYCLE_S, rel=0.01)


def test_what_a_form_leaves_out_widens_its_sizes_alone() -> None:
    """A share of 30 % is in the draws, as wide as said; without it they are the same as before."""
    _, weighed = late_records()
    (effect,) = weighed.hypothesis.effects
    wider = replace(effect, form_error=((LATE, 0.3),))
    model = replace(weighed.hypothesis.model, effects=(wider,))
    own = replace(weighed, hypothesis=replace(weighed.hypothesis, model=model))
    values, _ = size_draws(weighed, np.random.default_rng(4))
    spread, _ = size_draws(own, np.random.default_rng(4))
    ratio = spread[LATE] / values[LATE] - 1.0
    n = len(ratio)
    assert ratio.std() == pytest.approx(0.3, abs=4.0 * 0.3 / np.sqrt(2.0 * n))
    assert abs(ratio.mean()) < 4.0 * 0.3 / np.sqrt(n)


def with_late_form_error(weighed: Candidate, *shares: tuple[str, float]) -> Candidate:
    """The same cause, whose table says this of rows with late pulses."""
    (effect,) = weighed.hypothesis.effects
    model = weighed.hypothesis.model
    model = replace(model, effects=(replace(effect, late_form_error=shares),))
    return replace(weighed, hypothesis=replace(weighed.hypothesis, model=model))


def test_a_long_tail_under_a_high_gain_is_known_less_well_than_its_density_says() -> None:
    """Of 0.2 s: the interval holds it as its table is, and misses it without that share."""
    _, weighed = flown("tail_off", TAIL, TAIL_S, "high gain, union")
    holds = []
    for own in (weighed, with_late_form_error(weighed)):
        values, weights = size_draws(own, np.random.default_rng(5))
        low, high = weighted_interval(values[TAIL], weights)
        holds.append(low <= TAIL_S <= high)
    assert holds == [True, False]


def test_rows_between_firings_have_no_share_of_late_pulses() -> None:
    """Where rows are left between firings sizes are as they are without it."""
    _, weighed = late_records()
    more = with_late_form_error(weighed, (LATE, 0.5))
    values, other = (size_draws(w, np.random.default_rng(6))[0][LATE] for w in (weighed, more))
    assert (values == other).all()


def test_shortest_interval_of_a_weighted_sample() -> None:
    """Weights count: the tenth that weighs nothing is outside."""
    values = np.arange(10.0)
    weights = np.array([0.0, *[1.0] * 9])
    assert weighted_interval(values, weights, 1.0) == (1.0, 9.0)


def test_weighted_interval_of_a_normal() -> None:
    """The shortest 90 % interval of a weighted normal sample is the central one."""
    z = np.random.default_rng(1).standard_normal(40_000)
    low, high = weighted_interval(z, np.full(len(z), 1.0 / len(z)))
    assert (low, high) == pytest.approx((-1.645, 1.645), abs=0.08)
