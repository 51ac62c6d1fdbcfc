"""The papers' least squares: closed forms on made-up events, correction factors, bars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from totals_cases import flight

from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model import Draws, Model, build_model
from cassini_bayes.model.terms import TORQUE
from cassini_bayes.model.thrusts import ThrustDraws
from cassini_bayes.results.baselines import (
    MEAN,
    PER_EVENT,
    POOLED,
    correction_factor,
    perturbation_bars,
)
from cassini_bayes.studies.totals_calibration import simulate_totals, with_room


def equal_pulses(event: TotalsEvent) -> TotalsEvent:
    """The same event fired in 125 ms pulses throughout, so that one factor corrects them all."""
    pulses = np.rint(event.on_time_s / 0.125)
    return replace(event, pulses=pulses, on_time_s=0.125 * pulses)


def exact_events(thrust: float) -> tuple[Model, dict[str, float]]:
    """Eight biases flown by thrusters of one level, without noise, at the nominal parameters."""
    events, priors = flight()
    for name in ("hold_rate_rad_s", "hold_attitude_rad", "wheel_resolution_rpm"):
        priors = priors.with_fixed(name, 1e-12)
    priors = priors.with_fixed("on_time_resolution_s", 1e-6)
    template = tuple(equal_pulses(with_room(event)) for event in events)
    model = build_model(template, priors, delta_v="ignore")
    nominal = model.space.centre()
    n_events, k = model.totals_rows.stack.on_time_s.shape
    thrusts = ThrustDraws(
        thrust_n=np.full((1, n_events, k), thrust),
        common_n=np.full(1, thrust),
        level_n=np.full((1, k), thrust),
    )
    truth = Draws(nominal, thrusts, ({TORQUE: np.zeros((1, n_events, 3))},))
    simulated = simulate_totals(template, model, truth, np.random.default_rng(1))
    return build_model(simulated, priors, delta_v="ignore"), nominal


def test_pooled_and_mean_estimates_return_the_thrust_of_noise_free_events() -> None:
    """Without noise and with the right tail-off the corrected least squares are unbiased to 1 %."""
    model, nominal = exact_events(0.7)
    table = perturbation_bars(model, nominal)
    for method in (POOLED, MEAN):
        found = table[table["method"] == method]["estimate_n"]
        assert found.to_numpy() == pytest.approx(0.7, rel=0.01)


def test_uncorrected_rectangular_estimate_is_high() -> None:
    """Negative control: the factor matters; without it thrust comes out some 24 % too high."""
    model, nominal = exact_events(0.7)
    stack = model.totals_rows.stack
    factor = correction_factor(stack.on_time_s[0], stack.pulses[0], nominal)
    assert factor == pytest.approx(1 + (0.050 - 0.020) / 0.125, abs=0.06)
    found = perturbation_bars(model, nominal)
    pooled = found[found["method"] == POOLED]["estimate_n"]
    assert (pooled * factor).min() > 0.8


def test_per_event_pseudo_inverse_is_a_minimum_norm_answer() -> None:
    """Six unknowns, three equations: the balance holds exactly, yet thrusters get wrong shares."""
    model, nominal = exact_events(0.7)
    table = perturbation_bars(model, nominal)
    per_event = table[table["method"] == PER_EVENT]
    assert np.abs(per_event["estimate_n"] / 0.7 - 1).max() > 0.3


def test_correction_factor_is_equation_seven_of_paper_003() -> None:
    """(t_c − τ_rise + τ_fall)/t_c = 1.36 for 125 ms, 20 ms, 65 ms; 1 where nothing fired."""
    parameters = {
        "tau_delay_s": np.array([0.005]),
        "tau_rise_s": np.array([0.02]),
        "tau_fall_s": np.array([0.065]),
    }
    factor = correction_factor(np.array([12.5, 0.0]), np.array([100.0, 0.0]), parameters)
    assert factor[0] == pytest.approx([1.36, 1.0])


def test_bars_combine_one_at_a_time_perturbations() -> None:
    """RSS is below the worst case; removing the tail-off perturbation leaves smaller bars."""
    events, priors = flight()
    model = build_model(events, priors, delta_v="ignore")
    nominal = model.space.centre()
    table = perturbation_bars(model, nominal)
    assert (table["bar_rss_n"] <= table["bar_worst_n"] + 1e-12).all()
    no_tail = {**nominal, "tau_fall_s": 1e-9}
    smaller = perturbation_bars(model, no_tail)
    pooled = table["method"] == POOLED
    assert (smaller[pooled]["bar_rss_n"] / smaller[pooled]["estimate_n"]).mean() < (
        table[pooled]["bar_rss_n"] / table[pooled]["estimate_n"]
    ).mean()


def test_short_on_times_are_marked_invalid() -> None:
    """The 5 s rule of paper 003 marks thrusters with less on-time, in totals per event."""
    events, priors = flight()
    model = build_model(events, priors, delta_v="ignore")
    table = perturbation_bars(model, model.space.centre())
    per_event = table[table["method"] == PER_EVENT]
    assert (per_event["valid"] == (per_event["on_time_s"] >= 5.0)).all()
    assert 0 < per_event["valid"].sum() < len(per_event)


def test_thruster_that_did_not_fire_has_no_estimate() -> None:
    """A thruster without on-time gets NaN in its event, not zero."""
    events, priors = flight(2)
    silent = replace(
        events[0],
        on_time_s=events[0].on_time_s * (np.arange(8) != 2),
        pulses=events[0].pulses * (np.arange(8) != 2),
    )
    model = build_model((silent, events[1]), priors, delta_v="ignore")
    table = perturbation_bars(model, model.space.centre())
    row = table[
        (table["method"] == PER_EVENT) & (table["event"] == silent.id) & (table["thruster"] == "z3")
    ]
    assert np.isnan(row["estimate_n"]).all()
    assert not row["valid"].any()
