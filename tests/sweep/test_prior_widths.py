"""Wider and narrower priors from a fit's own draws, against the closed form and against a sweep."""

from __future__ import annotations

import numpy as np
import pytest
from sweep_cases import TOY_NAMES, bounded_baseline, toy_baseline, toy_exact

from cassini_bayes.sweep.cells import reweighted
from cassini_bayes.sweep.variations import Group, Variation
from cassini_bayes.sweep.weights import moments
from cassini_bayes.sweep.widths import HIGH, LOW, WIDTHS, width_effects

CENTRE = Group("centre of mass", TOY_NAMES)


def test_trusted_widths_agree_with_the_closed_form_and_a_sweep_and_others_say_so() -> None:
    """Mean and sd of a conjugate normal; the same numbers as a sweep's weights; × 4 is refused."""
    baseline = toy_baseline()
    priors = baseline.factory.priors
    effect = width_effects(priors, [CENTRE], baseline.parameters, baseline.values)[0]
    assert effect.trusted[WIDTHS.index(1.0)]
    assert not effect.trusted[-1]  # control: a posterior narrower than a prior four times as wide
    for i in np.flatnonzero(effect.trusted):
        variation = Variation(CENTRE.name, "width", TOY_NAMES, amount=WIDTHS[i])
        changed = variation.applied(priors)
        weights, values = reweighted(baseline, variation, baseline.factory.build(changed))
        found = moments(values, weights.values)
        np.testing.assert_allclose(effect.mean[i], found.mean, rtol=1e-12)
        np.testing.assert_allclose(effect.sd[i], found.sd, rtol=1e-9)
        np.testing.assert_allclose(effect.low[i], found.quantiles[LOW], rtol=1e-12)
        np.testing.assert_allclose(effect.high[i], found.quantiles[HIGH], rtol=1e-12)
        mean, sd = toy_exact(changed)
        error = 4.5 * sd / np.sqrt(effect.effective[i])
        if effect.pareto_k[i] < 0.5:
            assert (np.abs(effect.mean[i] - mean) < error).all()
            assert (np.abs(effect.sd[i] - sd) < error).all()
            assert (np.abs(effect.low[i] - (mean - 1.645 * sd)) < 2 * error).all()
    assert effect.trusted[: WIDTHS.index(1.0) + 1].sum() >= 3


@pytest.mark.parametrize(("scale", "kept"), [(1.0, 1), (0.0, 0)])
def test_a_prior_that_moves_nothing_is_left_out(scale: float, kept: int) -> None:
    """Of quantities that do not follow the parameters nothing is said; of the parameters it is."""
    baseline = toy_baseline(2_000)
    noise = np.random.default_rng(5).standard_normal((2_000, 1))
    values = scale * baseline.values[:, :1] / baseline.values[:, 0].std() + (1.0 - scale) * noise
    found = width_effects(baseline.factory.priors, [CENTRE], baseline.parameters, values, 0.05)
    assert len(found) == kept


def test_widths_beyond_the_ends_of_the_prior_are_not_told() -> None:
    """Of a uniform only narrower ones are: draws say nothing of values that the fit excluded."""
    baseline = bounded_baseline()
    group = Group("centre of mass", ("cm_x_m",))
    effect = width_effects(baseline.factory.priors, [group], baseline.parameters, baseline.values)[
        0
    ]
    wider = np.array(WIDTHS) > 1.0
    np.testing.assert_array_equal(effect.trusted, ~wider)
    assert np.isnan(effect.mean[wider]).all()
