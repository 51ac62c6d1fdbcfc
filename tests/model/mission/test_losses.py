"""Losses of thrust: their terms against shifted means, their evidence against quadrature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mission_cases import PRIORS, mission_of, mission_table
from scipy.integrate import quad
from scipy.stats import binom, halfnorm, norm, truncnorm
from totals_cases import flight

from cassini_bayes.computing.arrays import picked
from cassini_bayes.errors import InputError
from cassini_bayes.model.mission.losses import (
    Loss,
    LossPrior,
    chosen,
    draw_losses,
    draw_thrusts_given,
    index_of_hypothesis,
    log_bayes,
    log_bayes_of,
    log_bayes_pair,
    log_bayes_single,
    log_both_positive,
    log_prior_of,
    loss_prior,
    loss_terms,
    near_hypotheses,
    prior_losses,
)
from cassini_bayes.model.mission.model import BranchAt
from cassini_bayes.model.thrusts import ThrustPrior, collapse_thrusts
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import read_priors

SCALE = 0.15


@pytest.fixture(scope="module")
def branch() -> BranchAt:
    """The eight flight events at three points."""
    model = mission_of(flight()[0], mission_table(pressure=None, dated=[]))
    z = 0.3 * np.random.default_rng(3).standard_normal((3, model.space.dimension))
    return model.at(z)[0][0]


def prior_of(branch: BranchAt) -> ThrustPrior:
    """The thrusts' prior as an ordinary fit has it, with a design row for every event."""
    rows = branch.scale[..., None, None] * branch.thrusts.rows(branch.thrusts.years)
    return ThrustPrior(branch.thrusts.common_n, 0.0, False, 0.0, rows, branch.thrusts.departures)


def shifted_log_likelihood(branch: BranchAt, losses: list[Loss], sizes: list[float]) -> np.ndarray:
    """Collapsed log likelihood with every event's mean thrust lowered by hand."""
    mean = branch.offset_n.copy()
    for loss, size in zip(losses, sizes, strict=True):
        lost = branch.thrusts.common_n * size * branch.scale[:, loss.onset :]
        mean[:, loss.onset :, loss.thruster] -= lost
    none = np.zeros(len(mean))
    return collapse_thrusts(prior_of(branch), branch.information, none, mean).log_likelihood


