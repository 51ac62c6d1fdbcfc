"""No notice of ArviZ's reaches a user, on the first run of a day either."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


def first_import_of_the_day(home: Path, code: str) -> str:
    """What a fresh process prints where ArviZ's cache, which holds the day, is empty."""
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "XDG_CACHE_HOME": str(home), "HOME": str(home)},
        capture_output=True,
        text=True,
        check=True,
    ).stderr


@pytest.mark.parametrize("name", ["arviz", "corner"])
def test_first_import_of_a_day_is_quiet(tmp_path: Path, name: str) -> None:
    """Control: the plain import does print it, once."""
    quiet = f"from cassini_bayes.computing.arviz_import import {name}; {name}()"
    assert first_import_of_the_day(tmp_path / "a", quiet) == ""
    assert "ArviZ is undergoing" in first_import_of_the_day(tmp_path / "b", f"import {name}")


def test_other_warnings_are_left_alone() -> None:
    """The filters are as before, so that a later warning is still shown."""
    code = (
        "import warnings; from cassini_bayes.computing.arviz_import import arviz\n"
        "before = warnings.filters[:]; arviz(); assert before == warnings.filters[-len(before):]\n"
        "warnings.warn('seen')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "seen" in done.stderr
