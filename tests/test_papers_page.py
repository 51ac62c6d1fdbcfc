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


# What the papers print, counted in their text: numbered equations, tables, appendices. Appendix C
# of 004 is its equations.
PRINTED = {
    "000": ("1-24", "1, 2, A1", "A, B, C, D"),
    "001": ("1-23", "1, 2, 3", ""),
    "002": ("1-4", "", ""),
    "003": ("1-8", "1, 2", ""),
    "004": ("1-19, C1-C9, D1-D5", "1, 2, 3", "A, B, D"),
}
NUMBERS = r"[A-D]?\d+(?:-[A-D]?\d+)?"


def spelt_out(text: str) -> set[str]:
    """Numbers of a list with ranges: 1, 8, C1-C3."""
    found = set()
    for each in re.findall(NUMBERS, text):
        first, _, last = each.partition("-")
        letter = first.rstrip("0123456789")
        ends = [int(end.lstrip("ABCD")) for end in (first, last or first)]
        found |= {f"{letter}{number}" for number in range(ends[0], ends[1] + 1)}
    return found


def covered(rows: str) -> tuple[set[str], set[str], set[str]]:
    """Equations, tables and appendices that the items of some rows name."""
    items = re.findall(r"(?m)^\| (.+?) \|", rows)
    equations = [m for item in items for m in re.findall(rf"eqs?\. ((?:{NUMBERS}(?:, )?)+)", item)]
    tables = [m for item in items for m in re.findall(r"Tables? ((?:[A-D]?\d(?:, )?)+)", item)]
    appendices = [m for item in items for m in re.findall(r"App\. ((?:[A-D](?:, )?\b)+)", item)]
    return (
        spelt_out(" ".join(equations)),
        set(re.findall(r"[A-D]?\d", " ".join(tables))),
        set(re.findall("[A-D]", " ".join(appendices))),
    )


@pytest.mark.parametrize("paper", PRINTED)
def test_every_number_of_a_paper_has_a_row(paper: str) -> None:
    """No equation, table or appendix that a paper prints is left out, and none is made up."""
    rows = PAGE.split(f"## Paper {paper}")[1].split("\n## ")[0]
    equations, tables, appendices = PRINTED[paper]
    assert covered(rows) == (
        spelt_out(equations),
        set(re.findall(r"\w+", tables)),
        set(re.findall(r"\w", appendices)),
    )


def test_a_number_without_a_row_is_seen() -> None:
    """Negative control: a page whose row of eq. 2 is gone does not have it."""
    rows = "| eqs. 1, 3-5, C2: sums | a |\n| App. A, Table A1: more | b |\n"
    assert covered(rows) == ({"1", "3", "4", "5", "C2"}, {"A1"}, {"A"})
