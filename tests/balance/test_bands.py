"""Bands of rows and of turns: the noise that each is said to have is the one it has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from telemetry_cases import made_up_samples, reduced, telemetry_priors

from cassini_bayes.balance.bands import make_bands, rounded_slopes, turn_bands
from cassini_bayes.balance.rounded_wheels import coherent_shares
from cassini_bayes.balance.statistics.turns import slope_weights


def test_summed_noise_of_unlike_pieces_is_that_of_every_band() -> None:
    """White rates summed over pieces of 2 to 16 rows: mean squares of slopes, band by band.

    Slow modes weigh long pieces most. Control: the mean over all pieces is half of it and less.
    """
    noise, squares, stated = 1e-5 / 30.0, [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        lengths = rng.permutation([2, 2, 2, 3, 3, 4, 4, 8, 16] * 2)
        time = np.concatenate([40.0 * i + np.arange(m) for i, m in enumerate(lengths)])
        samples = made_up_samples(rng, len(time), fires=False, wander=30.0 * noise)
        statistics, _ = reduced(replace(samples, time_s=time), telemetry_priors())
        bands, products, _ = turn_bands(statistics)
        grams = products.of(np.arange(statistics.gram.shape[-1])[statistics.layout.rate])
        rates = np.diagonal(grams[:, 0, 0], axis1=1, axis2=2)
        contrasts = np.array([band.contrasts for band in bands])
        squares.append(rates.mean(axis=1) / contrasts / noise**2)
        stated.append([band.summed_s2 for band in bands])
        over_all = statistics.turns.slope_summed_s2.mean()
    found, expected = np.mean(squares, axis=0), np.mean(stated, axis=0)
    # three axes and forty repetitions: four standard errors of a mean square
    scatter = 4.0 * np.sqrt(2.0 / (120.0 * contrasts))
    assert np.all(np.abs(found / expected - 1.0) < scatter)
    assert over_all < 0.6 * found[0]


def test_what_no_mode_has_of_a_random_walk_is_on_the_rows_left() -> None:
    """Mean square of simulated walks beyond all modes, per row left."""
    rng = np.random.default_rng(20261129)
    statistics, _ = reduced(made_up_samples(rng, 600, fires=False), telemetry_priors())
    _, fast, *_ = make_bands(statistics)
    rest, rows = fast[-1], statistics.rows
    modes, time = rows - rest.rows, statistics.counters.row_time_s
    basis = np.linalg.qr(np.cos(np.pi * np.outer(time, np.arange(modes)) / statistics.duration_s))
    steps = np.sqrt(np.diff(time, prepend=0.0))[:, None]
    walks = np.cumsum(steps * rng.standard_normal((rows, 400)), axis=0)
    left = walks - basis[0] @ (basis[0].T @ walks)
    found = np.sum(left**2) / (400 * rest.rows)
    # 400 times 300 squares, the slowest of which have a tenth of the sum: 1 % at most
    assert rest.walk[0] == pytest.approx(found, rel=0.04)
    assert 0.5 * rest.walk[0] < 0.9 * found < found < 0.9 * 2.0 * rest.walk[0]


DRIFTS = (0.0, 0.011, 0.047)  # steps a second: at rest, one in three pieces, three in two


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_roundings_of_slow_wheels_last_as_long_as_they_stay(noise: float) -> None:
    """Slopes of 32 s and rates printed in whole steps: mean squares of what is printed wrongly.

    Of a wheel at rest on the slowest modes and on the others, of those that move over all. Control:
    rounding that is another in every row has less than half of it, of a wheel at rest and of one
    that takes three pieces for a step.
    """
    rng = np.random.default_rng(20261124)
    turns = reduced(made_up_samples(rng, 70), telemetry_priors())[0].turns
    pieces, repetitions, time = 32, 300, np.arange(33.0)
    weights = slope_weights(time)
    waves = np.cos(np.pi * np.outer((np.arange(pieces) + 0.5) / pieces, np.arange(pieces)))
    waves /= np.linalg.norm(waves, axis=0)
    sizes, ramp = np.tile([len(time), time[-1]], (pieces, 1)), time - time.mean()
    begins = 33.0 * np.arange(pieces)[:, None]
    share = coherent_shares(np.array([noise]))[0]
    white = (noise**2 + (1.0 - share.sum()) / 12.0) * weights @ weights
    found, stated = np.zeros((2, pieces, len(DRIFTS)))
    for _ in range(repetitions):
        rates = rng.uniform(size=3) + np.multiply.outer(begins + time, DRIFTS)  # (p, m, W)
        shown = np.round(rates + noise * rng.standard_normal(rates.shape))
        slopes = np.einsum("pmw,m->pw", shown - rates, weights)
        lines = [shown.mean(axis=1), np.einsum("pmw,m->pw", shown, ramp) / (ramp @ ramp)]
        own = replace(turns, slope_stride=1, slope_shown=np.concatenate([sizes, *lines], axis=1))
        squares = np.tensordot(share, rounded_slopes(own, waves, 1.0)[0], (0, 1)) / 12.0
        found += (waves.T @ slopes) ** 2 / repetitions
        stated += (squares + white) / repetitions
    # a mean of 300 squares on eight modes, most of it on the first, has a standard error of 8 %
    for modes in (slice(0, 8), slice(8, None)):
        assert stated[modes, 0].mean() == pytest.approx(found[modes, 0].mean(), rel=0.25)
    # lines through single treads of a staircase are too flat: what moves lasts up to half too much
    assert stated.mean(axis=0) == pytest.approx(found.mean(axis=0), rel=0.5)
    alone = (noise**2 + 1.0 / 12.0) * weights @ weights
    assert alone < 0.5 * found.mean(axis=0)[:2].min()
