"""A sweep's section and figures where draws do not reach a changed prior, or cannot be trusted."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
import pytest

from cassini_bayes.report.plots.sweep import sweep_figures, tornado_figure, worth_figure
from cassini_bayes.report.sweep import CANNOT_SAY, cells_of, changes_table, strongest_sentence


def cell(
    change: str, kind: str, size: float, k: float = 0.1, effective: float = 4e3
) -> dict[str, object]:
    """A row of the sweep's table; NaN: no draw reaches the cell."""
    if np.isnan(size):
        k, effective = np.inf, 0.0
    values = dict.fromkeys(("shift_sd", "shift_error", "width_ratio", "width_error"), size)
    head = {"group": "tail", "kind": kind, "change": change, "parameters": "tau_fall_s"}
    weights = {"estimate": "reweighted", "pareto_k": k, "effective_draws": effective}
    return {**head, "quantity": "q", **weights, "reported": True, **values}


def test_draws_that_reach_no_changed_prior_are_told_from_no_change() -> None:
    """Without a cell no prior was changed; cells without numbers ask for a fit anew."""
    cells = pd.DataFrame([cell("width × 2", "width", np.nan)])
    assert strongest_sentence(cells[:0]) == "No prior was changed."
    assert "fit them anew" in strongest_sentence(cells)


@pytest.mark.parametrize(
    ("kind", "size", "names"),
    [
        ("width", np.nan, set()),
        ("shift", 0.5, {"tornado_1"}),
        ("width", 0.5, {"tornado_1", "overlay_1"}),
    ],
)
def test_figures_that_would_be_empty_are_left_out(kind: str, size: float, names: set[str]) -> None:
    """Cells without numbers are in no figure, and single shifts in no overlay; none warns."""
    table = pd.DataFrame([cell("width × 4", "width", np.nan), cell("width × 2", kind, size)])
    table = table if names else table[:1]
    draws = np.random.default_rng(1).standard_normal(400)
    line = {"q": np.quantile(draws, (np.arange(199) + 1.0) / 200.0) + size}
    without = pd.DataFrame({"level": [], "quantity": []})
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        figures = sweep_figures(
            table, {"q": ("N", draws)}, [("tail", kind, "width × 2", line)], without, without
        )
    assert set(figures) == names


def test_every_cell_counts_once() -> None:
    """Also one of whose quantities some have no numbers, as that without the event they are of."""
    rows = [
        {**cell("width × 2", "width", 1.0), "quantity": "p"},
        cell("width × 2", "width", 1.0),
        {**cell("without a", "without", 1.0), "estimate": "refitted"},
    ]
    cells = cells_of(pd.DataFrame(rows))
    assert cells["estimate"].tolist() == ["reweighted", "refitted"]


UNTRUSTED = [
    cell("width × 4", "width", 2.0, k=0.93, effective=58.0),
    cell("width × ¼", "width", 1.5, k=0.3, effective=90.0),
]


def test_weights_that_are_not_trusted_lead_nothing() -> None:
    """The largest shift is not named, nor ranked, where k̂ or the effective draws forbid it."""
    cells = pd.DataFrame([*UNTRUSTED, cell("width × 2", "width", 0.5)])
    said = strongest_sentence(cells)
    assert "width × 2" in said
    assert "width × 4" not in said
    assert "cannot say what 2 of the 3 changes do" in said
    assert "standard deviation, which is then 0.50 ± 0.50 times as large" in said
    assert "fit them anew" in strongest_sentence(cells[:2])
    rows = [[c.text for c in row] for row in changes_table(cells).rows]
    assert [row[0] for row in rows] == ["tail: width × 2", "tail: width × 4", "tail: width × ¼"]
    assert [row[1] for row in rows] == ["q", CANNOT_SAY, CANNOT_SAY]
    assert rows[1][2:4] == ["–", "–"]


def test_figures_mark_weights_that_are_not_trusted() -> None:
    """They are crosses that lift no row of a tornado, and are in no overlay and no heat map."""
    small = {**cell("width × 2", "width", 0.5), "group": "torque"}
    cells = pd.DataFrame([*UNTRUSTED, small])
    tornado = tornado_figure(cells, "q")
    axes = tornado.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "tail: width",
        "torque: width",
    ]
    crosses = [mark for mark in axes.lines if mark.get_marker() == "x"]
    assert len(crosses) == 2
    assert "draws cannot say" in [text.get_text() for text in tornado.legends[0].get_texts()]
    draws = np.random.default_rng(1).standard_normal(400)
    line = {"q": np.quantile(draws, (np.arange(199) + 1.0) / 200.0)}
    overlaid = [("tail", "width", "width × 4", line)]
    nothing = pd.DataFrame({"level": [], "quantity": []})
    figures = sweep_figures(cells, {"q": ("N", draws)}, overlaid, nothing, nothing)
    assert set(figures) == {"tornado_1"}
    known = pd.DataFrame([{"level": "block", "known": "tail", "quantity": "q", "width_ratio": 0.5}])
    heat = worth_figure(known, cells.assign(event=["a", "b", "c"]))
    assert heat is not None
    assert [text.get_text() for axes in heat.axes for text in axes.texts] == ["−50", "−50"]
    assert all("standard deviation" in axes.get_title(loc="left") for axes in heat.axes)
