"""Quiet pieces: columns integrated row by row are those of the event's statistics."""

from __future__ import annotations

import numpy as np
import pytest
from telemetry_cases import event_of, made_up_samples, telemetry_priors

from cassini_bayes.balance.statistics.sampling import ExtraColumn
from cassini_bayes.balance.statistics.turns import (
    Pieces,
    WhiteTurns,
    contrasts_of,
    noise_squares,
    pieces_of,
    slope_weights,
    turns_between,
    walk_square,
)
from cassini_bayes.balance.statistics.walk import cosines, walk_scales


def test_integrated_columns_have_the_gram_matrices_of_slopes_and_the_rest() -> None:
    """Two ways to the same inner products, of wheel rates, a constant and turns."""
    event = event_of(made_up_samples(np.random.default_rng(3), 160), telemetry_priors())
    layout, turns = event.statistics.layout, event.statistics.turns
    rows = event.usable_rows
    pieces = pieces_of(rows, layout, event.sampling)
    vectors = len(layout.vector)
    columns = np.r_[layout.one, layout.wheel]
    own = pieces.integrated(rows.scalar[:, columns - vectors])
    steps = np.cumsum(turns_between(rows.cosines), axis=0)
    own = np.column_stack([own, pieces.centred(np.vstack([np.zeros(3), steps]))])
    columns = np.r_[columns, layout.turn]
    kept = np.ix_(columns, columns)
    total = (turns.slope_gram + turns.gram.sum(axis=0))[0, 0][kept]
    size = np.sqrt(np.diagonal(total))
    assert own.T @ own == pytest.approx(total, abs=1e-9 * np.outer(size, size).max())
    assert np.abs(np.add.reduceat(own, pieces.ends[:-1], axis=0)).max() < 1e-9


def test_a_columns_own_integral_counts_in_turns_alone() -> None:
    """What trapezoids miss of a swing is made up for, in turns and not in rows."""
    event = event_of(made_up_samples(np.random.default_rng(3), 160), telemetry_priors())
    grams = []
    for over_trapezoids in (1.0, 1.5):
        column = ExtraColumn("swing", lambda rows: np.sin(rows.time_s), over_trapezoids)
        own = event.with_columns((column,)).statistics
        place = own.layout.extra_place.start
        turns = (own.turns.slope_gram + own.turns.gram.sum(axis=0))[0, 0]
        wheel = own.layout.wheel.start
        grams.append((turns[place, place], turns[place, wheel], own.gram[..., place, place].sum()))
    once, more = grams
    assert more == pytest.approx((2.25 * once[0], 1.5 * once[1], once[2]))


def test_noise_of_integrals_is_whitened_with_what_is_summed_up() -> None:
    """Covariance over the contrasts of every piece is one; control: slopes are far from it without.

    Attitudes with noise 1 and rows with noise √r, summed up by trapezoids.
    """
    time_s = np.r_[0.0:32.0, 40.0:44.0, 50.0:90.0:4.0, 100.0]
    pieces = Pieces(time_s, np.array([0, 32, 36, 46, 47]))
    ratios = np.array([0.0, 0.05, 0.3])
    turns = WhiteTurns.over(pieces, ratios)
    rows = np.eye(len(time_s))
    centred, summed = pieces.centred(rows), pieces.integrated(rows)
    for axis, ratio in enumerate(ratios):
        noise = centred @ centred.T + ratio * summed @ summed.T
        made = turns.whitened(centred, axis)
        assert made @ noise @ made.T == pytest.approx(centred, abs=1e-9)
    ramp = turns.ramps[:32]
    assert ramp @ ramp == pytest.approx(1.0)
    assert ramp @ noise[:32, :32] @ ramp == pytest.approx(1.0 / turns.slope_shares[0, 2])
    assert ramp @ noise[:32, :32] @ ramp > 10.0


