"""The totals model at its door: what it needs, what it refuses, what ΔV does to it."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from totals_cases import B_BRANCH, FLIGHT, ROOT, flight, point

from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model import build_model, draw, log_likelihood
from cassini_bayes.model.totals import DeltaVUse
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import read_priors


def test_walked_dimension_does_not_grow_with_events() -> None:
    """One event and eight events are walked in the same 23 dimensions."""
    for n in (1, 8):
        events, priors = flight(n)
        assert len(build_model(events, priors).space.names) == 23


def test_other_branch_is_refused() -> None:
    """A-branch events under B-branch priors are an error that names the event and both branches."""
    events, priors = flight(2)
    with pytest.raises(InputError, match=r"2009-10-05-bias.*branch B.*branch A"):
        build_model((events[0], replace(events[1], branch="A")), priors)


def test_same_id_twice_is_refused() -> None:
    """Two events with one id would be told apart by nobody."""
    events, priors = flight(1)
    with pytest.raises(InputError, match="each event once"):
        build_model((events[0], events[0]), priors)


def test_wheels_without_priors_are_refused() -> None:
    """An event that uses a wheel the priors file does not list is an error naming the wheels."""
    events, _ = flight(1)
    priors = read_priors(ROOT / "priors" / "cassini_a_branch_2005.toml")
    with pytest.raises(InputError, match="wheels"):
        build_model((replace(events[0], branch="A"),), priors)


def test_rows_without_pulse_counts_are_refused() -> None:
    """The ideal ground-software rows have no pulses: the tail-off cannot be applied."""
    priors = read_priors(B_BRANCH)
    ideal = read_totals(FLIGHT, priors.spacecraft, source="gsw_ideal")
    with pytest.raises(InputError, match="pulse"):
        build_model(ideal, priors)


def test_unknown_pulse_shape_is_refused() -> None:
    """The message lists the shapes there are."""
    events, priors = flight(1)
    with pytest.raises(InputError, match="first_order"):
        build_model(events, priors, pulse_shape="square")


@pytest.mark.parametrize(
    ("missing", "without"), [("mass_kg", "ignore"), ("thrust_predicted_n", "as-measured")]
)
def test_what_a_delta_v_needs_is_asked_for_only_where_it_is_used(
    missing: str, without: DeltaVUse
) -> None:
    """Of no mass nothing is asked with ΔV ignored; an accelerometer's needs no assumed thrust."""
    (event,), priors = flight(1)
    bare = (replace(event, **{missing: None}),)
    with pytest.raises(InputError, match=missing):
        build_model(bare, priors)
    build_model(bare, priors, delta_v=without)


def test_a_row_in_which_nothing_fired_is_refused() -> None:
    """Eight of them had drawn the thrust from 0.760 ± 0.050 to 0.832 N."""
    events, priors = flight(1)
    none = (replace(events[0], on_time_s=0.0 * np.asarray(events[0].on_time_s)),)
    with pytest.raises(InputError, match="at least one thruster that fired"):
        build_model(none, priors)


def test_collapsed_parameters_must_be_normal() -> None:
    """A bounded jitter prior cannot be integrated out: refused with the way out."""
    events, priors = flight(1)
    bounded = priors.with_distribution(
        "thrust_jitter_n", Distribution("norm", {"loc": 0.0, "scale": 0.01}, low=-0.02, high=0.02)
    )
    with pytest.raises(InputError, match="thrust_jitter_n"):
        build_model(events, bounded)


def test_common_level_with_another_prior_is_walked() -> None:
    """A uniform common level joins the walked parameters and agrees with a wide normal one."""
    events, priors = flight(4)
    uniform = priors.with_distribution(
        "thrust_common_n", Distribution("uniform", {"loc": 0.5, "scale": 0.5})
    )
    walked = build_model(events, uniform, delta_v="ignore")
    assert walked.space.names[-1] == "thrust_common_n"
    fixed = build_model(events, priors.with_fixed("thrust_common_n", 0.74), delta_v="ignore")
    z = np.zeros((1, len(fixed.space.names)))
    at = walked.space.to_standard({**point(walked, np.zeros((1, 22))), "thrust_common_n": 0.74})
    ours = log_likelihood(walked, np.atleast_2d(at))[0]
    # the expansion of the Jacobian sits at the uniform's mean, 0.75, instead of 0.74
    assert ours == pytest.approx(log_likelihood(fixed, z)[0], abs=1e-3)


def test_computed_delta_v_leaves_every_thrust_where_it_was() -> None:
    """Conditional thrusts with a computed ΔV are those without ΔV, to the last digit."""
    events, priors = flight()
    with_it = build_model(events, priors)
    without = build_model(events, priors, delta_v="ignore")
    z = 0.5 * with_it.space.sample(np.random.default_rng(1), 6)
    shared = [with_it.space.names.index(name) for name in without.space.names]
    draws = []
    for model, points in ((with_it, z), (without, z[:, shared])):
        draws.append(draw(model, points, np.random.default_rng(2)).thrusts.thrust_n)
    assert np.array_equal(*draws)


def test_measured_delta_v_informs_thrust() -> None:
    """Taken as measured, a ΔV five per cent larger raises the thrust by about as much."""
    events, priors = flight()
    priors = priors.with_fixed("mass_factor", 1.0).with_fixed("delta_v_noise_m_s", 1e-5)
    levels = []
    for scale in (1.0, 1.05):
        scaled = tuple(
            replace(e, delta_v_m_s=np.array([0.0, 0.0, scale * e.delta_v_m_s[2]])) for e in events
        )
        model = build_model(scaled, priors, delta_v="as-measured")
        z = np.zeros((1, len(model.space.names)))
        thrusts = draw(model, z, np.random.default_rng(3)).thrusts
        levels.append(thrusts.thrust_n[0, :, :4].mean())
    assert 1.03 < levels[1] / levels[0] < 1.08


def test_parameter_shared_by_an_idle_and_a_prime_wheel_keeps_its_prior() -> None:
    """A wheel left out must not switch off a parameter that a wheel in use depends on."""
    priors = read_priors(ROOT / "tests" / "data" / "priors" / "twelve.toml")
    shared = "old_wheel_inertia_kg_m2"
    users = [w.number for w in priors.spacecraft.wheels if w.inertia_parameter == shared]
    assert len(users) > 1
    prime = tuple(number for number in priors.wheels if number != users[0])
    fewer = replace(priors, wheels=prime)
    names = fewer.spacecraft.thruster_names(fewer.branch)
    event = TotalsEvent(
        id="made-up",
        epoch=datetime(2020, 1, 1, tzinfo=UTC),
        branch=fewer.branch,
        wheels=prime,
        rwa_start_rpm=np.zeros(3),
        rwa_end_rpm=np.full(3, 500.0),
        duration_s=600.0,
        thrusters=names,
        on_time_s=np.full(len(names), 2.0),
        pulses=np.full(len(names), 16.0),
        delta_v_m_s=None,
        delta_v_source=None,
        hydrazine_g=None,
        mass_kg=None,
        thrust_predicted_n=None,
        source="simulation",
    )
    model = build_model((event,), fewer)
    assert shared not in model.idle
    assert shared in model.space.names


def test_axis_pair_with_the_wrong_torque_is_refused() -> None:
    """A centre of mass beyond the thrusters turns a pair's torque round: said before sampling."""
    events, priors = flight(1)
    with pytest.raises(InputError, match="axis_pairs"):
        build_model(events, priors.with_fixed("cm_y_m", 2.0))
