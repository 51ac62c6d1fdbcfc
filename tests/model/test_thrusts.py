"""The collapsed posterior against plain, dense and brute-force versions of itself."""

from __future__ import annotations

from dataclasses import Field, fields, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal
from totals_cases import flight, plain_log_likelihood, point

from cassini_bayes.balance.totals_terms import ResponseJacobian
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.predictive import event_log_likelihood, jacobian_expansion_error
from cassini_bayes.model.thrusts import (
    collapse_totals,
    draw_linear,
    thrust_moments,
    totals_log_likelihood,
    totals_log_posterior,
)
from cassini_bayes.model.totals import LinearSystem, TotalsTerm, build_totals, linear_system
from cassini_bayes.priors.reader import Priors
from cassini_bayes.results.record import draws_of, prior_draws

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def case() -> tuple[tuple[TotalsEvent, ...], Priors, TotalsTerm]:
    """The eight flight events, their priors and the model without ΔV."""
    events, priors = flight()
    return events, priors, build_totals(events, priors, delta_v="ignore")


def dense_thrust_prior(model: TotalsTerm) -> tuple[Array, Array]:
    """Mean and covariance of all events' thrusts stacked, written out densely."""
    linear, n_events = model.thrust_prior, len(model.stack.event_ids)
    shared = linear.shared @ linear.shared.T
    own = linear.own @ linear.own.T
    covariance = np.kron(np.ones((n_events, n_events)), shared) + np.kron(np.eye(n_events), own)
    return np.full(len(covariance), linear.common_mean_n), covariance


def test_collapsed_likelihood_equals_dense_gaussian_integral(
    case: tuple[tuple[TotalsEvent, ...], Priors, TotalsTerm],
) -> None:
    """Block elimination agrees with one dense integral over all 64 thrusts to 1e-8."""
    _, _, model = case
    rng = np.random.default_rng(1)
    for z in 0.5 * model.space.sample(rng, 5):
        system = linear_system(model, model.space.to_parameters(z[None]))
        mean, prior = dense_thrust_prior(model)
        n_events, k = model.stack.on_time_s.shape
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
        assert totals_log_likelihood(model, z[None])[0] == pytest.approx(integral, rel=1e-8)


def test_collapsed_likelihood_equals_plain_likelihood_by_bayes_identity() -> None:
    """log p(y) = log p(y|F,τ) + log p(F,τ) − log p(F,τ|y) with the plain likelihood, any F, τ."""
    events, priors = flight(3)
    model = build_totals(events, priors, delta_v="ignore")
    n_events = len(events)
    rng = np.random.default_rng(2)
    for z in 0.5 * model.space.sample(rng, 3):
        values = point(model, z[None])
        system = linear_system(model, model.space.to_parameters(z[None]))
        evidence = []
        for _ in range(3):
            _, draws = prior_draws(model, 1, rng)
            thrust, torque = draws.thrust_n[0], draws.external_torque_n_m[0]
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
            sd = model.thrust_prior.torque_sd_n_m
            white = (torque - model.thrust_prior.torque_mean_n_m) / sd
            log_prior += -0.5 * (white**2).sum() - n_events * np.log(sd * np.sqrt(2 * np.pi)).sum()
            evidence.append(plain + log_prior - dense_conditional(model, system, thrust, torque))
        assert evidence == pytest.approx([totals_log_likelihood(model, z[None])[0]] * 3, rel=1e-8)


def dense_conditional(
    model: TotalsTerm, system: LinearSystem, thrust: Array, torque: Array
) -> float:
    """Log density of the conditional normal of all thrusts and torques, assembled densely."""
    mean, prior = dense_thrust_prior(model)
    n_events, k = model.stack.on_time_s.shape
    sd = model.thrust_prior.torque_sd_n_m
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
    x = np.concatenate(
        [thrust.reshape(-1), (torque - model.thrust_prior.torque_mean_n_m).reshape(-1)]
    )
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
    model = build_totals(events, priors, delta_v="ignore")
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
    assert totals_log_likelihood(model, z)[0] == pytest.approx(brute, rel=1e-8)


def test_conditional_draws_have_the_conditional_moments(
    case: tuple[tuple[TotalsEvent, ...], Priors, TotalsTerm],
) -> None:
    """Thrusts drawn back at one point have the closed-form mean and variance (4.5 s.e.)."""
    _, _, model = case
    n = 10_000
    z = np.repeat(0.3 * model.space.sample(np.random.default_rng(3), 1), n, axis=0)
    system = linear_system(model, model.space.to_parameters(z))
    draws = draw_linear(model, system, collapse_totals(model, system), np.random.default_rng(4))
    mean, variance = thrust_moments(model, z[:1])
    error = (draws.thrust_n.mean(0) - mean[0]) / np.sqrt(variance[0] / n)
    ratio = draws.thrust_n.var(0) / variance[0]
    assert np.abs(error).max() < 4.5
    assert np.abs(ratio - 1).max() < 4.5 * np.sqrt(2 / n)
    assert np.abs(draws.level_n.mean(1) - draws.common_n).std() < 0.05


