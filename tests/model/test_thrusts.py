"""The collapsed posterior against plain, dense and brute-force versions of itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from totals_cases import flight, plain_log_likelihood, point

from cassini_bayes.balance.totals_system import TotalsSystem
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.catalogue import named_effects
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model import (
    Model,
    build_model,
    conditional_thrusts,
    draw,
    draw_prior,
    event_log_density,
    log_likelihood,
    log_posterior,
)
from cassini_bayes.model.thrusts import (
    collapse_thrusts,
    draw_thrusts,
    level_moments,
    thrust_log_prior,
)
from cassini_bayes.priors.reader import Priors


@pytest.fixture(scope="module")
def case() -> tuple[tuple[TotalsEvent, ...], Priors, Model]:
    """The eight flight events, their priors and the model without ΔV."""
    events, priors = flight()
    return events, priors, build_model(events, priors, delta_v="ignore")


def system_at(model: Model, z: Array) -> TotalsSystem:
    """The balance of the rows at walked coordinates z (n, d)."""
    return model.totals_rows.at(model.points(z)).system


def dense_thrust_prior(model: Model, factor: Array | None = None) -> tuple[Array, Array]:
    """Mean and covariance of all events' thrusts stacked, written out densely.

    ``factor`` (E, K) is that of effects on the levels; departures of events do not know of it.
    """
    linear, n_events = model.thrust_prior, len(model.totals_rows.stack.event_ids)
    shared = linear.shared @ linear.shared.T
    own = linear.departures @ linear.departures.T
    scale = np.ones(n_events * len(shared)) if factor is None else factor.reshape(-1)
    levels = scale[:, None] * np.kron(np.ones((n_events, n_events)), shared) * scale
    covariance = levels + np.kron(np.eye(n_events), own)
    return scale * linear.common_mean_n, covariance


def dense_log_likelihood(model: Model, z: Array, factor: Array | None = None) -> float:
    """The collapsed likelihood at z (1, d) by one dense integral over all thrusts."""
    system = system_at(model, z)
    mean, prior = dense_thrust_prior(model, factor)
    n_events, k = model.totals_rows.stack.on_time_s.shape
    size = n_events * k
    precision, linear_term = np.linalg.inv(prior), np.linalg.solve(prior, mean)
    constant = -0.5 * mean @ linear_term - 0.5 * np.linalg.slogdet(2 * np.pi * prior)[1]
    for e in range(n_events):
        at = slice(e * k, (e + 1) * k)
        noise = system.covariance[0, e] + system.torque_covariance[e]
        design, target = system.design[0, e], system.target[0, e]
        gradient, hessian = system.jacobian.gradient[0, e], system.jacobian.hessian[0, e]
        base = mean[at]
        precision[at, at] += design.T @ np.linalg.solve(noise, design) - hessian
        linear_term[at] += design.T @ np.linalg.solve(noise, target) + gradient - hessian @ base
        constant += -0.5 * target @ np.linalg.solve(noise, target)
        constant += -0.5 * np.linalg.slogdet(2 * np.pi * noise)[1]
        constant += system.jacobian.value[0, e] - gradient @ base + 0.5 * base @ hessian @ base
    integral = constant + 0.5 * linear_term @ np.linalg.solve(precision, linear_term)
    integral += 0.5 * size * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(precision)[1]
    return float(integral)


def test_collapsed_likelihood_equals_dense_gaussian_integral(
    case: tuple[tuple[TotalsEvent, ...], Priors, Model],
) -> None:
    """Block elimination agrees with one dense integral over all 64 thrusts to 1e-8."""
    _, _, model = case
    rng = np.random.default_rng(1)
    for z in 0.5 * model.space.sample(rng, 5):
        found = log_likelihood(model, z[None])[0]
        assert found == pytest.approx(dense_log_likelihood(model, z[None]), rel=1e-8)


@pytest.mark.parametrize("name", ["thruster_degraded:z3", "thrust_scale"])
def test_a_factor_scales_levels_from_its_onset_on_and_no_departures(name: str) -> None:
    """Dense integral: levels times the factor in later rows, departures as wide as before.

    Negative control: departures scaled as well, as they were, give another density.
    """
    events, priors = flight()
    ids = [event.id for event in events]
    (effect,) = named_effects([f"{name}@{ids[5]}"], priors, priors.wheels, ["totals"], order=ids)
    model = build_model(events, priors, delta_v="ignore", effects=[effect])
    rng = np.random.default_rng(3)
    for z in 0.5 * model.space.sample(rng, 3):
        value = float(model.space.to_parameters(z[None])[effect.parameters[0].name][0])
        factor = np.ones((len(events), len(model.thrusters)))
        factor[5:, slice(None) if name == "thrust_scale" else model.thrusters.index("z3")] = value
        found = log_likelihood(model, z[None])[0]
        assert found == pytest.approx(dense_log_likelihood(model, z[None], factor), rel=1e-8)
        # with the same density of the rows in scaled thrusts F' = f F
        wide = replace(
            model.thrust_prior, departures=factor[:, :, None] * model.thrust_prior.departures
        )
        scaled = replace(model, thrust_prior=wide)
        assert abs(log_likelihood(scaled, z[None])[0] - found) > 1e-3


def test_thrusts_with_a_factor_are_drawn_as_they_are_delivered() -> None:
    """About the level before the onset, about the factor times it after: prior draws, their
    density, and posterior draws against the conditional moments.
    """
    events, priors = flight()
    ids = [event.id for event in events]
    name = f"thruster_degraded:z3@{ids[5]}"
    (effect,) = named_effects([name], priors, priors.wheels, ["totals"], order=ids)
    model = build_model(events, priors, delta_v="ignore", effects=[effect])
    rng, n = np.random.default_rng(4), 2_000
    k, size = model.thrusters.index("z3"), effect.parameters[0].name
    drawn = draw_prior(model, n, rng)
    level, factor = drawn.thrusts.level_n[:, k], np.asarray(drawn.parameters[size])
    before = drawn.thrusts.thrust_n[:, 4, k] - level
    after = drawn.thrusts.thrust_n[:, 5, k] - factor * level
    own = float(np.sqrt((model.thrust_prior.departures[k] ** 2).sum()))
    assert [before.std(), after.std()] == pytest.approx([own, own], rel=0.1)
    assert abs(after.mean()) < 5.0 * own / np.sqrt(n)
    log_prior = thrust_log_prior(model.thrust_prior, drawn.parameters, drawn.thrusts)
    flat = thrust_log_prior(
        model.thrust_prior, drawn.parameters, replace(drawn.thrusts, factor=1.0)
    )
    assert log_prior.mean() > flat.mean() + 0.5  # a loss is no departure of the event
    z = np.zeros((n, model.space.dimension))
    mean, variance = conditional_thrusts(model, z[:1])
    delivered = draw(model, z, rng).thrusts.thrust_n
    assert (np.abs(delivered.mean(0) - mean[0]) < 5.0 * np.sqrt(variance[0] / n)).all()


def test_collapsed_likelihood_equals_plain_likelihood_by_bayes_identity() -> None:
    """log p(y) = log p(y|F,τ) + log p(F,τ) − log p(F,τ|y) with the plain likelihood, any F, τ."""
    events, priors = flight(3)
    model = build_model(events, priors, delta_v="ignore")
    n_events = len(events)
    rng = np.random.default_rng(2)
    for z in 0.5 * model.space.sample(rng, 3):
        values = point(model, z[None])
        system = system_at(model, z[None])
        evidence = []
        for _ in range(3):
            draws = draw_prior(model, 1, rng)
            thrust, torque = draws.thrusts.thrust_n[0], draws.torque_n_m[0]
            plain = plain_log_likelihood(
                events,
                values,
                thrust,
                torque,
                model.thrust_prior.common_mean_n,
                expand_jacobian=True,
            )
            mean, prior = dense_thrust_prior(model)
            log_prior = multivariate_normal(mean, prior).logpdf(thrust.reshape(-1))
            sd = model.torque_sd_n_m
            white = (torque - model.torque_mean_n_m) / sd
            log_prior += -0.5 * (white**2).sum() - n_events * np.log(sd * np.sqrt(2 * np.pi)).sum()
            evidence.append(plain + log_prior - dense_conditional(model, system, thrust, torque))
        assert evidence == pytest.approx([log_likelihood(model, z[None])[0]] * 3, rel=1e-8)


def dense_conditional(model: Model, system: TotalsSystem, thrust: Array, torque: Array) -> float:
    """Log density of the conditional normal of all thrusts and torques, assembled densely."""
    mean, prior = dense_thrust_prior(model)
    n_events, k = model.totals_rows.stack.on_time_s.shape
    sd = model.torque_sd_n_m
    size = n_events * (k + 3)
    precision = np.zeros((size, size))
    precision[: n_events * k, : n_events * k] = np.linalg.inv(prior)
    linear_term = np.zeros(size)
    linear_term[: n_events * k] = np.linalg.solve(prior, mean)
    for e in range(n_events):
        at = np.r_[e * k : (e + 1) * k, n_events * k + 3 * e : n_events * k + 3 * e + 3]
        columns = np.hstack([system.design[0, e], system.torque_design[e]])
        noise = np.linalg.inv(system.covariance[0, e])
        precision[np.ix_(at, at)] += columns.T @ noise @ columns
        linear_term[at] += columns.T @ noise @ system.target[0, e]
        gradient = system.jacobian.gradient[0, e]
        hessian = system.jacobian.hessian[0, e]
        precision[np.ix_(at[:k], at[:k])] -= hessian
        linear_term[at[:k]] += gradient - hessian @ mean[:k]
        precision[np.ix_(at[k:], at[k:])] += np.diag(sd**-2.0)
    x = np.concatenate([thrust.reshape(-1), (torque - model.torque_mean_n_m).reshape(-1)])
    centre = np.linalg.solve(precision, linear_term)
    log_det = np.linalg.slogdet(precision)[1]
    return float(
        0.5 * log_det
        - 0.5 * size * np.log(2 * np.pi)
        - 0.5 * (x - centre) @ precision @ (x - centre)
    )


def test_collapsed_likelihood_equals_brute_force_marginalisation() -> None:
    """With one number for all thrusts, summing the plain likelihood over a grid gives the same."""
    events, priors = flight(1)
    for name in ("thrust_individual_n", "thrust_jitter_n"):
        priors = priors.with_fixed(name, 0.0)
    for axis in "xyz":
        priors = priors.with_fixed(f"external_torque_{axis}_n_m", 1e-6)
    model = build_model(events, priors, delta_v="ignore")
    z = np.full((1, len(model.space.names)), 0.3)
    values = point(model, z)
    torque = np.full((1, 3), 1e-6)
    # the thrust is one number here: integrate over its total, N(0.76, 0.05² + 0.01²)
    sd = float(np.hypot(0.05, 0.01))
    t = np.linspace(-9, 9, 181)
    curve = np.array(
        [
            plain_log_likelihood(
                events,
                values,
                np.full((1, 8), 0.76 + sd * s),
                torque,
                model.thrust_prior.common_mean_n,
                expand_jacobian=True,
            )
            for s in t
        ]
    )
    integrand = curve - 0.5 * t**2 - 0.5 * np.log(2 * np.pi)
    brute = np.logaddexp.reduce(integrand) + np.log(t[1] - t[0])
    assert log_likelihood(model, z)[0] == pytest.approx(brute, rel=1e-8)


def test_conditional_draws_have_the_conditional_moments(
    case: tuple[tuple[TotalsEvent, ...], Priors, Model],
) -> None:
    """Thrusts drawn back at one point have the closed-form mean and variance (4.5 s.e.)."""
    _, _, model = case
    n = 10_000
    z = np.repeat(0.3 * model.space.sample(np.random.default_rng(3), 1), n, axis=0)
    draws = draw(model, z, np.random.default_rng(4)).thrusts
    mean, variance = conditional_thrusts(model, z[:1])
    error = (draws.thrust_n.mean(0) - mean[0]) / np.sqrt(variance[0] / n)
    ratio = draws.thrust_n.var(0) / variance[0]
    assert np.abs(error).max() < 4.5
    assert np.abs(ratio - 1).max() < 4.5 * np.sqrt(2 / n)
    assert np.abs(draws.level_n.mean(1) - draws.common_n).std() < 0.05


def test_common_level_is_recovered_from_levels_when_data_say_nothing() -> None:
    """With the likelihood switched off the prior of every level comes back from the draws."""
    events, priors = flight(1)
    blind = priors.with_fixed("hold_rate_rad_s", 1e3)
    model = build_model(events, blind, delta_v="ignore")
    n = 40_000
    z = model.space.sample(np.random.default_rng(5), n)
    draws = draw(model, z, np.random.default_rng(6)).thrusts
    expected = {"common_n": 0.05, "level_n": np.hypot(0.05, 0.02)}
    for name, sd in expected.items():
        values = getattr(draws, name)
        # the Jacobian still tilts thrust upwards by 3 σ²/F, a tenth of a standard deviation
        assert np.abs(values.mean(0) - 0.76 - 3 * 0.05**2 / 0.76).max() < 0.15 * 0.05
        assert np.abs(values.std(0) / sd - 1).max() < 0.05


def test_shared_prior_counts_once_over_eight_events(
    case: tuple[tuple[TotalsEvent, ...], Priors, Model],
) -> None:
    """log posterior − log likelihood is one unit normal per walked parameter, not per event."""
    _, _, model = case
    z = model.space.sample(np.random.default_rng(7), 4)
    once = multivariate_normal(np.zeros(z.shape[1])).logpdf(z)
    assert log_posterior(model, z) - log_likelihood(model, z) == pytest.approx(once)


def test_expansion_of_the_jacobian_is_accurate_over_the_prior(
    case: tuple[tuple[TotalsEvent, ...], Priors, Model],
) -> None:
    """The neglected cubic term is of order E (δF/F)³: hundredths of a nat over the prior."""
    _, _, model = case
    rng = np.random.default_rng(8)
    draws = draw_prior(model, 500, rng)
    thrust_n = draws.thrusts.thrust_n
    rows = model.totals_rows.at(model.points_at(draws.parameters, draws.size))
    error = rows.statistics(thrust_n)["jacobian_expansion_error"][1]
    relative = np.abs(thrust_n / 0.76 - 1).max((1, 2))
    assert (np.abs(error) < 8 * 3 * relative**3).all()
    assert np.abs(error).max() > 0


def test_event_log_likelihood_is_the_plain_one_with_exact_jacobian() -> None:
    """Pointwise log likelihoods sum to the plain likelihood with the Jacobian not expanded."""
    events, priors = flight()
    model = build_model(events, priors, delta_v="ignore")
    rng = np.random.default_rng(9)
    z = 0.5 * model.space.sample(rng, 3)
    draws = draw(model, z, rng)
    ours = event_log_density(model, z, draws).sum(-1)
    for i in range(3):
        plain = plain_log_likelihood(
            events,
            point(model, z[i : i + 1]),
            draws.thrusts.thrust_n[i],
            draws.torque_n_m[i],
            model.thrust_prior.common_mean_n,
            expand_jacobian=False,
        )
        assert ours[i] == pytest.approx(plain, rel=1e-8)


def test_naive_likelihood_without_jacobian_differs(
    case: tuple[tuple[TotalsEvent, ...], Priors, Model],
) -> None:
    """Negative control: dropping the Jacobian moves the common thrust by Cov(common, F) · g."""
    _, _, model = case
    n, levels, covariance = 20_000, [], np.zeros(0)
    points = model.points(np.zeros((n, len(model.space.names))))
    rows = model.totals_rows.at(points)
    jacobian = rows.system.jacobian
    flat = replace(
        jacobian,
        gradient=np.zeros_like(jacobian.gradient),
        hessian=np.zeros_like(jacobian.hessian),
    )
    for one in (rows, replace(rows, system=replace(rows.system, jacobian=flat))):
        collapsed = collapse_thrusts(model.thrust_prior, one.information, points.common_n, None)
        draws = draw_thrusts(model.thrust_prior, collapsed, np.random.default_rng(1))
        levels.append(draws.common_n.mean())
        centred = draws.common_n - draws.common_n.mean()
        covariance = np.tensordot(centred, draws.thrust_n, 1) / n
    # a tilt exp(g·F) of a normal shifts its mean by the covariance with F times g
    predicted = (jacobian.gradient[0] * covariance).sum()
    assert levels[0] - levels[1] == pytest.approx(predicted, rel=0.35)  # 13 % Monte Carlo error


def test_moments_of_levels_are_those_of_draws(case: tuple[object, object, Model]) -> None:
    """Common thrust and levels, in prior widths from the prior mean: 40,000 draws have the same."""
    _, _, model = case
    n, prior = 40_000, model.thrust_prior
    points = model.points(np.zeros((n, len(model.space.names))))
    rows = model.totals_rows.at(points)
    collapsed = collapse_thrusts(prior, rows.information, points.common_n, None)
    mean, width = (values[0] for values in level_moments(prior, collapsed))
    draws = draw_thrusts(prior, collapsed, np.random.default_rng(4))
    sizes = np.sqrt([prior.common_sd_n**2, *np.diagonal(prior.shared @ prior.shared.T)])
    drawn = np.column_stack([draws.common_n, draws.level_n]) - prior.common_mean_n
    drawn /= sizes
    assert mean == pytest.approx(drawn.mean(0), abs=5.0 / np.sqrt(n))
    assert width == pytest.approx(drawn.std(0), rel=5.0 / np.sqrt(2 * n))
