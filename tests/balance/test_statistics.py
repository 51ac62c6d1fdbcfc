"""Telemetry to Gram matrices: which rows, which columns, whatever the chunks."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from telemetry_cases import made_up_samples, reduced, telemetry_priors

from cassini_bayes.balance.statistics import (
    Carry,
    Samples,
    counter_reduction,
    layout_of,
    load_statistics,
    reduce_chunks,
    save_statistics,
    settle,
)
from cassini_bayes.balance.statistics.columns import effective_increments
from cassini_bayes.balance.statistics.event_statistics import CounterStatistics
from cassini_bayes.balance.statistics.first_look import LateRows, Preparation
from cassini_bayes.balance.statistics.inner_products import MODES, local_waves
from cassini_bayes.balance.statistics.long_levels import Levels, level_patterns
from cassini_bayes.balance.statistics.pairs import Pairs, quarter_of
from cassini_bayes.balance.statistics.preparation import prepare
from cassini_bayes.balance.statistics.rows import quiet_rows
from cassini_bayes.computing.arrays import joined
from cassini_bayes.errors import InputError
from cassini_bayes.model.event_reduction import sampling_of
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

ARRAYS = ("gram", "projection", "mode_gram", "cuts")


@pytest.mark.parametrize("chunks", [2, 3, 7, 40])
@pytest.mark.parametrize("fires", [True, False])
def test_chunks_do_not_matter(chunks: int, fires: bool) -> None:
    """Statistics are the same however the telemetry is cut, also in the middle of a firing."""
    samples = made_up_samples(np.random.default_rng(chunks), 160, fires=fires)
    whole, _ = reduced(samples, telemetry_priors())
    cut, _ = reduced(samples, telemetry_priors(), chunks=chunks)
    assert cut.rows == whole.rows
    for name in ARRAYS:
        # pytest.approx would take seconds for a quarter of a million numbers
        np.testing.assert_allclose(
            getattr(cut, name), getattr(whole, name), rtol=1e-11, atol=1e-9, err_msg=name
        )
    for field in fields(CounterStatistics):
        one, other = (getattr(each.counters, field.name) for each in (cut, whole))
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-10, err_msg=field.name)


def damaged(samples: Samples, how: str) -> Samples:
    """Telemetry that lacks attitudes for a while, or comes more seldom from some time on."""
    rows = np.arange(len(samples))
    if how == "more seldom":
        return replace(samples, time_s=samples.time_s + 3.0 * np.maximum(rows - 80, 0))
    attitude = np.where(((rows > 60) & (rows < 100))[:, None], np.nan, samples.attitude)
    return replace(samples, attitude=attitude)


@pytest.mark.parametrize("how", ["no attitudes", "more seldom"])
@pytest.mark.parametrize("chunks", [3, 7, 40])
def test_chunks_do_not_matter_where_rows_are_missing(how: str, chunks: int) -> None:
    """What is fired while attitudes are missing is not lost, and pieces are the same."""
    rng = np.random.default_rng(chunks)
    samples = damaged(made_up_samples(rng, 200, firing=0.01, wander=1e-5), how)
    whole, _ = reduced(samples, telemetry_priors())
    cut, _ = reduced(samples, telemetry_priors(), chunks=chunks)
    assert whole.turns.pieces == cut.turns.pieces > 3
    assert np.any(np.diff(samples.pulses[60:101], axis=0) != 0.0)
    for name in ARRAYS:
        one, other = getattr(cut, name), getattr(whole, name)
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-9, err_msg=name)
    for name in ("slope_gram", "gram", "contrasts", "slope_time_s"):
        one, other = getattr(cut.turns, name), getattr(whole.turns, name)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("chunks", [3, 7])
def test_chunks_do_not_matter_for_means_over_blocks(chunks: int) -> None:
    """A block that a gap has left few rows of is left out, whatever chunk it is in."""
    samples = made_up_samples(np.random.default_rng(chunks), 400, firing=0.3)
    samples = joined([samples.part(0, 140), samples.part(185, 400)])
    found = Preparation(late=LateRows(32.0, 32.0, 0.1, (0.3,) * 8))
    whole, _ = reduced(samples, telemetry_priors(), prepared=found)
    cut, _ = reduced(samples, telemetry_priors(), chunks=chunks, prepared=found)
    assert whole.rows == cut.rows == 11
    np.testing.assert_allclose(cut.gram, whole.gram, rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize("part", [0.3, 0.04, 1e-3])
def test_few_polynomials_stand_for_all_cosines(part: float) -> None:
    """Where many rows span a small part of an event, its cosines are made of fewer functions."""
    turn = 0.6 + part * np.sort(np.random.default_rng(0).random(600))
    waves, to_modes = local_waves(turn)
    assert to_modes is not None
    assert waves.shape[1] < 0.7 * MODES
    expected = np.cos(np.pi * turn[:, None] * np.arange(1, MODES + 1))
    np.testing.assert_allclose(waves @ to_modes.T, expected, rtol=0, atol=1e-11)
    # and a quarter of them is not enough
    few = waves.shape[1] // 4
    assert np.abs(waves[:, :few] @ to_modes[:, :few].T - expected).max() > 1e-11


def test_statistics_add_over_rows() -> None:
    """The Gram matrices of two halves of the rows add up to those of all."""
    samples = made_up_samples(np.random.default_rng(1), 100, fires=False)
    whole, sampling = reduced(samples, telemetry_priors())
    layout = whole.layout
    rows, _ = settle(samples, Carry.start(layout), layout, sampling, final=True)
    columns = [np.concatenate([rows.vector[:, c], rows.scalar], axis=1) for c in range(3)]
    halves = [
        sum(c[part].T @ d[part] for part in (slice(0, 40), slice(40, None)))
        for c in columns
        for d in columns
    ]
    assert np.array(halves).reshape(whole.gram.shape) == pytest.approx(whole.gram, rel=1e-12)


def test_rows_during_a_pulse_are_left_out() -> None:
    """A row counts only if the counters read before the guard time equal those at or after it."""
    counter_time = np.arange(6.0)
    counters = np.array([[0.0], [0.0], [1.0], [1.0], [1.0], [2.0]])
    asked = np.array([0.0, 1.0, 1.5, 2.0, 3.0, 3.4, 4.0, 4.5, 5.0, 6.0])
    quiet = quiet_rows(asked, counter_time, counters, guard_s=0.5)
    assert quiet.tolist() == [
        False,  # nothing is known before the first reading
        True,
        False,  # the pulse of the second reading may have begun
        False,
        True,
        True,
        True,
        False,
        False,
        False,  # after the last reading nothing is known
    ]


def test_faster_rows_inside_unchanged_brackets_are_used() -> None:
    """With on-times every 10 s the rows of a bracket without firing count, other rows do not."""
    counter_time = np.array([0.0, 10.0, 20.0, 30.0])
    counters = np.array([[0.0], [0.0], [3.0], [3.0]])
    asked = np.arange(0.0, 31.0, 2.0)
    quiet = quiet_rows(asked, counter_time, counters, guard_s=0.4)
    used = set(asked[quiet])
    assert used == {2.0, 4.0, 6.0, 8.0, 10.0, 22.0, 24.0, 26.0, 28.0, 30.0}


def test_a_merged_firing_is_one_pulse() -> None:
    """250 ms over two readings with one pulse count have one tail, not two."""
    priors = telemetry_priors()
    names = priors.spacecraft.thruster_names("B")
    sampling = sampling_of(priors, names, 10.0, "first_order")
    on_time = np.zeros((4, 8))
    pulses = np.zeros((4, 8))
    on_time[1, 0], on_time[2, 0], pulses[1, 0] = 0.2, 0.05, 1.0
    effective = effective_increments(on_time, pulses, sampling.pulses.expected_columns)[
        :, 0, 0
    ].sum()
    curve = PULSE_SHAPES["first_order"].thrust_fraction
    impulse = quad(
        lambda t: float(curve(t, 0.25, *sampling.pulse_reference_s)),
        0,
        2.0,
        limit=400,
        points=[0.005, 0.255, 0.3, 0.4],
    )[0]
    assert effective == pytest.approx(impulse, rel=1e-6)


def test_pulses_of_a_run_share_their_mean_width() -> None:
    """Three pulses in 90 ms gain three times what one of 30 ms does, at the reference exactly."""
    priors = telemetry_priors()
    names = priors.spacecraft.thruster_names("B")
    sampling = sampling_of(priors, names, 10.0, "first_order")
    on_time, pulses = np.zeros((3, 8)), np.zeros((3, 8))
    on_time[1, 2], pulses[1, 2] = 0.09, 3.0
    found = effective_increments(on_time, pulses, sampling.pulses.expected_columns)[1, 2]
    _, rise, fall = sampling.pulse_reference_s
    assert found[0] == pytest.approx(
        0.09 + 3 * (fall - rise) * (1 - np.exp(-0.03 / rise)), rel=1e-12
    )
    assert found == pytest.approx(3.0 * sampling.pulses.columns(np.array(0.03)), rel=1e-12)


def test_what_is_fired_in_nearly_every_interval_is_delivered() -> None:
    """Pulses of 49 to 51 ms in runs, 62 ms of another thruster alone, and readings that cut none.

    A thruster that fires in almost every interval has no pulse that stands alone. With the widths
    of the other as those of the event, two to six of its own together were too short for any, and
    lost 7 ms each.
    """
    rng, n = np.random.default_rng(4), 180
    pulses = np.zeros((n, 8))
    pulses[:, 0] = rng.choice([0, 1, 1, 1, 1, 2], n)
    pulses[::5, 2] = 1.0
    widths = np.where(np.arange(8) == 2, 0.062, 0.05) + 0.001 * rng.integers(-1, 2, (n, 8))
    gained = pulses * widths
    read, counted = (
        np.concatenate([np.zeros((1, 8)), np.cumsum(each, axis=0)]) for each in (gained, pulses)
    )
    samples = made_up_samples(rng, n + 1)
    samples = replace(
        samples, time_s=10.0 * np.arange(n + 1), on_time_s=read.round(3), pulses=counted
    )
    priors = telemetry_priors()
    found = prepare([samples], 0.125, 0.5).found
    names = priors.spacecraft.thruster_names("B")
    sampling = sampling_of(priors, names, 10.0 * n, "first_order")
    basis = replace(sampling, widths_s=found.widths_s).pulses
    effective = effective_increments(gained, pulses, basis.expected_columns)[..., 0].sum(axis=0)
    exact = (pulses * basis.columns(widths)[..., 0]).sum(axis=0)
    assert effective == pytest.approx(exact, abs=2e-4 * n)


def test_sign_of_the_quaternion_does_not_matter() -> None:
    """q and −q are the same attitude: flipped signs give the same statistics."""
    samples = made_up_samples(np.random.default_rng(2), 90)
    flipped = samples.attitude.copy()
    flipped[::3] *= -1.0
    one, _ = reduced(samples, telemetry_priors())
    other, _ = reduced(replace(samples, attitude=flipped), telemetry_priors())
    assert other.gram == pytest.approx(one.gram, rel=1e-12)


def test_statistics_survive_their_file(tmp_path: Path) -> None:
    """What is written is read back; a damaged or missing cache file is no statistics."""
    whole, _ = reduced(made_up_samples(np.random.default_rng(4), 80), telemetry_priors())
    path = tmp_path / "event.npz"
    save_statistics(path, whole)
    back = load_statistics(path)
    assert back is not None
    assert back.layout == whole.layout
    for name in ARRAYS:
        assert np.array_equal(getattr(back, name), getattr(whole, name))
    for field in fields(CounterStatistics):
        one, other = (getattr(each.counters, field.name) for each in (back, whole))
        assert np.array_equal(one, other), field.name
    path.write_bytes(path.read_bytes()[:500])
    assert load_statistics(path) is None
    assert load_statistics(tmp_path / "none.npz") is None


def test_joined_intervals_stay_in_their_quarter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where many intervals are told apart as few, sums over a quarter stay what they were."""
    samples = made_up_samples(np.random.default_rng(6), 400)
    every, sampling = reduced(samples, telemetry_priors())
    monkeypatch.setattr(counter_reduction, "MOST_STEPS", 9)
    few, _ = reduced(samples, telemetry_priors())
    assert every.counters.fired.sum(axis=0).max() > 4 * few.counters.fired.sum(axis=0).max()
    assert few.counters.steps.any()
    for name in ("square", "unlike", "steps"):
        sums = [
            np.array(
                [
                    getattr(own, name)[quarter_of(own.end_s, sampling.duration_s) == part].sum(0)
                    for part in range(4)
                ]
            )
            for own in (few.counters, every.counters)
        ]
        np.testing.assert_allclose(sums[0], sums[1], rtol=1e-12, atol=1e-18, err_msg=name)
    assert few.counters.slopes.max() == pytest.approx(every.counters.slopes.max(), rel=0.3)


