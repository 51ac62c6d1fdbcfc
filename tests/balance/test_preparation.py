"""A first look at telemetry: after how long a pulse may follow another, and steps of channels.

And what readings it takes: both counters in one row, and none after the last.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cassini_bayes.balance.statistics.counters import are_rarely_cut, single_widths
from cassini_bayes.balance.statistics.preparation import (
    LEAST_ALONE,
    QUANTILES,
    begin_with_cycles,
    channel_step,
    close_gaps,
    paired_widths,
    prepare,
)
from cassini_bayes.balance.statistics.rounded_counters import expected_on_times
from cassini_bayes.balance.statistics.rows import Samples
from cassini_bayes.computing.arrays import Array

CYCLE_S = 0.125


def counted(widths: Array) -> tuple[Array, Array]:
    """Cumulative on-time and pulses (m, 1): one pulse in every third interval."""
    on_time, pulses = np.zeros((2, 3 * len(widths) + 1, 1))
    places = 3 * np.arange(len(widths)) + 1
    on_time[places, 0], pulses[places, 0] = widths, 1.0
    return np.cumsum(on_time, axis=0), np.cumsum(pulses, axis=0)


@pytest.mark.parametrize("cycles", [1, 3])
@pytest.mark.parametrize("step", [0.0, 0.01])
def test_pulses_of_whole_cycles_leave_a_cycle(cycles: int, step: float) -> None:
    """Their successors come a cycle later, also where rounding moves a width by a step."""
    on_time, pulses = counted(np.full(40, cycles * CYCLE_S))
    shown = step * np.round(on_time / step) if step else on_time
    assert close_gaps(single_widths(shown, shown, pulses), step, CYCLE_S) == pytest.approx(
        [CYCLE_S] * QUANTILES
    )


def test_short_pulses_leave_what_remains_of_their_cycle() -> None:
    """Widths of 20 to 100 ms, evenly: gaps of 25 to 105 ms, evenly; those in company say nothing.

    Two pulses in one interval and a pulse right after another are no single pulses.
    """
    widths = np.linspace(0.02, 0.1, 200)
    on_time, pulses = counted(widths)
    found = close_gaps(single_widths(on_time, on_time, pulses), 0.001, CYCLE_S)
    expected = np.quantile(CYCLE_S - widths, (np.arange(QUANTILES) + 0.5) / QUANTILES)
    assert found == pytest.approx(expected, abs=1e-3)
    company = on_time + 0.01 * np.arange(len(on_time))[:, None]
    assert close_gaps(single_widths(company, company, pulses), 0.001, CYCLE_S) == ()


def test_pulses_that_readings_hardly_ever_cut_are_single_in_company() -> None:
    """A thruster with 50 ms in nearly every interval, another with 62 ms in every third.

    Of readings that cut no pulse all count that are alone in their interval, but those that begin
    with its end and have no on-time yet. (With those of the second thruster alone, 50 ms were
    too short for any pulse of the event, and two of them were taken to last anything.) Where one
    pulse in twenty runs on into the next interval, only those count that stand alone.
    """
    other, pulses_of_other = counted(np.full(40, 0.062))
    fires = (np.arange(len(other)) % 9 > 0).astype(float)
    steady = np.cumsum(0.05 * fires)[:, None]
    on_time = np.hstack([steady, other])
    pulses = np.hstack([np.cumsum(fires)[:, None], pulses_of_other])
    assert are_rarely_cut(on_time, pulses)
    found = single_widths(on_time, on_time, pulses)
    assert np.unique(found.round(6)) == pytest.approx([0.05, 0.062])
    begins = on_time.copy()
    begins[11, 0] = begins[10, 0]  # counted, and fired after the reading
    later = single_widths(begins, begins, pulses)
    assert np.unique(later.round(6)) == pytest.approx([0.05, 0.062, 0.1])
    cut = on_time.copy()
    cut[8::18, 0] -= 0.03  # what is left comes in an interval in which no pulse begins
    assert not are_rarely_cut(cut, pulses)
    alone = single_widths(cut, cut, pulses)
    assert np.unique(alone.round(6)) == pytest.approx([0.062])


def test_no_width_is_below_zero() -> None:
    """Pulses of 5 and 200 ms on steps of 0.1 s: what is expected of some of them is, by itself."""
    widths = np.random.default_rng(1).choice([0.005, 0.2], 400)
    on_time, pulses = counted(widths)
    shown = 0.1 * np.round(on_time / 0.1)
    expected = expected_on_times(shown, pulses, 0.1, CYCLE_S).on_time_s
    assert np.diff(expected, axis=0).min() < 0.0
    assert single_widths(expected, shown, pulses).min() == 0.0


def test_pulses_of_pairs_have_the_mean_width_of_their_firing() -> None:
    """Twenty pulses of 60 ms and ten twins of 70 ms together: half of all are 35 ms, half 60."""
    widths = np.r_[np.full(20, 0.06), np.full(10, 0.07)]
    on_time, pulses = counted(widths)
    twins = np.cumsum(
        np.diff(pulses, axis=0, prepend=0.0) * (1.0 + (np.arange(91) > 60)[:, None]), axis=0
    )
    found = paired_widths(on_time, twins)
    assert found == pytest.approx([0.035] * (QUANTILES // 2) + [0.06] * (QUANTILES // 2))
    assert paired_widths(on_time[:1], twins[:1]) == ()


def test_few_pulses_and_unknown_cycles_say_nothing() -> None:
    """Then the likelihood takes a control cycle."""
    on_time, pulses = counted(np.full(LEAST_ALONE - 1, 0.05))
    assert close_gaps(single_widths(on_time, on_time, pulses), 0.001, CYCLE_S) == ()
    on_time, pulses = counted(np.full(40, 0.05))
    assert close_gaps(single_widths(on_time, on_time, pulses), 0.001, 0.0) == ()


def test_few_values_one_step_apart_tell_the_step() -> None:
    """Wheels that rest between two printed values of 1 rpm, in a quiescent event.

    Constant readings tell no step, and neither do values that are no multiples of their difference.
    """
    rest = np.array([[96.0, -383.0, -528.0]] * 40)
    rest[::3, 0] += 1.0
    rest[7, 2] -= 1.0
    assert channel_step(rest) == pytest.approx(1.0)
    assert channel_step(0.05 * rest) == pytest.approx(0.05)
    assert channel_step(rest[1:3]) == 0.0
    assert channel_step(rest + 0.3) == 0.0
    assert channel_step(1.7 * rest) == 0.0


@pytest.mark.parametrize("step", [0.001, 0.01])
@pytest.mark.parametrize("phase_s", [0.0, 0.062])
def test_readings_that_cut_pulses_tell_whether_they_begin_with_cycles(
    step: float, phase_s: float
) -> None:
    """Begun with control cycles or at any millisecond: some ten of 300 pulses are cut, and say so.

    Close pulses then follow at any time in what is left of the cycle. Where none is cut nothing
    speaks against cycles.
    """
    rng = np.random.default_rng(11)
    time_s = np.arange(1200.0)
    for with_cycles in (True, False):
        begins = np.sort(rng.choice(9_000, 300, replace=False)) * CYCLE_S + phase_s
        if not with_cycles:
            begins = begins + rng.uniform(0.0, CYCLE_S, 300)
        widths = rng.uniform(0.03, 0.12, 300)
        on = np.clip(time_s[:, None] - begins, 0.0, widths).sum(axis=1)[:, None]
        pulses = (time_s[:, None] >= begins).sum(axis=1)[:, None].astype(float)
        shown = step * np.round(on / step)
        assert begin_with_cycles(time_s, shown, pulses, step, CYCLE_S) is with_cycles
        assert begin_with_cycles(time_s[:50], shown[:50], pulses[:50], step, CYCLE_S)
    usual = np.array(close_gaps(widths, step, CYCLE_S))
    free = np.array(close_gaps(widths, step, CYCLE_S, with_cycles=False))
    assert free.mean() == pytest.approx(0.5 * usual.mean(), rel=0.05)


def restless(rows: int, every: int) -> Samples:
    """Rows every second and counters ``every`` so many, between all of which a thruster fires."""
    rng, time_s = np.random.default_rng(4), np.arange(float(rows))
    pulses = np.cumsum(np.arange(rows) % every == every // 2).astype(float)[:, None]
    on_time = np.cumsum(rng.uniform(0.05, 0.1, rows)[:, None] * np.diff(pulses, axis=0, prepend=0))
    counters = np.stack([on_time[:, None], pulses])
    counters[:, time_s % every != 0.0] = np.nan
    level = np.tile([0.0, 0.0, 0.0, 1.0], (rows, 1))
    rate, wheel = 2e-5 * rng.standard_normal((2, rows, 3))
    return Samples(time_s, level, rate, wheel, *counters)


@pytest.mark.parametrize("after", [1, 8, 400])
def test_after_the_last_reading_nothing_is_known(after: int) -> None:
    """Thrusters may fire in rows that follow it: they are no rows between firings.

    All but the first 800 rows come after it. Counted as quiet they would be more than a tenth of
    the rows at readings, and means over rows with late pulses would not be taken.
    """
    samples = restless(800 + after, 10)
    samples.on_time_s[800:] = samples.pulses[800:] = np.nan
    found = prepare([samples], CYCLE_S, 0.5).found
    alone = prepare([samples.part(0, 791)], CYCLE_S, 0.5).found
    assert found.late == alone.late
    assert found.late.block_s > 0.0
    assert found.noise.rate_rad_s == alone.noise.rate_rad_s == 0.0


@pytest.mark.parametrize("more", ["on_time_s", "pulses"])
def test_readings_are_rows_with_both_counters(more: str) -> None:
    """One of them in every row, the other in every second: what is read is every second row."""
    samples, scarce = restless(600, 1), restless(600, 1)
    scarce.on_time_s[1::2] = scarce.pulses[1::2] = np.nan
    mixed = replace(scarce, **{more: getattr(samples, more)})
    one, other = (prepare([own], CYCLE_S, 0.5) for own in (scarce, mixed))
    assert np.array_equal(one.found.read_s, other.found.read_s)
    assert np.array_equal(one.found.pulses, other.found.pulses)
    (seen,) = other.samples([mixed])
    assert np.array_equal(seen.has_counters, scarce.has_counters)
    assert len(one.found.read_s) == 300
