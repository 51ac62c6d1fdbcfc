"""Matrices kept by part do what the same matrices do when they are written out."""

import numpy as np
import pytest

from cassini_bayes.balance.part_columns import ColumnsByPart, PartColumns, spread

COUNTS = [6, 9, 3]


def written_out() -> np.ndarray:
    """Three parts of a matrix: columns of one part, of two, of all and of none."""
    columns = np.random.default_rng(1).standard_normal((sum(COUNTS), 6))
    first, second, third = np.split(columns, np.cumsum(COUNTS)[:-1])
    first[:, 2] = third[:, 2] = second[:, 3] = third[:, 3] = first[:, 4] = 0.0
    columns[:, 5] = 0.0
    return columns


def test_products_are_those_of_the_whole_matrix() -> None:
    """X x, Xᵀ y, Xᵀ X, some columns alone, and the matrix itself."""
    whole, rng = written_out(), np.random.default_rng(2)
    kept = ColumnsByPart.of(whole, COUNTS)
    factors, values = rng.standard_normal((6, 2)), rng.standard_normal((len(whole), 3))
    assert kept.shape == whole.shape
    assert kept @ factors == pytest.approx(whole @ factors)
    assert kept @ factors[:, 0] == pytest.approx(whole @ factors[:, 0])
    assert kept.along(values) == pytest.approx(whole.T @ values)
    assert kept.gram() == pytest.approx(whole.T @ whole)
    some = np.array([1, 3, 5])
    assert np.array_equal(kept.chosen(some).written_out(), whole[:, some])
    assert np.array_equal(kept.written_out(), whole)


def test_parts_keep_only_what_they_have() -> None:
    """Columns that are zero in a part are not there; spread puts the others where they were."""
    kept = ColumnsByPart.of(written_out(), COUNTS)
    assert [part.places.tolist() for part in kept.parts] == [[0, 1, 3], [0, 1, 2, 4], [0, 1, 4]]
    assert [(own.start, own.stop) for own in kept.slices] == [(0, 6), (6, 15), (15, 18)]
    part = kept.parts[1]
    assert np.array_equal(spread(part.values, part.places, 6), written_out()[6:15])
    assert PartColumns.of(np.zeros((4, 3))).values.shape == (4, 0)
