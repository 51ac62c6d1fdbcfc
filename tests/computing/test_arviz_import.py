"""No notice of ArviZ's reaches a user, on the first run of a day either."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def first_import_of_the_day(home: Path, code: str) -> str:
    """What a fresh process prints where ArviZ's cache, which holds the day, is empty."""
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "XDG_CACHE_HOME": str(home), "HOME": str(home)},
        capture_output=True,
        text=True,
        check=True,
    ).stderr


def test_first_import_of_a_day_is_quiet(tmp_path: Path) -> None:
    """ArviZ, and corner, which imports it; control: the plain import does print the notice."""
    quiet = "from cassini_bayes.computing.arviz_import import arviz, corner; corner(); arviz()"
    assert first_import_of_the_day(tmp_path / "a", quiet) == ""
    assert "ArviZ is undergoing" in first_import_of_the_day(tmp_path / "b", "import arviz")


def test_other_warnings_are_left_alone(tmp_path: Path) -> None:
    """The filters are as before, so that a later warning is still shown.

    A made-up library stands in for ArviZ, which takes two seconds to import.
    """
    (tmp_path / "arviz.py").write_text("import warnings; warnings.warn('own', UserWarning)")
    code = (
        f"import sys, warnings; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from cassini_bayes.computing.arviz_import import arviz\n"
        "before = warnings.filters[:]; arviz(); assert before == warnings.filters[-len(before):]\n"
        "warnings.warn('seen')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "own" in done.stderr
    assert "seen" in done.stderr
