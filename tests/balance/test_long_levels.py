"""Roundings that last long are unknowns of their own: they hide no more than they are."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from telemetry_cases import made_up_samples, reduced, telemetry_priors

from cassini_bayes.balance.open_counters import short_levels
from cassini_bayes.balance.statistics.counters import counter_step
from cassini_bayes.balance.statistics.long_levels import (
    NO_LEVELS,
    Levels,
    level_patterns,
    longest,
)
from cassini_bayes.balance.statistics.preparation import prepare
from cassini_bayes.computing.arrays import Array

STEP_S = 1e-2
SIGMA_S = STEP_S / np.sqrt(12.0)


def levels_of(end_s: Array, fired: Array) -> Levels:
    """Couples of long pulses of unlike widths, that fired at these times."""
    couples = fired.shape[1]
    slopes = np.ones((*fired.shape, 1)) * np.eye(1, 4)
    ratio = np.full(fired.shape, np.inf)
    square, every = np.full(couples, SIGMA_S**2), np.ones(couples)
    return Levels(end_s, fired, slopes, square, ratio, every)


def test_the_longest_levels_are_found() -> None:
    """A couple that fires at 3, 7, 13 and 31 s of 80: what it shows from 13 s on lasts 18 and 49 s.

    Roots of 3, 4, 6, 18 and 49 s have the median 2.4 s^½, and 1.5 times that is reached by two. The
    other couple never fires: what it shows all the time is no rounding but a constant.
    """
    end_s = np.array([3.0, 7.0, 13.0, 31.0])
    found = longest(levels_of(end_s, np.array([[True, False]] * 4)), 80.0)
    assert found.couples == (0, 0)
    assert found.begin_s == pytest.approx([13.0, 31.0])
    values = found.at(np.array([0.0, 12.0, 13.0, 31.0, 50.0]))
    shown = np.array([[0, 0, 1, 0, 0], [0, 0, 0, 1, 1]]).T
    np.testing.assert_allclose(values, SIGMA_S * shown, atol=1e-12)
    alike = longest(levels_of(20.0 * np.arange(1.0, 4.0), np.ones((3, 1), dtype=bool)), 80.0)
    assert alike.couples == ()


def test_a_drift_is_told_nearly_as_well_as_with_every_level_known() -> None:
    """Variance of a drift's size beside roundings: all noise of bands, long ones unknown, exact.

    One couple fires every 8 s for 20 minutes, another seven times, so that its levels last minutes.
    Control: all levels as noise of bands.
    """
    rows = np.arange(1_200.0)
    seldom = np.array([100.0, 340.0, 420.0, 700.0, 740.0, 900.0, 1_100.0])
    end_s = np.sort(np.concatenate([np.arange(8.0, 1_200.0, 8.0) + 0.5, seldom]))
    fired = np.stack([~np.isin(end_s, seldom), np.isin(end_s, seldom)], axis=1)
    known = levels_of(end_s, fired)
    step = (rows[:, None] >= end_s).astype(float)
    always = np.ones((len(rows), 1))
    every = np.concatenate([level_patterns(known, g, step, always)[:, 0] for g in (0, 1)], axis=1)
    long = longest(known, 1_200.0).at(rows)
    assert 2 < long.shape[1] < 12
    drift = rows / 1_200.0
    constant, white = 10.0 * always, 3e-3
    waves = np.cos(np.pi * np.outer((rows + 0.5) / 1_200.0, np.arange(1_200)))
    waves /= np.linalg.norm(waves, axis=0)

    def spread(unknown: Array, noise: Array) -> float:
        """Standard deviation of the drift: columns of unknowns, and variances by mode."""
        columns = waves.T @ np.concatenate([constant, unknown], axis=1)
        signal = waves.T @ drift / np.sqrt(noise)
        columns = columns / np.sqrt(noise)[:, None]
        taken = np.linalg.solve(columns.T @ columns + np.eye(columns.shape[1]), columns.T @ signal)
        return float((signal @ signal - signal @ columns @ taken) ** -0.5)

    def of_bands(patterns: Array) -> Array:
        squares, noise = ((waves.T @ patterns) ** 2).sum(axis=1), np.full(1_200, white**2)
        for start, stop in pairwise([0, 1, 2, 4, 8, 16, 32, 128, 512, 1_200]):
            noise[start:stop] += squares[start:stop].mean()
        return noise

    begin = [np.abs(every - column[:, None]).max(axis=0).argmin() for column in long.T]
    short = np.delete(every, begin, axis=1)
    exact = spread(every, np.full(1_200, white**2))
    found, banded = spread(long, of_bands(short)), spread(every[:, :0], of_bands(every))
    assert exact < found < 1.1 * exact
    assert banded > 1.3 * exact


def test_a_reduction_has_long_levels_where_steps_are_coarse() -> None:
    """Columns for them, none of them in the bands' patterns; and none with steps of 1 ms."""
    samples = made_up_samples(np.random.default_rng(3), 300, firing=0.03)
    on_time, pulses = samples.on_time_s, samples.pulses
    assert counter_step(on_time, pulses) > 3e-3
    found = prepare([samples], 0.125, 0.5).found
    statistics, _ = reduced(samples, telemetry_priors(), prepared=found)
    counters = statistics.counters
    assert len(statistics.layout.levels) == len(counters.level_begin_s) > 0
    time = counters.row_time_s
    step = (time[:, None] >= counters.end_s).astype(float)
    left = [
        short_levels(counters, g, step, np.ones((len(time), 1)))[:, 0]
        for g in range(counters.fired.shape[1])
    ]
    of_couples = np.bincount(counters.level_couple, minlength=len(left))
    gone = [int((~own.any(axis=0)).sum()) for own in left]
    assert gone == of_couples.tolist()
    fine = prepare([samples], 0.125, 0.5).found
    known, _ = reduced(samples, telemetry_priors())
    assert fine.rounding
    assert known.layout.levels == NO_LEVELS.couples == ()
