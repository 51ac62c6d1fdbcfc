"""Late records: columns and offsets against pulses that are delivered as they are."""

from __future__ import annotations

import numpy as np
import pytest

from cassini_bayes.balance.statistics import RowContext
from cassini_bayes.effects.firings import TAIL_S
from cassini_bayes.effects.time_offset import (
    LAG_S,
    OFFSETS_S,
    PULSE_S,
    column_name,
    columns,
    delivered,
    hat_weights,
    seen_offset,
)
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

TAU_S = 0.010, 0.020, 0.050
FIRST_ORDER = PULSE_SHAPES["first_order"]
EVERY_S = 20  # a pulse in so many readings: each stands alone
FIRED = 4_000


def delivered_share(age_s: np.ndarray, width_s: float) -> np.ndarray:
    """Share of a pulse's impulse that is there at an age, by its thrust curve."""
    grid = np.linspace(0.0, 4.0, 40_001)
    thrust = FIRST_ORDER.thrust_fraction(grid, width_s, *TAU_S)
    so_far = np.cumsum(thrust)
    return np.interp(age_s, grid, so_far / so_far[-1])


def context(offset_s: float, width_s: float) -> tuple[RowContext, np.ndarray, np.ndarray]:
    """Readings at 1 Hz of pulses at random moments, shown late; what is delivered; quiet rows."""
    rng = np.random.default_rng(7)
    start = EVERY_S * np.arange(1.0, FIRED) + rng.uniform(0.0, 1.0, FIRED - 1)
    time = np.arange(float(EVERY_S * FIRED))
    count = np.searchsorted(start, time - offset_s, side="right").astype(float)
    before = np.searchsorted(start, time, side="right")
    age = time - start[np.maximum(before - 1, 0)]
    last = np.where(before > 0, delivered_share(age, width_s), 0.0)
    there = (width_s + TAIL_S) * (np.maximum(before - 1, 0) + last)
    counters = time, width_s * count[:, None], count[:, None]
    quiet = np.concatenate([[False], np.diff(count) == 0.0])
    return (
        RowContext(time, np.zeros((len(time), 3)), np.zeros((len(time), 3)), *counters),
        (there - (width_s + TAIL_S) * count),
        quiet,
    )


@pytest.mark.parametrize("width_s", [0.03, 0.06, 0.125])
@pytest.mark.parametrize("offset_s", [0.15, 0.3, 0.6, 1.0, 1.6, -0.5, -1.0, -1.6])
def test_rows_of_a_late_record_are_wrong_by_what_the_columns_say(
    offset_s: float, width_s: float
) -> None:
    """Mean of what quiet rows of 4,000 pulses at random moments lack, within chance and 15 ms."""
    rows, lacking, quiet = context(offset_s, width_s)
    shares = hat_weights(seen_offset(np.array([offset_s])), np.array(OFFSETS_S))[0]
    made = {column.name: column.values(rows) for column in columns(("z1",))}
    said = sum(
        share * made[column_name("z1", node)]
        for share, node in zip(shares, OFFSETS_S, strict=True)
        if node != 0.0
    )
    whole = (width_s + TAIL_S) * FIRED
    wrong = float(lacking[quiet].sum()) / whole
    found = float(said[quiet].sum()) / whole
    chance = 4.0 * 0.5 / np.sqrt(FIRED)
    assert found == pytest.approx(wrong, abs=chance + 0.015)


def test_a_record_taken_as_delivered_at_once_would_be_found_earlier() -> None:
    """Negative control: the hidden share at 0.3 s is 0.21, and not 0.3."""
    _, lacking, quiet = context(0.3, PULSE_S)
    share = float(lacking[quiet].sum()) / ((PULSE_S + TAIL_S) * FIRED)
    assert share == pytest.approx(0.3 - LAG_S - 0.5 * PULSE_S, abs=0.03)


def test_lags_are_the_mean_times_of_thrust_curves() -> None:
    """The mean time of the thrust beyond half the width, of pulses of 15 to 500 ms."""
    grid = np.linspace(0.0, 2.0, 20_001)
    for width in (0.015, 0.06, 0.125, 0.5):
        thrust = FIRST_ORDER.thrust_fraction(grid, width, *TAU_S)
        mean = float(grid @ thrust / thrust.sum())
        assert mean - 0.5 * width == pytest.approx(LAG_S, abs=0.01)


def test_increments_are_delivered_by_a_lag_later() -> None:
    """Straight lines from start to end of every interval, each later by its own lag."""
    time, counted = np.arange(5.0), np.array([0.0, 1.0, 1.0, 3.0, 3.0])
    lag = np.array([0.25, 0.1, 0.5, 0.1])
    at = np.array([0.0, 0.25, 0.75, 1.25, 2.0, 2.5, 3.0, 3.5, 4.0])
    wanted = [0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 2.0, 3.0, 3.0]
    assert delivered(at, time, counted, lag) == pytest.approx(np.array(wanted))


def test_offsets_are_seen_as_straight_lines_between_columns() -> None:
    """None is none, the nodes are themselves, and no larger offset is seen as a smaller one."""
    assert seen_offset(np.array(OFFSETS_S)) == pytest.approx(np.array(OFFSETS_S))
    grid = np.linspace(-2.0, 2.0, 401)
    assert (np.diff(seen_offset(grid)) >= 0.0).all()
