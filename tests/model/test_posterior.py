"""The model of telemetry: equal to a plain likelihood, right about evidence and draws."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from event_cases import ROOT, eased
from telemetry_cases import (
    event_of,
    joint_of_slews,
    made_up_samples,
    model_of,
    plain_log_likelihood,
    telemetry_priors,
)

from cassini_bayes.balance.bands import is_sparse, motion_table
from cassini_bayes.balance.kernel import estimated_wheels
from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.model import build_model, collapse, draw, log_likelihood, log_posterior
from cassini_bayes.model.posterior import with_equal_bands_merged
from cassini_bayes.model.telemetry import unknowns_of
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import Priors
from cassini_bayes.sampling.warmstart import warm_start
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.scenario import simulate_file
from cassini_bayes.studies.telemetry_calibration import reduced_simulation, without_jacobian


@pytest.mark.parametrize("seed", range(4))
def test_fast_likelihood_equals_the_plain_one(seed: int) -> None:
    """Gram matrices and elimination give what a dense normal over all raw rows gives, to 1e-9."""
    rng = np.random.default_rng(seed)
    events = [
        made_up_samples(rng, 60),
        made_up_samples(rng, 50, fires=False),
        made_up_samples(rng, 300),  # enough for all bands
        made_up_samples(rng, 110, every_s=4.0),  # sparse: as many modes as rows
        # turns of quiet pieces between cut tails
        made_up_samples(rng, 400, firing=0.008, wander=1e-4, rate_noise=2e-4),
    ]
    model = model_of(events)
    sparse = [is_sparse(term.event.statistics) for term in model.telemetry]
    assert sparse == [False] * 3 + [True, False]
    assert model.telemetry[4].event.statistics.turns.pieces > 8
    assert model.telemetry[4].balance.turns[0].left_open.pairs.max() > 0.1
    (z,) = 0.5 * model.space.sample(rng, 1)
    parameters = {name: float(v) for name, v in model.space.to_parameters(z).items()}
    plain = plain_log_likelihood(model, parameters)
    # where turns tell momentum the dense covariance has a condition of 1e10
    assert log_likelihood(model, z[None])[0] == pytest.approx(plain, rel=1e-9, abs=3e-4)


def test_points_do_not_depend_on_what_is_worked_out_with_them() -> None:
    """Batches of one to sixteen and of more: kernels take sixteen points at a time.

    Products of matrices round otherwise by their shape, and sums of squares cancel: 8e-12 at most
    in twenty such models.
    """
    rng = np.random.default_rng(8)
    model = model_of([made_up_samples(rng, 300), made_up_samples(rng, 120, fires=False)])
    z = 0.5 * model.space.sample(rng, 19)
    together = log_likelihood(model, z)
    alone = [log_likelihood(model, point[None])[0] for point in z]
    assert np.isfinite(together).all()
    assert together == pytest.approx(alone, rel=3e-11, abs=0.0)
    for first in (2, 3, 5, 15):
        assert log_likelihood(model, z[first:]) == pytest.approx(alone[first:], rel=3e-11, abs=0.0)


def test_rates_and_turns_share_the_noise_of_wheels() -> None:
    """Slews in pieces of three rows: the joint normal of rates and turns, written out densely.

    Control: with turns independent of the rows it is tens of nats off.
    """
    rng = np.random.default_rng(5)
    samples = made_up_samples(rng, 90, fires=False, wander=1e-5, rate_noise=2e-5)
    time = 8.0 * (np.arange(90) // 3) + np.arange(90) % 3
    samples = replace(samples, time_s=time.astype(float))
    priors = telemetry_priors().with_fixed("torque_noise_n_m_s05", 0.0)
    # better than wheels are: what is shared counts
    priors = priors.with_fixed("rate_noise_rad_s", 1e-6).with_fixed("attitude_noise_rad", 1e-6)
    model = build_model([event_of(samples, priors, "slews")], priors)
    assert [band.contrasts for band in model.telemetry[0].balance.turns] == [1, 1, 2, 3, 1, 22, 30]
    z = 0.5 * model.space.sample(rng, 1)
    values = {name: float(v) for name, v in model.space.to_parameters(z[0]).items()}
    found = float(log_likelihood(model, z)[0])
    shared, apart = joint_of_slews(model, values)
    assert found == pytest.approx(shared, rel=1e-6)
    assert abs(found - apart) > 10.0


def test_bands_alike_are_merged_without_a_change() -> None:
    """Without torque noise a slew's bands as one give the plain likelihood; with it they stay."""
    rng = np.random.default_rng(14)
    events = [made_up_samples(rng, 60), made_up_samples(rng, 300, fires=False)]
    free = telemetry_priors()
    priors = free.with_fixed("torque_noise_n_m_s05", 0.0)
    reduced = [event_of(samples, priors, f"e{i}") for i, samples in enumerate(events)]
    model = build_model(reduced, priors)
    merged = with_equal_bands_merged(model)
    fast = len(model.telemetry[0].balance.fast)
    assert [len(term.balance.fast) for term in merged.telemetry] == [fast, 1]
    z = 0.5 * model.space.sample(rng, 1)
    parameters = {name: float(v) for name, v in model.space.to_parameters(z[0]).items()}
    plain = plain_log_likelihood(merged, parameters)
    assert log_likelihood(merged, z)[0] == pytest.approx(plain, rel=1e-9)
    noisy = build_model(reduced, free)
    assert with_equal_bands_merged(noisy) is noisy


