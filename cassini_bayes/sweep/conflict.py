"""Prior-data conflict per block and per event, before and after fitting, in a sentence each.

Blocks. With z a block's standard coordinates (before the data mean 0, variance 1), y the data and a
linear model, the posterior mean m has variance V = 1 − C before the data are seen, C the posterior
covariance. mᵀ V⁻¹ m is χ² with as many degrees of freedom as the data tell directions of the block;
a direction that they narrow by less than 5 % is not told. *After fitting* m and C are those of the
posterior. *Before fitting* m = Cov(z, y) Cov(y)⁻¹ (y − E y), from draws of the prior and its
predictive distribution, without any fit.

Events. The distance of the event's on-times from their predictive distribution, in its own
covariance, ranked among its draws: under the prior (before) and under the posterior (after; the
data have then been used twice, so it is conservative).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from cassini_bayes.computing.arrays import Array
from cassini_bayes.results.ranks import holm
from cassini_bayes.results.record import Fit
from cassini_bayes.sweep.coordinates import Coordinates

INFORMED: Final = 1.0 - 0.95**2
"""Share of the prior variance that data take away where they narrow a width by 5 %; a direction
with less is the prior's alone."""
RANK: Final = 1e-6  # of the largest eigenvalue, and of a range of draws: less is rounding
LEVEL: Final = 0.05  # family-wise (Holm): one false conflict in twenty fits
LEAST_PULL: Final = 0.5  # prior standard deviations: less is not worth a sentence (judgement)
_ON_TIME: Final = "on_time_s"


@dataclass(frozen=True)
class Pull:
    """How far the data pull a block: p-value, directions told, and the strongest parameter."""

    p_value: float
    directions: int
    parameter: str
    pull: float  # of that parameter, in the standard deviations that it was expected to move by


NO_PULL: Final = Pull(np.nan, 0, "", np.nan)


def conflict_table(blocks: Mapping[str, Coordinates], fit: Fit) -> pd.DataFrame:
    """One row per block and event: p-values before and after fitting, verdict, sentence.

    ``verdict`` is ``conflict`` where Holm's correction over all rows of the same kind leaves either
    p-value below 0.05, ``not told`` where the data narrow no direction of the block, else
    ``agree``. Columns: level, name, p_before, p_after, directions, parameter, pull_sd, verdict,
    sentence. A p-value is NaN where the fit has nothing to take it from.
    """
    rows: list[tuple[object, ...]] = []
    for block, coordinates in blocks.items():
        before, after = pull_before(coordinates, fit), pull_after(coordinates)
        rows.append(("block", block, before.p_value, *vars(after).values()))
    for event, (p_before, p_after) in event_p_values(fit).items():
        rows.append(("event", event, p_before, *vars(replace(NO_PULL, p_value=p_after)).values()))
    columns = ["level", "name", "p_before", "p_after", "directions", "parameter", "pull_sd"]
    table = pd.DataFrame(rows, columns=columns)
    table["verdict"] = "agree"
    for level in ("block", "event"):
        own_rows = table["level"] == level
        for column in ("p_before", "p_after"):
            told = own_rows & table[column].notna()
            if told.any():
                bad = holm(table.loc[told, column].to_numpy()) < LEVEL
                table.loc[table.index[told][bad], "verdict"] = "conflict"
    silent = (table["level"] == "block") & table[["p_before", "p_after"]].isna().all(axis=1)
    table.loc[silent, "verdict"] = "not told"
    table["sentence"] = [sentence(row) for _, row in table.iterrows()]
    return table


def sentence(row: pd.Series) -> str:
    """A row of :func:`conflict_table` in words."""
    name = str(row["name"])
    told = ", ".join(
        f"p = {_probability(float(row[column]))} {when} fitting"
        for column, when in (("p_before", "before"), ("p_after", "after"))
        if np.isfinite(row[column])
    )
    if row["verdict"] == "not told":
        return f"{name}: these data say nothing about it; the prior is returned."
    if row["level"] == "event":
        if row["verdict"] == "conflict":
            return f"{name}: its on-times are not what the model leads one to expect ({told})."
        return f"{name}: its on-times are among those the model leads one to expect ({told})."
    pull = f"{row['pull_sd']:+.1f}".replace("-", "−")
    worth_saying = bool(row["parameter"]) and abs(row["pull_sd"]) >= LEAST_PULL
    most = f"the strongest pull is on {row['parameter']}, {pull} σ" if worth_saying else ""
    if row["verdict"] == "conflict":
        end = f"; {most}" if most else ""
        return (
            f"{name}: data and prior disagree ({told}){end}. One of them, or the model, is wrong."
        )
    return f"{name}: the data agree with the prior ({told}){f'; {most}' if most else ''}."


