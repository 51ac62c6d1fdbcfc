"""Numbers and times as text: what plain digits spell, and nothing else."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_seed, in_utc, parse_number


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_number_is_read_as_it_was_written(value: float) -> None:
    """repr of any finite double comes back, bit for bit."""
    found = parse_number(repr(value))
    assert found is not None
    assert math.copysign(1.0, found) == math.copysign(1.0, value)
    assert found == value


@pytest.mark.parametrize("text", ["-1118", "4.28", "+.5", "5.", "1e3", "1.5E-07", "007"])
def test_plain_spellings_are_numbers(text: str) -> None:
    """Signs, points without digits on one side, exponents."""
    assert parse_number(text) == float(text)


@pytest.mark.parametrize(
    "text",
    ["", ".", "+", "1_0", "0x1f", "nan", "inf", "1e999", "1e", "e5", " 1", "1\n", "٣", "1.2.3"],
)
def test_other_text_is_none(text: str) -> None:
    """What float takes beyond plain digits, and what it does not take."""
    assert parse_number(text) is None


def test_a_number_has_no_thousand_digits() -> None:
    """Longer than any number that means something."""
    assert parse_number("0." + "3" * 398) is not None
    assert parse_number("0." + "3" * 399) is None


@pytest.mark.parametrize(
    ("text", "hour"),
    [("2010-02-13", 0), ("2010-02-13T12:00:00Z", 12), ("2010-02-13T12:00:00+02:00", 10)],
)
def test_times_become_utc(text: str, hour: int) -> None:
    """With a zone or without, as text or as a time."""
    assert in_utc(text) == datetime(2010, 2, 13, hour, tzinfo=UTC)
    assert in_utc(datetime.fromisoformat(text)) == in_utc(text)


@pytest.mark.parametrize("text", ["", "yesterday", "2010-02-31", "0001-01-01T00:00:00+05:00"])
def test_no_time_is_none(text: str) -> None:
    """No date, and one that its zone moves before the year 1."""
    assert in_utc(text) is None


def test_seeds_are_plain_whole_numbers() -> None:
    """Of NumPy's kinds too; what is no whole number, or too large, is refused."""
    for seed in (7, np.int64(7), np.uint8(7)):
        assert type(check_seed(seed)) is int
        assert check_seed(seed) == 7
    for wrong in (True, 7.0, np.float64(7.0), "7", -1, 2**63):
        with pytest.raises(InputError, match="a whole number from 0"):
            check_seed(wrong)
