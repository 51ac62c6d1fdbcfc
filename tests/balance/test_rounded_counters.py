"""Rounded counters give back the on-times that were commanded, as well as can be known."""

from __future__ import annotations

import numpy as np
import pytest
from counter_cases import CYCLE_S, readings

from cassini_bayes.balance.statistics.counters import single_widths
from cassini_bayes.balance.statistics.rounded_counters import (
    KNOWN,
    Rounding,
    expected_on_times,
    kinds_of,
    read_levels,
)
from cassini_bayes.computing.arrays import Array


def test_runs_that_show_nothing_are_not_lost() -> None:
    """Pulses of 60 to 120 ms on counters of 125 ms: a pulse that moved no counter still counts.

    The error is never far from a reading's, which is what silent runs would add up to (10 s).
    Widths that drift by half in the meantime are followed: their mean would be off by seconds.
    """
    for drift in (0.0, 0.5):
        widths = np.random.default_rng(6).uniform(0.06, 0.12, 300)
        widths *= np.linspace(1.0 - drift, 1.0, 300)
        shown, true, pulses = readings(widths, CYCLE_S)
        found = expected_on_times(shown, pulses, CYCLE_S, CYCLE_S)
        assert abs(found.on_time_s - true).max() < 1.5 * CYCLE_S
        assert found.rounding[0].step_s == CYCLE_S


def test_readings_of_coarse_counters_are_used_some_firings_apart() -> None:
    """Unlike pulses: a step of their mean width hides what each had, a fine one does not."""
    widths = np.random.default_rng(6).uniform(0.02, 0.2, 300)
    every = [
        expected_on_times(shown, pulses, step, 0.0).rounding[0].every
        for step in (0.002, 0.01, CYCLE_S)
        for shown, _, pulses in [readings(widths, step)]
    ]
    assert every[:2] == [1.0, 1.0]
    assert 4.0 < every[2] < 12.0


@pytest.mark.parametrize(
    ("levels", "every"), [(1, 1.0), (2, 5.0), (10, 3.0), (11, 3.0), (9, np.inf)]
)
def test_the_first_and_the_last_reading_are_always_used(levels: int, every: float) -> None:
    """And those between are at least so far apart."""
    found = read_levels(levels, every)
    assert found[0] == 0
    assert found[-1] == levels - 1
    assert np.all(np.diff(found) >= min(np.floor(every), levels - 1))


@pytest.mark.parametrize("step", [0.01, 0.02, CYCLE_S])
def test_multiples_of_a_control_cycle_are_known_exactly(step: float) -> None:
    """Single and merged pulses of full cycles: nothing of the rounding is left."""
    widths = CYCLE_S * np.random.default_rng(1).integers(1, 4, 60)
    shown, true, pulses = readings(widths, step)
    found = expected_on_times(shown, pulses, step, CYCLE_S)
    np.testing.assert_allclose(found.on_time_s, true, atol=1e-12)
    assert found.rounding == (KNOWN,)


def test_pulses_alike_are_known_better_than_the_step() -> None:
    """Widths of 117 ms, no multiple of anything: a tenth of the rounding is left, and said so."""
    shown, true, pulses = readings(np.full(80, 0.117), 0.01)
    found = expected_on_times(shown, pulses, 0.01, CYCLE_S)
    error = found.on_time_s - true
    before = (shown - true).std()
    assert (error - error.mean()).std() < 0.3 * before
    assert found.rounding[0].ratio.max() < 0.05


def test_a_long_pulse_among_alike_ones_is_believed() -> None:
    """Pulses of 52 ms and one of 93 ms on 10 ms: no reading is off by more than a step.

    A spread for all would take half of the 41 ms for rounding, until the thruster fires again.
    What stays open of the long pulse is its own rounding, of the others next to nothing.
    """
    widths = np.full(160, 0.052)
    widths[70] = 0.093
    shown, true, pulses = readings(widths, 0.01)
    found = expected_on_times(shown, pulses, 0.01, CYCLE_S)
    assert abs(found.on_time_s - true).max() < 0.01
    ratio = found.rounding[0].ratio[found.rounding[0].ratio > 0.0]
    assert ratio[70] > 2.0
    assert np.median(ratio) < 0.3


