"""The size from which a cause would have been seen, against integrals over its prior."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.diagnosis.visible import (
    DETECTED,
    Visible,
    detectable_size,
    size_sd,
    visible_size,
)
from cassini_bayes.effects.effect import Effect, EffectParameter, Kind, unchanged
from cassini_bayes.effects.wording import AtLeast
from cassini_bayes.priors.distributions import Distribution

WIDTH, SD, NATS = 0.2, 0.013, 7.2
KIND = Kind("made_up", unchanged)


def effect(name: str, **keywords: float) -> Effect:
    """An effect of one size with this prior."""
    bounds = {key: keywords.pop(key) for key in ("low", "high") if key in keywords}
    prior = Distribution(name, keywords, bounds.get("low"), bounds.get("high"))
    return Effect(KIND, "z3", (EffectParameter("size", "size", "N", prior),), 0.01)


def log_bayes_factor(estimate: float, sd: float, prior: Distribution, null: float) -> float:
    """Of a size with this estimate over no effect: the integral over its prior."""

    def density(x: float) -> float:
        likelihood = stats.norm.logpdf(x, estimate, sd) - stats.norm.logpdf(null, estimate, sd)
        return float(np.exp(prior.log_density(x) + likelihood - 0.5 * NATS))

    low, high = estimate - 8.0 * sd, min(estimate + 8.0 * sd, prior.support[1])
    return float(np.log(integrate.quad(density, low, high, limit=200)[0]) + 0.5 * NATS)


@pytest.mark.parametrize("sd", [0.001, SD, 0.05])
@pytest.mark.parametrize(
    ("own", "null", "sign"),
    [
        (effect("norm", loc=0.0, scale=WIDTH), 0.0, 1.0),
        (effect("halfnorm", scale=WIDTH), 0.0, 1.0),
        (effect("norm", loc=1.0, scale=WIDTH, high=1.0), 1.0, -1.0),
    ],
)
def test_an_estimate_of_that_size_has_the_evidence(
    own: Effect, null: float, sign: float, sd: float
) -> None:
    """1.28 σ less than the size that is seen is where the integral gives the nats needed."""
    prior = own.parameters[0].distribution
    size = detectable_size(sd, WIDTH, NATS, one_sided=prior.support != (-np.inf, np.inf))
    estimate = null + sign * (size - DETECTED * sd)
    assert log_bayes_factor(estimate, sd, prior, null) == pytest.approx(NATS, abs=0.02)


def made_up(own: Effect, estimate: float, null: float) -> Visible | None:
    """Two nuisances and a size that trades with one: a normal likelihood, known in closed form."""
    design = np.array([[1.0, 0.3, 0.8], [0.0, 1.0, -0.4], [0.0, 0.0, 1.0]]) / SD
    prior = own.parameters[0].distribution
    data = design @ np.array([0.0, 0.0, estimate])

    def density(z: Array) -> Array:
        size = prior.quantile_of_standard(z[:, 2]) - null
        points = np.column_stack([z[:, :2], size])
        left = data - points @ design.T
        return np.asarray(-0.5 * (left**2).sum(1) + stats.norm.logpdf(z).sum(1))

    rows = design[:, :2]
    precision = rows.T @ rows + np.eye(2)
    mean = np.linalg.solve(precision, rows.T @ data)
    base = Mode(mean, np.linalg.cholesky(np.linalg.inv(precision)), 0.0, True)
    return visible_size(density, base, own, NATS)


@pytest.mark.parametrize("estimate", [0.0, SD, -SD])
@pytest.mark.parametrize(
    ("own", "null"),
    [
        (effect("norm", loc=0.0, scale=WIDTH), 0.0),
        (effect("halfnorm", scale=WIDTH), 0.0),
        (effect("norm", loc=1.0, scale=WIDTH, high=1.0), 1.0),
    ],
)
def test_what_the_data_know_a_size_to(own: Effect, null: float, estimate: float) -> None:
    """σ is that of the closed form with both nuisances free, wherever chance puts the estimate."""
    found = made_up(own, estimate, null)
    assert found is not None
    design = np.array([[1.0, 0.3, 0.8], [0.0, 1.0, -0.4], [0.0, 0.0, 1.0]]) / SD
    whole = np.linalg.inv(design.T @ design + np.diag([1.0, 1.0, 0.0]))
    assert found.sd == pytest.approx(np.sqrt(whole[2, 2]), rel=0.02)


def test_what_the_data_do_not_know_is_not_seen() -> None:
    """A likelihood that does not depend on the size; one that knows it worse than the prior."""
    sizes = WIDTH / 3.0 ** np.arange(7.0, -1.0, -1.0)
    assert size_sd(sizes, np.zeros(8)) is None
    assert size_sd(sizes, -(sizes**2)) is None
    assert size_sd(sizes, 0.5 * (sizes / 3.0) ** 2) == pytest.approx(3.0)
    assert detectable_size(3.0, WIDTH, NATS, one_sided=True) > 10.0 * WIDTH


@pytest.mark.parametrize(
    ("size", "words"),
    [
        (AtLeast(1.0, 0.0412, (-1.0,), "1"), "95 % or less"),
        (AtLeast(1.0, 0.0412, (1.0, -1.0), "1"), "at most 95 or at least 105 %"),
        (AtLeast(0.0, 0.0412, (1.0,), "1"), "5 % or more"),
        (AtLeast(0.0, 0.0412, (1.0, -1.0), "1"), "±5 % or more"),
        (AtLeast(0.0, 0.0212, (1.0,), "1"), "2.2 % or more"),
        (AtLeast(0.0, 0.05, (1.0, -1.0), "1", True), "5 % or more off its prior mean"),
    ],
)
def test_sizes_are_said_rounded_away_from_nothing(size: AtLeast, words: str) -> None:
    """Never less than what is seen."""
    assert size.said("%", 100.0) == words