def test_bands_that_are_one_keep_the_measure_of_each() -> None:
    """Their reference noise has torque noise, of which the measure of fast bands has little."""
    rng = np.random.default_rng(15)
    free = telemetry_priors()
    event = event_of(made_up_samples(rng, 300, fires=False), free, "slew")
    louder = (*event.sampling.reference_noise, ("torque_noise_n_m_s05", 5.0))
    event = replace(event, sampling=replace(event.sampling, reference_noise=louder))
    model = build_model([event], free.with_fixed("torque_noise_n_m_s05", 0.0))
    merged = with_equal_bands_merged(model)
    assert [len(term.balance.fast) for term in merged.telemetry] == [1]
    z = 0.5 * model.space.sample(rng, 8)
    assert log_likelihood(merged, z) == pytest.approx(log_likelihood(model, z), abs=1e-5)


def test_draws_have_the_conditional_moments() -> None:
    """Draws of an event's own unknowns scatter about a mean with the precision of its equations."""
    rng = np.random.default_rng(8)
    model = model_of([made_up_samples(rng, 60, fires=False)])
    z = np.repeat(model.space.sample(rng, 1), 4_000, axis=0)
    (event,) = collapse(model, z[:1]).terms
    draws = draw(model, z, rng)
    own = unknowns_of(draws.thrusts.thrust_n, draws.integrated[0])
    normal, mean, sd = event.system.normal[0], event.system.own_mean, event.system.own_sd[0]
    precision = normal[:-1, :-1] + np.diag(sd**-2)
    covariance = np.linalg.inv(precision)
    expected = covariance @ (normal[:-1, -1] + mean / sd**2)
    error = (own.mean(0) - expected) / np.sqrt(np.diag(covariance) / len(own))
    assert np.abs(error).max() < 4.0
    assert np.cov(own.T) == pytest.approx(covariance, rel=0.2, abs=0.1 * covariance.max())


def test_a_shared_prior_counts_once() -> None:
    """The prior of a parameter is in the posterior once, however many events share it."""
    rng = np.random.default_rng(5)
    events = [made_up_samples(rng, 40), made_up_samples(rng, 40)]
    model = model_of(events)
    z = model.space.sample(rng, 3)
    prior = -0.5 * (z**2).sum(1) - 0.5 * z.shape[1] * np.log(2 * np.pi)
    assert log_posterior(model, z) - log_likelihood(model, z) == pytest.approx(prior)


def test_walked_dimension_does_not_grow_with_events() -> None:
    """One event and four walk in the same parameters; only what is integrated out grows."""
    rng = np.random.default_rng(6)
    one = model_of([made_up_samples(rng, 40)])
    four = model_of([made_up_samples(rng, 40) for _ in range(4)])
    assert one.space.names == four.space.names


