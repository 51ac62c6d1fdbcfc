"""Error budget and prior conflicts against analytic and Monte Carlo answers."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from totals_cases import flight

from cassini_bayes.model import Model, build_model, conditional_thrusts, draw, log_posterior
from cassini_bayes.results.sensitivity import error_budget, prior_against_posterior
from cassini_bayes.sampling.warmstart import warm_start


@pytest.fixture(scope="module")
def fitted() -> tuple[Model, np.ndarray]:
    """The flight model without ΔV and posterior draws of its nuisances."""
    events, priors = flight()
    model = build_model(events, priors, delta_v="ignore")
    rng = np.random.default_rng(1)
    warm = warm_start(lambda z: log_posterior(model, z), len(model.space.names), rng)
    return model, warm.draws.resample(rng, 4_000)


@pytest.fixture(scope="module")
def budget(fitted: tuple[Model, np.ndarray]) -> pd.DataFrame:
    """The flight events' error budget."""
    return error_budget(*fitted)


def test_shares_of_the_variance_sum_to_one(budget: pd.DataFrame) -> None:
    """Block shares, noise-only and nonlinear parts add up to one for every thrust."""
    shares = budget[[name for name in budget if name.endswith("|share")]]
    assert shares.sum(axis=1).to_numpy() == pytest.approx(np.ones(len(budget)), abs=1e-9)
    assert budget["nonlinear|share"].abs().max() < 0.05


def test_full_sd_is_that_of_the_draws(
    fitted: tuple[Model, np.ndarray], budget: pd.DataFrame
) -> None:
    """The budget's total standard deviation is that of thrusts drawn back (Monte Carlo error)."""
    model, z = fitted
    draws = draw(model, z, np.random.default_rng(2))
    sd = draws.thrusts.thrust_n.std(0).reshape(-1)
    assert budget["full_sd_n"].to_numpy() == pytest.approx(sd, rel=4.5 / np.sqrt(2 * len(z)))


def test_tail_off_dominates_the_flight_thrusts(budget: pd.DataFrame) -> None:
    """With pulses nearly all alike the tail-off time is the largest contributor everywhere."""
    names = [n for n in budget if n.endswith("|share") and n != "noise-only|share"]
    assert (budget[names].idxmax(axis=1) == "tail-off|share").all()


def test_consider_contribution_is_the_shift_from_one_prior_sd(
    fitted: tuple[Model, np.ndarray], budget: pd.DataFrame
) -> None:
    """Moving tau_fall by one prior standard deviation shifts the estimate by its contribution."""
    model, z = fitted
    centre = z.mean(0)
    names = list(model.space.names)
    step = 0.2
    shifted = np.tile(centre, (2, 1))
    shifted[:, names.index("tau_fall_s")] += [step, -step]
    mean, _ = conditional_thrusts(model, shifted)
    slope = np.abs(mean[0] - mean[1]).reshape(-1) / (2 * step)
    fall = budget["tail-off|consider_n"].to_numpy()
    assert (fall >= slope * 0.98).all()
    assert (fall < 1.1 * slope + 0.02).all()


def test_conflict_is_flagged_when_a_prior_is_moved_away(
    fitted: tuple[Model, np.ndarray],
) -> None:
    """A tail-off prior far from what the data want is a conflict; the real one is not."""
    events, priors = flight()
    narrow = priors.parameters["tau_fall_s"].distribution
    assert narrow is not None
    moved = priors.scaled(["thrust_common_n"], width=0.1).scaled(
        ["tau_fall_s"], width=0.5, shift=5.0
    )
    model = build_model(events, moved, delta_v="ignore")
    rng = np.random.default_rng(3)
    warm = warm_start(lambda z: log_posterior(model, z), len(model.space.names), rng)
    table = prior_against_posterior(model, warm.draws.resample(rng, 4_000)).set_index("name")
    assert table.loc["tau_fall_s", "verdict"] == "conflict"
    honest = prior_against_posterior(*fitted).set_index("name")
    assert "conflict" not in set(honest["verdict"])
    assert honest.loc["cm_z_m", "verdict"] == "prior returned"
    assert np.isnan(honest.loc["cm_z_m", "surprise"])
