"""Sensitivity to the effects' priors: evidence at other widths from the draws that there are."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import Ranking, Weighed
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.diagnosis.widths import by_width, reweighted
from cassini_bayes.effects.effect import Effect, EffectParameter, Kind, unchanged
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.sampling.warmstart import TRUSTED_K, pareto_k

PRIOR_SD, NOISE_SD = 2.0e-3, 1.0e-3


def weighed(seen: float, draws: int = 20_000) -> Weighed[Hypothesis]:
    """A cause whose one parameter is measured once, with exact posterior draws."""
    precision = 1.0 / PRIOR_SD**2 + 1.0 / NOISE_SD**2
    mean, sd = seen / NOISE_SD**2 / precision, precision**-0.5
    x = mean + sd * np.random.default_rng(1).standard_normal(draws)
    prior = Distribution("norm", {"loc": 0.0, "scale": PRIOR_SD})
    parameter = EffectParameter("effect_x", "x", "", prior)
    effect = Effect(Kind("x", unchanged), "", (parameter,), 0.1)
    model = SimpleNamespace(space=ParameterSpace(("effect_x",), {}, (prior,), ("effect",)))
    hypothesis = cast(Hypothesis, SimpleNamespace(name="x", effects=(effect,), model=model))
    mode = Mode(np.array([mean / PRIOR_SD]), np.array([[sd / PRIOR_SD]]), 0.0)
    even = np.full(draws, -np.log(draws))
    return Weighed(hypothesis, mode, 0.0, 0.0, (x / PRIOR_SD)[:, None], even)


@pytest.mark.parametrize("width", [0.5, 2.0])
def test_evidence_at_another_width_is_the_closed_form(width: float) -> None:
    """Normal prior and noise: evidence N(seen; 0, prior² + noise²) at either width."""
    seen = 2.5e-3
    log_weights = reweighted(weighed(seen), width)
    found, k = logsumexp(log_weights), pareto_k(log_weights)
    wanted = norm.logpdf(seen, 0.0, np.hypot(width * PRIOR_SD, NOISE_SD)) - norm.logpdf(
        seen, 0.0, np.hypot(PRIOR_SD, NOISE_SD)
    )
    assert found == pytest.approx(wanted, abs=0.03)  # five Monte Carlo errors
    assert k < TRUSTED_K


def test_draws_that_do_not_reach_are_told() -> None:
    """A prior thirty times narrower wants values that no draw of a clear effect has."""
    k = pareto_k(reweighted(weighed(8.0e-3, draws=500), 1.0 / 30.0))
    assert k > TRUSTED_K


def verdict(seen: float, draws: int) -> Ranking[Hypothesis]:
    """That cause beside the baseline, even odds before the data."""
    cause = weighed(seen, draws)
    hypothesis = SimpleNamespace(**vars(cause.hypothesis), causes=("x",))
    none = SimpleNamespace(name="none", causes=(), effects=())
    log_factor = norm.logpdf(seen, 0.0, np.hypot(PRIOR_SD, NOISE_SD)) - norm.logpdf(
        seen, 0.0, NOISE_SD
    )
    log_odds = np.array([log_factor, 0.0]) - np.logaddexp(log_factor, 0.0)
    both = (
        Weighed(
            cast(Hypothesis, hypothesis), cause.mode, 0.0, 0.0, cause.z, cause.log_weights, 0.0
        ),
        Weighed(cast(Hypothesis, none), cause.mode, 0.0),
    )
    return Ranking(both, log_odds)


def test_probability_and_size_at_every_width_are_the_closed_form(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Odds of two normal evidences, and the mean of a normal posterior, where draws reach."""

    def exact(own: Weighed[Hypothesis], _: np.random.Generator) -> tuple[dict[str, Array], Array]:
        assert own.z is not None
        return {"x": PRIOR_SD * own.z[:, 0]}, np.full(len(own.z), 1.0 / len(own.z))

    monkeypatch.setattr("cassini_bayes.diagnosis.widths.size_draws", exact)
    seen = 2.5e-3
    found = by_width(verdict(seen, 20_000), np.random.default_rng(0))
    trusted = [row for row in found if row["trusted"]]
    assert {0.5, 1.0, 2.0, 4.0} <= {row["width"] for row in trusted}
    for row in trusted:
        sd = row["width"] * PRIOR_SD
        factor = norm.pdf(seen, 0.0, np.hypot(sd, NOISE_SD)) / norm.pdf(seen, 0.0, NOISE_SD)
        assert row["probabilities"]["x"] == pytest.approx(factor / (1.0 + factor), abs=0.01)
        mean = seen / (1.0 + (NOISE_SD / sd) ** 2)
        assert row["sizes"]["x"]["mean"] == pytest.approx(mean, abs=0.1 * NOISE_SD)
        half_width = 1.645 / np.hypot(1.0 / sd, 1.0 / NOISE_SD)
        ends = [mean - half_width, mean + half_width]
        # where the density is flat, the ends of the shortest interval of draws scatter
        assert row["sizes"]["x"]["hdi_90"] == pytest.approx(ends, abs=0.3 * NOISE_SD)


def test_a_width_that_draws_do_not_reach_is_not_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few draws of a clear effect say nothing of a prior a quarter as wide; ends stay in order."""
    monkeypatch.setattr(
        "cassini_bayes.diagnosis.widths.size_draws",
        lambda own, _: ({"x": PRIOR_SD * own.z[:, 0]}, np.ones(len(own.z))),
    )
    found = by_width(verdict(8.0e-3, 200), np.random.default_rng(0))
    assert found[0]["width"] == 0.25
    assert found[0]["pareto_k"] > TRUSTED_K
    assert not found[0]["trusted"]
    # its weights are as good as nothing: only their ratios count
    low, high = found[0]["sizes"]["x"]["hdi_90"]
    assert 0.0 < low <= high < 8.0e-3 + 5.0 * NOISE_SD
    assert {row["width"] for row in found if row["trusted"]} >= {1.0, 2.0**0.5}
