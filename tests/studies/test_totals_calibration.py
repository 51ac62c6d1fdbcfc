"""The calibration campaign: its simulation, its ranks, its judgement, its resumption."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from totals_cases import B_BRANCH, FLIGHT, flight, plain_log_likelihood, point

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model import build_model, draw_prior
from cassini_bayes.results.ranks import Ranks
from cassini_bayes.studies import totals_calibration as calibration
from cassini_bayes.studies.totals_calibration import (
    Campaign,
    judge,
    simulate_totals,
    with_room,
)

CAMPAIGN = Campaign(FLIGHT, B_BRANCH, seed=3)


@cache
def ranks_of(control: str, index: int) -> Array:
    """Ranks of a repetition, which nobody may change."""
    return np.asarray(replace(CAMPAIGN, control=control).repetition(index)["ranks"])


def uniform_ranks(n: int, shift: float = 0.0) -> Ranks:
    """Made-up ranks of three parameters; the last one shifted towards one."""
    ranks = np.random.default_rng(1).uniform(size=(n, 3))
    ranks[:, 2] = np.clip(ranks[:, 2] + shift, 0, 1)
    return Ranks(("a", "b", "c"), ranks, np.zeros(n), np.zeros(n, dtype=bool))


def test_simulated_events_close_their_momentum_balance() -> None:
    """Without noise the plain likelihood of the truth is at its peak: the residual is nil."""
    events, priors = flight()
    for name in ("hold_rate_rad_s", "hold_attitude_rad", "wheel_resolution_rpm"):
        priors = priors.with_fixed(name, 1e-9)
    priors = priors.with_fixed("on_time_resolution_s", 1e-7)
    template = tuple(with_room(event) for event in events)
    model = build_model(template, priors, delta_v="ignore")
    rng = np.random.default_rng(2)
    truth = draw_prior(model, 1, rng)
    simulated = simulate_totals(template, model, truth, rng)
    truth_z = np.atleast_2d(model.space.to_standard(truth.parameters))
    loose = {**point(model, truth_z), "hold_rate_rad_s": 1e-7}

    def density(scale: float) -> float:
        return plain_log_likelihood(
            simulated,
            loose,
            truth.thrusts.thrust_n[0] * scale,
            truth.torque_n_m[0],
            model.thrust_prior.common_mean_n,
            expand_jacobian=False,
        )

    assert density(1.0) > density(1.003) + 1e2
    assert density(1.0) > density(0.997) + 1e2


def test_simulated_on_times_respond_and_stay_positive() -> None:
    """On-times and pulse counts change together, on the pairs that work only, and stay positive."""
    events, priors = flight()
    template = tuple(with_room(event) for event in events)
    model = build_model(template, priors, delta_v="ignore")
    rng = np.random.default_rng(4)
    for _ in range(50):
        truth = draw_prior(model, 1, rng)
        simulated = simulate_totals(template, model, truth, rng)
        for row, event in enumerate(simulated):
            answers = np.abs(model.totals_rows.stack.response[row]).sum(-1) > 0
            assert event.on_time_s[~answers] == pytest.approx(template[row].on_time_s[~answers])
            assert (event.on_time_s > 0).all()
            assert event.pulses is not None
            width = event.on_time_s / event.pulses
            before = template[row].on_time_s / template[row].pulses
            assert width == pytest.approx(before, rel=0.5 / event.pulses.min() + 0.01)


def test_repetition_is_reproducible_and_complete() -> None:
    """The same campaign and index give the same ranks, all of them fractions, one per parameter."""
    again = CAMPAIGN.repetition(0)["ranks"]
    assert isinstance(again, np.ndarray)
    first, other = (ranks_of(CAMPAIGN.control, index) for index in (0, 1))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert len(first) == len(CAMPAIGN.names())
    assert ((first >= 0) & (first <= 1)).all()


def test_judgement_passes_uniform_ranks_and_fails_shifted_ones() -> None:
    """Uniform ranks pass; one parameter shifted by a tenth fails coverage and uniformity."""
    good, bad = judge(uniform_ranks(2_000)), judge(uniform_ranks(2_000, shift=0.1))
    assert good.passed
    assert good.tolerance == pytest.approx(0.03)
    assert not bad.passed
    assert bad.failing == ("c",)
    assert bad.smallest_p_value < 1e-6


def test_few_repetitions_get_a_wider_tolerance() -> None:
    """With 60 repetitions binomial scatter is wider than 3 %, and so is the tolerance."""
    assert judge(uniform_ranks(60)).tolerance > 0.1


def test_controls_fail_where_the_model_passes() -> None:
    """Six repetitions suffice: ignoring hold rates or pulse shapes misses most true thrusts."""
    thrusts = [name.startswith("thrust_n") for name in CAMPAIGN.names()]
    average = {}
    for control in calibration.CONTROLS:
        ranks = np.stack([ranks_of(control, index)[thrusts] for index in range(6)])
        average[control] = ((ranks > 0.05) & (ranks < 0.95)).mean()
    assert average["none"] > 0.8
    assert average["hold-rates-ignored"] < average["none"] - 0.05
    assert average["rectangular-pulses"] < 0.4


def test_a_campaign_depends_on_all_that_changes_its_repetitions(tmp_path: Path) -> None:
    """Seed, control, events and priors, by their content, are in its identity."""
    priors = tmp_path / "priors.toml"
    priors.write_bytes(B_BRANCH.read_bytes())
    same = replace(CAMPAIGN, priors=priors)
    assert same.identity() == CAMPAIGN.identity()
    priors.write_bytes(B_BRANCH.read_bytes() + b"# changed\n")
    others = [replace(CAMPAIGN, seed=4), replace(CAMPAIGN, control="rectangular-pulses"), same]
    assert len({own.identity() for own in (CAMPAIGN, *others)}) == 4


def test_parameter_that_a_control_fixes_is_left_out_of_the_judgement() -> None:
    """A column of NaN (not in the fitted model) beside uniform ranks passes; it is not a miss."""
    good = uniform_ranks(2_000)
    blank = replace(good, ranks=np.column_stack([good.ranks[:, :2], np.full(2_000, np.nan)]))
    assert judge(blank).passed
    assert blank.of_fitted().names == ("a", "b")