def test_unlike_pulses_between_readings_that_are_used_are_told_by_all() -> None:
    """Of pulses of some 39 ms on 10 ms not all readings are used; 104 beside 37 ms stay unlike."""
    rng = np.random.default_rng(2)
    widths = 0.037 + rng.exponential(0.003, 49)
    widths[[1, 20, 35]] = 0.104
    shown, true, pulses = readings(widths, 0.01)
    found = expected_on_times(shown, pulses, 0.01, CYCLE_S)
    assert found.rounding[0].every > 1.0
    assert abs(found.on_time_s - true).max() < 0.01  # half of 65 ms where they share evenly


@pytest.mark.statistical
def test_few_firings_tell_the_scatter_of_widths_together() -> None:
    """Six thrusters of ten pulses of 118 ± 20 ms on steps of 50 ms, as one controller has them.

    The log of the variance of their widths is off by 0.6 (root mean square), by 1.2 if each speaks
    for itself; then one in fifteen is said to be known ten times too well. 150 thrusters in 25
    flights leave these figures good to some 10 %.
    """
    rng = np.random.default_rng(9)
    step, scatter = 0.05, 0.02
    alone, together = [], []
    for _ in range(25):
        each = [readings(rng.normal(0.118, scatter, 10), step) for _ in range(6)]
        shown, _, pulses = (np.hstack(part) for part in zip(*each, strict=True))
        together += expected_on_times(shown, pulses, step, 0.0).rounding
        alone += [expected_on_times(u, n, step, 0.0).rounding[0] for u, _, n in each]

    def off(each: list[Rounding]) -> Array:
        usual = np.array([np.median(one.ratio[one.ratio > 0.0]) for one in each])
        return np.log(usual * step**2 / 12.0 / scatter**2)

    assert np.sqrt(np.mean(off(together) ** 2)) < 0.7
    assert np.sqrt(np.mean(off(alone) ** 2)) > 1.0
    assert off(together).min() > np.log(0.1) > off(alone).min()


def open_variance(rounding: Rounding, levels: int) -> float:
    """Mean variance about their own mean of levels with the stated precision."""
    apart = np.diff(np.eye(levels), axis=0)
    seen = np.zeros(levels)
    seen[read_levels(levels, rounding.every)] = 1.0
    ratio = np.maximum(rounding.ratio[rounding.ratio > 0.0], 1e-9)
    covariance = np.linalg.inv(np.diag(seen) + apart.T @ (apart / ratio[:, None]))
    centred = covariance - covariance.mean(axis=0)
    return float(rounding.variance_s2 * np.trace(centred - centred.mean(axis=1)[:, None]) / levels)


@pytest.mark.statistical
def test_the_open_variance_is_that_of_the_error() -> None:
    """Pulses of 20 to 125 ms: the error's variance over 40 flights is the stated one, to 15 %.

    80 runs of 40 flights leave a standard error of some 3 % of a variance.
    """
    rng = np.random.default_rng(2)
    square, stated = [], []
    for _ in range(40):
        widths = rng.uniform(0.115, 0.135, 80)
        shown, true, pulses = readings(widths, 0.02)
        found = expected_on_times(shown, pulses, 0.02, 0.0)
        error = (found.on_time_s - true)[3:-3]
        square.append(float(((error - error.mean()) ** 2).mean()))
        stated.append(open_variance(found.rounding[0], 81))
    assert np.mean(square) == pytest.approx(np.mean(stated), rel=0.15)