def _probability(p: float) -> str:
    return f"{p:.2f}" if p >= 0.01 else f"{p:.1g}"


def pull_after(own: Coordinates) -> Pull:
    """The pull of the data on a block, from its posterior."""
    mean = own.posterior.mean(0)
    covariance = np.atleast_2d(np.cov(own.posterior, rowvar=False))
    return _pull(own.names, mean, np.eye(len(mean)) - covariance)


def pull_before(own: Coordinates, fit: Fit) -> Pull:
    """The pull of the data on a block, predicted from the prior and its predictive draws."""
    draws, observed = _predictive(fit, "prior_predictive")
    if draws.shape[1] == 0 or len(draws) != len(own.prior):
        return NO_PULL
    z = own.prior - own.prior.mean(0)
    gain = _whitened(draws)
    white = (draws - draws.mean(0)) @ gain
    cross = z.T @ white / (len(z) - 1.0)
    mean = cross @ ((observed - draws.mean(0)) @ gain)
    return _pull(own.names, mean, cross @ cross.T)


def _pull(names: tuple[str, ...], mean: Array, variance: Array) -> Pull:
    """mᵀ V⁺ m over the directions that the data tell."""
    values, vectors = np.linalg.eigh(0.5 * (variance + variance.T))
    told = values > INFORMED
    if not told.any():
        return NO_PULL
    along = vectors[:, told].T @ mean
    distance = float((along**2 / values[told]).sum())
    diagonal = np.diagonal(variance)
    pulls = np.where(
        diagonal > INFORMED, mean / np.sqrt(np.where(diagonal > INFORMED, diagonal, 1.0)), 0.0
    )
    strongest = int(np.argmax(np.abs(pulls)))
    return Pull(
        p_value=float(chi2.sf(distance, told.sum())),
        directions=int(told.sum()),
        parameter=names[strongest] if pulls[strongest] != 0.0 else "",
        pull=float(pulls[strongest]),
    )


def event_p_values(fit: Fit) -> dict[str, tuple[float, float]]:
    """Event → p-values of its on-times before and after fitting; empty without on-times."""
    if _ON_TIME not in fit.groups["observed_data"]:
        return {}
    before, after = (
        {
            str(event): predictive_p_value(*_predictive(fit, group, str(event)))
            for event in fit.groups["observed_data"].coords["event"].values
        }
        for group in ("prior_predictive", "posterior_predictive")
    )
    return {event: (p_value, after[event]) for event, p_value in before.items()}


def predictive_p_value(draws: Array, observed: Array) -> float:
    """Share of predictive draws (n, r) as far out as the observation (r,), in their covariance."""
    if draws.shape[1] == 0:
        return np.nan
    centre, gain = draws.mean(0), _whitened(draws)
    distances = (((draws - centre) @ gain) ** 2).sum(-1)
    mine = float((((observed - centre) @ gain) ** 2).sum())
    return float(((distances >= mine).sum() + 1.0) / (len(draws) + 1.0))


def _whitened(draws: Array) -> Array:
    """Matrix (r, rank) that makes draws (n, r) uncorrelated with unit variance."""
    scale = draws.std(0, ddof=1)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.corrcoef(draws, rowvar=False)))
    kept = values > RANK * values[-1]
    return np.asarray(vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None])


def _predictive(fit: Fit, group: str, event: str | None = None) -> tuple[Array, Array]:
    """Predictive on-times (n, r) that vary from draw to draw, and the observed ones (r,)."""
    if _ON_TIME not in fit.groups[group] or _ON_TIME not in fit.groups["observed_data"]:
        return np.empty((0, 0)), np.empty(0)
    drawn, seen = fit.groups[group][_ON_TIME], fit.groups["observed_data"][_ON_TIME]
    if event is not None:
        drawn, seen = drawn.sel(event=event), seen.sel(event=event)
    draws = drawn.values.reshape(drawn.sizes["chain"] * drawn.sizes["draw"], -1)
    observed = seen.values.reshape(-1)
    varies = np.isfinite(draws).all(0) & np.isfinite(observed) & (np.ptp(draws, axis=0) > RANK)
    return np.asarray(draws[:, varies]), np.asarray(observed[varies])
