"""Figures: every axis named with its unit, priors drawn, nothing clipped, any shape of run."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from made_up_review import full_figures, full_review, made_up_review, without_corners
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import same_color
from matplotlib.text import Text

from cassini_bayes.errors import InputError
from cassini_bayes.report import figures_of, sections_of
from cassini_bayes.report.plots import Figure, encode, encoded, is_corner, save_figures
from cassini_bayes.report.plots.checks import balance_figure
from cassini_bayes.report.plots.corners import corner_figure
from cassini_bayes.report.plots.criticism import MOST_NATS_LABELLED, nats_to_label
from cassini_bayes.report.plots.powers import plain
from cassini_bayes.report.plots.quantities import (
    NORMAL_90,
    decimals_for,
    display_scale,
    interval,
    number,
    plus_minus,
    readable_unit,
    short_events,
    short_name,
)
from cassini_bayes.report.plots.style import PRIOR_LINE, thruster_styles
from cassini_bayes.report.plots.tables import (
    Column,
    budget_blocks,
    nuisance_column,
    thrust_grid,
)
from cassini_bayes.results.review import Review

ODD_NAMES = (r"a $\frac$ b", "$x_$", "100$")
WITHOUT_UNIT = ("event", "thruster", "parameter", "quantity")


@pytest.fixture(scope="module")
def review() -> Review:
    """Eight events, eight thrusters."""
    return full_review()


@pytest.fixture(scope="module")
def figures() -> dict[str, Figure]:
    """All figures of that review."""
    return full_figures()


def drawn(**shape: Any) -> dict[str, Figure]:
    """Figures of a run of some shape.

    The nuisances are the same in all of them: their corner plots, slow to draw, are left out.
    """
    return figures_of([*map(without_corners, sections_of(made_up_review(draws=60, **shape)))])


@dataclass(frozen=True)
class State:
    """What matplotlib keeps for all: its settings, and the numbers of pyplot's figures."""

    settings: dict[str, Any]
    numbers: list[int]

    @classmethod
    def now(cls) -> State:
        """As it is."""
        return cls(dict(matplotlib.rcParams), plt.get_fignums())


@dataclass(frozen=True)
class Drawn:
    """Figures, and matplotlib's state before they were made and after one was written."""

    figures: dict[str, Figure]
    before: State
    after: State


@pytest.fixture(scope="module")
def odd() -> Drawn:
    """Figures of a run with missing cells and events of odd names."""
    before = State.now()
    figures = drawn(n_thrusters=4, missing_cells=True, event_ids=ODD_NAMES)
    encode(figures["balance"], "svg")
    return Drawn(figures, before, State.now())


def test_all_figures_of_a_full_review_are_there_in_the_report_s_order(figures) -> None:
    """Nuisances are spread over corner plots of at most nine parameters."""
    assert list(figures) == [
        "thrusts", "corner_joint", "corner_thrusts", "nuisances", "corner_nuisances_1",
        "corner_nuisances_2", "corner_nuisances_3", "torques", "budget", "predictive", "balance",
        "delta_v", "delta_v_thrusts", "convergence",
    ]  # fmt: skip


def unlabelled(figure: Figure) -> list[str]:
    """Axes with tick labels but no label, or a label that carries no unit."""
    found = []
    for i, axes in enumerate(figure.axes):
        for axis in (axes.xaxis, axes.yaxis):
            label = axis.get_label_text()
            shows_ticks = any(t.get_text() for t in axis.get_ticklabels()) and axis.get_tick_params(
                which="major"
            ).get("labelleft" if axis is axes.yaxis else "labelbottom", True)
            named = label.startswith(WITHOUT_UNIT) or ("[" in label and "]" in label)
            if shows_ticks and not named:
                found.append(f"axes {i} {axis.axis_name}: {label!r}")
    return found


