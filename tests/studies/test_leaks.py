"""Leak monitors: odds that are a plain normal's, names by polarity, a campaign that goes on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal
from study_cases import study_in

from cassini_bayes.balance.statistics import Samples
from cassini_bayes.errors import InputError
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.spacecraft import lever_arms
from cassini_bayes.studies import leak_trials
from cassini_bayes.studies.leak_attitudes import (
    LEVER_M,
    MomentumNoise,
    least_leak_n,
    separation_sigma,
)
from cassini_bayes.studies.leak_campaign import MONITORS, by_size, compare_leak_monitors, judged
from cassini_bayes.studies.leak_monitors import (
    HALF_ROWS,
    ROWS_EVERY_S,
    SIZES_N,
    STARTS_EVERY_S,
    Odds,
    Residual,
    Track,
    alarm_row,
    residual_of,
    stretches,
    threshold_track,
)
from cassini_bayes.studies.leak_trials import (
    MOST_ROWS,
    LeakTrials,
    Trial,
    padded,
    trials_of,
)

Array = NDArray[np.float64]
SCENARIO = Path("runs/scenarios/calibration.toml")
PRIORS = Path("priors/cassini_b_branch_telemetry.toml")
NAMES = ("z1", "z2", "z3", "z4", "y1", "y2", "y3", "y4")


@cache
def arms() -> Array:
    """Torque per newton of the B branch at the prior means."""
    priors = read_priors(PRIORS)
    means = {name: prior.mean for name, prior in priors.parameters.items()}
    return np.asarray(lever_arms(priors.spacecraft, "B", means))


def made_up(leak_n: float = 0.0, thruster: int = 0, rows: int = 12) -> Residual:
    """A residual of white noise, of the first row's and of a leak from 40 s on."""
    rng = np.random.default_rng(2)
    time = 10.0 * np.arange(rows, dtype=np.float64)
    shared = np.eye(rows) + 0.5 + 1e-3 * np.minimum(time[:, None], time)
    covariance = np.asarray(np.kron(shared, np.diag([1e-4, 2e-4, 5e-5])), dtype=np.float64)
    momentum = (np.linalg.cholesky(covariance) @ rng.standard_normal(3 * rows)).reshape(rows, 3)
    leak = leak_n * np.maximum(time - 40.0, 0.0)[:, None] * arms()[:, thruster]
    return Residual(time, momentum + leak, covariance, arms(), NAMES)


def test_odds_of_the_first_rows_are_those_of_a_shorter_event() -> None:
    """At every row the Bayes factor is a ratio of plain normal densities of the rows so far."""
    residual = made_up(2e-3, 3)
    found = Odds(residual).log_bayes_factor
    starts = np.arange(0.0, residual.time_s[-1], STARTS_EVERY_S)
    for rows in (1, 5, len(residual.time_s)):
        covariance = residual.covariance[: 3 * rows, : 3 * rows]
        data = residual.momentum_n_m_s[:rows].ravel()
        none = multivariate_normal.logpdf(data, np.zeros(3 * rows), covariance)
        for k in (0, 3, 6):
            ratios = [
                multivariate_normal.logpdf(
                    data,
                    (
                        size
                        * np.maximum(residual.time_s[:rows] - start, 0.0)[:, None]
                        * residual.arms_m[:, k]
                    ).ravel(),
                    covariance,
                )
                - none
                for size in SIZES_N
                for start in starts
            ]
            assert found[rows - 1, k] == pytest.approx(np.log(np.mean(np.exp(ratios))), abs=1e-8)


@pytest.mark.parametrize("thruster", range(8))
def test_both_monitors_name_every_thruster(thruster: int) -> None:
    """A leak far above the noise is named by its polarity, and by the odds."""
    residual = made_up(5e-3, thruster, rows=40)
    assert Odds(residual).track().thruster[-1] == thruster
    track = threshold_track(residual, 100.0)
    assert track.thruster[-1] == thruster
    gained = residual.momentum_n_m_s[-1] - residual.momentum_n_m_s[-11]
    assert track.statistic[-1] == pytest.approx(np.linalg.norm(gained))


