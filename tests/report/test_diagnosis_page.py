"""The page of a diagnosis: its order, what is folded, words for pictures, nothing from outside."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from typing import Any

import numpy as np
from diagnosis_record_cases import CAUSE, SAYS, cause, record

from cassini_bayes.diagnosis.nuisances import Trade
from cassini_bayes.diagnosis.overlay import Channel, Overlay
from cassini_bayes.report.diagnosis_page import render_diagnosis
from cassini_bayes.report.diagnosis_pictures import Drawn
from cassini_bayes.report.diagnosis_slider import width_slider
from cassini_bayes.report.plots.overlays import overlay_figure, trade_figure

PICTURE = Drawn("causes", "Bars of <the> causes.", "Causes.", b"png", b"svg")


class Page(HTMLParser):
    """Tags of a page in order with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep it."""
        self.tags.append((tag, dict(attrs)))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        """Attributes of every one of a kind."""
        return [attributes for name, attributes in self.tags if name == tag]


def whole(best: str = CAUSE) -> dict[str, Any]:
    """A record with all that a page needs; 45 causes are near nothing."""
    near = [cause(f"thruster_leak:{i}", 0.001, -1.0, says="it leaks") for i in range(45)]
    first = cause(best, 0.9, 9.0 if best != "none" else 0.0, says=SAYS if best == CAUSE else None)
    rest = [cause("none", 0.05, 0.0)] if best != "none" else []
    fields = {"elpd": 1.0, "elpd_se": 0.1, "log_evidence": 10.0, "rmse_nms": 0.1}
    return record(
        first,
        *rest,
        *near,
        baseline=fields,
        extended={"causes": [best], **fields},
        sensitivity={"0.5": {best: 0.8}, "2": {best: 0.9}},
        separation=[],
        closure=[],
        findings=["a <b>finding</b>"],
        seed=1,
        command=["cassini-bayes", "diagnose"],
        sha256={"p.toml": "abc"},
        versions={"numpy": "2"},
        fit_percent=[
            {"event": "a", "channel": "rate X", "baseline_percent": 57.8, "extended_percent": 60.0}
        ],
    )


def test_the_answer_stands_before_contents_and_everything_else() -> None:
    """One first heading, then the verdict, then the contents, whose links all lead somewhere."""
    text = render_diagnosis(whole(), [PICTURE], "made up")
    page = Page(text)
    assert len(page.all("h1")) == 1
    assert text.index(SAYS) < text.index("<nav") < text.index('id="causes"')
    names = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(names) == len(set(names))
    targets = [str(a["href"])[1:] for a in page.all("a") if str(a.get("href")).startswith("#")]
    assert set(targets) <= set(names)
    assert "Provenance" in text
    assert "abc" in text


def test_pictures_have_words_and_nothing_comes_from_outside() -> None:
    """Alternative texts, no script, no address but those inside the page; texts are escaped."""
    text = render_diagnosis(whole(), [PICTURE], "made <up>")
    page = Page(text)
    assert [image["alt"] for image in page.all("img")] == ["Bars of <the> causes."]
    assert not page.all("script")
    assert not re.search(r'(src|href)="(?!#|data:)', text)
    assert "<b>finding" not in text
    assert "made &lt;up&gt;" in text


def test_causes_near_nothing_are_one_line_with_the_list_folded() -> None:
    """Forty-five nulls are behind one line where none is best; the first table has none alone."""
    text = render_diagnosis(whole("none"), [PICTURE], "null")
    assert "45 of 45 others cannot be told apart from nothing" in text
    folds = text.index("45 of 45")
    assert "thruster_leak:7" not in text[:folds]
    assert "thruster_leak:7" in text[folds:]


def test_overlay_and_trade_are_drawn_of_what_there_is() -> None:
    """With a cause its part is shaded and the fit has two numbers; without one there is one."""
    time, wave = np.arange(100.0), np.sin(np.arange(100.0) / 9.0)
    wave = wave - wave.mean()
    own = Channel("rate X", "mrad/s", wave, 0.9 * wave)
    both = Channel("wheel 1", "rpm", wave, 0.9 * wave, 0.99 * wave, 0.3 * wave)
    still = Channel("wheel 2", "rpm", 0.1 * wave, wave, 0.1 * wave, 0.0 * wave)
    figure = overlay_figure(Overlay("e", time, (own, both, still)))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert "rate X, fit 90.00 %" in titles
    assert "wheel 1, fit 90.00 → 99.00 %" in titles
    assert "wheel 2, fit below 0 → 100.00 %" in titles
    shaded = [len(axes.collections) for axes in figure.axes]
    assert sum(shaded) == 2
    rng = np.random.default_rng(1)
    draws = rng.normal(size=(50, 2))
    drawn = trade_figure(Trade("c", "size", "thrust level of Z3", -0.7, draws, 3.0 * draws, "N"))
    assert drawn.axes[2].get_ylabel() == "thrust level of Z3 (N)"
    for shift in (0.0, 100.0):  # a prior near the posterior, and one far from it
        far = trade_figure(Trade("c", "size", "tau_fall_s", 0.0, draws + shift, 3.0 * draws))
        low, high = far.axes[2].get_xlim()
        assert low < draws[:, 0].min() + shift
        assert draws[:, 0].max() + shift < high
        assert high - low < 10.0 * np.ptp(draws[:, 0])


def test_what_would_have_been_seen_is_a_table_with_a_place_in_the_contents() -> None:
    """Sizes in words beside what is known of them; without such rows there is no section."""
    row = {
        "cause": "thruster_leak:z3",
        "parameter": "leak_n",
        "unit": "N",
        "size": 3e-6,
        "sd": 5e-7,
        "prior_width": 3e-5,
        "thruster": "z3",
        "says": "Z3 leaks 3 µN or more of thrust without command",
    }
    hidden = {**row, "cause": "center_of_mass:y", "size": None, "sd": None, "says": None}
    text = render_diagnosis(whole("none") | {"visible": [row, hidden]}, [PICTURE], "made up")
    assert "Z3 leaks 3 µN or more of thrust without command" in text
    assert "no size that its prior allows (leak_n)" in text
    assert 'href="#visible"' in text
    assert 'id="visible"' not in render_diagnosis(whole("none"), [PICTURE], "made up")


def at_width(width: float, share: float, k: float, mean: float) -> dict[str, Any]:
    """The verdict at one width of the priors."""
    size = {"mean": mean, "sd": 0.04, "hdi_90": [mean - 0.06, mean + 0.06]}
    return {
        "width": width,
        "pareto_k": k,
        "trusted": k <= 0.7,
        "probabilities": {CAUSE: share, "none": 1.0 - share},
        "cause": CAUSE,
        "sizes": {"thrust_factor": size},
    }


def test_the_slider_moves_probabilities_and_sizes_and_says_where_draws_do_not_reach() -> None:
    """Each width has its own numbers; above k̂ 0.7 none; without widths there is no script."""
    shown = whole()
    size = {"mean": 0.74, "sd": 0.04, "hdi_90": [0.68, 0.80], "unit": ""}
    shown["causes"][0]["parameters"] = {"thrust_factor": size}
    each = (0.5, 0.91, 0.95, 0.76), (1.0, 0.9, 0.1, 0.74), (2.0, 0.8, 0.3, 0.7)
    shown["by_width"] = [at_width(*own) for own in each]
    slider = width_slider(shown)
    assert slider is not None
    assert slider.quantities == (
        f"{CAUSE}: thrust_factor", f"probability of {CAUSE}", "probability of none",
    )  # fmt: skip
    narrow, as_fitted, wide = slider.priors[0].rows
    assert narrow == (None, None, None)
    assert "Pareto k̂ is 0.95, above 0.7" in slider.priors[0].notes[0]
    assert [row.value for row in as_fitted if row] == ["0.740 ± 0.040", "0.900", "0.100"]
    assert [row.value for row in wide if row] == ["0.700 ± 0.040", "0.800", "0.200"]
    text = render_diagnosis(shown, [PICTURE], "slider")
    assert 'id="slider-width"' in text
    shown["by_width"] = []
    assert 'id="slider-width"' not in render_diagnosis(shown, [PICTURE], "none")