def test_every_axis_with_figures_has_a_label_with_its_unit(figures) -> None:
    """Also a control: the check sees a label without unit."""
    assert {name: unlabelled(f) for name, f in figures.items() if unlabelled(f)} == {}
    bad = Figure()
    bad.subplots().set(xlabel="time", ylabel="thrust [N]")
    bad.draw_without_rendering()
    assert unlabelled(bad) == ["axes 0 x: 'time'"]


def outside(figure: Figure) -> list[str]:
    """Texts and axes that reach beyond the figure by more than two pixels."""
    canvas = FigureCanvasAgg(figure)
    figure.draw_without_rendering()  # places every text and axes, paints none
    renderer, page = canvas.get_renderer(), figure.bbox
    found = []
    for artist in (*figure.axes, *figure.texts, *figure.legends):
        box = artist.get_tightbbox(renderer)
        if box is not None and (
            box.x0 < -2 or box.y0 < -2 or box.x1 > page.width + 2 or box.y1 > page.height + 2
        ):
            found.append(f"{artist}: {box}")
    return found


def test_nothing_is_clipped_at_the_edge_of_a_figure(figures) -> None:
    """Also a control: a text pushed over the edge is seen."""
    assert {name: outside(f) for name, f in figures.items() if outside(f)} == {}
    bad = Figure()
    bad.text(0.99, 0.5, "a long text that runs over the edge")
    assert len(outside(bad)) == 1


def test_no_axes_are_empty_and_none_lie_over_each_other(figures) -> None:
    """Every pair of axes of a figure is disjoint, and every one has something drawn in it."""
    for name, figure in figures.items():
        boxes = [axes.get_position() for axes in figure.axes]
        assert all(axes.has_data() for axes in figure.axes), name
        for i, a in enumerate(boxes):
            for b in boxes[:i]:
                width = min(a.x1, b.x1) - max(a.x0, b.x0)
                height = min(a.y1, b.y1) - max(a.y0, b.y0)
                assert width < 1e-6 or height < 1e-6, name


def prior_lines(axes: Axes) -> int:
    """Lines and contours in the colour of priors."""
    lines = [line for line in axes.lines if same_color(line.get_color(), PRIOR_LINE)]
    contours = [
        c for c in axes.collections
        if len(c.get_edgecolor()) and same_color(c.get_edgecolor()[0], PRIOR_LINE)
    ]  # fmt: skip
    return len(lines) + len(contours)


def test_corner_plots_draw_the_prior_in_every_panel(figures) -> None:
    """A density on the diagonal, contours below it."""
    for name, figure in figures.items():
        if is_corner(name):
            assert all(prior_lines(axes) >= 1 for axes in figure.axes), name


def test_headline_shows_every_interval_where_the_summary_has_it(review: Review, figures) -> None:
    """The thick bars of each panel span the tabulated interval; the prior band is drawn."""
    figure = figures["thrusts"]
    low, high = thrust_grid(review, "hdi_90_low"), thrust_grid(review, "hdi_90_high")
    assert len(figure.axes) == 8
    for k, axes in enumerate(figure.axes):
        thick = next(c for c in axes.collections if c.get_linewidth()[0] == 5)
        segments = np.array(thick.get_segments())[:-1, :, 1]
        np.testing.assert_allclose(segments, np.column_stack([low[:, k], high[:, k]]), rtol=1e-12)
        assert len(axes.patches) >= 9


def test_intervals_say_kind_and_probability(figures) -> None:
    """Every figure with intervals names them in title or legend."""
    for name in (
        "thrusts",
        "nuisances",
        "torques",
        "predictive",
        "balance",
        "delta_v",
        "delta_v_thrusts",
    ):
        figure = figures[name]
        texts = [figure.get_suptitle(), *(g.get_title().get_text() for g in figure.legends)]
        texts += [t.get_text() for legend in figure.legends for t in legend.get_texts()]
        assert any("90 %" in t and ("HDI" in t or "interval" in t) for t in texts), name