def test_thrust_is_not_attenuated() -> None:
    """Momentum F (u + a n) from rounded counters: F is found; on the readings it is not (control).

    Widths vary by 4 ms about 125 ms, the step is 1.8 ms: 3 % of what tells F from a between
    neighbours is rounding, and the readings alone find F too small by that.
    """
    rng = np.random.default_rng(3)
    plain, calibrated = [], []
    for _ in range(60):
        shown, true, pulses = readings(rng.normal(0.125, 0.004, 400), 0.0018)
        momentum = 0.75 * (true + 0.03 * pulses) + 1e-4 * rng.standard_normal(true.shape)
        found = expected_on_times(shown, pulses, 0.0018, 0.0).on_time_s
        for series, kept in ((shown, plain), (found, calibrated)):
            gained = np.diff(np.concatenate([series, pulses, momentum], axis=1)[::3], axis=0)
            kept.append(np.linalg.lstsq(gained[:, :2], gained[:, 2], rcond=None)[0][0])
    assert np.mean(calibrated) == pytest.approx(0.75, abs=4 * np.std(calibrated) / np.sqrt(60))
    assert np.mean(plain) < 0.75 - 8 * np.std(plain) / np.sqrt(60)


def test_fine_counters_stay_as_they_are() -> None:
    """Steps of a tenth of a millisecond are no rounding."""
    shown, _, pulses = readings(np.full(10, 0.1234), 1e-4)
    found = expected_on_times(shown, pulses, 1e-4, 0.0)
    np.testing.assert_array_equal(found.on_time_s, shown)
    assert found.rounding == (KNOWN,)


def test_steps_longer_than_the_pulses_are_told() -> None:
    """Pulses of 60 to 120 ms on counters of 125 ms have a step that hides them; of 20 ms not."""
    widths = np.random.default_rng(8).uniform(0.06, 0.12, 100)
    for step, hidden in ((CYCLE_S, True), (0.02, False)):
        shown, _, pulses = readings(widths, step)
        (found,) = expected_on_times(shown, pulses, step, CYCLE_S).rounding
        assert found.step_s == pytest.approx(step)
        assert (found.step_s > found.width_s) is hidden


def read_thrice(widths: Array, fired: Array) -> tuple[Array, Array, Array]:
    """Counters in steps of 10 ms and true on-times and pulses (3 n + 1, K) of thrusters that fire
    together, for widths (n,), as ``fired`` (n, K) says; three readings follow each firing.
    """
    nothing = np.zeros((1, fired.shape[1]))
    true, pulses = (
        np.concatenate([nothing, np.repeat(np.cumsum(one, axis=0), 3, axis=0)])
        for one in (widths[:, None] * fired, fired)
    )
    return 0.01 * np.round(true / 0.01), true, pulses


def of_two_axes(
    rng: np.random.Generator, means: tuple[float, float], scatter_s: float
) -> tuple[Array, Array, Array]:
    """Rounded and true on-times and pulses (m, 3): one thruster fires now with the second, now with
    the third, for as long as is usual of either pair.
    """
    n = 120
    pair = rng.integers(0, 2, n)
    widths = np.array(means)[pair] + scatter_s * rng.standard_normal(n)
    return read_thrice(widths, np.stack([np.ones(n), pair == 0, pair == 1], axis=1))


def error_of_firings(shown: Array, true: Array, pulses: Array) -> float:
    """Root mean square error of what the first thruster's firings are expected to last, s."""
    found = expected_on_times(shown, pulses, 0.01, 0.0)
    wrong = np.diff(found.on_time_s[:, 0] - true[:, 0])
    return float(np.sqrt(np.mean(wrong[np.diff(pulses[:, 0]) > 0.0] ** 2)))


