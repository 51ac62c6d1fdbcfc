"""What the papers say over the years: Table 1 with navigation, inertia, the recharge."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.special import logsumexp
from scipy.stats import norm
from study_cases import study_in
from totals_cases import FLIGHT, ROOT

from cassini_bayes.studies.a_branch_table import (
    COMMON_N,
    COMMON_SD_N,
    DEFICIT_SCALE,
    ERROR,
    SHIFT_SD_M,
    Hypothesis,
    losses,
    shift_from_ratio,
    table_1,
    weigh,
    without_navigation,
)
from cassini_bayes.studies.inertia_epochs import estimator_error, moment_ratios
from cassini_bayes.studies.papers_over_years import PAIR, study_papers
from cassini_bayes.studies.pressure_laws import recharge_prediction

SIDES_X, SIDES_Y = np.array([1, -1, -1, 1, 0, 0]), np.array([1, 1, -1, -1, 0, 0])


def monte_carlo(weak: list[int], scatter: float, doubted: float, n: int = 6_000) -> float:
    """Log evidence of Table 1: common level, shifts and deficits drawn, thrusts on a grid."""
    rng = np.random.default_rng(3)
    table = table_1()
    common = COMMON_N + COMMON_SD_N * rng.standard_normal((n, 1))
    e_x = SHIFT_SD_M["x"] * rng.standard_normal((n, 1))
    e_y = doubted * SHIFT_SD_M["y"] * rng.standard_normal((n, 1))
    thrust = np.linspace(0.3, 1.1, 161)
    step, total = thrust[1] - thrust[0], np.zeros(n)
    for k in range(6):
        deficit = np.abs(DEFICIT_SCALE * rng.standard_normal((n, 1))) if k in weak else 0.0
        density = norm.logpdf(thrust, common * (1 - deficit), scatter * COMMON_N)
        torque = thrust * (1 - SIDES_X[k] * e_x / 1.234) * (1 - SIDES_Y[k] * e_y / 1.580)
        density = density + norm.logpdf(table.study_n[k], torque, ERROR * table.study_n[k])
        if k < 4:
            seen = table.navigation_n[k]
            density = density + norm.logpdf(seen, thrust, ERROR * seen)
        total += np.log(step) + logsumexp(density, axis=1)
    return float(logsumexp(total) - np.log(n))


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("weak", "doubted", "name"), [([], 1.0, ""), ([2], 1.0, ""), ([2, 3], 1.0, ""), ([], 5.0, "y")]
)
def test_quadrature_agrees_with_draws_from_the_priors(
    weak: list[int], doubted: float, name: str
) -> None:
    """Another way to the same integral, to a third of a nat."""
    found = weigh(table_1(), Hypothesis("x", tuple(weak), name), 0.06).log_evidence
    assert found == pytest.approx(monte_carlo(weak, 0.06, doubted), abs=0.3)


def test_navigation_puts_the_centre_of_mass_below_the_pair() -> None:
    """By some 30 nats at 2.6 %, by a few at 6 %; without navigation it is not told apart so."""
    pair, shift = Hypothesis("pair", (2, 3)), Hypothesis("cm", doubted="y")
    gap = {
        scatter: weigh(table_1(), pair, scatter).log_evidence
        - weigh(table_1(), shift, scatter).log_evidence
        for scatter in (0.026, 0.06)
    }
    assert 25.0 < gap[0.026] < 35.0
    assert 3.0 < gap[0.06] < 10.0
    alone = without_navigation(table_1())
    assert (
        weigh(alone, pair, 0.026).log_evidence - weigh(alone, shift, 0.026).log_evidence
        < gap[0.026] - 10.0
    )


def test_two_losses_and_the_shift_that_is_left() -> None:
    """Losses near the paper's without tuning; study over navigation leaves no shift."""
    found = losses(table_1(), 0.026)
    (z3, _), (z4, _) = found["z3"], found["z4"]
    assert z3[0] == pytest.approx(0.26, abs=0.01)
    assert z4[0] == pytest.approx(0.147, abs=0.01)
    assert found["z3"][1][1] > z3[1]  # the start level is not known as well
    mean, sd = shift_from_ratio(table_1())
    assert abs(mean) < sd


def test_one_percent_cannot_hold_for_inertia_estimates() -> None:
    """The estimator's error from four dates, and its scatter about each axis's mean as oracle."""
    ratios, dates = moment_ratios()
    assert dates == ("2000-03-15", "2003-02-27", "2004-10-05", "2005-02-09")
    error = estimator_error(ratios)
    plain = float(np.sqrt(((ratios - ratios.mean(0)) ** 2).sum() / 9))
    assert error.mean == pytest.approx(plain, rel=0.15)
    assert error.p_claimed < 0.01
    quiet = estimator_error(0.005 * np.random.default_rng(1).standard_normal((4, 3)))
    assert quiet.p_claimed > 0.05


def test_neither_pressure_law_is_decided_by_the_recharge() -> None:
    """+57 % by the proportional law, some +49 % by the affine one; less than a nat apart."""
    laws = [recharge_prediction(sd, np.random.default_rng(1)) for sd in (0.0, 0.2)]
    assert laws[0].mean == pytest.approx(1.57, abs=0.01)
    assert laws[1].mean == pytest.approx(1.49, abs=0.02)
    assert 0.0 < laws[1].log_density - laws[0].log_density < 1.0
    assert laws[0].intercept == (0.0, 0.0)


def test_the_page_says_what_the_tables_beside_it_have(tmp_path: Path) -> None:
    """Cells of the page against the CSV files, and claims read as one and as two deviations."""
    study_papers(study_in(tmp_path), FLIGHT, ROOT / "priors" / "cassini_b_branch_2010.toml")
    text = (tmp_path / "page.md").read_text()
    causes = pd.read_csv(tmp_path / "page-table-1.csv")
    rows = causes[causes.with_navigation & (causes.name == PAIR)].sort_values("scatter")
    both = " | ".join(f"{value:+.1f}" for value in rows.log_bayes_factor)
    assert f"| `{PAIR}` | {both} |" in text
    beliefs = pd.read_csv(tmp_path / "page-beliefs.csv").set_index("priors")
    today, tested = beliefs.loc["today"], beliefs.loc["tested tail-off"]
    assert f"| today | {today.log_evidence:.2f} |" in text
    assert tested.thrust_mean_n_sd < 0.6 * today.thrust_mean_n_sd
    assert (beliefs.pareto_k < 0.7).all()
    inertia = pd.read_csv(tmp_path / "page-inertia.csv")
    assert f"| 2004-10-05 | {100 * inertia.xx[2]:+.1f} % |" in text
    ratios, _ = moment_ratios()
    assert estimator_error(ratios, 0.005).p_claimed < 1e-9 < estimator_error(ratios).p_claimed
