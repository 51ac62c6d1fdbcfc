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


def test_an_error_is_one_line_whatever_it_was_told() -> None:
    """Newlines and control characters are escaped, parts of any length are cut; the parts stay."""
    error = InputError("a\nb.toml", "a\ttext", "x" * 10_000, "μ stays")
    assert str(error).isprintable()
    assert str(error).startswith("a\\nb.toml: expected a\\ttext, got xxx")
    assert str(error).endswith("…; μ stays")
    assert len(str(error)) < 1_000
    assert error.got == "x" * 10_000