def test_a_common_thrust_that_is_not_normal_is_walked() -> None:
    """Its prior cannot be integrated out; nearly normal it gives what the normal one gives."""
    rng = np.random.default_rng(11)
    priors = telemetry_priors()
    samples = made_up_samples(rng, 40)
    normal = build_model([event_of(samples, priors)], priors)
    wide = replace_with_student(priors)
    walked = build_model([event_of(samples, wide)], wide)
    assert set(walked.space.names) - set(normal.space.names) == {"thrust_common_n"}
    z = walked.space.sample(rng, 1)
    others = [walked.space.names.index(name) for name in normal.space.names]
    place = walked.space.names.index("thrust_common_n")
    # the level on a grid, with its prior, against the integral that the model does itself
    levels = np.linspace(-8.0, 8.0, 4_001)
    points = np.repeat(z, len(levels), axis=0)
    points[:, place] = levels
    log_p = log_likelihood(walked, points) - 0.5 * levels**2 - 0.5 * np.log(2 * np.pi)
    top = log_p.max()
    integral = top + np.log(np.exp(log_p - top).sum() * (levels[1] - levels[0]))
    assert integral == pytest.approx(log_likelihood(normal, z[:, others])[0], abs=1e-2)


@pytest.mark.parametrize("expected_n", [0.6, 1.5])
def test_counters_are_as_noisy_as_the_thrust_that_there_is(expected_n: float) -> None:
    """Thrusts that size open counters are those of the data (0.76 N), whatever was expected."""
    priors = telemetry_priors()
    common = priors.parameters["thrust_common_n"].distribution
    assert common is not None
    wrong = {"loc": expected_n, "scale": 0.04}
    priors = priors.with_distribution("thrust_common_n", Distribution("norm", wrong))
    event = event_of(made_up_samples(np.random.default_rng(6), 300), priors)
    (term,) = build_model([event], priors).telemetry
    assert term.balance.thrusts_n == pytest.approx(np.full(8, 0.76), rel=0.06)


def replace_with_student(priors: Priors) -> Priors:
    """The common thrust with a Student-t prior of so many degrees of freedom that it is normal."""
    prior = priors.parameters["thrust_common_n"].distribution
    assert prior is not None
    student = Distribution("t", {"df": 1e7, "loc": prior.mean(), "scale": prior.sd()})
    return priors.with_distribution("thrust_common_n", student)


def test_the_same_event_twice_is_refused() -> None:
    """Two events of one name would count the data twice."""
    rng = np.random.default_rng(7)
    priors = telemetry_priors()
    event = event_of(made_up_samples(rng, 40), priors)
    with pytest.raises(InputError, match="each event once"):
        build_model([event, event], priors)
    with pytest.raises(InputError, match="at least one event"):
        build_model([], priors)


def test_a_parameter_that_is_missing_is_named() -> None:
    """Priors without the noise of the channels are refused by name."""
    rng = np.random.default_rng(9)
    priors = telemetry_priors()
    event = event_of(made_up_samples(rng, 40), priors)
    lacking = replace(
        priors,
        parameters={k: v for k, v in priors.parameters.items() if k != "wheel_noise_rpm"},
    )
    with pytest.raises(InputError, match="wheel_noise_rpm"):
        build_model([event], lacking)


def test_evidence_of_a_linear_gaussian_case_is_exact() -> None:
    """With only lever arms free the evidence is a Gaussian integral; importance draws find it."""
    rng = np.random.default_rng(12)
    priors = telemetry_priors()
    free = ("cm_x_m", "cm_y_m", "thruster_lx_m")
    for name, prior in priors.parameters.items():
        if prior.distribution is not None and name not in free:
            linear = name.startswith(("thrust_", "external_torque"))
            value = 0.0 if linear and name != "thrust_common_n" else prior.distribution.mean()
            priors = priors.with_fixed(name, value)
    # tails as long as the rise: nothing to cut, so that lever arms enter linearly
    priors = priors.with_fixed("tau_fall_s", 0.02).with_fixed("tau_rise_s", 0.02)
    # on-times that are no multiples: what rounded ones leave open would scale with lever arms
    samples = made_up_samples(rng, 40)
    samples = replace(samples, on_time_s=1.000314 * samples.on_time_s)
    model = build_model([event_of(samples, priors)], priors)
    assert model.space.names == free
    assert not model.telemetry[0].event.statistics.counters.open_s2.any()

    def plain(z: np.ndarray) -> float:
        values = {name: float(v) for name, v in model.space.to_parameters(z).items()}
        return plain_log_likelihood(model, values) - 0.5 * float(z @ z)

    unit = np.eye(3)
    centre = plain(np.zeros(3))
    gradient = np.array([(plain(e) - plain(-e)) / 2 for e in unit])
    curvature = np.array(
        [
            [(plain(a + b) - plain(a - b) - plain(b - a) + plain(-a - b)) / 4 for b in unit]
            for a in unit
        ]
    )
    # ∫ exp(c + gᵀz + ½ zᵀHz) dz (2π)^(-3/2)
    exact = (
        centre
        - 0.5 * gradient @ np.linalg.solve(curvature, gradient)
        - 0.5 * np.linalg.slogdet(-curvature)[1]
    )
    warm = warm_start(partial(log_posterior, model), 3, rng)
    assert warm.draws.log_evidence_se < 0.05
    assert abs(warm.draws.log_evidence - exact) < 3 * warm.draws.log_evidence_se