@pytest.mark.parametrize(
    "losses", [[Loss(0, 3)], [Loss(3, 1), Loss(5, 4)], [Loss(0, 6), Loss(1, 2)]]
)
def test_terms_of_losses_are_those_of_lowered_thrusts(branch: BranchAt, losses: list[Loss]) -> None:
    """log L(s) = log L(0) + bᵀs − ½ sᵀCs; oracle: the collapsed density of lowered thrusts."""
    terms = loss_terms(branch)
    sizes = [0.2, 0.07][: len(losses)]
    places = np.array([[loss.onset, loss.thruster] for loss in losses])
    o, k = places.T
    expected = (terms.linear[:, o, k] * sizes).sum(1)
    expected -= 0.5 * (terms.square[:, o, k] * np.square(sizes)).sum(1)
    if len(losses) == 2:
        expected -= sizes[0] * sizes[1] * terms.cross(places[:1], places[1:])[:, 0]
    change = shifted_log_likelihood(branch, losses, sizes) - branch.levels.log_likelihood
    np.testing.assert_allclose(change, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("linear", [-400.0, -3.0, 0.0, 25.0, 300.0])
def test_evidence_of_one_loss_is_its_integral(linear: float) -> None:
    """Closed form against quadrature, for gains as for losses."""
    square = 900.0

    def integrand(s: float) -> float:
        height = linear * s - 0.5 * square * s**2
        return float(np.exp(height - top) * halfnorm.pdf(s, scale=SCALE))

    best = max(linear / (square + SCALE**-2), 0.0)
    top = linear * best - 0.5 * square * best**2
    value = quad(integrand, 0.0, 2.0, points=[best, best + 0.03], limit=200)[0]
    found = log_bayes_single(np.array(linear), np.array(square), SCALE)
    assert float(found) == pytest.approx(np.log(value) + top, abs=1e-6)


@pytest.mark.parametrize(
    ("linear", "square", "cross"),
    [((60.0, 40.0), (900.0, 600.0), 300.0), ((80.0, -30.0), (900.0, 600.0), -200.0),
     ((-20.0, -40.0), (400.0, 600.0), 250.0)],
)  # fmt: skip
def test_evidence_of_two_losses_is_their_integral(
    linear: tuple[float, float], square: tuple[float, float], cross: float
) -> None:
    """Both terms and sizes by a product rule of 400 nodes each."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    s, t = np.meshgrid(0.4 * (nodes + 1.0), 0.4 * (nodes + 1.0), indexing="ij")
    height = linear[0] * s + linear[1] * t
    height -= 0.5 * (square[0] * s**2 + square[1] * t**2) + cross * s * t
    density = halfnorm.pdf(s, scale=SCALE) * halfnorm.pdf(t, scale=SCALE)
    value = (np.exp(height) * density * np.outer(0.4 * weights, 0.4 * weights)).sum()
    found = log_bayes_pair(np.array(linear), np.array(square), np.array(cross), SCALE)
    assert float(found) == pytest.approx(np.log(value), abs=1e-6)


def test_hypotheses_add_up_whichever_is_the_reference(branch: BranchAt) -> None:
    """Probabilities add up to one; at one point the reference does not matter; pairs are there."""
    terms = picked(loss_terms(branch), slice(0, 1))
    prior = LossPrior(0.1, SCALE)
    which = near_hypotheses(terms, prior, include=(Loss(6, 5), Loss(1, 7)))
    place = index_of_hypothesis(which, (Loss(1, 7), Loss(6, 5)))
    assert set(which[place]) == {Loss(1, 7), Loss(6, 5)}
    log_prior, found = log_prior_of(which, prior, (8, 8)), log_bayes_of(terms, which, SCALE)
    first, other = (chosen(log_prior, found - found[:, [reference]]) for reference in (0, 17))
    np.testing.assert_allclose(first, other, atol=1e-12)
    assert first.sum() == pytest.approx(1.0)
    assert {len(losses) for losses in which} == {0, 1, 2}


def test_evidence_of_one_hypothesis_is_that_among_all(branch: BranchAt) -> None:
    """A hypothesis weighed alone, from its own terms, as in the table of all."""
    which = ((), (Loss(3, 4),), (Loss(0, 6), Loss(1, 2)), (Loss(5, 1), Loss(2, 7)))
    found = log_bayes_of(loss_terms(branch), which, SCALE)
    for number, hypothesis in enumerate(which):
        alone = log_bayes(branch, hypothesis, SCALE)
        np.testing.assert_allclose(alone, found[:, number], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("h", "k", "correlation"),
    [(7.5, 0.3, 0.6), (1.2, -2.0, -0.8), (-1.0, -1.5, 0.3), (0.0, 1.0, -0.5), (0.5, 0.0, 0.95)],
)
def test_probability_that_both_are_positive(h: float, k: float, correlation: float) -> None:
    """Owen's T function against a numerical integral over the first normal."""
    root = np.sqrt(1.0 - correlation**2)

    def integrand(x: float) -> float:
        return float(norm.pdf(x) * norm.cdf((k + correlation * x) / root))

    value = quad(integrand, -h, 9.0, epsabs=1e-13, limit=200)[0]
    found = log_both_positive(np.array([h]), np.array([k]), np.array([correlation]))
    assert found[0] == pytest.approx(np.log(value), abs=1e-9)


def test_small_probabilities_keep_their_logarithm() -> None:
    """Both means at −8 standard deviations: quantiles of the first, by its integral in logs."""
    h, k, correlation = -8.0, -8.0, 0.2
    root = np.sqrt(1.0 - correlation**2)
    value = quad(
        lambda x: np.exp(norm.logpdf(x) + norm.logcdf((k + correlation * x) / root) + 60.0),
        -h, 12.0, epsabs=0.0, limit=200,
    )[0]  # fmt: skip
    found = log_both_positive(np.array([h]), np.array([k]), np.array([correlation]))
    assert found[0] == pytest.approx(np.log(value) - 60.0, abs=0.02)


def test_first_events_alone_are_a_branch_of_their_own(branch: BranchAt) -> None:
    """A branch cut to five events has the density and the losses of a mission of these five."""
    model = mission_of(flight(5)[0], mission_table(pressure=None, dated=[]))
    z = 0.3 * np.random.default_rng(3).standard_normal((3, model.space.dimension))
    whole = model.at(z)[0][0]
    assert np.isfinite(branch.left.constant).all()  # eliminated before the cut
    cut = branch.first(5)
    np.testing.assert_allclose(cut.levels.log_likelihood, whole.levels.log_likelihood, rtol=1e-10)
    np.testing.assert_allclose(loss_terms(cut).linear, loss_terms(whole).linear, rtol=1e-8)


def test_drawn_losses_have_the_moments_of_their_normal(branch: BranchAt) -> None:
    """Drawn sizes of one loss against scipy's truncated normal, and no size without a loss."""
    terms = loss_terms(branch)
    n = 4_000
    many = picked(terms, np.zeros(n, dtype=np.int64))
    which = [(Loss(5, 5),)] * (n - 1) + [()]
    drawn = draw_losses(many, which, SCALE, np.random.default_rng(1))
    precision = terms.square[0, 5, 5] + SCALE**-2
    mean, sd = terms.linear[0, 5, 5] / precision, precision**-0.5
    oracle = truncnorm(-mean / sd, np.inf, loc=mean, scale=sd)
    assert drawn.share[-1].tolist() == [0.0, 0.0]
    assert drawn.share[:-1, 0].mean() == pytest.approx(oracle.mean(), abs=4 * oracle.std() / n**0.5)


def test_thrusts_without_a_loss_are_those_of_the_collapsed_model(branch: BranchAt) -> None:
    """Draws without losses have the conditional moments that the fit of single events uses."""
    from cassini_bayes.model.thrusts import thrust_moments

    n = 4_000
    one = branch.take(np.zeros(n, dtype=np.int64))
    none = draw_losses(loss_terms(one), [()] * n, SCALE, np.random.default_rng(2))
    _, thrust = draw_thrusts_given(one, none, np.random.default_rng(2))
    single = branch.take(np.zeros(1, dtype=np.int64))
    collapsed = collapse_thrusts(prior_of(single), single.information, np.zeros(1), single.offset_n)
    mean, variance = thrust_moments(prior_of(single), collapsed)
    mean = mean + replace(single).thrusts.reference_n[:, None]
    error = 5 * np.sqrt(variance[0] / n)
    assert (np.abs(thrust.mean(0) - mean[0]) < error).all()
    np.testing.assert_allclose(thrust.std(0), np.sqrt(variance[0]), rtol=0.06)


def test_losses_before_any_data_follow_their_prior() -> None:
    """One thruster in ten fails, at most two; onsets after the first event; half-normal shares."""
    n = 20_000
    drawn = prior_losses(LossPrior(0.1, SCALE), (n, 5, 8), np.random.default_rng(3))
    failing = (drawn.share > 0).sum(1)
    for count, probability in enumerate(binom.pmf([0, 1], 8, 0.1)):
        assert (failing == count).mean() == pytest.approx(probability, abs=0.015)
    assert failing.max() == 2
    assert (drawn.thruster[:, 0] != drawn.thruster[:, 1]).all()
    assert {int(o) for o in drawn.onset.ravel()} == {1, 2, 3, 4}
    mean = halfnorm.mean(scale=SCALE)
    assert drawn.share[drawn.share > 0].mean() == pytest.approx(mean, rel=0.03)
    alone = prior_losses(LossPrior(0.1, SCALE), (10, 1, 8), np.random.default_rng(3))
    assert not alone.share.any()  # a branch of one event has no onset after it


@pytest.mark.parametrize(
    ("name", "prior", "message"),
    [
        ("thrust_loss_share", 0.1, r"halfnorm from 0 without bounds.*got fixed = 0\.1"),
        (
            "thrust_loss_share",
            Distribution("norm", {"loc": 0.20, "scale": 0.01}),
            r"thrust_loss_share\.dist: expected halfnorm.*got Distribution\('norm'",
        ),
        ("thrust_loss_share", Distribution("halfnorm", {"scale": 0.1}, high=0.3), "without bounds"),
        ("thrust_loss_share", Distribution("halfnorm", {"loc": -0.1}, low=0.0), "from 0"),
        ("failing_probability", 0.0, r"above 0 and below 1, got 0\.0"),
        ("failing_probability", 1.0, r"above 0 and below 1, got 1\.0"),
        ("failing_probability", Distribution("beta", {"a": 1.0, "b": 9.0}), "a fixed probability"),
    ],
)
def test_beliefs_on_losses_are_those_the_formulae_are_for(
    name: str, prior: Distribution | float, message: str
) -> None:
    """Another prior of what is lost, or a sure answer on whether, is refused in one line; none is
    read as something else.
    """
    priors = read_priors(PRIORS)
    assert loss_prior(priors) == LossPrior(0.1, 0.15)
    changed = (
        priors.with_distribution(name, prior)
        if isinstance(prior, Distribution)
        else priors.with_fixed(name, prior)
    )
    with pytest.raises(InputError, match=message) as refused:
        loss_prior(changed)
    assert "\n" not in str(refused.value)