def test_common_level_is_recovered_from_levels_when_data_say_nothing() -> None:
    """With the likelihood switched off the prior of every level comes back from the draws."""
    events, priors = flight(1)
    blind = priors.with_fixed("hold_rate_rad_s", 1e3)
    model = build_totals(events, blind, delta_v="ignore")
    n = 40_000
    z = model.space.sample(np.random.default_rng(5), n)
    _, draws = draws_of(model, z, np.random.default_rng(6))
    expected = {"common_n": 0.05, "level_n": np.hypot(0.05, 0.02)}
    for name, sd in expected.items():
        values = getattr(draws, name)
        # the Jacobian still tilts thrust upwards by 3 σ²/F, a tenth of a standard deviation
        assert np.abs(values.mean(0) - 0.76 - 3 * 0.05**2 / 0.76).max() < 0.15 * 0.05
        assert np.abs(values.std(0) / sd - 1).max() < 0.05


def test_shared_prior_counts_once_over_eight_events(
    case: tuple[tuple[TotalsEvent, ...], Priors, TotalsTerm],
) -> None:
    """log posterior − log likelihood is one unit normal per walked parameter, not per event."""
    _, _, model = case
    z = model.space.sample(np.random.default_rng(7), 4)
    once = multivariate_normal(np.zeros(z.shape[1])).logpdf(z)
    assert totals_log_posterior(model, z) - totals_log_likelihood(model, z) == pytest.approx(once)


def test_expansion_of_the_jacobian_is_accurate_over_the_prior(
    case: tuple[tuple[TotalsEvent, ...], Priors, TotalsTerm],
) -> None:
    """The neglected cubic term is of order E (δF/F)³: hundredths of a nat over the prior."""
    _, _, model = case
    rng = np.random.default_rng(8)
    parameters, draws = prior_draws(model, 500, rng)
    error = jacobian_expansion_error(model, parameters, draws.thrust_n)
    relative = np.abs(draws.thrust_n / 0.76 - 1).max((1, 2))
    assert (np.abs(error) < 8 * 3 * relative**3).all()
    assert np.abs(error).max() > 0


def test_event_log_likelihood_is_the_plain_one_with_exact_jacobian() -> None:
    """Pointwise log likelihoods sum to the plain likelihood with the Jacobian not expanded."""
    events, priors = flight()
    model = build_totals(events, priors, delta_v="ignore")
    rng = np.random.default_rng(9)
    z = 0.5 * model.space.sample(rng, 3)
    parameters, draws = draws_of(model, z, rng)
    ours = event_log_likelihood(model, parameters, draws).sum(-1)
    for i in range(3):
        plain = plain_log_likelihood(
            events,
            point(model, z[i : i + 1]),
            draws.thrust_n[i],
            draws.external_torque_n_m[i],
            model.thrust_prior.common_mean_n,
            expand_jacobian=False,
        )
        assert ours[i] == pytest.approx(plain, rel=1e-8)


def _batched(field: Field[object]) -> bool:
    """Whether a field of the linear system carries the batch axis."""
    return field.name not in ("jacobian", "torque_design", "torque_covariance", "offset_n")


def _tiled(jacobian: ResponseJacobian, n: int) -> ResponseJacobian:
    """The same Jacobian at n points."""
    return ResponseJacobian(
        np.repeat(jacobian.value, n, 0),
        np.repeat(jacobian.gradient, n, 0),
        np.repeat(jacobian.hessian, n, 0),
    )


def test_naive_likelihood_without_jacobian_differs(
    case: tuple[tuple[TotalsEvent, ...], Priors, TotalsTerm],
) -> None:
    """Negative control: dropping the Jacobian moves the common thrust by Cov(common, F) · g."""
    _, _, model = case
    z = np.zeros((1, len(model.space.names)))
    system = linear_system(model, model.space.to_parameters(z))
    flat = replace(
        system.jacobian,
        gradient=np.zeros_like(system.jacobian.gradient),
        hessian=np.zeros_like(system.jacobian.hessian),
    )
    n, levels, covariance = 20_000, [], np.zeros(0)
    for one in (system, replace(system, jacobian=flat)):
        many = {f.name: np.repeat(getattr(one, f.name), n, 0) for f in fields(one) if _batched(f)}
        tiled = replace(one, **many, jacobian=_tiled(one.jacobian, n))
        draws = draw_linear(model, tiled, collapse_totals(model, tiled), np.random.default_rng(1))
        levels.append(draws.common_n.mean())
        centred = draws.common_n - draws.common_n.mean()
        covariance = np.tensordot(centred, draws.thrust_n, 1) / n
    # a tilt exp(g·F) of a normal shifts its mean by the covariance with F times g
    predicted = (system.jacobian.gradient[0] * covariance).sum()
    assert levels[0] - levels[1] == pytest.approx(predicted, rel=0.35)  # 13 % Monte Carlo error
