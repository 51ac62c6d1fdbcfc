"""Thrusts over a mission: as flown, at one pressure, and what sets in when."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from cassini_bayes.report.plots.style import INK, PRIOR, new_figure, symbols, thruster_styles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS: Final = 4  # panels across a page
_FEW: Final = 60  # events above which points get no bars


def mission_drawings(
    thrust: pd.DataFrame, health: pd.DataFrame, onsets: pd.DataFrame, dated: Mapping[str, str]
) -> dict[str, Callable[[], Figure]]:
    """Three figures of every branch, by name; ``dated`` maps a fact's epoch to what it is."""
    drawings: dict[str, Callable[[], Figure]] = {}
    for branch in dict.fromkeys(thrust["branch"]):
        rows = thrust[thrust["branch"] == branch].assign(
            when=lambda frame: pd.to_datetime(frame["epoch"], utc=True)
        )
        of_branch = [table[table["branch"] == branch] for table in (health, onsets)]
        drawings |= {
            f"thrust_{branch}": partial(over_time, rows, "thrust", "thrust in the event", dated),
            f"normalised_{branch}": partial(
                over_time, rows, "normalised", "thrust at the reference pressure", dated
            ),
            f"losses_{branch}": partial(losses, rows, *of_branch),
        }
    return drawings


def over_time(own: pd.DataFrame, name: str, label: str, dated: Mapping[str, str]) -> Figure:
    """One panel per thruster: mean and central 90 %; filled where the event saw the thruster."""
    thrusters = list(dict.fromkeys(own["thruster"]))
    rows = -(-len(thrusters) // _COLUMNS)
    figure = new_figure(11.0, 2.6 * rows)
    grid = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False)
    styles = thruster_styles(thrusters)
    within = {
        epoch: what
        for epoch, what in dated.items()
        if own["when"].min() <= pd.to_datetime(epoch, utc=True) <= own["when"].max()
    }
    for axes, thruster in zip(grid.flat, thrusters, strict=False):
        part, style = own[own["thruster"] == thruster], styles[thruster]
        _panel(axes, part, name, style.colour)
        axes.set_title(thruster.upper())
        for epoch in within:
            when = pd.to_datetime(epoch, utc=True)
            axes.axvline(when, color=PRIOR, linewidth=0.8, linestyle="--")
        axes.tick_params(axis="x", labelrotation=35)
    for axes in grid[:, 0]:
        axes.set_ylabel("N")
    for axes in list(grid.flat)[len(thrusters) :]:
        axes.set_visible(False)
    branch = own["branch"].iloc[0]
    facts = ", ".join(f"{what} {epoch[:10]}" for epoch, what in within.items())
    dashed = f"\ndashed: {facts}" if facts else ""
    shown = f"{label}, mean and central 90 %; filled: on for more than 5 s{dashed}"
    figure.suptitle(f"Branch {branch}: {shown}", x=0.01, ha="left", fontsize=9.5)
    return figure


def _panel(axes: Axes, part: pd.DataFrame, name: str, colour: str) -> None:
    when, seen = part["when"].to_numpy(), part["saw_it"].to_numpy()
    mean, low, high = (part[f"{name}{what}_n"].to_numpy() for what in ("", "_low", "_high"))
    if name == "normalised":
        axes.fill_between(when, low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(when, mean, color=colour, linewidth=1.2)
    elif len(part) <= _FEW:
        axes.vlines(when, low, high, color=colour, linewidth=0.8, alpha=0.7)
    axes.plot(when[seen], mean[seen], "o", color=colour, markersize=3.0)
    axes.plot(when[~seen], mean[~seen], "o", mfc="white", mec=colour, markersize=3.0)


def losses(own: pd.DataFrame, health: pd.DataFrame, onsets: pd.DataFrame) -> Figure:
    """Probability that a thruster has lost thrust, and of each onset given that it has."""
    figure = new_figure(9.0, 3.4)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.6))
    thrusters = list(health["thruster"])
    styles = thruster_styles(thrusters)
    places = np.arange(len(thrusters))
    colours = [styles[name].colour for name in thrusters]
    left.barh(places, health["failing"], color=colours, height=0.7)
    left.set_yticks(places, [name.upper() for name in thrusters])
    left.invert_yaxis()
    left.set_xlim(0.0, 1.0)
    left.set_xlabel("probability of a loss")
    when = own.drop_duplicates("event").set_index("event")["when"]
    shown = health.nlargest(2, "failing")["thruster"]
    for name in shown:
        part = onsets[onsets["thruster"] == name]
        chance = health.loc[health["thruster"] == name, "failing"].iloc[0]
        look, label = (
            (styles[name].marker, 4.0, styles[name].colour),
            f"{name.upper()} ({chance:.0%})",
        )
        symbols(right, when[part["event"]], part["probability"], *look, label=label)
    right.set_ylabel("probability of the onset, if it fails")
    if np.isfinite(right.dataLim.y1):  # not with a single event: nothing can set in
        right.set_ylim(0.0, 1.15 * right.dataLim.y1)
    right.tick_params(axis="x", labelrotation=35)
    right.legend(loc="best")
    branch = own["branch"].iloc[0]
    title = f"Branch {branch}: losses of thrust, the two likeliest at the right"
    figure.suptitle(title, x=0.01, ha="left", fontsize=9.5, color=INK)
    return figure
