"""Free oscillations of events that start alike or anew: which rows have which, and their turns."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cassini_bayes.effects.line_starts import in_common, starts_of, turned, turns


def test_rows_and_turns_of_an_event_share_a_start() -> None:
    """The rows of all events come first, then their turns in the same order."""
    rows: list[Any] = [SimpleNamespace(turns=of) for of in (None, None, None, 1, 1, 1)]
    starts = starts_of(rows)
    assert starts.of_rows == (0, 1, 2, 0, 1, 2)
    assert starts.count == 3
    assert starts.series(1).tolist() == [2, 3, 6, 7, 8]
    assert starts_of(rows[:1]).of_rows == (0,)


def test_one_oscillation_in_all_events_has_the_sum_of_their_columns() -> None:
    """Cosines to cosines, sines to sines; what drives is one for all already."""
    columns = np.arange(9.0)  # three events: c s c s c s, x y z
    assert (columns @ in_common(3, 1)).tolist() == [0 + 2 + 4, 1 + 3 + 5, 6, 7, 8]
    assert (columns @ in_common(3, 3)).tolist() == columns.tolist()


def test_what_turns_one_oscillation_gives_back_all() -> None:
    """Sizes of all events are those of one, turned; of one event, and of none, it is left alone."""
    rng = np.random.default_rng(3)
    swings = rng.standard_normal(8)
    turn = turns(swings)
    assert np.mean(np.abs(turn) ** 2) == pytest.approx(1.0)
    largest = int(np.hypot(swings[::2], swings[1::2]).argmax())
    assert turn[largest].imag == pytest.approx(0.0)
    one = (swings[2 * largest] + 1j * swings[2 * largest + 1]) / turn[largest].real
    assert turned(turn) @ [one.real, one.imag, 0.2] == pytest.approx([*swings, 0.2])
    assert turns(swings[:2]) == pytest.approx([1.0])
    assert turned(turns(swings[:2])) == pytest.approx(np.eye(3))
    assert turns(np.zeros(4)) == pytest.approx([1.0, 1.0])
