"""Quiet pieces: columns integrated row by row are those of the event's statistics."""

from __future__ import annotations

import numpy as np
import pytest
from telemetry_cases import event_of, made_up_samples, telemetry_priors

from cassini_bayes.balance.statistics.columns import ExtraColumn
from cassini_bayes.balance.statistics.turns import pieces_of, turns_between


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
    total = (turns.slope_gram + turns.gram)[0, 0][kept]
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
        turns = (own.turns.slope_gram + own.turns.gram)[0, 0]
        wheel = own.layout.wheel.start
        grams.append((turns[place, place], turns[place, wheel], own.gram[..., place, place].sum()))
    once, more = grams
    assert more == pytest.approx((2.25 * once[0], 1.5 * once[1], once[2]))
