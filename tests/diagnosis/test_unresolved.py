"""What records leave open: roundings that last or repeat are unknowns, not noise of every row."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from event_cases import document, priors

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis import unresolved
from cassini_bayes.diagnosis.hypotheses import Hypothesis, extend, none_hypothesis
from cassini_bayes.diagnosis.innovations import innovations
from cassini_bayes.diagnosis.modes import find_mode
from cassini_bayes.diagnosis.p_value import p_value
from cassini_bayes.diagnosis.unresolved import LEAST_REST, rounding_lines, roundings, timed
from cassini_bayes.simulation import scenario_of
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM
from cassini_bayes.studies.blind.flights import reduced
from cassini_bayes.studies.scenario import simulate_file

SEEDS = range(16)
STEP_RPM = 1.0


@cache
def at_mode(seed: int, step_rpm: float = STEP_RPM) -> tuple[Hypothesis, Array]:
    """Slews with wheel rates in coarse steps and rates of a fine gyro, nothing hidden."""
    content = document()
    content["event"] = content["event"][1:]
    content["telemetry"] |= {"wheel_noise_rpm": 0.1, "wheel_resolution_rpm": step_rpm}
    flown = simulate_file(scenario_of(content), seed, priors=priors())
    none = none_hypothesis(reduced(flown, priors()))
    return none, find_mode(none.log_density, none.dimension).point


def test_every_rest_has_one_rounding_of_its_wheel() -> None:
    """Columns are one wheel's momentum in rows whose printed rates are two neighbours, else 0."""
    none, point = at_mode(0)
    columns, variance = roundings(none, point, 0)
    event = none.model.telemetry[0].event
    assert columns.shape == (len(event.usable_rows.time_s), 3, len(variance))
    assert len(variance) >= 3
    printed = np.round(event.samples.wheel_rad_s / (STEP_RPM * RAD_S_PER_RPM))
    for own in np.moveaxis(columns, 2, 0):
        rows = np.any(own, axis=1)
        assert np.count_nonzero(rows) >= LEAST_REST
        assert np.all(own[rows] == own[rows][0])
        assert min(np.ptp(wheel[rows]) for wheel in printed.T) <= 1.0


def test_rates_without_steps_leave_nothing_open() -> None:
    """No steps, no roundings."""
    none, point = at_mode(0, 0.0)
    for opened in (roundings, rounding_lines):
        columns, variance = opened(none, point, 0)
        assert columns.shape[2] == len(variance) == 0


def small_p_values() -> int:
    """How many of the flights have a p-value of 0.05 or less."""
    count = 0
    for seed in SEEDS:
        left = innovations(*at_mode(seed))
        times = [event.time_s for event in left.rows]
        count += p_value(left.linear, left.target, times, np.random.default_rng(seed)) <= 0.05
    return count


def test_wheels_at_rest_are_no_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    """p-values of 16 flights are as they should be, and are not if rounding were white noise.

    Four and more of 16 are at most 0.05 by chance in 0.7 %; 8 were, as white noise.
    """
    assert small_p_values() <= 3

    def none_open(hypothesis: Hypothesis, z: Array, place: int) -> unresolved.Unknowns:
        columns, _ = roundings(hypothesis, z, place)
        return columns[:, :, :0], np.zeros(0)

    monkeypatch.setattr(unresolved, "roundings", none_open)
    assert small_p_values() >= 6


@cache
def driven_evenly(seed: int, *, sparse: bool = False) -> tuple[Hypothesis, Array]:
    """A bias whose wheels are driven by 2 mN m for a quarter of an hour: a step in eight seconds.

    Rows are 1 s apart, or ``sparse``: 4 s, with counters every 10 s.
    """
    content = document()
    own = content["event"][0]
    ends = zip(own["from_rpm"], (1.0, -1.0, -1.0), strict=True)
    own |= {"settle_s": 30.0, "to_rpm": [rate + 120.0 * sign for rate, sign in ends]}
    content["event"], content["wheels"] = [own], {"torque_limit_n_m": 0.002}
    content["telemetry"] |= {"wheel_noise_rpm": 0.1, "wheel_resolution_rpm": STEP_RPM}
    if sparse:
        every = dict.fromkeys(("attitude_every_s", "rate_every_s", "wheel_every_s"), 4.0)
        content["telemetry"] |= {**every, "counter_every_s": 10.0}
    flown = simulate_file(scenario_of(content), seed, priors=priors())
    none = none_hypothesis(reduced(flown, priors()))
    return none, find_mode(none.log_density, none.dimension).point


def test_counters_at_times_of_their_own_have_no_wheel_rates() -> None:
    """Rows every 4 s and counters every 10 s: wheels are read where they are printed."""
    columns, variance = rounding_lines(*driven_evenly(0, sparse=True), 0)
    assert len(variance) > 0
    assert np.isfinite(columns).all()


def p_value_of(seed: int) -> float:
    """Of such a bias, in which nothing is hidden."""
    left = innovations(*driven_evenly(seed))
    times = [event.time_s for event in left.rows]
    return p_value(left.linear, left.target, times, np.random.default_rng(seed))


def test_wheels_driven_evenly_are_no_oscillation(monkeypatch: pytest.MonkeyPatch) -> None:
    """p-values of four biases are ordinary, and all small if roundings were white noise alone.

    Three of four at most 0.1 are a chance of 0.4 %.
    """
    assert np.sort([p_value_of(seed) for seed in range(4)])[2] > 0.1

    def none_open(hypothesis: Hypothesis, z: Array, place: int) -> unresolved.Unknowns:
        columns, _ = rounding_lines(hypothesis, z, place)
        return columns[:, :, :0], np.zeros(0)

    monkeypatch.setattr(unresolved, "rounding_lines", none_open)
    assert max(p_value_of(seed) for seed in range(4)) < 0.03


def test_wheel_noise_is_told_where_wheels_are_driven_evenly() -> None:
    """Mean over four biases: 0.1 rpm within a fifth. As white noise roundings left 0.034 of it."""
    found = [
        none.model.space.to_parameters(point[None])["wheel_noise_rpm"][0]
        for none, point in map(driven_evenly, range(4))
    ]
    assert np.mean(found) == pytest.approx(0.1, rel=0.2)


def test_moments_of_weak_thrusters_leave_less_open() -> None:
    """A late record of all thrusts at a share of their level leaves that share of momentum open."""
    content = document()
    content["event"] = content["event"][:1]
    events = reduced(simulate_file(scenario_of(content), 1, priors=priors()), priors())
    full, catalogue = none_hypothesis(events), events.catalogue
    late = extend(full, [catalogue.effect("time_offset")])
    weak = extend(full, [catalogue.effect(name) for name in ("thrust_scale", "time_offset")])
    columns, variance = timed(late, np.r_[np.zeros(full.dimension), 1.0], 0)
    at = np.r_[np.zeros(full.dimension), -1.0, 1.0]
    own, same = timed(weak, at, 0)
    (factor,) = weak.effects[0].values(weak.model.points(at[None]).parameters).values()
    assert factor[0] < 0.9
    assert np.abs(columns).max() > 0.0
    assert own == pytest.approx(factor[0] * columns)
    assert same == pytest.approx(variance)