@pytest.mark.parametrize("ratio", [0.1, 1.0, 10.0])
def test_roundings_that_are_joined_leave_as_much(ratio: float) -> None:
    """Of slow modes, in which k levels of a couple are one: within 40 %; as one rounding 2.3 to 4.

    What firings add between two readings has ``ratio`` times the variance of a rounding.
    """
    rng, seconds, number, step = np.random.default_rng(20), 2_000, 600, 0.01
    ends = np.sort(rng.choice(np.arange(1, seconds - 1), number, replace=False)).astype(float)
    rows, each = np.arange(float(seconds)), (number, 1)
    slopes = np.zeros((*each, 5))
    slopes[..., 0] = 1.0
    pairs = Pairs(ends, np.ones(each, dtype=bool), np.zeros(each), np.zeros((*each, 5, 5)), slopes)
    levels = Levels(
        ends, pairs.fired, slopes, np.array([step**2 / 12]), np.full(each, ratio), np.ones(1)
    )
    _, _, joined = counter_reduction._joined(pairs, np.zeros(each), levels, float(seconds), 150)
    assert len(joined.end_s) < 160
    modes = np.cos(np.pi * np.arange(1, 20) * (rows[:, None] + 0.5) / seconds)

    def square(own: Levels) -> float:
        """What all leave in the slowest modes, s²."""
        begun = (rows[:, None] >= own.end_s).astype(float)
        pattern = level_patterns(own, 0, begun, np.ones((seconds, 1)))[:, 0]
        return float(((modes.T @ pattern) ** 2).sum())

    assert square(joined) == pytest.approx(square(levels), rel=0.4)
    as_one = replace(joined, open_s2=levels.open_s2, open_ratio=joined.open_ratio / 4.0)
    assert square(as_one) > 2.3 * square(levels)


