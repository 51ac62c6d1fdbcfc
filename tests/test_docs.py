"""The documentation hangs together: links lead somewhere, the index names every page."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PARTS = ("tutorial", "how-to", "topics", "reference")
PAGES = sorted(
    path
    for path in DOCS.rglob("*.md")
    if not path.relative_to(DOCS).parts[0].startswith("_")  # what a build leaves
)
TEXTS = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "VISION.md")]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
NAMING = [
    path
    for folder in ("cassini_bayes", "tests", "benchmarks", "priors", "runs", "notebooks")
    for suffix in ("*.py", "*.toml", "*.md", "*.ipynb")
    for path in sorted((ROOT / folder).rglob(suffix))
]
README_LINES = 130
_LINK = re.compile(r"!?\[[^\]]*\]\(([^()\s]+)\)", re.DOTALL)
_ADDRESS = re.compile(r"[a-z]+:")


def prose(path: Path) -> str:
    """The text of a page, or of a notebook's Markdown cells, without blocks of code."""
    text = path.read_text("utf-8")
    if path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    text = re.sub(r"^(```+)(?!\{).*?^\1$", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"(?<!`)`[^`\n]+`(?!`)", "", text)


@cache
def anchors(path: Path) -> frozenset[str]:
    """Anchors of a page's headings, as GitHub and MyST make them."""
    text = re.sub(r"^(```+).*?^\1$", "", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#{1,6} +(.+?) *$", text, flags=re.MULTILINE)
    kept = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return frozenset(heading.replace(" ", "-") for heading in kept)


def broken(text: str, page: Path) -> list[str]:
    """Links of a text, as it stands in a page, that lead nowhere."""
    found = []
    for link in _LINK.findall(text):
        if _ADDRESS.match(link):
            continue
        target, _, anchor = link.partition("#")
        place = (page.parent / target).resolve() if target else page
        if not place.exists() or (anchor and anchor not in anchors(place)):
            found.append(link)
    return found


@pytest.mark.parametrize(
    "page", [*TEXTS, *PAGES, *NOTEBOOKS], ids=lambda path: path.relative_to(ROOT).as_posix()
)
def test_every_link_leads_somewhere(page: Path) -> None:
    """Relative links and anchors of pages, of the files beside them and of notebooks."""
    assert broken(prose(page), page) == []


def test_a_link_that_leads_nowhere_is_seen() -> None:
    """Negative control: a missing page and heading; an address and a page that is there."""
    page = DOCS / "index.md"
    text = (
        "[a](gone.md) [b](topics/priors.md#gone) [c](https://example.org/x) [d](topics/priors.md)"
    )
    assert broken(text, page) == ["gone.md", "topics/priors.md#gone"]


def test_code_names_pages_that_there_are() -> None:
    """A docstring, comment or message that sends a reader to a page sends to one that exists."""
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in NAMING
        for name in re.findall(r"docs/[\w/-]+\.md", path.read_text("utf-8"))
        if not (ROOT / name).is_file()
    ]
    assert wrong == []


@pytest.mark.parametrize("part", PARTS)
def test_the_index_of_a_part_names_every_page(part: str) -> None:
    """A page that is added gets a line in the index of its part, and the order it is read in."""
    index = (DOCS / part / "index.md").read_text("utf-8")
    pages = {path.stem for path in (DOCS / part).glob("*.md")} - {"index"}
    linked = {Path(link).stem for link in _LINK.findall(index) if "/" not in link}
    assert pages - linked == set()


def test_the_index_leads_to_every_part() -> None:
    """The first page names all parts and the results, and no page stands beside it."""
    index = (DOCS / "index.md").read_text("utf-8")
    assert all(f"]({part}/index.md)" in index for part in (*PARTS, "results"))
    assert [path.name for path in DOCS.glob("*.md")] == ["index.md"]


def test_the_comparison_quotes_the_vision() -> None:
    """What is excluded is excluded by words that VISION has."""
    page = (DOCS / "topics" / "comparison.md").read_text("utf-8")
    vision = " ".join((ROOT / "VISION.md").read_text("utf-8").split())
    excluded = [line for line in page.splitlines() if line.startswith("|") and "xcluded" in line]
    assert excluded
    assert all("VISION: “" in line for line in excluded)
    for quoted in re.findall(r"“([^”]+)”", page):
        assert quoted in vision


def test_the_readme_is_short() -> None:
    """What, two commands, a picture, a page of use, links."""
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= README_LINES


def test_what_the_comparison_excludes_stands_in_the_vision() -> None:
    """Every thing of theirs is here, or its row quotes the line that excludes it, word by word."""
    page = (DOCS / "topics" / "comparison.md").read_text("utf-8")
    vision = " ".join((ROOT / "VISION.md").read_text("utf-8").split())
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in page.splitlines()
        if line.startswith("|") and not line.startswith(("| theirs", "| ---"))
    ]
    assert len(rows) > 60
    for theirs, here in rows:
        assert theirs
        assert here
        quotes = re.findall("“([^”]+)”", here) if "VISION" in here else []
        assert bool(quotes) == ("excluded" in here or "VISION" in here), theirs
        for quote in quotes:
            assert quote in vision, quote