def test_an_alarm_needs_rows_in_a_row() -> None:
    """Two rows above the threshold are no alarm where three are asked for."""
    statistic = np.array([0.0, 5.0, 5.0, 0.0, 5.0, 5.0, 5.0, 5.0])
    assert alarm_row(statistic, 1.0, 1) == 1
    assert alarm_row(statistic, 1.0, 3) == 6
    assert alarm_row(statistic, 1.0, 5) is None


def test_the_residual_is_as_wide_as_it_says() -> None:
    """Whitened, the residual of flown events without a leak has χ²/n near one; a leak is seen."""
    campaign = LeakTrials(SCENARIO, PRIORS, seed=20_050_128)
    squares = []
    seen: list[Residual] = []

    def kept(*arguments: object) -> Residual:
        seen.append(residual_of(*arguments))  # type: ignore[arg-type]
        return seen[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(leak_trials, "residual_of", kept)
        found = [campaign.repetition(index) for index in (7, 8, 9)]
    flown = trials_of({key: np.stack([one[key] for one in found]) for key in found[0]})
    for trial, residual in zip(flown, seen, strict=True):
        assert trial.thruster == -1
        lower = np.linalg.cholesky(residual.covariance)
        squares.append(np.linalg.solve(lower, residual.momentum_n_m_s.ravel()) ** 2)
        assert trial.tracks[0].statistic.max() < 3.0
        np.testing.assert_allclose(trial.time_s, residual.first_s + residual.time_s)
        assert residual.first_s >= HALF_ROWS  # rows of a stretch lie before its middle
    assert 0.75 < np.concatenate(squares).mean() < 1.25


def test_a_turn_tells_a_leak_from_every_inertial_torque() -> None:
    """σ is what the likest constant torque and start in three axes leave of a leak that turns."""
    noise, turn = MomentumNoise(0.02, 2e-4), np.radians(40.0)
    time = np.arange(0.0, 1500.1, ROWS_EVERY_S)
    before = np.array([3e-4, 1e-4, 0.0])
    after = Rotation.from_rotvec([0.0, 0.0, turn]).apply(before)
    momentum = np.minimum(time, 900.0)[:, None] * before
    momentum = momentum + np.maximum(time - 900.0, 0.0)[:, None] * after
    covariance = 0.02**2 * np.eye(len(time)) + 2e-4**2 * np.minimum(time[:, None], time)
    precision = np.linalg.inv(np.kron(covariance, np.eye(3)))
    free = np.kron(np.stack([np.ones_like(time), time], axis=1), np.eye(3))
    fitted = np.linalg.solve(free.T @ precision @ free, free.T @ precision @ momentum.ravel())
    left = momentum.ravel() - free @ fitted
    expected = np.sqrt(left @ precision @ left)
    found = separation_sigma(float(np.linalg.norm(before)), turn, 900.0, 600.0, noise)
    assert found == pytest.approx(expected, rel=1e-6)
    assert separation_sigma(1.0, 0.0, 900.0, 600.0, noise) == 0.0  # one attitude: alike
    least = least_leak_n(turn, 900.0, noise)
    assert separation_sigma(LEVER_M * least, turn, 900.0, 900.0, noise) == pytest.approx(5.0)


def test_rates_of_stretches_are_mean_rates_over_rows_at_rest() -> None:
    """A steady turn comes out exactly, a wheel's ramp at its middle; no stretch holds a pulse."""
    time = np.arange(200.0)
    spin = np.array([2e-4, -1e-4, 3e-4])
    attitude = Rotation.from_rotvec(time[:, None] * spin).as_quat()
    fired = np.floor(time / 25.0) * 0.125
    samples = Samples(
        time,
        attitude,
        np.full((200, 3), np.nan),
        np.stack([50.0 + 0.2 * time], axis=1),
        fired[:, None],
        (fired / 0.125)[:, None],
    )
    still = stretches(samples, 0.5)
    np.testing.assert_allclose(still.rate_rad_s, np.tile(spin, (len(still.rows), 1)), atol=1e-12)
    np.testing.assert_allclose(still.wheel_rad_s[:, 0], 50.0 + 0.2 * still.time_s, atol=1e-9)
    assert still.rate_per_rad == pytest.approx(np.sqrt(2.0) / (2 * HALF_ROWS))
    assert np.diff(still.time_s).min() > 1.0
    assert np.all(fired[still.rows - HALF_ROWS] == fired[still.rows + HALF_ROWS])
    with pytest.raises(InputError, match="stretches of 7 rows at rest"):
        stretches(samples, 30.0)


def synthetic(index: int) -> Trial:
    """A trial without a flight: leaks raise the odds tenfold above the noise, and the residual."""
    rng = np.random.default_rng(index)
    time = 10.0 * np.arange(30, dtype=np.float64)
    thruster = index % 8 if index % 10 < 7 else -1
    size = 10.0 ** rng.uniform(-5, -2.4) if thruster >= 0 else 0.0
    rise = np.where(time > 100.0, 2e4 * size, 0.0)
    tracks = tuple(
        Track(rng.uniform(0, 1, 30) + share * rise, np.full(30, max(thruster, 0)))
        for share in (1.0, 0.1, 0.1, 0.1)
    )
    return Trial(size, thruster, 100.0, time, tracks)


def test_padded_trials_come_back() -> None:
    """Rows, thrusters and statistics are those that went in; more rows than fit are refused."""
    flown = [synthetic(index) for index in range(10)]
    arrays = [padded(trial) for trial in flown]
    back = trials_of({key: np.stack([one[key] for one in arrays]) for key in arrays[0]})
    for before, after in zip(flown, back, strict=True):
        assert (before.leak_n, before.thruster) == (after.leak_n, after.thruster)
        np.testing.assert_array_equal(before.time_s, after.time_s)
        for old, new in zip(before.tracks, after.tracks, strict=True):
            np.testing.assert_array_equal(old.statistic, new.statistic)
            np.testing.assert_array_equal(old.thruster, new.thruster)
    with pytest.raises(InputError, match="rows at rest"):
        padded(replace(flown[0], time_s=np.arange(MOST_ROWS + 1.0)))


def test_a_study_of_leaks_writes_its_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven of ten biases get a leak; the page names every monitor and has table and figure."""
    asked: list[bool] = []

    def flown(_priors: object, _document: object, leaks: bool, rng: np.random.Generator) -> Trial:
        asked.append(leaks)
        return synthetic(int(rng.integers(7)) if leaks else 7)

    monkeypatch.setattr(leak_trials, "fly_trial", flown)
    study = study_in(tmp_path, tmp_path / "leaks.md")
    compare_leak_monitors(study, SCENARIO, PRIORS, {"trials": 40}, calibrated=True)
    assert asked == [index % 10 < 7 for index in range(40)]
    text = study.page.read_text(encoding="utf-8")
    assert text.startswith("# Leaks with calibrated thrusters\n\nWhich monitor finds")
    assert "28 wheel biases with a leak and 1" in text
    assert all(monitor.label in text for monitor in MONITORS)
    assert {path.name for path in tmp_path.glob("leaks.*")} == {
        "leaks.md",
        "leaks.csv",
        "leaks.png",
    }
    assert (tmp_path / "leaks-torque.png").exists()


def test_false_alarms_set_the_thresholds() -> None:
    """Half of the quiet events set them, the rest has the asked rate; stronger odds find more."""
    flown = [synthetic(index) for index in range(400)]
    table = judged(flown)
    assert set(table["monitor"]) == {monitor.label for monitor in MONITORS}
    assert table["false_alarms"].max() < 0.2
    found = table.groupby("monitor", observed=True)["found"].mean()
    assert found["sequential odds, 1 row"] > found["threshold, 200 s, 1 row"] + 0.1
    assert by_size(table)["leaks"].sum() == len(table)
