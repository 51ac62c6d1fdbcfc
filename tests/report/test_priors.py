"""The prior slider: what the page shows is what a sweep's weights say, or nothing."""

from __future__ import annotations

import json
import re

import pandas as pd
import pytest
from sweep_cases import small_fit

from cassini_bayes.report import render_report
from cassini_bayes.report.page import Section, Slider
from cassini_bayes.report.plots.quantities import interval, plus_minus
from cassini_bayes.report.priors import COMMON_GROUP, prior_slider
from cassini_bayes.results.record import Fit
from cassini_bayes.results.review import Review
from cassini_bayes.spacecraft.parameters import THRUST_COMMON
from cassini_bayes.sweep.cells import reweighted
from cassini_bayes.sweep.models import Factory, walked_values
from cassini_bayes.sweep.plan import plan
from cassini_bayes.sweep.specification import SweepFile
from cassini_bayes.sweep.variations import Variation
from cassini_bayes.sweep.weights import moments
from cassini_bayes.sweep.widths import HIGH, LOW, WIDTHS

QUANTITIES = ["thrust_common_n", "thrust_level_n"]


@pytest.fixture(scope="module")
def fitted() -> tuple[Factory, Fit]:
    """Two flight events."""
    return small_fit()


@pytest.fixture(scope="module")
def review(fitted: tuple[Factory, Fit]) -> Review:
    """That fit under review."""
    factory, fit = fitted
    model = factory.build(factory.priors).model
    draws = walked_values(fit.posterior, model.space.names, model.spacecraft)
    z = model.space.to_standard({name: draws[name] for name in model.space.names})
    return Review("small", model, factory.priors, fit, z, pd.DataFrame(), {})


@pytest.fixture(scope="module")
def section(review: Review) -> Section:
    """Its section on priors."""
    return next(prior_slider(review))


def slider_in(section: Section) -> Slider:
    """The slider of the section."""
    return next(block for block in section.blocks if isinstance(block, Slider))


def test_so_few_draws_that_no_weights_are_trusted_have_no_slider(
    review: Review, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even those of the prior as it was: nothing is shown, and nothing fails."""
    monkeypatch.setattr("cassini_bayes.sweep.weights.FEWEST_DRAWS", 1e9)
    assert list(prior_slider(review)) == []


@pytest.mark.parametrize("width", [0.5, 2.0**0.5])
def test_the_page_shows_the_posterior_that_the_package_weights(
    fitted: tuple[Factory, Fit], section: Section, width: float
) -> None:
    """Texts of levels under a changed tail-off prior are those of a sweep's cell."""
    factory, fit = fitted
    baseline = plan(factory, fit, SweepFile(quantities=QUANTITIES), "test").baseline
    slider = slider_in(section)
    own = next(prior for prior in slider.priors if prior.name == "tail-off")
    names = tuple(
        n for n in section.frame["parameters"][section.frame["prior"] == own.name].iloc[0].split()
    )
    variation = Variation("tail-off", "width", names, amount=width)
    model = factory.build(variation.applied(factory.priors))
    weights, values = reweighted(baseline, variation, model)
    place = WIDTHS.index(width)
    assert own.trusted[place] == weights.trusted
    assert weights.trusted
    found = moments(values, weights.values)
    for j, name in enumerate(baseline.names):
        label = "common thrust" if name == "thrust_common_n" else f"{name[15:-1]} level"
        row = own.rows[place][slider.quantities.index(label)]
        assert row is not None
        assert row.value == plus_minus(found.mean[j], found.sd[j])
        assert row.interval == interval(found.quantiles[LOW, j], found.quantiles[HIGH, j])


def test_weights_on_the_drawn_back_common_thrust_agree_with_the_collapsed_ones(
    fitted: tuple[Factory, Fit], section: Section
) -> None:
    """A sweep weights the density with thrusts integrated out: the same but for sampling."""
    factory, fit = fitted
    baseline = plan(factory, fit, SweepFile(quantities=["thrust_common_n"]), "test").baseline
    variation = Variation("thrust", "width", (THRUST_COMMON,), amount=0.5)
    model = factory.build(variation.applied(factory.priors))
    weights, values = reweighted(baseline, variation, model)
    found = moments(values, weights.values)
    frame = section.frame
    assert frame is not None
    row = frame[
        (frame["prior"] == COMMON_GROUP)
        & (frame["width"] == 0.5)
        & (frame["quantity"] == "common thrust")
    ].iloc[0]
    error = found.sd[0] * (weights.effective**-0.5 + row["effective_draws"] ** -0.5)
    assert abs(row["mean"] - found.mean[0]) < 4 * error
    assert abs(row["sd"] - found.sd[0]) < 4 * error
    as_fitted = frame[(frame["width"] == 1.0) & (frame["quantity"] == "common thrust")]["sd"].iloc[
        0
    ]
    assert as_fitted - found.sd[0] > 10 * error  # control: the prior matters


def test_where_the_draws_cannot_say_nothing_is_shown(section: Section) -> None:
    """No number and a sentence with the reason, exactly where the weights are not trusted."""
    told = 0
    for prior in slider_in(section).priors:
        for i, trusted in enumerate(prior.trusted):
            assert all((row is not None) is trusted for row in prior.rows[i])
            assert ("cannot say" in prior.notes[i]) is not trusted
            told += trusted
    assert told < sum(len(prior.trusted) for prior in slider_in(section).priors)
    assert all(prior.trusted[WIDTHS.index(1.0)] for prior in slider_in(section).priors)


def test_the_page_holds_the_numbers_and_a_script_of_its_own(
    section: Section, review: Review
) -> None:
    """Data as JSON that cannot end the script; labels on both controls; no address, no network."""
    html = render_report_of(review, section)
    data = re.search(r'<script type="application/json" id="slider-data">(.*?)</script>', html, re.S)
    assert data is not None
    assert json.loads(data[1]) == json.loads(json.dumps(slider_in(section).data))
    for control in ("slider-prior", "slider-width"):
        assert f'for="{control}"' in html
        assert f'id="{control}"' in html
    assert "http" not in html.split("</style>", 1)[1]
    assert not re.search(r"fetch\(|XMLHttpRequest|import\(|<script[^>]*src", html)


def render_report_of(review: Review, section: Section) -> str:
    """A page with this section alone."""
    return render_report(review, [section], {})
