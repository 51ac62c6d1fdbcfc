"""Tables of a run: which thrusts their priors disagree with."""

from __future__ import annotations

import pandas as pd

from cassini_bayes.results.tables import conflict_sentences, thrust_conflicts


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