def test_bars_of_delta_v_have_the_noise_of_the_table(review, figures) -> None:
    """The thin bar of every event is as long as both standard deviations of its row together."""
    table = review.delta_v
    sd = np.hypot(table["computed_sd_mm_s"], table["noise_sd_mm_s"])
    thin = figures["delta_v"].axes[1].collections[1].get_segments()
    np.testing.assert_allclose(np.ptp(thin, axis=1)[:, 1], 2.0 * NORMAL_90 * sd, rtol=1e-9)


def test_thrusters_keep_their_colour_and_twelve_differ() -> None:
    """The same name has the same style whatever comes after it."""
    names = [f"t{i}" for i in range(12)]
    styles = thruster_styles(names)
    assert len({s.colour for s in styles.values()}) == 12
    assert len({s.marker for s in styles.values()}) == 12
    assert thruster_styles(names[:5]) == {n: styles[n] for n in names[:5]}
    repeated = thruster_styles([f"t{i}" for i in range(24)])
    assert len({(s.colour, s.marker) for s in repeated.values()}) == 24


@pytest.mark.parametrize(
    "shape",
    [
        {"n_events": 1, "n_thrusters": 9},
        {"n_events": 3, "n_thrusters": 2, "baseline": False, "delta_v": False},
        {"n_events": 20, "n_thrusters": 3},
        {"n_events": 1, "n_thrusters": 1, "delta_v": False},
    ],
    ids=str,
)
def test_other_shapes_of_run_draw_too(shape) -> None:
    """One event, nine thrusters, no baseline, no ΔV: labelled and unclipped."""
    figures = drawn(**shape)
    assert ("delta_v" in figures) == shape.get("delta_v", True)
    for name, figure in figures.items():
        assert unlabelled(figure) == [], name
        assert outside(figure) == [], name


def test_missing_cells_and_odd_names_draw_too(odd: Drawn) -> None:
    """Every figure is there, labelled and unclipped."""
    assert "delta_v" in odd.figures
    for name, figure in odd.figures.items():
        assert unlabelled(figure) == [], name
        assert outside(figure) == [], name


def test_a_dollar_in_a_name_is_a_dollar(odd: Drawn) -> None:
    """Names that would be broken mathematics are drawn, and shown as they are."""
    shown = set()
    for figure in odd.figures.values():
        assert encode(figure, "svg")
        shown |= {text.get_text() for text in figure.findobj(Text)}
    assert all(any(name in text for text in shown) for name in ODD_NAMES)
    assert not any("mathdefault" in text for text in shown)


@pytest.mark.parametrize(
    ("label", "text"),
    [
        (r"$\mathdefault{10^{3}}$", "10³"),
        (r"$\mathdefault{-2\times10^{-12}}$", "−2×10⁻¹²"),
        (r"$\mathdefault{0}$", "0"),
        ("", ""),
    ],
)
def test_powers_are_plain_text(label: str, text: str) -> None:
    """What matplotlib writes as mathematics, written with raised digits."""
    assert plain(label) == text


def test_fixed_missing_or_too_few_draws_do_not_break_a_corner_plot() -> None:
    """A column without spread or with NaN is left out and named; too few rows give no figure."""
    rng = np.random.default_rng(1)
    good = [Column(n, "m", rng.standard_normal(500), rng.standard_normal(300)) for n in "ab"]
    fixed = Column("fixed_one", "m", np.full(500, 3.0), np.full(300, 3.0))
    broken = Column("broken_one", "m", np.full(500, np.nan), np.zeros(300))
    figure = corner_figure([*good, fixed, broken], "title")
    assert figure is not None
    assert len(figure.axes) == 3
    assert any("fixed_one, broken_one" in t.get_text() for t in figure.legends[0].get_texts())
    assert corner_figure([good[0], fixed], "title") is None
    few = [Column(n, "m", np.arange(2.0), np.arange(2.0)) for n in "ab"]
    assert corner_figure(few, "title") is None