def test_pulses_are_as_long_as_others_that_came_with_the_same_thrusters() -> None:
    """Pulses of 26 ms about one axis and of 36 ms about another are told apart, 10 ms steps or not.

    Two of them are 62 ms as two of 31 ms would be, so that by the thruster's own readings each is
    5 ms off. Negative control: what fires beside it at random tells nothing.
    """
    together, alone, at_random = [], [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        shown, true, pulses = of_two_axes(rng, (0.026, 0.036), 0.001)
        together.append(error_of_firings(shown, true, pulses))
        alone.append(error_of_firings(shown[:, :1], true[:, :1], pulses[:, :1]))
        other = of_two_axes(rng, (0.03, 0.03), 0.001)
        mixed = [np.concatenate([one[:, :1], two[:, 1:]], axis=1) for one, two in
                 zip((shown, true, pulses), other, strict=True)]  # fmt: skip
        at_random.append(error_of_firings(*mixed))
    assert np.mean(together) < 0.0015
    assert np.mean(alone) > 0.0025
    assert np.mean(at_random) > 0.9 * np.mean(alone)


def test_company_moves_nothing_where_widths_owe_nothing_to_it() -> None:
    """Pulses alike in all companies: the errors are those of the thruster alone, within 3 %."""
    errors = np.array(
        [
            (error_of_firings(*all_three), error_of_firings(*(one[:, :1] for one in all_three)))
            for seed in range(40)
            for all_three in [of_two_axes(np.random.default_rng(seed), (0.045, 0.045), 0.004)]
        ]
    )
    assert errors[:, 0].mean() == pytest.approx(errors[:, 1].mean(), rel=0.03)


@pytest.mark.parametrize(
    ("width", "scatter", "lowest", "highest"),
    [(0.061, 0.002, 1.2, 4.0), (0.0545, 0.001, 0.2, 0.7), (0.055, 0.02, 0.95, 1.05)],
)
def test_roundings_that_repeat_last(
    width: float, scatter: float, lowest: float, highest: float
) -> None:
    """The variance of slow cosines of roundings is what is stated, over that of independent ones.

    Nearly multiples of the step leave the same rounding again and again, those between two
    multiples take turns; of unlike widths each is one of its own.
    """
    n, seen, stated = 400, [], []
    slow = np.cos(np.pi * (np.arange(n) + 0.5)[:, None] / n * np.arange(1, 9)) * np.sqrt(2.0 / n)
    for seed in range(30):
        widths = width + scatter * np.random.default_rng(seed).standard_normal(n)
        shown, true, pulses = readings(widths, 0.01)
        rounding = (shown - true)[1::3, 0]
        seen.append(np.mean((slow.T @ rounding) ** 2) / (0.01**2 / 12.0))
        found = expected_on_times(shown, pulses, 0.01, 0.0).rounding[0]
        stated.append(found.variance_s2 / (0.01**2 / 12.0))
    assert np.mean(stated) == pytest.approx(np.mean(seen), rel=0.35)
    assert lowest < np.mean(stated) < highest


def of_two_kinds(
    rng: np.random.Generator, widths_s: tuple[float, float], scatter_s: float
) -> tuple[Array, Array, Array]:
    """Rounded and true on-times and pulses (m, 1): one to three pulses together, of two kinds.

    Every other interval is idle. Of one of ten seconds no company tells which of them fired.
    """
    n = 150
    count = rng.choice([1, 1, 2, 3], n)
    long = rng.binomial(count, 0.6)
    gained = long * widths_s[1] + (count - long) * widths_s[0]
    gained = gained + scatter_s * np.sqrt(count) * rng.standard_normal(n)
    true, pulses = (
        np.concatenate([[0.0], np.repeat(np.cumsum(each), 2)])[:, None] for each in (gained, count)
    )
    return 0.01 * np.round(true / 0.01), true, pulses


def test_pulses_of_two_kinds_are_as_long_as_others_of_their_kind() -> None:
    """24 and 62 ms on steps of 10 ms: sums tell how many are of either, and errors are 1 ms.

    Negative control: widths of all sizes between, as scattered, have no kinds, and stay as unsure
    as readings are.
    """
    of_kinds, of_all = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        of_kinds.append(error_of_firings(*of_two_kinds(rng, (0.024, 0.062), 0.001)))
        of_all.append(error_of_firings(*of_two_kinds(rng, (0.043, 0.043), 0.019)))
    assert np.mean(of_kinds) < 0.0014
    assert np.mean(of_all) > 0.003


def test_two_kinds_are_told_by_a_gap_that_no_width_leaves() -> None:
    """One width shows two readings, so that 24 ms alone has no kinds; nor has 24 and 41 ms."""
    rng = np.random.default_rng(3)
    shown, _, pulses = of_two_kinds(rng, (0.024, 0.062), 0.001)
    kinds = kinds_of(single_widths(shown, shown, pulses), 0.01)
    assert kinds is not None
    assert kinds.width_s == pytest.approx([0.024, 0.062], abs=2e-3)
    for widths in ((0.024, 0.024), (0.024, 0.041)):
        shown, _, pulses = of_two_kinds(rng, widths, 0.001)
        assert kinds_of(single_widths(shown, shown, pulses), 0.01) is None


def test_the_only_pulse_of_its_kind_is_unsure() -> None:
    """One of 24 ms of a thruster whose others last 62 ms, beside a thruster with both kinds.

    It is expected to last about as long as those of the other, to 2 ms, and what is open of it is
    larger than of the pulses beside it. Negative control: without the other thruster it lasts what
    readings say, to 3 ms.
    """
    wrong, alone, ratios = [], [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        shown, _, pulses = of_two_kinds(rng, (0.024, 0.062), 0.001)
        n = len(shown) // 2
        widths = np.where(np.arange(n) == n // 2, 0.024, 0.062) + 0.001 * rng.standard_normal(n)
        other = np.concatenate([[0.0], np.repeat(np.cumsum(widths), 2)])
        read = 0.01 * np.round(other / 0.01)[:, None]
        begun = np.concatenate([[0.0], np.repeat(np.arange(1.0, n + 1.0), 2)])[:, None]
        place = 2 * (n // 2)
        own = expected_on_times(read, begun, 0.01, 0.0)
        alone.append(np.diff(own.on_time_s[:, 0] - other)[place])
        with_other = np.hstack([shown, read]), np.hstack([pulses, begun])
        both = expected_on_times(*with_other, 0.01, 0.0)
        wrong.append(np.diff(both.on_time_s[:, 1] - other)[place])
        ratio = both.rounding[1].ratio
        ratios.append(ratio[place] / np.median(ratio[ratio > 0.0]))
    assert np.sqrt(np.mean(np.square(wrong))) < min(
        0.0024, 0.8 * np.sqrt(np.mean(np.square(alone)))
    )
    assert np.median(ratios) > 1.5


def of_rare_company(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Rounded and true on-times and pulses (m, 4): 39 ms with the first and second, 50 ms with the
    second and third, and at last once the first with the fourth, for 50 ms.
    """
    n = 120
    pair = np.append(rng.integers(0, 2, n - 1), 2)
    widths = np.array([0.039, 0.050, 0.050])[pair] + 0.001 * rng.standard_normal(n)
    return read_thrice(widths, np.array([[1.0, 1, 0, 0], [0, 1, 1, 0], [1, 0, 0, 1]])[pair])


def test_what_is_usual_in_a_company_that_came_once_is_not_known() -> None:
    """A pulse of 50 ms in a company of its own, of a thruster whose others last 39 ms.

    It is not drawn to these, and what is open of it is as much as companies differ. Negative
    control: by the thruster's readings alone it is, and is off by more.
    """
    own, alone, open_ratio = [], [], []
    for seed in range(30):
        shown, true, pulses = of_rare_company(np.random.default_rng(seed))
        found = expected_on_times(shown, pulses, 0.01, 0.0)
        own.append(np.diff(found.on_time_s[:, 0] - true[:, 0])[-3])
        open_ratio.append(found.rounding[0].ratio[-3])
        found = expected_on_times(shown[:, :1], pulses[:, :1], 0.01, 0.0)
        alone.append(np.diff(found.on_time_s[:, 0] - true[:, 0])[-3])
    assert min(open_ratio) > 1.0
    assert np.mean(np.abs(own)) < 0.6 * np.mean(np.abs(alone))
