"""Reading a review: grids of thrusts, and the draws of a parameter by its name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
import xarray as xr

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report.plots.quantities import Scale, display_scale, short_name
from cassini_bayes.results.review import Review

SHARE: Final = "|share"
NOISE_ONLY: Final = "noise-only"
NONLINEAR: Final = "nonlinear"
NOT_BLOCKS: Final = (NOISE_ONLY, NONLINEAR)  # what is left besides the blocks of nuisances
MOST_COLUMNS: Final = 9
"""Parameters of one corner plot."""


@dataclass(frozen=True)
class Column:
    """One parameter as figures show it: draws in display units, label and unit."""

    label: str
    unit: str
    posterior: Array  # (n,)
    prior: Array  # (m,)


def all_events_of(review: Review) -> list[str]:
    """Ids of all events in the order of the fit."""
    return [str(event) for event in review.fit.posterior.coords["event"].values]


def events_of(review: Review) -> list[str]:
    """Ids of the events that have thrusts, in the order of the fit: a slew has none."""
    if "thrust_n" not in review.fit.posterior:
        return []
    first = review.fit.posterior["thrust_n"].values[0, 0]
    has = np.isfinite(first).any(axis=-1)
    return [event for event, is_there in zip(all_events_of(review), has, strict=True) if is_there]


def thrusters_of(review: Review) -> list[str]:
    """Thruster names in the order of the spacecraft; none in a fit without thrusts."""
    if "thruster" not in review.fit.posterior.coords:
        return []
    return [str(name) for name in review.fit.posterior.coords["thruster"].values]


def grid(
    table: pd.DataFrame,
    column: str,
    review: Review,
    item: str = "thruster",
    events: list[str] | None = None,
) -> Array:
    """``column`` of an event × thruster table as (E, K), in the fit's order; NaN where absent.

    ``events`` are the rows wanted, those with thrusts if it is left out.
    """
    rows = events_of(review) if events is None else events
    wide = table.set_index(["event", item])[column].unstack(item)
    wide = wide.reindex(index=rows, columns=thrusters_of(review))
    return np.asarray(wide, dtype=float)


def thrust_grid(review: Review, column: str) -> Array:
    """``column`` of the thrust posterior, (E, K)."""
    rows = review.summary[review.summary["quantity"] == "thrust_n"]
    return grid(rows, column, review, "item")


def level_row(review: Review, column: str) -> Array:
    """``column`` of the thrusters' levels over all events, (K,)."""
    rows = review.summary[review.summary["quantity"] == "thrust_level_n"].set_index("item")
    return np.asarray(rows[column].reindex(thrusters_of(review)), dtype=float)


def flat_draws(dataset: xr.Dataset, name: str) -> Array:
    """Draws of a variable with chains put together, (n, ...)."""
    values = dataset[name].values
    return np.asarray(values.reshape(-1, *values.shape[2:]), dtype=float)


def both_draws(review: Review, name: str) -> tuple[Array, Array]:
    """Draws of a variable from the posterior and from the prior."""
    return flat_draws(review.fit.posterior, name), flat_draws(review.fit.prior, name)


def level_columns(review: Review) -> list[Column]:
    """Thrust level of every thruster."""
    posterior, prior = both_draws(review, "thrust_level_n")
    return [
        Column(f"{name} level", "N", posterior[:, k], prior[:, k])
        for k, name in enumerate(thrusters_of(review))
    ]


def common_column(review: Review) -> Column | None:
    """The thrust that all thrusters share; None where there are none."""
    name = "thrust_common_n"
    if name not in review.fit.posterior:
        return None
    return Column("common thrust", "N", *both_draws(review, name))


def nuisance_column(review: Review, name: str) -> Column | None:
    """Draws of a walked parameter; None when the fit keeps it under no name known here.

    Wheel inertias are kept in one variable with a ``wheel`` dimension.
    """
    rows = review.nuisances[review.nuisances["name"] == name]
    if rows.empty:
        return None
    unit = str(rows["unit"].iloc[0])
    if name in review.fit.posterior:
        after, before = both_draws(review, name)
        if after.ndim > 1:  # of some events: the walked parameter is the same in all of them
            own = int(np.flatnonzero(np.isfinite(after[0]))[-1])
            after, before = after[:, own], before[:, own]
    else:
        place = _wheel_place(review, name)
        if place is None:
            return None
        after, before = (draws[:, place] for draws in both_draws(review, _WHEEL_INERTIA))
    scale = parameter_scale(review, name)
    return Column(short_name(name, unit), scale.unit, after * scale.factor, before * scale.factor)


_WHEEL_INERTIA = "rwa_inertia_kg_m2"


def _wheel_place(review: Review, name: str) -> int | None:
    """Which wheel's inertia a parameter is: the one whose posterior mean is the same number."""
    if _WHEEL_INERTIA not in review.fit.posterior:
        return None
    mean = float(review.nuisances.set_index("name")["mean"][name])
    means = flat_draws(review.fit.posterior, _WHEEL_INERTIA).mean(axis=0)
    same = np.flatnonzero(np.isclose(means, mean, rtol=1e-9, atol=0.0))
    return int(same[0]) if len(same) else None


def parameter_scale(review: Review, name: str) -> Scale:
    """The unit in which a walked parameter is shown everywhere."""
    row = review.nuisances.set_index("name").loc[name]
    return display_scale(
        str(row["unit"]), float(row["mean"]), float(row["prior_mean"]), float(row["prior_sd"])
    )


def budget_blocks(budget: pd.DataFrame) -> list[str]:
    """Blocks of the error budget, largest mean share first; noise and the rest last."""
    columns = [c for c in budget.columns if c.endswith(SHARE)]
    names = [c.removesuffix(SHARE) for c in columns]
    blocks = [n for n in names if n not in NOT_BLOCKS]
    blocks.sort(key=lambda n: -float(np.nanmean(np.abs(budget[n + SHARE]))) if len(budget) else 0.0)
    return blocks + [n for n in NOT_BLOCKS if n in names]


def nuisance_pages(review: Review) -> list[tuple[list[str], str]]:
    """Walked parameters per corner plot, and its title: by block, on as few pages as labels allow.

    A block is split only where it is larger than a page.
    """
    table = review.nuisances
    pages: list[tuple[list[str], list[str]]] = []
    for block in dict.fromkeys(table["block"]):
        members = list(table[table["block"] == block]["name"])
        for start in range(0, len(members), MOST_COLUMNS):
            part = members[start : start + MOST_COLUMNS]
            if pages and len(pages[-1][0]) + len(part) <= MOST_COLUMNS:
                pages[-1][0].extend(part)
                pages[-1][1].append(str(block))
            else:
                pages.append((part, [str(block)]))
    return [(names, f"Nuisances: {', '.join(dict.fromkeys(blocks))}") for names, blocks in pages]
