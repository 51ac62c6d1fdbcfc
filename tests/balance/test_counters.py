"""Readings of counters tell their step, and what commands are multiples of."""

from __future__ import annotations

import numpy as np
import pytest
from counter_cases import CYCLE_S, readings

from cassini_bayes.balance.statistics.counters import (
    counter_step,
    is_quantised,
)
from cassini_bayes.balance.statistics.rounded_counters import KNOWN, expected_on_times
from cassini_bayes.computing.arrays import Array


def test_what_commands_are_made_of_is_told_by_all_thrusters() -> None:
    """A thruster of three firings looks like multiples of a cycle; the others show it is not."""
    widths = np.random.default_rng(7).uniform(0.06, 0.12, 60)
    shown, _, pulses = readings(widths, CYCLE_S)
    rare = np.minimum(pulses, 4.0)
    both = expected_on_times(
        np.hstack([shown, CYCLE_S * rare]), np.hstack([pulses, rare]), CYCLE_S, CYCLE_S
    )
    assert all(one.variance_s2 > 0.0 for one in both.rounding)


def test_a_step_is_told_from_the_readings() -> None:
    """Multiples of 10 ms, of a cycle, of nothing; few values tell nothing."""
    rng = np.random.default_rng(4)
    true = np.cumsum(rng.uniform(0.02, 0.2, 50))[:, None]
    count = np.arange(50.0)[:, None]
    assert counter_step(np.round(true, 2), count) == 0.01
    assert counter_step(np.round(true, 3), count) == 0.001
    assert counter_step(CYCLE_S * np.cumsum(1.0 + count % 3, axis=0), count) == CYCLE_S
    assert counter_step(true, count) == 0.0
    assert counter_step(count[:3], count[:3]) == 0.0


@pytest.mark.parametrize("width", [0.05, 0.1, 0.125, 0.3])
def test_pulses_of_one_width_are_no_steps(width: float) -> None:
    """Readings that are a width times the pulses are exact, also where one has just begun.

    A counter whose pulses all last 125 ms, in a control cycle of 250 ms, had been taken for one in
    steps of 125 ms: noise that is not there, and a lever arm 8.6 standard deviations off. Another
    thruster with pulses of any width says that the readings are rounded.
    """
    count = np.repeat(np.arange(30.0), 2)[:, None]
    begun = count + (np.arange(60) % 7 == 3)[:, None]
    assert counter_step(width * count, begun) == 0.0
    found = expected_on_times(width * count, begun, counter_step(width * count, begun), 0.25)
    np.testing.assert_array_equal(found.on_time_s, width * count)
    assert found.rounding == (KNOWN,)
    other = np.round(np.cumsum(np.random.default_rng(4).uniform(0.0, 0.2, (60, 1)), axis=0), 2)
    both = np.hstack([width * count, other]), np.hstack([begun, np.arange(60.0)[:, None]])
    assert counter_step(*both) >= 0.005


def test_other_widths_are_not_taken_for_multiples() -> None:
    """Negative control: widths of any size are no multiples, nor is a step that tells nothing.

    Long pulses do not make up for short ones.
    """
    rng = np.random.default_rng(5)

    def quantised(widths: Array, step: float) -> bool:
        shown, _, pulses = readings(widths, step)
        return is_quantised(shown[:, 0], pulses[:, 0], step, CYCLE_S)

    widths = rng.uniform(0.02, 0.125, 30)
    assert not quantised(widths, 0.01)
    assert not quantised(widths, CYCLE_S)
    assert not quantised(np.where(np.arange(30) % 3 == 0, 8 * CYCLE_S, 0.06), CYCLE_S)
    assert not quantised(np.full(30, CYCLE_S), 0.1)
    endless = np.cumsum(np.full(30, 0.06))[:, None]
    counted = 1.0 + np.arange(30.0)
    assert not is_quantised(CYCLE_S * np.round(endless[:, 0] / CYCLE_S), counted, CYCLE_S, CYCLE_S)
    assert quantised(np.full(30, CYCLE_S), 0.01)
    assert quantised(np.full(30, CYCLE_S), CYCLE_S)
