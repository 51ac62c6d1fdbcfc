"""The report: valid, self-contained, escaped, complete, for any shape of run."""

from __future__ import annotations

import base64
import dataclasses
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from made_up_review import blank, full_review, made_up_review, page_of

from cassini_bayes.errors import InputError
from cassini_bayes.report import (
    figures_of,
    render_report,
    sections_of,
    write_report,
    write_tables,
)
from cassini_bayes.report import sections as registry
from cassini_bayes.report.checks import balance_caption
from cassini_bayes.report.page import Chapter, Paragraph, Section
from cassini_bayes.report.verdict import NOT_CONVERGED
from cassini_bayes.results.review import Review

VOID = {"meta", "link", "br", "img", "input", "hr", "col", "wbr"}


class Page(HTMLParser):
    """Tags that balance, ids, addresses and the text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.faults: list[str] = []
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.words: list[str] = []
        self.feed(html)
        self.close()
        self.faults += [f"never closed: {tag}" for tag in self.open]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "action", "data", "poster", "srcset"):
                self.addresses.append(value or "")
            if name.startswith("on"):
                self.faults.append(f"{tag} {name}")

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.faults.append(f"unbalanced: {tag}")

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def review() -> Review:
    """Eight events, eight thrusters."""
    return full_review()


@pytest.fixture(scope="module")
def html(review: Review) -> str:
    """Its report, with a place for every figure (drawn in test_plots.py)."""
    sections = sections_of(review)
    drawings = {own.name: own.draw for section in sections for own in section.drawings}
    return render_report(review, sections, blank(drawings))


def test_the_page_is_well_formed(html: str) -> None:
    """Tags balance, ids are unique, every inner link has its target; the check sees a fault."""
    page = Page(html)
    assert page.faults == []
    assert len(page.ids) == len(set(page.ids))
    inner = [a[1:] for a in page.addresses if a.startswith("#")]
    assert len(inner) == 11
    assert set(inner) <= set(page.ids)
    assert html.lstrip().startswith("<!DOCTYPE html>")
    assert Page("<p><b></p>").faults != []


def test_the_page_needs_nothing_else(html: str) -> None:
    """No script, no style sheet, no address but inner links and pictures held in the page."""
    page = Page(html)
    assert {"script", "link", "iframe", "object", "embed", "base"} & set(page.tags) == set()
    assert all(a.startswith(("#", "data:image/")) for a in page.addresses)
    style = re.search(r"<style>(.*?)</style>", html, re.S)
    assert style is not None
    assert "url(" not in style[1]
    assert "@import" not in style[1]
    assert "http" not in style[1]


def test_every_picture_has_its_place(html: str) -> None:
    """Those of the figures, in their order, inside the page."""
    found = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    names = [base64.b64decode(own).decode() for own in found]
    assert len(names) == len(set(names)) == 14
    assert names[0] == "thrusts"


def test_every_thruster_in_every_event_is_listed(html: str, review: Review) -> None:
    """Both names in one table of the event, its numbers as tabulated."""
    for event in review.fit.posterior.coords["event"].values:
        part = html.split(f"<summary>{event} <")[1].split("</details>")[0]
        names = re.findall(r'<th scope="row">(\w+)</th>', part)
        assert names == [str(t) for t in review.fit.posterior.coords["thruster"].values]
    row = review.summary[review.summary["name"] == f"thrust_n[{event},z1]"].iloc[0]
    assert f"<td>{row['mean']:.3f} ± {row['sd']:.3f}</td>" in part


def test_order_summary_then_warnings_then_the_headline(html: str) -> None:
    """What must be seen first comes first."""
    places = [
        html.index(mark)
        for mark in (
            "<h1>", 'class="verdict"', "Read this first", 'class="numbers"', 'class="summary"',
            'id="contents"', 'id="thrusts"', 'id="numbers"',
            'id="nuisances"', 'id="budget"', 'id="checks"', 'id="delta-v"', 'id="convergence"',
            'id="provenance"', 'id="glossary"',
        )
    ]  # fmt: skip
    assert places == sorted(places)


def test_the_verdict_names_the_prior_and_what_is_known_well(html: str, review: Review) -> None:
    """Level, prior and narrowing by hand; the impulse's relative width over all thrusters."""
    first = Page(html.split('<div class="verdict">')[1].split("</div>")[0]).text
    common = review.summary[review.summary["quantity"] == "thrust_common_n"].iloc[0]
    assert f"Thrust {common['mean']:.3f} ± {common['sd']:.3f} N" in first
    narrower = 100 * (1 - common["sd"] / common["prior_sd"])
    before = f"{common['prior_mean']:.3f} ± {common['prior_sd']:.3f} N"
    assert f"{narrower:.0f} % narrower than the prior, {before}" in first
    draws = review.fit.posterior["impulse_per_on_time_n"]
    relative = (draws.std(("chain", "draw"), ddof=1) / draws.mean(("chain", "draw"))).values
    kept = relative[relative <= 2 * np.median(relative)]
    assert f"to {100 * kept.min():.2g}–{100 * kept.max():.2g}" in first
    assert html.index('class="verdict"') < html.index("<figure")