def test_a_fixed_prior_is_no_obstacle() -> None:
    """A prior that does not vary is not drawn; the posterior is."""
    rng = np.random.default_rng(2)
    columns = [Column(n, "m", rng.standard_normal(500), np.full(300, 1.0)) for n in "ab"]
    figure = corner_figure(columns, "title")
    assert figure is not None
    assert sum(prior_lines(axes) for axes in figure.axes) == 0


def test_wheel_inertias_are_found_by_their_parameter_names(review: Review) -> None:
    """A walked wheel inertia shows the draws of its own wheel, in the units of the labels."""
    column = nuisance_column(review, "rwa2_inertia_kg_m2")
    assert column is not None
    own = review.fit.posterior["rwa_inertia_kg_m2"].sel(wheel="rwa2").values.reshape(-1)
    np.testing.assert_array_equal(column.posterior, own)
    tail = nuisance_column(review, "tau_fall_s")
    assert tail is not None
    assert tail.unit == "ms"
    np.testing.assert_allclose(
        tail.posterior, 1e3 * review.fit.posterior["tau_fall_s"].values.ravel()
    )


def test_stacked_shares_add_up_to_the_whole(review: Review, figures) -> None:
    """Bars of a thruster, negative ones included, sum to 100 %; noise comes after the blocks."""
    bars = [p for p in figures["budget"].axes[0].patches if math.isclose(p.get_height(), 0.72)]
    total: dict[float, float] = {}
    for bar in bars:
        place = round(bar.get_y(), 6)
        total[place] = total.get(place, 0.0) + bar.get_width()
    np.testing.assert_allclose(list(total.values()), 100.0, atol=1e-6)
    assert budget_blocks(review.budget)[-2:] == ["noise-only", "nonlinear"]
    assert "noise" in budget_blocks(review.budget)[:-2]  # a block of nuisances like any other


def test_pictures_are_whole_and_ask_for_nothing(figures) -> None:
    """A page shows corner plots as PNG, all else as SVG without script or outside reference."""
    assert encoded("corner_nuisances_3", figures["corner_nuisances_3"]).shown[0] == "png"
    assert encoded("balance", figures["balance"]).shown[0] == "svg"
    for name in (name for name in figures if not is_corner(name)):
        content = encode(figures[name], "svg")
        assert b"<script" not in content
        assert all(a.startswith(b"#") for a in re.findall(rb'xlink:href="([^"]+)"', content))


def test_files_are_whole_and_svg_only_where_small(figures, tmp_path: Path) -> None:
    """PNG of all, SVG of all but corner plots, nothing left beside them."""
    some = {n: figures[n] for n in ("balance", "corner_nuisances_3")}
    written = save_figures(some, tmp_path / "figures")
    assert sorted(p.name for p in written) == [
        "balance.png",
        "balance.svg",
        "corner_nuisances_3.png",
    ]
    assert sorted(p.name for p in (tmp_path / "figures").iterdir()) == sorted(
        p.name for p in written
    )
    assert written[0].read_bytes().startswith(b"\x89PNG")


def test_the_same_draws_give_the_same_bytes(review: Review) -> None:
    """SVG and PNG carry neither a date nor a random mark."""
    for kind in ("svg", "png"):
        first, second = (encode(balance_figure(review), kind) for _ in range(2))
        assert first == second


def test_a_place_that_cannot_be_written_is_an_input_error(figures, tmp_path: Path) -> None:
    """A file where the folder should be: one line, nothing half-written."""
    (tmp_path / "figures").write_text("in the way")
    with pytest.raises(InputError, match="can be written"):
        save_figures({"balance": figures["balance"]}, tmp_path / "figures")


def test_making_figures_leaves_no_global_state(odd: Drawn) -> None:
    """No figure is registered with pyplot, and matplotlib's settings are as before."""
    assert odd.after.numbers == odd.before.numbers
    assert odd.after.settings == odd.before.settings
    plt.figure()  # negative control: one of a plotting session is seen
    assert State.now().numbers != odd.before.numbers
    plt.close()


