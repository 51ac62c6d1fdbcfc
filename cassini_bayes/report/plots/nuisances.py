"""Prior against posterior of what is not thrust."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from cassini_bayes.report.plots.quantities import (
    INTERVAL,
    NORMAL_90,
    Scale,
    display_scale,
    plus_minus,
    short_events,
    short_name,
)
from cassini_bayes.report.plots.style import (
    INK,
    PRIOR,
    VERDICT_COLOURS,
    headline,
    legend_below,
    line,
    new_figure,
    patch,
    symbols,
)
from cassini_bayes.report.plots.tables import all_events_of, nuisance_column, parameter_scale
from cassini_bayes.results.review import Review

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PRIOR_UNITS: Final = "departure from the prior mean [prior standard deviations]"
MARKERS: Final = {"conflict": "X", "informed": "o", "prior returned": "s"}
VERDICT_MEANING: Final = {
    "conflict": "conflict: data and prior disagree",
    "informed": "informed by the data",
    "prior returned": "prior returned: the data say nothing",
}


@dataclass(frozen=True)
class ForestRow:
    """One parameter in units of its prior's standard deviation, with its numbers as text."""

    label: str
    group: str
    mean: float
    low: float
    high: float
    prior_low: float
    prior_high: float
    verdict: str
    text: str


def nuisance_figure(review: Review) -> Figure:
    """Every walked parameter against its prior, in prior standard deviations."""
    rows = [_walked_row(review, row) for _, row in review.nuisances.iterrows()]
    return forest_figure(rows, f"Nuisances: prior against posterior – mean and {INTERVAL}")


def torque_figure(review: Review) -> Figure | None:
    """The collapsed external torques against their priors; None when there are none."""
    table = review.summary
    torques = table[(table["quantity"] == "external_torque_n_m") & (table["prior_sd"] > 0)]
    if torques.empty:
        return None
    shown = dict(zip(all_events_of(review), short_events(all_events_of(review)), strict=True))
    magnitudes = torques[["mean", "prior_mean", "prior_sd"]].abs().max()
    scale = display_scale(str(torques["unit"].iloc[0]), *(float(m) for m in magnitudes))
    rows = [_torque_row(row, shown, scale) for _, row in torques.iterrows()]
    return forest_figure(rows, f"External torque: prior against posterior – mean and {INTERVAL}")


def _walked_row(review: Review, row: pd.Series) -> ForestRow:
    name, unit = str(row["name"]), str(row["unit"])
    scale = parameter_scale(review, name)
    column = nuisance_column(review, name)
    ends = (-NORMAL_90, NORMAL_90)
    if column is not None:
        centre, spread = float(row["prior_mean"]), float(row["prior_sd"])
        low, high = np.quantile(column.prior / scale.factor, [0.05, 0.95])
        ends = (float(low) - centre) / spread, (float(high) - centre) / spread
    verdict = str(row["verdict"])
    surprise = f"  ({row['surprise']:+.1f} σ)".replace("-", "−") if verdict == "conflict" else ""
    label = f"{short_name(name, unit)}{surprise}"
    unit_shown = Scale(scale.factor, scale.unit.strip("–"))
    return _in_prior_units(row, label, str(row["block"]), ends, verdict, unit_shown)


def _torque_row(row: pd.Series, shown_events: dict[str, str], scale: Scale) -> ForestRow:
    label = shown_events.get(str(row["event"]), str(row["event"]))
    narrowed = float(row["sd"]) < 0.95 * float(row["prior_sd"])
    verdict = "informed" if narrowed else "prior returned"
    return _in_prior_units(
        row, label, f"axis {row['item']}", (-NORMAL_90, NORMAL_90), verdict, scale
    )