def test_the_naive_balance_residual_pulls_inertia_down() -> None:
    """A density of the balance residual rewards small inertias; that of the channels does not."""
    rng = np.random.default_rng(3)
    priors = telemetry_priors()
    samples = made_up_samples(rng, 800, fires=False)
    model = build_model([event_of(samples, priors)], priors)
    place = model.space.names.index("rwa1_inertia_kg_m2")
    shrunk = np.zeros((2, len(model.space.names)))
    for name in model.space.names:
        if "inertia" in name:
            shrunk[1, model.space.names.index(name)] = -2.0
    assert place >= 0
    right = log_posterior(model, shrunk)
    naive = without_jacobian(model, shrunk)
    assert right[1] < right[0] - 5.0
    assert naive[1] - naive[0] > right[1] - right[0] + 20.0


def test_wheels_that_show_nothing_leave_the_density_finite() -> None:
    """Fewer rows than directions leave mean squares of zero: the density is flat there."""
    spline = motion_table(3)
    nodes, coefficients = spline.x, np.ascontiguousarray(spline.c)
    found = [
        estimated_wheels(
            3.0,
            nodes,
            coefficients,
            square * np.diag([0.0] * 3 + [1.0, 1.0, 0.0]),
            np.eye(3),
            np.eye(3),
            np.ones(3),
            np.empty((3, 3)),
        )
        for square in (1.0, 1e-6, 1e-12, 1e-24, 0.0)
    ]
    assert np.all(np.isfinite(found))
    assert found[2:] == pytest.approx([found[2]] * 3, abs=1e-4)
    assert found[0] < found[1] <= found[2] + 1e-4


def test_the_prior_of_the_initial_momentum_is_flat() -> None:
    """A bias by 80 N m s: a prior that is wider still changes nothing, one of 10 N m s does."""
    scenario = ROOT / "runs" / "scenarios" / "calibration.toml"
    content = eased(read_toml(scenario, "a scenario file"), 1.0, 4.0)
    bias = {"from_rpm": [1800.0, -1700.0, 1900.0], "to_rpm": [-1800.0, 1700.0, -1600.0]}
    content["event"] = [next(e for e in content["event"] if e["kind"] == "bias") | bias]
    priors = telemetry_priors()
    flight = simulate_file(scenario_of(content, scenario.parent), 11, priors=priors)
    model = build_model([reduced_simulation(flight.events[0], priors)], priors)
    term = model.telemetry[0]
    z = model.space.sample(np.random.default_rng(1), 6)

    def gained(sd_n_m_s: float) -> Array:
        """Log likelihoods over that of the first point."""
        balance = replace(term.balance, initial_sd_n_m_s=sd_n_m_s)
        values = log_likelihood(replace(model, telemetry=(replace(term, balance=balance),)), z)
        return np.asarray(values - values[0])

    wide = gained(1e4)
    assert gained(term.balance.initial_sd_n_m_s) == pytest.approx(wide, abs=0.01)
    assert np.abs(gained(10.0) - wide).max() > 0.1


def test_no_wheel_is_without_noise() -> None:
    """Wheel rates without a step: the density is flat where noise is beyond any tachometer's.

    Sums of squares had lost all digits there, and the density rose to 1e15.
    """
    model = model_of([made_up_samples(np.random.default_rng(2), 300)])
    z = np.zeros((3, model.space.dimension))
    place = model.space.names.index("wheel_noise_rpm")
    wanted = np.array([1e-4, 1e-9, 1e-12])
    z[:, place] = model.space.distributions[place].standard_of(wanted)
    assert model.space.to_parameters(z)["wheel_noise_rpm"] == pytest.approx(wanted)
    found = log_likelihood(model, z)
    assert found == pytest.approx(found[0], abs=1.0)
