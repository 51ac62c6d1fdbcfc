"""Bands of rows and of turns: the noise that each is said to have is the one it has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from telemetry_cases import made_up_samples, reduced, telemetry_priors

from cassini_bayes.balance.bands import turn_bands


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
        bands, grams, _ = turn_bands(statistics)
        rates = np.diagonal(grams[:, 0, 0], axis1=1, axis2=2)[:, statistics.layout.rate]
        contrasts = np.array([band.contrasts for band in bands])
        squares.append(rates.mean(axis=1) / contrasts / noise**2)
        stated.append([band.summed_s2 for band in bands])
        over_all = statistics.turns.slope_summed_s2.mean()
    found, expected = np.mean(squares, axis=0), np.mean(stated, axis=0)
    # three axes and forty repetitions: four standard errors of a mean square
    scatter = 4.0 * np.sqrt(2.0 / (120.0 * contrasts))
    assert np.all(np.abs(found / expected - 1.0) < scatter)
    assert over_all < 0.6 * found[0]
