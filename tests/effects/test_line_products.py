"""Inner products of a line beside a linear model are those of columns written out.

Of rows, and of turns whose noise is correlated between axes and unlike about each: taken for that
of body axes, products less what the fit takes away had been below zero, and a search had failed.
"""

from __future__ import annotations

import numpy as np
import pytest
from line_cases import TIME, body

from cassini_bayes.balance.linearised import InnovationRows, Linear
from cassini_bayes.balance.part_columns import ColumnsByPart, PartColumns
from cassini_bayes.balance.statistics.turns import Pieces, WhiteTurns
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.appendage import KnownMotion, known_motion, oscillation_series
from cassini_bayes.effects.line_products import LineProducts, many_lines
from cassini_bayes.effects.line_starts import starts_of
from cassini_bayes.effects.oscillation import over_trapezoids

CORRELATED = np.array([[1.0, 0.0, 0.0], [0.8, 1.0, 0.0], [-0.6, 0.9, 1.0]])
RATIO_PER_S2 = np.array([0.001, 0.02, 0.4])
LINE = (0.031, 0.002)


def rows_and_turns(rng: np.random.Generator) -> tuple[list[InnovationRows], Linear, KnownMotion]:
    """An event's rows and turns, beside a model of forty columns of waves along any direction."""
    n = len(TIME)
    shown = np.stack([body(TIME), 0.5 * body(TIME), 0.2 * body(TIME)], axis=1)
    pieces = Pieces(TIME, np.r_[np.arange(0, n, 16), n])
    turns = WhiteTurns.over(pieces, RATIO_PER_S2)
    waves = np.stack([np.cos(2 * np.pi * f * TIME + f) for f in np.linspace(0.02, 0.04, 40)])
    columns = np.einsum("kn,ka->nak", waves, rng.standard_normal((40, 3)))
    white = rng.standard_normal((n, 3))
    none, still = np.zeros((n, 0)), np.zeros((n, 4))
    rows = InnovationRows("a", TIME, white, white, shown, none, none, (), (), CORRELATED, still)
    of_turns = InnovationRows(
        "a", TIME, pieces.centred(white), white, shown, none, none, (), (), CORRELATED, still, turns
    )
    to_white = np.linalg.inv(CORRELATED)
    seen = np.einsum("ab,nbk->nak", to_white, columns)
    parts = PartColumns.of(seen.reshape(3 * n, -1)), PartColumns.of(turned_white(turns, columns))
    both = ColumnsByPart(parts, 40)
    linear = Linear(np.zeros(6 * n), both, np.full(40, 1e-6))
    return [rows, of_turns], linear, known_motion(TIME, shown)


def turned_white(turns: WhiteTurns, momentum: Array) -> Array:
    """Momentum (n, 3, q) integrated over pieces, with its noise white, (3 n, q)."""
    n = len(momentum)
    integrated = turns.pieces.integrated(momentum.reshape(n, -1)).reshape(n, 3, -1)
    seen = np.einsum("ab,nbk->nak", np.linalg.inv(CORRELATED), integrated)
    return turns.whitened_axes(seen).reshape(3 * n, -1)


def written_out(series: Array, direction: Array, turns: WhiteTurns | None) -> Array:
    """Whitened columns (3 n, q) of series (n, q) along a direction."""
    momentum = series[:, None, :] * direction[:, None]
    if turns is None:
        seen = np.einsum("ab,nbk->nak", np.linalg.inv(CORRELATED), momentum)
        return np.asarray(seen.reshape(-1, series.shape[1]))
    return over_trapezoids(LINE[0], 1.0) * turned_white(turns, momentum)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.6, 0.0, 0.8)])
def test_products_are_those_of_columns_written_out(direction: tuple[float, float, float]) -> None:
    """Gram and projection along a direction, what the fit takes away taken off."""
    events, linear, motion = rows_and_turns(np.random.default_rng(3))
    products = LineProducts(events, [motion, motion], linear, starts_of(events))
    gram, projection = products.about((*LINE, direction), np.eye(5))
    series = np.column_stack(oscillation_series(TIME, motion, *LINE))
    each = [written_out(series, np.array(direction), event.turns) for event in events]
    along = np.concatenate([event.white.reshape(-1) for event in events])
    plain = np.concatenate(each)
    fitted = np.concatenate([part.values for part in linear.columns.parts])
    across = fitted.T @ plain
    expected = plain.T @ plain - across.T @ np.linalg.solve(linear.gram(), across)
    size = np.sqrt(np.diagonal(plain.T @ plain))
    assert gram / np.outer(size, size) == pytest.approx(expected / np.outer(size, size), abs=1e-9)
    assert projection / size == pytest.approx(along @ plain / size, abs=1e-9)


def test_of_all_axes_nothing_is_below_zero() -> None:
    """Series along three axes at once, less what the fit takes away, have a Gram of no sign."""
    events, linear, motion = rows_and_turns(np.random.default_rng(3))
    products = LineProducts(events, [motion, motion], linear, starts_of(events))
    gram, _ = products.along_axes(*LINE)
    values = np.linalg.eigvalsh(gram)
    assert values[0] > -1e-9 * values[-1]


def test_of_many_lines_products_are_the_same_but_for_the_fit() -> None:
    """Projections are exact; squares of turns are good to a quarter, as swings go by frequency."""
    events, _, motion = rows_and_turns(np.random.default_rng(3))
    starts = starts_of(events)
    many = many_lines(events, [motion, motion], (np.array([LINE[0]]), LINE[1]), starts)
    cosine, sine, *_ = oscillation_series(TIME, motion, *LINE)
    for axis, direction in enumerate(np.eye(3)):
        each = [
            written_out(np.column_stack([cosine, sine]), direction, event.turns) for event in events
        ]
        # series as attitudes show them, and not by trapezoids: a part in a thousand at 0.03 Hz
        along = sum(own.T @ e.white.reshape(-1) for own, e in zip(each, events, strict=True))
        squares = sum(own.T @ own for own in each)
        size = np.sqrt(np.diagonal(squares))
        found = many.projection[0, 0, axis, :2]
        assert found / size == pytest.approx(along / size, abs=0.02)
        seen = many.gram[0, 0, axis, :2, :2]
        assert seen / np.outer(size, size) == pytest.approx(
            squares / np.outer(size, size), abs=0.25
        )