def _in_prior_units(
    row: pd.Series,
    label: str,
    group: str,
    prior_ends: tuple[float, float],
    verdict: str,
    scale: Scale,
) -> ForestRow:
    """A row of posterior and prior as departures from the prior's mean in its deviations."""
    values = row[["mean", "hdi_90_low", "hdi_90_high"]].astype(float)
    mean, low, high = ((values - float(row["prior_mean"])) / float(row["prior_sd"])).tolist()
    after, before = (
        plus_minus(float(row[centre]) * scale.factor, float(row[spread]) * scale.factor)
        for centre, spread in (("mean", "sd"), ("prior_mean", "prior_sd"))
    )
    text = f"{after} {scale.unit}   prior {before}"
    return ForestRow(label, group, mean, low, high, *prior_ends, verdict, text)


def forest_figure(rows: Sequence[ForestRow], title: str) -> Figure:
    """Intervals one under another, grouped; grey bars are priors, numbers stand at the right."""
    groups = list(dict.fromkeys(row.group for row in rows))
    ordered = [row for group in groups for row in rows if row.group == group]
    places, heads = _places(ordered, groups)
    bottom = max(places, default=0.0) + 0.8
    figure = new_figure(9.6, 0.235 * bottom + 1.75)
    axes = figure.subplots()
    for place, row in zip(places, ordered, strict=True):
        _forest_row(axes, place, row)
    for group, place in heads.items():
        _words(axes, 0.008, place, group, fontsize=8, color="#555555", fontweight="bold")
    reach = max([3.0, *(1.08 * abs(v) for r in ordered for v in (r.low, r.high) if np.isfinite(v))])
    axes.set_xlim(-reach, reach)
    axes.set_ylim(bottom, -1.3)
    axes.set_yticks(places, [row.label for row in ordered])
    for label, row in zip(axes.get_yticklabels(), ordered, strict=True):
        if row.verdict == "conflict":
            label.set(color=VERDICT_COLOURS["conflict"], fontweight="bold")
    axes.tick_params(axis="y", length=0)
    axes.axvline(0.0, color="#999999", lw=0.8, zorder=0)
    axes.grid(axis="x")
    axes.set_xlabel(PRIOR_UNITS)
    axes.set_ylabel("parameter (units at the right)")
    headline(figure, title)
    used = [v for v in VERDICT_COLOURS if any(r.verdict == v for r in ordered)]
    interval = {"lw": 2.5, "ms": 5.5, "mfc": "white"}
    handles = [
        patch(facecolor="#dedede", edgecolor=PRIOR, label="prior, 90 % equal-tailed"),
        *(
            line(color=VERDICT_COLOURS[v], marker=MARKERS[v], label=VERDICT_MEANING[v], **interval)
            for v in used
        ),
    ]
    legend_below(figure, handles, ncols=len(handles))
    return figure


def _places(
    rows: Sequence[ForestRow], groups: Sequence[str]
) -> tuple[list[float], dict[str, float]]:
    """Vertical place of each row and of each group's heading."""
    places: list[float] = []
    heads: dict[str, float] = {}
    at = -0.6
    for group in groups:
        heads[group] = at
        for _ in (row for row in rows if row.group == group):
            at += 1.0
            places.append(at)
        at += 1.15
    return places, heads


def _forest_row(axes: Axes, place: float, row: ForestRow) -> None:
    colour = VERDICT_COLOURS.get(row.verdict, INK)
    grey: dict[str, Any] = {"color": "#dedede", "edgecolor": PRIOR, "lw": 0.5, "zorder": 1}
    axes.barh(place, row.prior_high - row.prior_low, left=row.prior_low, height=0.72, **grey)
    axes.hlines(place, row.low, row.high, color=colour, lw=2.5, zorder=3)
    marker = MARKERS.get(row.verdict, "o")
    symbols(axes, [row.mean], [place], marker, 5.5, colour, hollow=True, mew=1.3, zorder=4)
    _words(axes, 1.01, place, row.text, fontsize=7.6, color="#333333")


def _words(axes: Axes, across: float, place: float, text: str, **look: Any) -> None:
    """Text of a row, at a fraction of the width."""
    frame = axes.get_yaxis_transform()
    axes.text(across, place, text, transform=frame, va="center", ha="left", **look)