@pytest.mark.parametrize(
    ("mean", "sd", "expected"),
    [
        (0.74321, 0.00941, "0.7432 ± 0.0094"),
        (-0.0786, 0.0036, "−0.0786 ± 0.0036"),
        (6560.4, 66.2, "6560 ± 66"),
        (123456.0, 1234.0, "123456 ± 1234"),
        (1.0, 0.0996, "1.00 ± 0.10"),
        (-0.0001, 0.05, "0.000 ± 0.050"),
        (-2.11e-6, 9.0e-7, "−2.11 × 10⁻⁶ ± 9.0 × 10⁻⁷"),
        (float("nan"), 0.1, "–"),
        (1.5, float("nan"), "1.500"),
        (2.0, 0.0, "2.000 ± 0.000"),
    ],
)
def test_numbers_have_sensible_digits(mean: float, sd: float, expected: str) -> None:
    """Standard deviation to two digits, the value to match, no negative zero."""
    assert plus_minus(mean, sd) == expected


def test_digits_follow_the_standard_deviation() -> None:
    """Two significant digits of any sd from 1e-5 up survive rounding."""
    for sd in np.geomspace(1.3e-4, 95.0, 60):
        shown = float(number(sd, sd))
        assert abs(shown - sd) <= 0.051 * sd
        assert decimals_for(sd) <= 5
    assert interval(0.71234, 0.76543) == "0.712 … 0.765"
    assert interval(float("nan"), 1.0) == "–"


def test_units_and_names_for_people() -> None:
    """Superscripts, prefixes for small values, names and events cut short."""
    assert readable_unit("kg m2") == "kg m²"
    assert readable_unit("m s-1") == "m s⁻¹"
    assert readable_unit("1") == "–"
    assert (display_scale("s", 0.05, 0.01).unit, display_scale("s", 0.05).factor) == ("ms", 1e3)
    assert display_scale("rad/s", 4e-5).unit == "µrad/s"
    assert display_scale("N m", 2e-6).unit == "µN m"
    assert display_scale("m", 0.13).unit == "m"
    assert display_scale("kg m2", 0.01).unit == "kg m²"
    assert display_scale("m", 0.0, float("nan")).factor == 1.0
    assert short_name("hold_rate_rad_s", "rad/s") == "hold_rate"
    assert short_name("delta_v_noise_m_s", "m s-1") == "delta_v_noise"
    assert short_name("mass_factor", "1") == "mass_factor"
    assert short_events(["2009-08-22-bias", "2010-02-13-bias"]) == ["2009-08-22", "2010-02-13"]
    assert short_events(["a-very-long-event-name"]) == ["a-very…nt-name"]
    alike = [f"rwa-unload-orbit-{number}" for number in (1021, 1022)]
    assert short_events(alike) == ["1021", "1022"]
    assert len(set(short_events(["x" * 20 + "a" + "y" * 20, "x" * 20 + "b" + "y" * 20]))) == 2
    assert short_events(["same"]) == ["same"]


@pytest.mark.parametrize(
    ("low", "high", "labelled"),
    [
        (-5.9, 33.0, [-5.0, 0.0, 5.0, 10.0, 20.0]),
        (-12.0, 20_000.0, [-10.0, 0.0, 10.0, 100.0, 1_000.0, 10_000.0]),
        (-0.4, 11.0, [0.0, 5.0, 10.0]),
    ],
)
def test_nats_have_more_labels_than_zero_and_ten(
    low: float, high: float, labelled: list[float]
) -> None:
    """As many of 1, 2 and 5 as there is room for, and powers where there is not."""
    assert nats_to_label(low, high) == labelled


def test_labels_of_nats_do_not_run_into_each_other() -> None:
    """Six at most, up to a million either way, and always zero."""
    for high in np.geomspace(11.0, 1e6, 40):
        for low in (-0.1 * high, -high):
            ticks = nats_to_label(low, high)
            assert 0.0 in ticks
            assert 2 <= len(ticks) <= MOST_NATS_LABELLED
