"""Rounded wheel rates: where wheels rest, what they scatter there, and what lasts or repeats."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from cassini_bayes.balance.rounded_wheels import (
    Rests,
    ShownRows,
    WheelSquares,
    between_steps,
    coherent_shares,
    rests,
    wheel_squares,
)
from cassini_bayes.computing.arrays import Array

ROWS = 4_000


def at_rest(levels: Array) -> Rests:
    """Where a wheel printed at every second rests."""
    return rests(np.arange(len(levels), dtype=float), levels)


def in_steps(shown: Array) -> ShownRows:
    """Wheels (r, W) printed in steps of 1 at every second."""
    return ShownRows(np.arange(len(shown), dtype=float), shown, 1.0)


def variance(squares: WheelSquares, noise: float) -> Array:
    """Of wheels (…, W), in steps squared, as they say."""
    share = coherent_shares(np.array([noise]))[0]
    repeated = np.tensordot(share, np.moveaxis(squares.lasting, -2, 0), 1)
    rounding = ((1.0 - share.sum()) * squares.moving + repeated) / 12.0
    return np.asarray(noise**2 * squares.moving + squares.seen + rounding)


def printed(speed: float, noise: float, rng: np.random.Generator, phase: float = 0.0) -> Array:
    """Whole steps shown of a wheel at ``phase`` that gains ``speed`` steps a row."""
    return np.asarray(np.round(phase + speed * np.arange(ROWS) + noise * rng.standard_normal(ROWS)))


@pytest.mark.parametrize("noise", [0.0, 0.2, 0.6])
def test_a_driven_wheel_moves_and_a_still_one_rests(noise: float) -> None:
    """Three steps a row pass every value; none at all never does, whatever the noise."""
    rng = np.random.default_rng(1)
    assert at_rest(printed(3.0, noise, rng)).moving.mean() > 0.999
    assert at_rest(printed(0.0, 0.1, rng, phase=0.2)).moving.mean() == 0.0


@pytest.mark.parametrize("phase", [0.0, 0.2, 0.4, 0.5])
def test_a_wheel_at_rest_has_the_scatter_that_it_shows(phase: float) -> None:
    """A fair share of readings of the next value is its own variance p (1 − p), at any phase."""
    levels = printed(0.0, 0.2, np.random.default_rng(2), phase)
    found = at_rest(levels)
    assert found.moving.mean() < 0.02
    # ten draws from the binomial's scatter
    assert found.variance.mean() == pytest.approx(levels.var(), abs=0.02)


def test_a_wheel_that_never_changes_is_not_known_exactly() -> None:
    """Twenty readings of one value leave a fortieth of a step squared, never nothing."""
    found = at_rest(np.full(20, 7.0))
    assert found.variance == pytest.approx(np.full(20, 0.025))


@pytest.mark.parametrize("speed", [0.0, 0.01, 0.3])
def test_noise_of_some_steps_makes_rounding_white(speed: float) -> None:
    """Readings that scatter over more than two values: all rows alike, none chosen by its noise."""
    rng = np.random.default_rng(5)
    found = at_rest(printed(speed, 2.5, rng))
    assert found.moving.all()
    assert not found.variance.any()
    # two values, as often one as the other, are a wheel at rest
    assert not at_rest(np.round(rng.uniform(0.0, 1.0, ROWS))).moving.all()


def test_a_slow_staircase_passes_its_values() -> None:
    """Without noise every tread is left on the other side: its error has a mean of nothing."""
    assert at_rest(printed(0.02, 0.0, np.random.default_rng(3))).moving[100:-100].all()


@pytest.mark.parametrize("noise", [0.05, 0.12, 0.2, 0.3])
def test_the_share_that_lasts_is_that_of_simulated_readings(noise: float) -> None:
    """Mean error of a resting reading over all phases: its square by quadrature over the noise."""
    phase = (np.arange(200) + 0.5) / 200 - 0.5
    above = norm.cdf((phase[:, None] - np.arange(-3.5, 4.0)) / noise)  # what is printed exceeds it
    shown = above.sum(axis=1) - 4.0
    wanted = 12.0 * np.mean((shown - phase) ** 2)
    assert coherent_shares(np.array([noise])).sum() == pytest.approx(wanted, abs=0.003)


def test_squares_on_modes_are_those_of_simulated_errors() -> None:
    """Resting wheels of all phases: the mean square of their errors on modes, slow and fast.

    Summing over modes gives all rows.
    """
    rng, noise, rows = np.random.default_rng(4), 0.15, 128
    modes, _ = np.linalg.qr(rng.standard_normal((rows, rows)))
    modes[:, 0] = 1.0
    modes, _ = np.linalg.qr(modes)
    phases = rng.uniform(-0.5, 0.5, 1_000)
    true = np.broadcast_to(phases, (rows, len(phases)))
    shown = np.round(true + noise * rng.standard_normal(true.shape))
    actual = ((modes.T @ (shown - true)) ** 2).mean(axis=1)
    on, over = wheel_squares(in_steps(shown), modes)
    expected = variance(on, noise).mean(axis=-1)
    # 1,000 squares of about a normal: 4.5 %, and the coarse form of what flickers
    assert expected[0] == pytest.approx(actual[0], rel=0.25)
    assert expected[1:].mean() == pytest.approx(actual[1:].mean(), rel=0.1)
    assert actual[0] > 10.0 * actual[1:].mean()
    assert expected.sum() == pytest.approx(variance(over, noise).mean(), rel=0.02)


def cosines(rows: int, count: int) -> Array:
    """Orthonormal cosines (rows, 1 + count), the constant first."""
    order, place = np.arange(count + 1), (np.arange(rows) + 0.5) / rows
    waves = np.sqrt(2.0 / rows) * np.cos(np.pi * np.outer(place, order))
    waves[:, 0] /= np.sqrt(2.0)
    return waves


@pytest.mark.parametrize("stray", [0.03, 0.05])
def test_near_a_threshold_a_rounding_drifts(stray: float) -> None:
    """Wheels that stray a little about a threshold, with noise of a twelfth of a step.

    What is printed strays five times as far. Its error on the 30 slowest cosines has about the
    square that is said, on the three slowest five times that of a rounding that only lasts.
    """
    rng, noise, rows, wheels = np.random.default_rng(8), 0.08, 1_024, 200
    modes = cosines(rows, 30)
    true = modes[:, 1:] @ (rng.standard_normal((30, wheels)) / np.arange(1, 31)[:, None])
    true = 0.5 + stray * true / true.std(axis=0)
    shown = np.round(true + noise * rng.standard_normal(true.shape))
    actual = ((modes.T @ (shown - true)) ** 2)[1:].mean(axis=1)
    on, over = wheel_squares(in_steps(shown), modes)
    share = coherent_shares(np.array([noise]))[0]
    lasting = (share @ on.lasting[1:].mean(axis=2).T) / 12.0
    said = on.seen[1:].mean(axis=1) + lasting
    assert said.sum() == pytest.approx(actual.sum(), rel=0.7)
    assert np.all(said[[0, 1, 4, 9, 19, 29]] > 0.8 * actual[[0, 1, 4, 9, 19, 29]])
    scatter = np.mean([at_rest(own).variance.mean() for own in shown.T])
    assert np.all(actual[:3] > 5.0 * (scatter + lasting[:3]))
    assert over.seen.mean() > scatter * rows


def test_a_wheel_that_shows_one_value_or_none_but_noise_does_not_drift() -> None:
    """Where readings never change, or only by their noise, nothing is added but chance."""
    rng, rows = np.random.default_rng(9), 1_024
    modes = cosines(rows, 30)
    still = np.tile([[3.0, 0.5]], (rows, 100))
    shown = np.round(still + [0.0, 0.2] * 100 * rng.standard_normal(still.shape))
    on, _ = wheel_squares(in_steps(shown), modes)
    scatter = np.array([at_rest(own).variance.mean() for own in shown.T])
    assert on.seen[1:, ::2] == pytest.approx(np.full((30, 100), scatter[0]))
    assert on.seen[1:, 1::2].mean() == pytest.approx(scatter[1::2].mean(), rel=0.3)


@pytest.mark.parametrize("noise", [0.0, 0.15, 0.4])
@pytest.mark.parametrize("period", [3.3, 8.4, 70.0])
def test_a_driven_wheel_is_known_between_its_steps(period: float, noise: float) -> None:
    """Lines through readings are right to a seventh of a step where readings are not to a third."""
    true = 0.3 + np.arange(ROWS) / period
    levels = np.round(true + noise * np.random.default_rng(6).standard_normal(ROWS))
    rate, driven = between_steps(np.arange(ROWS, dtype=float), levels)
    assert driven[10:-10].mean() > 0.9
    assert (rate - true)[10:-10].std() < 0.15 < (levels - true).std()
    assert not between_steps(np.arange(ROWS, dtype=float), np.where(true > 9.0, 5.0, 2.0))[1].any()
    still = np.round(0.3 + noise * np.random.default_rng(7).standard_normal(ROWS))
    assert not between_steps(np.arange(ROWS, dtype=float), still)[1].any()


@pytest.mark.parametrize("noise", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("period", [3.3, 8.4, 40.0])
def test_roundings_of_wheels_driven_evenly_repeat(period: float, noise: float) -> None:
    """Squares of errors of 300 wheels by octave, slow and fast: most of a rounding is in lines.

    As white noise it would have 1/12 in every mode, some two to four times what there is in most.
    """
    rng, rows = np.random.default_rng(10), 1_060
    modes = cosines(rows, 128)
    true = rng.uniform(0.0, 1.0, 300) + np.arange(rows)[:, None] / period
    shown = np.round(true + noise * rng.standard_normal(true.shape))
    actual = ((modes.T @ (shown - true)) ** 2).mean(axis=1)
    on, over = wheel_squares(in_steps(shown), modes)
    said = variance(on, noise).mean(axis=1)
    for part in (slice(1, 8), slice(8, 32), slice(32, 64), slice(64, 129)):
        # squares of 300 wheels in 7 modes and more: 3 %; the phase is known to 0.05 steps
        assert said[part].mean() == pytest.approx(actual[part].mean(), rel=0.2)
    repeats = coherent_shares(np.array([noise])).sum()
    assert said[1:8].mean() < noise**2 + (1.0 - 0.75 * repeats) / 12.0
    rest = variance(over, noise).mean() - said.sum()
    assert rest == pytest.approx(((shown - true) ** 2).sum(axis=0).mean() - actual.sum(), rel=0.05)


def test_means_over_rows_have_less_of_a_rounding() -> None:
    """Of rows that are means over eight, a rounding is white and an eighth, in sum and by mode."""
    levels = np.round(np.arange(400)[:, None] / 3.3)
    shown = ShownRows(8.0 * np.arange(400.0), levels, 1.0, averaged=8.0)
    on, over = wheel_squares(shown, cosines(400, 16))
    assert on.lasting == pytest.approx(np.full((17, 4, 1), 0.125), rel=0.05)
    assert over.lasting == pytest.approx(np.full((4, 1), 50.0), rel=0.01)


@pytest.mark.parametrize(("gained", "every"), [(5.37, 100), (5.37, 50), (1.37, 50)])
def test_a_wheel_that_goes_and_stops_rests(gained: float, every: int) -> None:
    """Turns of 5 s, again and again: what lasts in rests is there, in modes of some rests each.

    It is not driven evenly, though halves of long lines are alike.
    """
    shown, said, actual = squares_of_wheels(goes_and_stops(gained, every), 0.1, 12)
    assert np.mean([at_rest(own).moving.mean() for own in shown.T]) < 0.8
    assert said > 0.25 * actual


@pytest.mark.parametrize("noise", [0.05, 0.2])
@pytest.mark.parametrize(
    ("gained", "every", "moves", "least"),
    [(5.37, 100, 0.2, 0.75), (200.3, 120, 0.2, 0.7), (5.37, 50, 0.3, 0.65), (1.37, 50, 0.85, 0.2)],
)
def test_a_wheel_that_pauses_on_its_way_rests(
    gained: float, every: int, moves: float, least: float, noise: float
) -> None:
    """All turns to one side: a value that it shows for a minute is not passed.

    Steps of one and of two by turns look like a slow staircase, and are told from one in part only.
    """
    shown, said, actual = squares_of_wheels(goes_and_stops(gained, every), noise, 12)
    assert np.mean([at_rest(own).moving.mean() for own in shown.T]) < moves
    assert least < said / actual < 1.1


def goes_and_stops(gained: float, every: int) -> Array:
    """A path (r, 1) of 1,000 rows: so many steps in 5 of them, then none, again and again."""
    time = np.arange(1_000)
    return np.asarray(gained * (np.clip(time % every, 0, 5) / 5 + time // every)[:, None])


def squares_of_wheels(
    path: Array, noise: float, rng: int | np.random.Generator
) -> tuple[Array, float, float]:
    """Printed rates of 100 wheels on a path (r, 1 or 100), and squares of their slow errors.

    The squares are those that readings say, and the true ones, on the 31 slowest cosines.
    """
    rng, modes = np.random.default_rng(rng), cosines(len(path), 31)
    true = rng.uniform(0.0, 1.0, 100) + path
    shown = np.round(true + noise * rng.standard_normal(true.shape))
    actual = ((modes.T @ (shown - true)) ** 2).mean(axis=1)[1:]
    said = variance(wheel_squares(in_steps(shown), modes)[0], noise).mean(axis=1)[1:]
    return shown, float(said.mean()), float(actual.mean())


@pytest.mark.parametrize("path", ["settles", "wanders", "turns"])
def test_a_wheel_that_goes_on_within_its_noise_does_not_rest(path: str) -> None:
    """Its noise hides its steps, but its mean goes on: none of that is a rounding.

    It was taken for a rest, and its motion for an error of 10 to 46 times the true square.
    """
    rng, time = np.random.default_rng(13), np.arange(1_000.0)[:, None]
    if path == "settles":
        motion = 10.0 * np.exp(-time / 300.0)
    elif path == "wanders":
        motion = np.cumsum(0.05 * rng.standard_normal((1_000, 100)), axis=0)
    else:
        motion = 1e-4 * (time - rng.uniform(0.0, 1_000.0, 100)) ** 2
    _, said, actual = squares_of_wheels(motion, 0.2, rng)
    assert 0.8 < said / actual < 2.0


@pytest.mark.parametrize("period", [2.6, 1.9985, 1.0 / 1.002])
def test_thinned_rows_do_not_make_slow_what_is_fast(period: float) -> None:
    """A harmonic is as slow in every second row as it is in all of them."""
    rng, rows = np.random.default_rng(11), 2_000
    true = rng.uniform(0.0, 1.0, 20) + np.arange(rows)[:, None] / period
    shown, modes = np.round(true), cosines(rows, 32)
    all_rows, _ = wheel_squares(in_steps(shown), modes)
    thinned = ShownRows(2.0 * np.arange(rows // 2), shown[::2], 1.0, 2)
    half, _ = wheel_squares(thinned, modes[::2])
    largest, thinned_largest = (each.lasting.max(axis=(0, 2)) for each in (all_rows, half))
    slow = largest > 0.5 * rows  # most of a harmonic in one mode
    assert thinned_largest[slow] == pytest.approx(largest[slow], rel=0.2)
    assert np.all(thinned_largest[~slow] <= largest[~slow] + 1.0)
    assert np.count_nonzero(slow) == {2.6: 0, 1.9985: 2}.get(period, 4)


def test_without_steps_noise_is_white() -> None:
    """No rounding: every row has the noise alone, on every mode."""
    rates = np.random.default_rng(5).standard_normal((50, 3))
    shown = ShownRows(np.arange(50.0), rates, 0.0, 2)
    on, over = wheel_squares(shown, np.eye(50)[:, :7])
    assert np.all(on.moving == 1.0)
    assert np.all(over.moving == 100.0)
    assert not on.seen.any()
    assert not on.lasting.any()
    assert not over.lasting.any()
