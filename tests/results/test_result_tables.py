"""Tables of a run: which thrusts their priors disagree with."""

from __future__ import annotations

import numpy as np
import pandas as pd

from cassini_bayes.results.tables import (
    conflict_sentences,
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
