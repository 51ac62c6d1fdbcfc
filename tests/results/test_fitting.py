"""Fitting: priors come back from a silent likelihood, slow walkers count as few draws."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from totals_cases import flight

from cassini_bayes.errors import InputError
from cassini_bayes.model import build_model
from cassini_bayes.results.fitting import (
    ALL_MET,
    IMPORTANCE_MET,
    Sampled,
    fit_model,
    fit_warnings,
    stop_rule_held,
)
from cassini_bayes.results.record import Fit
from cassini_bayes.results.tables import summarise
from cassini_bayes.sampling.ensembles import SamplerSettings, stored_ess

SILENT = SamplerSettings(ensembles=2, target_ess=800, seed=5)


@pytest.fixture(scope="module")
def silent() -> Sampled:
    """One event whose dead-band rates are so large that its figures say nothing."""
    events, priors = flight(1)
    return fit_model(
        build_model(events, priors.with_fixed("hold_rate_rad_s", 1e3), delta_v="ignore"),
        SILENT,
        draws_per_ensemble=2_000,
        prior_draws=2_000,
    )


def test_priors_come_back_when_the_likelihood_is_silent(silent: Sampled) -> None:
    """Every walked parameter has its prior's mean and width, within Monte Carlo error.

    The Jacobian stays: more tail-off means less on-time for the same momentum, so it tilts tau_fall
    by 3 σ / (width + tau_fall − tau_rise) = 0.39 of its prior width; all others by under a tenth.
    """
    z = silent.flat_z
    names = np.array(silent.model.space.names)
    expected = np.where(names == "tau_fall_s", 3 * 0.02 / (0.125 + 0.050 - 0.020), 0.0)
    assert names[np.abs(z.mean(0) - expected) > 0.1 + 4 / np.sqrt(800)].size == 0
    assert names[np.abs(z.std(0) - 1) > 4 / np.sqrt(2 * 800)].size == 0


def test_collapsed_priors_come_back_too(silent: Sampled) -> None:
    """Thrusts and torques drawn back have their priors' widths; the evidence is the prior's own."""
    summary = summarise(silent.fit)
    drawn = summary[summary["quantity"].isin(["thrust_n", "external_torque_n_m"])]
    expected = np.where(drawn["quantity"] == "thrust_n", np.sqrt(0.05**2 + 0.02**2 + 2e-4), 1e-6)
    assert drawn["sd"].to_numpy() == pytest.approx(expected, rel=0.12)


def test_log_prior_has_every_block_of_the_model(silent: Sampled) -> None:
    """Walked and collapsed blocks are there; a collapsed one is its normal's density."""
    blocks = silent.fit.groups["log_prior"]
    wanted = {"thrust", "torque", "tail_off", "centre_of_mass", "geometry", "wheel_inertia"}
    assert wanted <= set(blocks.data_vars)
    # torque: three normals of width 1e-6, mean log density −½ − log(1e-6 √2π) each
    mean = 3 * (-0.5 - np.log(1e-6 * np.sqrt(2 * np.pi)))
    assert float(blocks["torque"].mean()) == pytest.approx(mean, abs=4 * np.sqrt(1.5 / 800))


def test_effective_size_of_stored_draws_sees_slow_walkers() -> None:
    """Walkers that each move slowly are few draws, though neighbours in the file are not alike."""
    rng = np.random.default_rng(1)
    ensembles, walkers, steps, rho = 4, 92, 400, 0.98  # autocorrelation time 99
    chain = np.empty((ensembles, steps, walkers))
    chain[:, 0] = rng.standard_normal((ensembles, walkers))
    for i in range(1, steps):
        fresh = rng.standard_normal((ensembles, walkers))
        chain[:, i] = rho * chain[:, i - 1] + np.sqrt(1 - rho**2) * fresh
    expected = ensembles * walkers * steps / 99
    bulk, tail = stored_ess(chain.reshape(ensembles, -1), walkers)
    assert 0.5 * expected < bulk < 1.5 * expected
    assert tail < 3 * expected


def test_too_few_stored_draws_are_refused() -> None:
    """Settings that could never reach the target are an error before sampling."""
    events, priors = flight(1)
    model = build_model(events, priors, delta_v="ignore")
    with pytest.raises(InputError, match="draws_per_ensemble"):
        fit_model(model, SamplerSettings(target_ess=2_000), draws_per_ensemble=500)


@pytest.mark.parametrize(
    ("attributes", "held"),
    [
        ({"stop_rule": ALL_MET}, True),
        ({"stop_rule": IMPORTANCE_MET}, True),
        ({"stop_rule": "R-hat 1.08"}, False),
        ({"stop_rule": "not converged"}, False),
        ({}, False),
    ],
)
def test_only_a_stop_rule_that_held_is_trusted(attributes: dict[str, str], held: bool) -> None:
    """Of chains and of a mission's importance draws; a file that does not say so is doubted."""
    fit = Fit({"sample_stats": xr.Dataset()}, attributes)
    assert stop_rule_held(fit) is held
    assert [sentence[:16] for sentence in fit_warnings(fit)] == (
        [] if held else ["Sampling stopped"]
    )
