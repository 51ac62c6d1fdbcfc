"""Evidence of printed estimates against closed forms, where the prior's own draws fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm, truncnorm

from cassini_bayes.diagnosis.summaries import (
    Prediction,
    SummaryCause,
    leave_out,
    positive_normal,
    untrusted,
    weigh_summaries,
)
from cassini_bayes.studies.published_cases import a_branch

ROOT = np.array([[3.0, 0.0, 0.0], [1.0, 2.0, 0.0], [0.5, -1.0, 1.0], [2.0, 0.3, -0.4]])
TARGET = np.array([24.0, -2.0, 3.0, 17.0])  # eight prior standard deviations along the first
SD = np.full(4, 0.02)


def predict(z: np.ndarray) -> Prediction:
    """A linear model: estimates ROOT z, no spread of their own."""
    estimate = z @ ROOT.T
    return Prediction(estimate, np.zeros_like(estimate), {"first": z[:, 0]})


FAR = SummaryCause("far", 1.0, 3, predict)


def log_evidence(kept: np.ndarray) -> float:
    """Closed form N(y; 0, ROOT ROOTᵀ + SD²)."""
    own = ROOT[kept]
    covariance = own @ own.T + np.diag(SD[kept] ** 2)
    return float(multivariate_normal(np.zeros(len(own)), covariance).logpdf(TARGET[kept]))


def test_far_posterior_has_its_closed_form_evidence() -> None:
    """Eight prior standard deviations out, evidence, mean and width are the closed form's."""
    (found,) = weigh_summaries(TARGET, SD, [FAR], np.random.default_rng(1), 40_000)
    assert found.log_evidence == pytest.approx(log_evidence(np.arange(4)), abs=0.05)
    precision = np.eye(3) + ROOT.T @ ROOT / SD[0] ** 2
    mean = np.linalg.solve(precision, ROOT.T @ TARGET / SD[0] ** 2)
    sd = np.sqrt(np.linalg.inv(precision)[0, 0])
    assert found.parameters["first"][0] == pytest.approx(mean[0], abs=0.1 * sd)
    assert found.parameters["first"][1] == pytest.approx(sd, rel=0.1)
    assert found.trusted
    assert untrusted([found]) == ""


def test_draws_from_the_prior_alone_fail_there() -> None:
    """Negative control: as many plain prior draws miss the same evidence by far."""
    z = np.random.default_rng(1).standard_normal((40_000, 3))
    misfit = ((TARGET - predict(z).estimate_n) / SD) ** 2
    score = -0.5 * misfit.sum(-1) - np.log(SD).sum() - 2.0 * np.log(2.0 * np.pi)
    plain = float(np.logaddexp.reduce(score)) - np.log(40_000)
    assert abs(plain - log_evidence(np.arange(4))) > 100.0


def test_too_few_draws_are_told() -> None:
    """With two hundred draws the hypothesis is named as not to be relied upon."""
    (found,) = weigh_summaries(TARGET, SD, [FAR], np.random.default_rng(1), 200)
    assert not found.trusted
    assert "far" in untrusted([found])


def test_left_out_scores_are_differences_of_closed_forms() -> None:
    """Every log score is log Z(all) − log Z(others), every residual that of the others' fit."""
    found = leave_out(TARGET, SD, FAR, np.random.default_rng(1))
    for place in range(4):
        kept = np.delete(np.arange(4), place)
        wanted = log_evidence(np.arange(4)) - log_evidence(kept)
        # no more than the Monte Carlo error of two evidences, three standard errors each
        assert found.log_scores[place] == pytest.approx(wanted, abs=0.15)
        precision = np.eye(3) + ROOT[kept].T @ ROOT[kept] / SD[0] ** 2
        mean = np.linalg.solve(precision, ROOT[kept].T @ TARGET[kept] / SD[0] ** 2)
        residual = TARGET[place] - ROOT[place] @ mean
        assert found.residual_n[place] == pytest.approx(residual, abs=0.02)


@pytest.mark.parametrize(("mean", "sd"), [(0.0, 0.2), (0.065, 0.0625), (0.065, 0.0005)])
def test_positive_normal_is_the_truncated_normal(mean: float, sd: float) -> None:
    """Its quantiles are those of a normal cut off at zero, in both tails; sd 0 is a constant."""
    z = np.linspace(-7.0, 7.0, 29)
    wanted = truncnorm(-mean / sd, np.inf, loc=mean, scale=sd)
    found = positive_normal(z, mean, sd)
    assert found[z <= 0] == pytest.approx(wanted.ppf(norm.cdf(z[z <= 0])), rel=1e-6, abs=1e-12)
    assert found[z > 0] == pytest.approx(wanted.isf(norm.sf(z[z > 0])), rel=1e-6)
    assert positive_normal(z, mean, 0.0) == pytest.approx(mean)
    assert np.isfinite(positive_normal(np.array([-60.0, 60.0]), mean, sd)).all()


def test_far_shift_of_the_a_branch_has_its_evidence_by_quadrature() -> None:
    """The c.m. shift of paper 003's branch, 24 baseline prior sd away, by a double integral.

    The shift along X is held at zero, so that thrust level and shift along Y are left.
    """
    case = a_branch()
    shifted = replace(case, cm_sd_m={"x": 1e-9, "y": 5.0 * case.cm_sd_m["y"]})
    (found,) = weigh_summaries(
        case.estimate_n, case.sd_n, [shifted.as_cause("y", 1.0)], np.random.default_rng(1), 40_000
    )

    def density(level: float, shift: float) -> float:
        own = shifted.predict(np.array([[level, 0.0, shift]]))
        sd = np.hypot(case.sd_n, own.own_sd_n[0])
        value = norm.logpdf(case.estimate_n, own.estimate_n[0], sd).sum()
        return float(np.exp(value + norm.logpdf(level) + norm.logpdf(shift)))

    levels = np.linspace(-3.0, 2.0, 81)
    inner = [quad(lambda s, a=a: density(a, s), -9.0, 1.0, limit=60)[0] for a in levels]
    wanted = float(np.log(np.trapezoid(inner, levels)))
    assert found.log_evidence == pytest.approx(wanted, abs=0.03)
    assert found.parameters["cm_y shift (m)"][0] == pytest.approx(-0.137, abs=0.003)
