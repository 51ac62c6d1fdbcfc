"""A fit as ArviZ wants it, so that its summaries, plots and leave-one-out work as they are.

ArviZ pairs variables of different groups by name and by chain and draw; ``fit.nc`` says more than
that: figures without a replicate, replicates of other draws, events that lack a quantity.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import xarray as xr

from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.computing.arviz_import import arviz
from cassini_bayes.results.fitting import WALKED
from cassini_bayes.results.groups import DENSITY
from cassini_bayes.results.record import Fit

REPLICATE: Final = "replicate"
MOST_REPLICATES: Final = 125
"""Of a chain: ``az.plot_ppc`` draws a density of each, a minute's work for all draws."""


def inference_data(fit: Fit, event_density: Array | None = None) -> Any:  # ArviZ has no types
    """The fit as ``arviz.InferenceData``.

    Parameters
    ----------
    fit
        Draws, prior draws, replicates and data.
    event_density
        Log density (n, E) of every event's data given what events share, to stand for what the fit
        has: the unit of leave-one-event-out (:func:`.event_log_marginal`).

    Returns
    -------
    InferenceData whose ``log_likelihood`` has one variable with one dimension, ``event``; whose
    predictive groups have what was observed and nothing else. Where only some events have a
    quantity, its dimension is named after it: ``thrust_n_event``. Replicates are thinned to
    :data:`MOST_REPLICATES` of a chain.
    """
    groups = {name: _finite(dataset) for name, dataset in fit.groups.items()}
    chains, draws = fit.posterior.sizes["chain"], fit.posterior.sizes["draw"]
    if event_density is not None:
        values = event_density.reshape(chains, draws, -1)
        density = fit.groups["log_likelihood"]
        (old,) = density.data_vars.values()
        groups["log_likelihood"] = xr.Dataset({DENSITY: old.copy(data=values)})
    replicated = {*groups["posterior_predictive"].data_vars} & {*groups["observed_data"].data_vars}
    observed = groups["observed_data"]
    others = [str(name) for name in observed.data_vars if name not in replicated]
    groups["constant_data"] = groups["constant_data"].merge(observed[others], compat="override")
    groups["observed_data"] = observed[sorted(map(str, replicated))]
    for name in ("posterior_predictive", "prior_predictive"):
        kept = [str(v) for v in groups[name].data_vars if v in replicated]
        groups[name] = _same_draws(groups[name][kept])
    stats = groups["sample_stats"]
    groups["sample_stats"] = stats[[str(v) for v in stats.data_vars if WALKED not in stats[v].dims]]
    if not replicated:
        groups = {k: v for k, v in groups.items() if "predictive" not in k and k != "observed_data"}
    data = arviz().InferenceData(**{k: v for k, v in groups.items() if v.data_vars})
    data.attrs.update(fit.attributes)
    return data


def draws_as_inference_data(variables: Mapping[str, xr.DataArray], group: str) -> Any:
    """Draws (chain, draw, ...) by name as one group of ``arviz.InferenceData``."""
    return arviz().InferenceData(**{group: xr.Dataset(dict(variables))})


def _finite(dataset: xr.Dataset) -> xr.Dataset:
    """Quantities of some events only, with those events alone, on a dimension of their own."""
    result = {}
    for name, variable in dataset.data_vars.items():
        converted = variable
        if "event" in variable.dims and variable.dtype.kind == "f":
            has = variable.dropna("event", how="all")
            if has.sizes["event"] < variable.sizes["event"]:
                converted = has.rename({"event": f"{name}_event"})
        if converted.size:
            result[str(name)] = converted
    return xr.Dataset(result, attrs=dataset.attrs)


def _same_draws(dataset: xr.Dataset) -> xr.Dataset:
    """Predictive variables as (chain, draw, ...), thinned; replicates as draws of one chain.

    Variables of every draw are thinned to as many as there are replicates of rows, if any.
    """
    if REPLICATE not in dataset.dims:
        count = dataset.sizes.get("draw", 0)
        return dataset.isel(draw=_evenly(count, min(count, MOST_REPLICATES))) if count else dataset
    count = dataset.sizes[REPLICATE]
    result = {}
    for name, variable in dataset.data_vars.items():
        if REPLICATE in variable.dims:
            converted = variable.rename({REPLICATE: "draw"}).drop_vars("draw", errors="ignore")
        else:
            flat = variable.stack(all=("chain", "draw")).reset_index("all", drop=True)
            converted = flat.isel(all=_evenly(flat.sizes["all"], count)).rename({"all": "draw"})
        converted = converted.expand_dims(chain=1).assign_coords(chain=[0], draw=np.arange(count))
        rest = [dim for dim in converted.dims if dim not in ("chain", "draw")]
        result[str(name)] = converted.transpose("chain", "draw", *rest)
    return xr.Dataset(result)


def _evenly(size: int, count: int) -> Places:
    """So many places of ``size``, evenly spaced from the first to the last."""
    return np.linspace(0, size - 1, count).round().astype(np.int64)
