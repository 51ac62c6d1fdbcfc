"""Errors keep their parts wherever they are carried."""

from __future__ import annotations

import copy

from cassini_bayes.errors import InputError


def test_an_error_survives_the_way_out_of_a_worker_process() -> None:
    """A copy, made as a process pool makes it, has the same message, parts and exit status."""
    error = InputError("file.csv: line 2", "a number", "'x'", "write one")
    again = copy.copy(error)
    assert str(again) == str(error) == "file.csv: line 2: expected a number, got 'x'; write one"
    assert (again.where, again.expected, again.got, again.fix) == (
        "file.csv: line 2",
        "a number",
        "'x'",
        "write one",
    )
    assert again.exit_code == 2
