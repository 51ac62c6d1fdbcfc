"""A sweep's section and figures where draws do not reach a changed prior."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
import pytest

from cassini_bayes.report.plots.sweep import sweep_figures
from cassini_bayes.report.sweep import cells_of, strongest_sentence


def cell(change: str, kind: str, size: float) -> dict[str, object]:
    """A row of the sweep's table; NaN: no draw reaches the cell."""
    values = dict.fromkeys(("shift_sd", "shift_error", "width_ratio", "width_error"), size)
    head = {"group": "tail", "kind": kind, "change": change, "parameters": "tau_fall_s"}
    return {**head, "quantity": "q", "estimate": "reweighted", "reported": True, **values}


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
