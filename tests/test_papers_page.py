"""The page of the papers names modules and tests that exist, and leaves no row open."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "topics" / "papers.md").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
    for line in PAGE.splitlines()
    if line.startswith("|") and not line.startswith(("| item", "| ---"))
]


def missing(module: str, test: str) -> list[str]:
    """What a row names that is not there."""
    files = re.findall(r"`([\w/.-]+\.(?:py|toml))`", module)
    found = [name for name in files if not (ROOT / "cassini_bayes" / name).is_file()]
    for name in re.findall(r"`([^`]+)`", test):
        file, _, function = name.partition("::")
        path = ROOT / "tests" / file
        if not path.is_file() or (function and f"def {function}(" not in path.read_text("utf-8")):
            found.append(name)
    return found


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_every_row_names_what_exists(row: list[str]) -> None:
    """Module and test are there, or the row says why nothing is built."""
    assert len(row) == 5
    item, module, test, published, ours = row
    assert all((item, published, ours))
    if module.startswith("not "):
        assert ":" in module
        return
    assert "`" in module
    assert "`" in test
    assert missing(module, test) == []


def test_a_row_that_names_nothing_is_seen() -> None:
    """Negative control: a module or a test that is gone is reported."""
    assert missing("`spacecraft/gone.py`", "`spacecraft/test_two_wheels.py::test_gone`") == [
        "spacecraft/gone.py",
        "spacecraft/test_two_wheels.py::test_gone",
    ]


@pytest.mark.parametrize("paper", ["000", "001", "002", "003", "004"])
def test_every_paper_has_its_table(paper: str) -> None:
    """Five sources, five tables."""
    assert f"## Paper {paper}" in PAGE
