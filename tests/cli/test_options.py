"""Progress on standard error: few plain lines, or one live line in a terminal."""

from __future__ import annotations

import io
import re

import pytest
from rich.console import Console

from cassini_bayes.cli.options import ConsoleReporter


def test_plain_progress_is_the_first_and_the_last_line(capsys: pytest.CaptureFixture[str]) -> None:
    """A hundred pieces within two seconds are no hundred lines; a stage told twice starts anew."""
    reporter = ConsoleReporter(quiet=False)
    for _ in range(2):
        for done in range(101):
            reporter.count("searches", done, 100)
    lines = capsys.readouterr().err.splitlines()
    said = [re.sub(r"^\[ *[\d.]+ s\] ", "", line) for line in lines]
    assert said == ["searches: 0 of 100", "searches: 100 of 100, 0 s left"] * 2


def test_a_terminal_has_one_live_line() -> None:
    """Every count is written over the one before; what is said beside it stays, and so the end."""
    reporter, shown = ConsoleReporter(quiet=False), io.StringIO()
    reporter._console = Console(file=shown, force_terminal=True, highlight=False, width=100)
    for done in range(3):
        reporter.count("searches", done, 3)
    reporter.log("none: log evidence 1.0")
    reporter.count("searches", 3, 3)
    lines = shown.getvalue().split("\n")
    assert len(lines) == 3  # the last is empty
    assert lines[0].count("\r") > 3
    assert lines[0].endswith("none: log evidence 1.0")
    assert lines[1].endswith("searches: 3 of 3, 0 s left")


def test_no_time_is_told_of_the_last_one(capsys: pytest.CaptureFixture[str]) -> None:
    """What is left longest takes longest: no time is promised for it, which others were to take."""
    ConsoleReporter(quiet=False).count("cells", 112, 113)
    assert capsys.readouterr().err.endswith("cells: 112 of 113, the last one is at work\n")


def test_quiet_is_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing at all."""
    reporter = ConsoleReporter(quiet=True)
    reporter.log("reading")
    reporter.count("searches", 0, 3)
    assert capsys.readouterr().err == ""
