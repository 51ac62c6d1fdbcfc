"""Replicated telemetry: measured rows among its replicates as often as promised, in fit.nc too."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from event_cases import model, simulated

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model import draw, log_posterior
from cassini_bayes.results.groups import build_fit
from cassini_bayes.results.record import Fit, read_fit, save_fit
from cassini_bayes.results.replicates import REPLICATED_ROWS, Replicates, replicated
from cassini_bayes.results.time_series import DRAWS, BalanceRows, balances, thinned_draws
from cassini_bayes.sampling.warmstart import warm_start

NAMES = ("bias", "slews")
INNER = 0.9  # nominal share of the measured values inside


@cache
def draws() -> Array:
    """Posterior points (2, 300, d) of both events, importance-sampled."""
    joint = model(*NAMES)
    start = warm_start(
        lambda z: log_posterior(joint, z), len(joint.space.names), np.random.default_rng(2)
    )
    assert start.draws.pareto_k < 0.7
    return start.draws.resample(np.random.default_rng(3), 600).reshape(2, 300, -1)


@cache
def rows() -> tuple[BalanceRows, ...]:
    """Balances of both events at the draws that are shown."""
    flat = draws().reshape(600, -1)
    z = flat[thinned_draws(600)]
    drawn = draw(model(*NAMES), z, np.random.default_rng(4))
    return tuple(balances(model(*NAMES), z, drawn, REPLICATED_ROWS))


@cache
def fit() -> Fit:
    """The record of a fit, with all groups."""
    joint, z = model(*NAMES), draws()
    density = log_posterior(joint, z.reshape(600, -1)).reshape(2, 300)
    rng = np.random.default_rng(5)
    return build_fit(joint, z, density, rng, {}, 200)


def inside(measured: Array, replicates: Array) -> Array:
    """Share of rows per channel with the measured value between the extreme ranks.

    A value exchangeable with n replicates has each of n + 1 ranks equally often.
    """
    n = len(replicates)
    cut = round(0.5 * (1.0 - INNER) * (n + 1))
    rank = (replicates < measured).sum(0)
    return np.asarray(((rank >= cut) & (rank <= n - cut)).mean(0))


def shares(found: Replicates) -> Array:
    """Shares inside of three body rates and three wheel rates."""
    return np.concatenate(
        [
            inside(found.measured_rate_rad_s, found.rate_rad_s),
            inside(found.measured_wheel_rpm, found.wheel_rpm),
        ]
    )


@pytest.mark.parametrize("place", range(2))
def test_measured_rows_lie_among_their_replicates(place: int) -> None:
    """On simulated telemetry nine tenths or more of all channels together, and of each of them.

    Three axes have noise of their own: together three binomial errors, and four for the worst of
    the twelve shares that the two events have.
    """
    found = replicated(rows()[place], np.random.default_rng(6))
    error = np.sqrt(INNER * (1.0 - INNER) / len(found.time_s))
    assert len(found.time_s) > 300
    # cut tails are drawn anew where the measured ones are fixed: replicates may be wider
    assert shares(found).mean() > INNER - 3.0 * error / np.sqrt(3.0)
    assert shares(found).min() > INNER - 4.0 * error


def test_replicates_without_noise_do_not_hold_the_measured_rows() -> None:
    """Negative control: the spread of the posterior alone is too narrow over all channels."""
    quiet = [
        replace(
            b,
            covariance=1e-4 * b.covariance,
            walk=0.0 * b.walk,
            scales=b.scales._replace(torque_n_m=0.0 * b.scales.torque_n_m),
        )
        for b in rows()
    ]
    for balance in quiet:
        assert shares(replicated(balance, np.random.default_rng(6))).mean() < 0.7


def test_replicates_of_a_weaker_thruster_branch_are_off() -> None:
    """Negative control: with delivered momentum three percent less the bias's rows lie outside."""
    weak = replace(rows()[0], predicted=0.97 * rows()[0].predicted)
    assert shares(replicated(weak, np.random.default_rng(6))).min() < 0.8


def test_each_channel_closes_the_same_balance() -> None:
    """Replicated rates with measured wheels, and the other way round, leave the same residual."""
    balance = rows()[0]
    found = replicated(balance, np.random.default_rng(6))
    rpm = 2.0 * np.pi / 60.0
    by_rate = (found.rate_rad_s - found.measured_rate_rad_s) @ np.swapaxes(balance.by_rate, 1, 2)
    moved = rpm * (found.wheel_rpm - found.measured_wheel_rpm)
    by_wheel = moved @ np.swapaxes(balance.by_wheel, 1, 2)
    assert by_rate == pytest.approx(by_wheel, abs=1e-9)
    assert by_rate.std() > 1e-3


def test_fit_holds_channels_with_units_times_and_origin(tmp_path: Path) -> None:
    """Both groups have them after writing and reading; measured ones are the file's own numbers."""
    path = tmp_path / "fit.nc"
    save_fit(fit(), path)
    groups = read_fit(path).groups
    predictive, observed = groups["posterior_predictive"], groups["observed_data"]
    for group in (predictive, observed):
        assert group["rate_rad_s"].attrs["units"] == "rad s-1"
        assert group["rwa_rpm"].attrs["units"] == "rpm"
        assert group["time_s"].attrs["units"] == "s"
        assert all(group[name].attrs["long_name"] for name in ("rate_rad_s", "rwa_rpm", "time_s"))
    assert predictive["rate_rad_s"].dims == ("replicate", "event", "sample", "axis")
    assert predictive.sizes["replicate"] == DRAWS
    assert predictive.sizes["sample"] <= REPLICATED_ROWS
    place = predictive["replicate_chain"] * 300 + predictive["replicate_draw"]
    assert place.values.tolist() == thinned_draws(600).tolist()
    for name in NAMES:
        csv = simulated() / name / "telemetry.csv"
        table = np.genfromtxt(csv, delimiter=",", names=True)
        own = observed.sel(event=name)
        used = np.isfinite(own["time_s"].values)
        at = np.searchsorted(table["time_s"], own["time_s"].values[used] - 1e-6)
        wheels = own["rwa_rpm"].sel(wheel="rwa4").values[used]
        assert wheels == pytest.approx(table["rwa4_rpm"][at], rel=1e-6)
        rates = own["rate_rad_s"].sel(axis="z").values[used]
        assert rates == pytest.approx(table["rate_z_rad_s"][at], rel=1e-6, abs=1e-12)


def test_replicates_cost_about_a_megabyte_per_event(tmp_path: Path) -> None:
    """What they add to fit.nc is bounded: draws times rows times six channels of four bytes."""
    with_channels, without = tmp_path / "with.nc", tmp_path / "without.nc"
    save_fit(fit(), with_channels)
    bare = {
        name: group.drop_dims("sample") if "sample" in group.dims else group
        for name, group in fit().groups.items()
    }
    save_fit(replace(fit(), groups=bare), without)
    added = with_channels.stat().st_size - without.stat().st_size
    assert 0 < added < 1.1 * len(NAMES) * DRAWS * REPLICATED_ROWS * 6 * 4


def test_a_fit_can_do_without() -> None:
    """Sweeps ask for quantities alone: the telemetry is not read again, and there is no channel."""
    joint, z = model(*NAMES), draws()[:, :5]
    rng = np.random.default_rng(5)
    found = build_fit(joint, z, np.zeros((2, 5)), rng, {}, 5, replicate_rows=False)
    assert "rate_rad_s" not in found.groups["posterior_predictive"]
