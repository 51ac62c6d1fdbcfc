"""Tables of a run: which thrusts their priors disagree with, and the noise of printed ΔV."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from totals_cases import flight

from cassini_bayes.model import build_model
from cassini_bayes.results.groups import build_fit
from cassini_bayes.results.tables import (
    conflict_sentences,
    delta_v_table,
    moments,
    thrust_conflicts,
    wide_sentences,
)


def summary(common: float, *levels: float) -> pd.DataFrame:
    """Posterior means of thrusts, all ± 0.03 N, with priors 0.76 ± 0.05 N."""
    names = ["thrust_common_n", *(f"thrust_level_n[z{k + 1}]" for k in range(len(levels)))]
    return pd.DataFrame(
        {
            "name": names,
            "quantity": [name.partition("[")[0] for name in names],
            "unit": "N",
            "mean": [common, *levels],
            "sd": 0.03,
            "prior_mean": 0.76,
            "prior_sd": 0.05,
        }
    )


def test_a_pulled_thrust_is_said() -> None:
    """The common thrust alone where it is pulled, else each level; 0.04 = √(0.05² − 0.03²)."""
    (said,) = conflict_sentences(thrust_conflicts(summary(0.56, 0.56, 0.56)))
    assert said.startswith("thrust_common_n: the data pull it -5.0 standard deviations")
    (said,) = conflict_sentences(thrust_conflicts(summary(0.75, 0.75, 0.60)))
    assert said.startswith("thrust_level_n[z2]: the data pull it -4.0 standard deviations")


def test_thrusts_as_believed_are_not_said() -> None:
    """Within a width nothing is said, nor where nothing fires."""
    assert thrust_conflicts(summary(0.75, 0.73)).empty
    assert thrust_conflicts(summary(0.75).iloc[:0]).empty


def test_a_posterior_in_two_places_is_said() -> None:
    """Two modes two standard deviations to either side; a parameter that nothing is known of."""
    rng = np.random.default_rng(1)
    places = rng.choice([-2.0, 2.0], 400) + 0.4 * rng.standard_normal(400)
    z = np.stack([places, rng.standard_normal(400), 0.3 * rng.standard_normal(400)], axis=1)
    (said,) = wide_sentences(("cm_y_m", "cm_x_m", "tau_fall_s"), z)
    assert said.startswith("cm_y_m: the posterior is 2.0 times as wide as the prior")


def test_what_is_fixed_has_its_value_and_no_width() -> None:
    """Sums of ten thousand draws alike have rounding: no standard deviation of 1e-16."""
    assert moments(np.full(9_999, 0.77)) == (0.77, 0.0)
    draws = np.random.default_rng(1).standard_normal(100)
    assert moments(draws) == (draws.mean(), draws.std(ddof=1))


@pytest.mark.parametrize("fixed", [False, True])
def test_the_noise_of_printed_delta_v_is_its_root_mean_square(fixed: bool) -> None:
    """Of draws that differ by factors; of a value that the priors fix, which has none, itself."""
    events, priors = flight(2)
    if fixed:
        priors = priors.with_fixed("delta_v_noise_m_s", 1e-4)
    model, rng = build_model(events, priors), np.random.default_rng(2)
    z = 0.3 * rng.standard_normal((1, 40, model.space.dimension))
    fit = build_fit(model, z, np.zeros((1, 40)), rng, {}, 20)
    assert ("delta_v_noise_m_s" in fit.posterior) != fixed
    draws = model.space.to_parameters(z[0]) | model.space.fixed
    noise = np.asarray(draws["delta_v_noise_m_s"])
    expected = 1e3 * np.sqrt((noise**2).mean())
    assert fixed or expected > 1.02e3 * noise.mean()
    np.testing.assert_allclose(delta_v_table(model, fit)["noise_sd_mm_s"], expected, rtol=1e-12)