@pytest.mark.parametrize("rows", [2, 3, 7, 60])
def test_noise_in_the_integrals_of_a_piece_is_that_of_the_whole_matrix(rows: int) -> None:
    """Sums over rows give the squares of the trapezoidal rule's matrix, at any times."""
    rng = np.random.default_rng(rows)
    time = 100.0 + np.cumsum(rng.uniform(0.2, 2.0, rows))
    half, lower = 0.5 * np.diff(time), np.tri(rows, rows - 1, -1)
    rule = np.zeros((rows, rows))
    rule[:, :-1] += lower * half
    rule[:, 1:] += lower * half
    ramp = time - time.mean()
    ramp /= np.linalg.norm(ramp)
    plane = np.column_stack([np.full(rows, rows**-0.5), ramp])
    left = np.eye(rows) - plane @ plane.T
    wanted = [
        ((ramp @ rule) ** 2).sum(),
        ((left @ rule) ** 2).sum(),
        ((left @ rule @ (lower * np.sqrt(np.diff(time)))) ** 2).sum(),
    ]
    each, left_squares = noise_squares(time, plane.T)
    found = [each[1, 0], *left_squares]
    assert found == pytest.approx(wanted, rel=1e-9, abs=1e-12)
    assert slope_weights(time) == pytest.approx(ramp @ rule)


@pytest.mark.parametrize("rows", [2, 3, 4, 9, 33, 400])
def test_contrasts_are_orthonormal_and_grouped_by_their_noise(rows: int) -> None:
    """Within a group of half periods what is summed up differs little; from group to group much.

    The last group is all that the basis leaves: there the attitude's noise is by far the most.
    """
    rng = np.random.default_rng(rows)
    time = 100.0 + np.cumsum(rng.uniform(0.9, 1.1, rows)) * min(1.0, 32.0 / rows)
    basis, group = contrasts_of(time)
    assert basis @ basis.T == pytest.approx(np.eye(len(basis)), abs=1e-12)
    assert len(group) == len(basis) - 2
    assert list(group) == sorted(group)
    ramp = time - time.mean()
    assert basis[:2] == pytest.approx(
        np.stack([np.full(rows, rows**-0.5), ramp / np.linalg.norm(ramp)]), abs=1e-12
    )
    summed = noise_squares(time, basis)[0][2:, 0] / np.median(np.diff(time)) ** 2
    for g in set(group.tolist()):
        own = summed[group == g]
        assert np.mean(own**2) < 1.5 * np.mean(own) ** 2  # 7.5 over all contrasts of 33 rows
        assert own.max() < 8.0 * own.min()
    if rows == 33:
        assert np.mean(summed**2) > 2.5 * np.mean(summed) ** 2


def test_pieces_may_have_very_many_rows() -> None:
    """32 s at 5 kHz: a matrix of all rows would need 200 GB."""
    time = np.linspace(0.0, 32.0, 160_001)
    (coarse, beyond), (fine, left) = (
        noise_squares(own, contrasts_of(own)[0][:2]) for own in (time[::1000], time)
    )
    # noise of rows that are a thousand times as many averages out; a walk does not
    assert fine[1, 0] / coarse[1, 0] == pytest.approx(1.0, rel=0.05)
    assert left / beyond == pytest.approx([1.0, 1000.0], rel=0.05)
    basis, group = contrasts_of(time)
    assert basis.shape == (17, 160_001)
    assert list(group) == [0, 0, 0, 1, 1, 1, 1, *[2] * 8]


@pytest.mark.parametrize("long_s", [8.0, 32.0])
def test_a_walk_has_more_than_its_first_cosines(long_s: float) -> None:
    """The closed form is the sum over very many cosines; 128 of them lack a part of it."""
    time, duration = 1_000.0 + np.arange(0.0, long_s + 1.0), 3_600.0
    weights = slope_weights(time)

    def of_cosines(count: int) -> float:
        scaled = walk_scales(duration, count) * cosines(time, duration, 1 + count)
        return float(((weights @ scaled[:, 1:]) ** 2).sum())

    whole = walk_square(time, weights, duration)
    assert whole == pytest.approx(of_cosines(50_000), abs=5e-3 * weights.sum() ** 2)
    assert whole - of_cosines(128) > 0.3 * weights.sum() ** 2