def test_intervals_are_joined_by_couple(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many intervals of many couples, of which each fired in few enough: none is joined.

    A level of one couple that began where another fired had been in the wrong rows.
    """
    samples = made_up_samples(np.random.default_rng(6), 400)
    every, _ = reduced(samples, telemetry_priors())
    most = int(every.counters.fired.sum(axis=0).max())
    assert len(every.counters.end_s) > most
    monkeypatch.setattr(counter_reduction, "MOST_STEPS", most)
    same, _ = reduced(samples, telemetry_priors())
    for field in fields(CounterStatistics):
        one, other = (getattr(each.counters, field.name) for each in (every, same))
        assert np.array_equal(one, other), field.name


def test_too_few_rows_are_refused() -> None:
    """Telemetry that fires all the time leaves nothing to use, and says so."""
    samples = made_up_samples(np.random.default_rng(5), 40)
    always = np.arange(40.0)[:, None] * np.full(8, 0.1)
    busy = replace(samples, on_time_s=always, pulses=np.floor(always * 8))
    with pytest.raises(InputError, match=r"within .* s of a firing"):
        reduced(busy, telemetry_priors())


def test_ceaseless_firing_does_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of a firing without end are worked up once enough of them wait."""
    monkeypatch.setattr("cassini_bayes.balance.statistics.columns.MOST_WAITING", 30)
    samples = made_up_samples(np.random.default_rng(6), 200)
    always = np.arange(200.0)[:, None] * np.full(8, 0.1)
    busy = replace(samples, on_time_s=always, pulses=np.floor(always * 8))
    priors = telemetry_priors()
    names = priors.spacecraft.thruster_names("B")
    sampling = sampling_of(priors, names, 199.0, "first_order")
    layout = layout_of((1, 2, 4), names, sampling)
    carry = Carry.start(layout)
    for start in range(0, 200, 10):
        _, carry = settle(busy.part(start, start + 10), carry, layout, sampling, final=False)
        assert carry.waiting is not None
        assert len(carry.waiting) <= 40


def test_the_reduction_wants_samples_in_order() -> None:
    """Samples of several parts joined are the samples of the whole."""
    samples = made_up_samples(np.random.default_rng(7), 30)
    both = joined([samples.part(0, 10), samples.part(10)])
    assert np.array_equal(both.time_s, samples.time_s)


def test_reduction_of_nothing_is_refused() -> None:
    """No chunk at all is too little telemetry."""
    priors = telemetry_priors()
    sampling = sampling_of(priors, (), 10.0, "first_order")
    with pytest.raises(InputError, match="at least 5 rows"):
        reduce_chunks("none", "slew", [], layout_of((1, 2, 4), (), sampling), sampling)
