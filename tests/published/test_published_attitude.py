"""The real attitude records: conventions confirmed by the records themselves."""

from __future__ import annotations

import numpy as np

from cassini_bayes.balance.statistics.turns import turns_between
from cassini_bayes.published.attitude import attitude_records
from cassini_bayes.spacecraft.attitude import direction_cosines


def test_rates_and_turns_of_the_attitude_tell_the_same_motion() -> None:
    """Stored rates against attitude differences: a median of 7 to 10 µrad/s on every axis."""
    for record in attitude_records():
        turns = turns_between(direction_cosines(record.attitude))
        step = np.diff(record.time_s)[:, None]
        middle = 0.5 * (record.rate_rad_s[1:] + record.rate_rad_s[:-1])
        miss = np.median(np.abs(middle - turns / step), axis=0)
        assert np.all((miss > 6e-6) & (miss < 1.1e-5))


def test_the_other_convention_would_be_seen() -> None:
    """Negative control: inverse attitudes miss the rates of a slew by hundreds of µrad/s."""
    record = attitude_records()[-1]
    inverse = record.attitude * np.array([-1.0, -1.0, -1.0, 1.0])
    turns = turns_between(direction_cosines(inverse))
    middle = 0.5 * (record.rate_rad_s[1:] + record.rate_rad_s[:-1])
    miss = np.median(np.abs(middle - turns / np.diff(record.time_s)[:, None]))
    assert miss > 1e-4


def test_records_are_whole() -> None:
    """Counts, unit norms, 4 s steps after the first ones, rates in steps of 5 µrad/s."""
    records = {record.name: record for record in attitude_records()}
    assert [len(record.time_s) for record in records.values()] == [222, 222, 2428]
    for record in records.values():
        np.testing.assert_allclose(np.linalg.norm(record.attitude, axis=1), 1.0, atol=1e-12)
        assert np.all(np.diff(record.time_s) > 0.0)
        # all but some records at the start and end of a segment
        steps = np.abs(record.rate_rad_s / 5e-6 - np.round(record.rate_rad_s / 5e-6))
        assert (steps.max(1) < 0.02).mean() > 0.98
        assert np.median(np.diff(record.time_s)) == 4.0