@pytest.mark.parametrize("converged", [True, False])
def test_a_page_of_no_result_says_so_first(
    converged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the command does: before any number, and nowhere where the fit converged."""
    monkeypatch.setattr("cassini_bayes.report.is_converged", lambda _: converged)
    own = made_up_review()
    text = Page(render_report(own, sections_of(own), {})).text
    assert (NOT_CONVERGED in text) is not converged
    if not converged:
        assert text.index(NOT_CONVERGED) < text.index("Thrust 0")


def test_a_card_says_how_much_of_the_posterior_is_prior(html: str, review: Review) -> None:
    """The share is the ratio of variances; what an event is worth is said; the table is its own."""
    event = str(review.fit.posterior.coords["event"].values[0])
    part = html.split(f"<summary>{event} <")[1].split("</details>")[0]
    row = review.summary[review.summary["name"] == f"thrust_n[{event},z1]"].iloc[0]
    share = 100 * (row["sd"] / row["prior_sd"]) ** 2
    assert f"<td>{share:.0f} %</td>" in part
    assert "Thrust levels, on average: 2.0 %" in part  # 0.02 / 0.98


def test_the_page_is_for_light_dark_and_print(html: str) -> None:
    """Colours for both, folds that open in print, folded long tables, one skip link."""
    assert "prefers-color-scheme: dark" in html
    assert "details::details-content" in html
    assert html.count("<details open") == 0
    assert html.count("<details") >= 20
    assert html.index('href="#contents"') < html.index("<main>")


def test_summary_says_spread_and_what_limits(html: str, review: Review) -> None:
    """The numbers in the paragraph under the verdict are the tables' own."""
    first = Page(html.split('<p class="summary">')[1].split("</p>")[0]).text
    shares = review.budget.filter(like="|share").drop(
        columns=["noise-only|share", "nonlinear|share"]
    )
    worst = shares.mean().idxmax().removesuffix("|share")
    assert f"{worst} limits the accuracy most: {100 * shares.mean().max():.0f} %" in first


def test_intervals_say_kind_and_probability(html: str) -> None:
    """Headings name the 90 % HDI, the text spells it out."""
    assert "90 % HDI [N]" in html
    assert "90 % highest-density interval" in html
    assert "90 % equal-tailed interval" in html


def test_a_conflict_is_flagged_and_a_computed_delta_v_explained(html: str) -> None:
    """The parameter in conflict is named in the text and marked in the table."""
    text = Page(html).text
    assert "In conflict with their priors: cm_y_m" in text
    assert '<td class="flag">conflict</td>' in html
    assert "nothing about the true thrust" in text


def test_on_times_the_model_does_not_predict_raise_no_alarm(review: Review) -> None:
    """A replicate that cannot vary has no tail probability, and is left out of the count."""
    html = page_of(review, {})
    fixed = int((review.predictive["sd_s"] == 0).sum())
    assert fixed > 0
    assert html.count("set by the limit cycle</td>") == fixed
    assert f"of the {len(review.predictive) - fixed} on-times so predicted" in html


def test_malicious_names_are_escaped() -> None:
    """Markup in an event id, a thruster's note, a fact or a warning stays text."""
    evil = '<script>alert("x")</script>'
    review = made_up_review(event_ids=[evil, 'b"><img src=x onerror=y>'], draws=40)
    frames = {**vars(review), "warnings": (evil,)}
    review = dataclasses.replace(review, name=evil, facts={evil: evil, "Stop rule": evil})
    fields = {field.name for field in dataclasses.fields(review)}
    vars(review).update({name: own for name, own in frames.items() if name not in fields})
    thrusts = [own for own in sections_of(review) if own.chapter is Chapter.THRUSTS]
    html = page_of(review, figures_of(thrusts))
    page = Page(html)
    assert page.faults == []
    assert "script" not in page.tags
    assert evil not in html
    assert page.text.count(evil) >= 5
    assert all(a.startswith(("#", "data:image/")) for a in page.addresses)


@pytest.mark.parametrize(
    "shape",
    [
        {"n_events": 1, "delta_v": False},
        {"baseline": False, "delta_v": False},
        {"missing_cells": True},
        {"n_thrusters": 12, "n_events": 2},
        {"n_events": 1, "n_thrusters": 1},
    ],
    ids=str,
)
def test_other_shapes_of_run_give_a_whole_report(shape) -> None:
    """Tables without figures: well formed, no NaN in sight."""
    review = made_up_review(draws=40, **shape)
    page = Page(page_of(review, {}))
    assert page.faults == []
    assert re.search(r"\bnan\b|\binf\b|\bNone\b", page.text) is None
    if not shape.get("baseline", True):
        assert "No estimates by the replaced methods" in page.text
    if not shape.get("delta_v", True):
        assert "No event of this run declares a computed ΔV" in page.text


def test_writing_is_atomic_and_refusal_is_one_line(review: Review, tmp_path: Path) -> None:
    """The file holds what was rendered; a folder in its place is an input error."""
    sections = sections_of(review)
    write_report(review, sections, {}, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == page_of(review, {})
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError) as caught:
        write_report(review, sections, {}, tmp_path / "folder")
    assert "\n" not in str(caught.value)


def test_a_table_is_one_function_in_the_registry(
    review: Review, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One more function gives a file, a section, a line of text; tables have distinct files."""

    def added(own: Review) -> Iterator[Section]:
        frame = own.summary[["name", "mean"]]
        yield Section(Chapter.THRUSTS, (Paragraph("one more"),), "Added", "added", frame)

    before = [own.name for own in sections_of(review) if own.frame is not None]
    assert len(before) == len(set(before)) >= 7
    monkeypatch.setattr(registry, "SECTIONS", (*registry.SECTIONS[:4], added))
    sections = sections_of(review)
    write_tables(sections, tmp_path)
    assert (tmp_path / "added.csv").read_text().startswith("name,mean")
    page = Page(render_report(review, sections, {}))
    assert "Added one more" in page.text
    assert page.faults == []


def test_tables_without_figures_load_no_plotting_library(tmp_path: Path) -> None:
    """A fit without a report writes its tables and never imports matplotlib."""
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from cassini_bayes.report import sections_of, write_tables\n"
        "import made_up_review as m\n"
        "sections = sections_of(m.made_up_review(n_events=2, draws=40))\n"
        f"write_tables(sections, Path({str(tmp_path)!r}))\n"
        "print([name for name in ('matplotlib', 'corner') if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True,
        cwd=Path(__file__).parents[1], timeout=120,
    )  # fmt: skip
    assert done.stdout.strip() == "[]"
    assert (tmp_path / "nuisances.csv").exists()


def test_the_headline_is_big_enough_for_a_phone_only_when_enlarged(html: str) -> None:
    """Pictures shrink to the page; a tap (no script) enlarges one inside its own frame."""
    assert html.count('type="checkbox"') == html.count("<figure")
    assert not re.findall(r"#figure-[\w-]+ img", html)  # would hold for the enlarged one, too
    assert "overflow-x: auto" in html
    assert 'name="viewport"' in html


def test_the_balance_is_explained_for_the_events_that_there_are() -> None:
    """Of telemetry the body's momentum and channel noise are named, of totals the dead-band."""
    recorded = balance_caption(telemetry=True, totals=False)
    assert "body and wheels" in recorded
    assert "dead-band" not in recorded
    assert "body and wheels" not in balance_caption(telemetry=False, totals=True)
    both = balance_caption(telemetry=True, totals=True)
    assert both.index("Totals: ") < both.index("dead-band") < both.index("Telemetry: ")
