"""Readings of counters tell their step, and what commands are multiples of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from counter_cases import CYCLE_S, readings
from telemetry_cases import made_up_samples

from cassini_bayes.balance.statistics.counters import (
    counter_step,
    delivered_pulses,
    is_quantised,
)
from cassini_bayes.balance.statistics.preparation import prepare
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


@pytest.mark.parametrize("phase_s", [0.029, 0.096])
def test_readings_that_cut_pulses_of_whole_cycles_are_known(phase_s: float) -> None:
    """Rows out of step with control cycles: where they cut a pulse it has lasted for the same time.

    Counters in steps of 10 ms are then known to 2 ms everywhere. Control: pulses of any width, cut
    or not, are rounded; so are those of two widths, most of which are no whole cycles, and those of
    whole cycles among which some are of half a one, after which readings stay as they are.
    """
    rng = np.random.default_rng(5)
    cycles = np.cumsum(rng.integers(1, 5, (80, 2)), axis=0)
    cut = phase_s * (rng.random((80, 2)) < 0.3)
    true = np.concatenate([np.zeros((1, 2)), 0.125 * cycles + cut])
    pulses = np.concatenate([np.zeros((1, 2)), np.arange(1.0, 81.0)[:, None] * np.ones(2)])
    found = expected_on_times(np.round(true, 2), pulses, 0.01, 0.125)
    assert found.rounding == (KNOWN, KNOWN)
    assert np.abs(found.on_time_s - true).max() < 2e-3
    widths = np.concatenate([np.zeros((1, 2)), np.cumsum(rng.uniform(0.03, 0.3, (80, 2)), axis=0)])
    often = np.concatenate(
        [np.zeros((1, 2)), 0.125 * cycles + phase_s * (rng.random((80, 2)) < 0.8)]
    )
    two = np.searchsorted([10, 20], np.arange(80), side="right")[:, None]
    halves = np.concatenate([np.zeros((1, 2)), 0.125 * cycles + 0.0625 * two])
    halves[:, 1] = np.repeat(halves[::2, 1], 2)[:81]  # while the other one fires
    for other in (widths, often, halves):
        open_ = expected_on_times(np.round(other, 2), pulses, 0.01, 0.125)
        assert all(one.variance_s2 > 0.0 for one in open_.rounding)


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
    begun = count + (np.arange(60) % 8 == 3)[:, None]
    assert counter_step(width * count, begun) == 0.0
    found = expected_on_times(width * count, begun, counter_step(width * count, begun), 0.25)
    np.testing.assert_array_equal(found.on_time_s, width * count)
    assert found.rounding == (KNOWN,)
    other = np.round(np.cumsum(np.random.default_rng(4).uniform(0.0, 0.2, (60, 1)), axis=0), 2)
    both = np.hstack([width * count, other]), np.hstack([begun, np.arange(60.0)[:, None]])
    assert counter_step(*both) >= 0.005


def test_a_short_pulse_among_full_ones_is_seen_where_none_is_late() -> None:
    """Pulses of a cycle but for two shorter ones, rounded to cycles: a pulse seems to be missing.

    It is not one that has just begun, as it does not come with the next reading. Taken as exact,
    such counters made a moment of inertia 4 standard deviations too large.
    """
    widths = np.full(12, CYCLE_S)
    widths[[3, 7]] = 0.069, 0.103
    true = np.repeat(np.cumsum(np.r_[0.0, widths]), 2)[:, None]
    count = np.repeat(np.arange(13.0), 2)[:, None]
    read = CYCLE_S * np.round(true / CYCLE_S)
    assert read[-1, 0] == 11 * CYCLE_S
    assert counter_step(read, count) == CYCLE_S
    begun = count.copy()
    begun[15] += 1.0  # control: counted at this reading, fired by the next
    assert counter_step(CYCLE_S * count, begun) == 0.0


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


def test_a_pulse_that_begins_with_a_reading_is_counted_with_its_on_time() -> None:
    """None of its on-time is there yet: it comes with the next reading, and so does its count.

    A pulse that a reading cuts stays where it is, and one that never comes is counted as it was.
    """
    on_time = np.array([0.0, 0.03, 0.03, 0.31, 0.35, 0.40, 0.40])
    pulses = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 4.0, 5.0])
    other = np.array([0.0, 0.0, 0.0, 0.02, 0.02, 0.02, 0.02])
    both = np.stack([pulses, (other > 0.0).astype(np.float64)], 1)
    found = delivered_pulses(np.stack([on_time, other], 1), both, 0.001)
    assert found[:, 0].tolist() == [0.0, 1.0, 1.0, 3.0, 4.0, 4.0, 5.0]
    assert found[:, 1].tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]
    # one that shows no on-time when it should have: what fires later is none of it
    lost, later = np.array([0.0, 1.0, 1.0, 2.0])[:, None], np.array([0.0, 0.0, 0.0, 0.03])[:, None]
    assert delivered_pulses(later, lost, 0.001).tolist() == lost.tolist()


def test_pairs_of_pulses_are_those_of_a_firing_whose_first_begins_with_a_reading() -> None:
    """Two pulses of 31 and 250 ms, the first at a reading: one firing of two, and rows before it.

    Coarse counters are left as they are: their pulses may be shorter than a step.
    """
    for step, kept in ((0.001, [0.0, 0.0, 2.0]), (0.01, [0.0, 1.0, 2.0])):
        time = np.arange(400.0)
        pulses, on_time = np.zeros(400), np.zeros(400)
        for start in range(10, 380, 10):
            width = step * np.round((0.02 + 0.0004 * start) / step)
            pulses[start + 1 :] += 1.0
            on_time[start + 1 :] += width
        pulses[385:] += 1.0
        pulses[386:] += 1.0
        on_time[386:] += 0.28
        made = made_up_samples(np.random.default_rng(1), 400)
        chunk = replace(made, time_s=time, on_time_s=on_time[:, None], pulses=pulses[:, None])
        (told,) = prepare([chunk], CYCLE_S, 0.3).samples([chunk])
        begun = told.pulses[384:387, 0] - told.pulses[384, 0]
        assert begun.tolist() == kept
