"""The tables of a finished run: summaries of draws, and model against measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd
import xarray as xr

from cassini_bayes.balance.computed_delta_v import predicted_delta_v
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.arviz_import import arviz
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.posterior import Model
from cassini_bayes.priors.reader import Priors
from cassini_bayes.results.baselines import perturbation_bars
from cassini_bayes.results.record import Fit
from cassini_bayes.results.sensitivity import conflicts, prior_against_posterior
from cassini_bayes.results.telemetry_baselines import burn_methods, thrust_methods
from cassini_bayes.results.time_series import EventSeries
from cassini_bayes.sampling.ensembles import stored_ess
from cassini_bayes.spacecraft.parameters import SOFTWARE

HDI_PROBABILITY: Final = 0.90
MM_PER_M: Final = 1e3
CHANNEL_NOISE: Final = "delta_v_noise_m_s"
WIDER: Final = 1.3  # than its prior, in standard normals: four hundred draws reach 1.1 by chance


def hdi(draws: Array, probability: float = HDI_PROBABILITY) -> tuple[Array, Array]:
    """Highest-density interval over the first axis: the narrowest that holds the probability.

    draws (n, ...) → low (...), high (...).
    """
    ordered = np.sort(draws, axis=0)
    n = len(ordered)
    inside = int(np.floor(probability * n))
    if inside >= n:
        return ordered[0], ordered[-1]
    width = ordered[inside:] - ordered[: n - inside]
    first = np.argmin(width, axis=0)
    low = np.take_along_axis(ordered, first[None], axis=0)[0]
    high = np.take_along_axis(ordered, first[None] + inside, axis=0)[0]
    return low, high


def described(draws: Array, unit: str = "") -> dict[str, Array]:
    """Columns of draws (n, ...): mean, standard deviation, ends of the highest-density interval."""
    low, high = hdi(draws)
    behind = f"_{unit}" if unit else ""
    return {
        f"mean{behind}": np.asarray(draws.mean(0)),
        f"sd{behind}": np.asarray(draws.std(0, ddof=1)),
        f"hdi_90_low{behind}": low,
        f"hdi_90_high{behind}": high,
    }


def by_event(
    events: Sequence[str], item: str, names: Sequence[str], columns: Mapping[str, Array]
) -> pd.DataFrame:
    """Long table: one row per event and item of columns (E, I)."""
    return pd.DataFrame(
        {
            "event": np.repeat(events, len(names)),
            item: np.tile(names, len(events)),
            **{name: values.reshape(-1) for name, values in columns.items()},
        }
    )


def summarise(fit: Fit) -> pd.DataFrame:
    """One row per scalar of the posterior: moments, interval, prior, effective sizes, R-hat.

    Chains are ensembles. Split R-hat is ArviZ's, effective sample sizes are the smaller of ArviZ's
    over ensembles and over walkers (:func:`cassini_bayes.sampling.ensembles.stored_ess`).
    Importance draws (of a mission) have no walkers and are one chain, so that R-hat is NaN.
    """
    posterior, prior = fit.posterior, fit.prior
    walkers = int(fit.attributes.get("walkers", 1))
    rows = []
    for quantity, everywhere in posterior.data_vars.items():
        variable = _where_it_is(everywhere)
        dims = [str(dim) for dim in variable.dims[2:]]
        before = prior[quantity].sel({dim: variable.coords[dim] for dim in dims})
        alone = variable.to_dataset(name=str(quantity))
        error = arviz().mcse(alone, method="mean")[quantity]
        is_one = posterior.sizes["chain"] == 1
        rhat = xr.full_like(error, np.nan) if is_one else arviz().rhat(alone)[quantity]
        for place in np.ndindex(variable.shape[2:]):
            labels = {
                dim: str(variable.coords[dim].values[i]) for dim, i in zip(dims, place, strict=True)
            }
            chains = variable.values[(slice(None), slice(None), *place)]
            values = chains.reshape(-1)
            mean, sd = moments(values)
            bulk, tail = stored_ess(chains, walkers)
            prior_mean, prior_sd = moments(
                before.values[(slice(None), slice(None), *place)].reshape(-1)
            )
            low, high = hdi(values)
            index = f"[{','.join(labels.values())}]" if labels else ""
            rows.append(
                {
                    "name": f"{quantity}{index}",
                    "quantity": quantity,
                    "event": labels.get("event", ""),
                    "item": next((v for d, v in labels.items() if d != "event"), ""),
                    "unit": variable.attrs["units"],
                    "mean": mean,
                    "sd": sd,
                    "median": np.median(values),
                    "hdi_90_low": float(low),
                    "hdi_90_high": float(high),
                    "prior_mean": prior_mean,
                    "prior_sd": prior_sd,
                    "ess_bulk": bulk,
                    "ess_tail": tail,
                    "rhat": float(rhat.values[place]),
                    "mcse_mean": float(error.values[place]),
                }
            )
    return pd.DataFrame(rows)


def moments(draws: Array) -> tuple[float, float]:
    """Mean and standard deviation of draws (n,): of what is fixed its value, and 0 exactly."""
    if np.ptp(draws) == 0.0:  # sums of it have rounding
        return float(draws[0]), 0.0
    return float(draws.mean()), float(draws.std(ddof=1))


def _where_it_is(variable: xr.DataArray) -> xr.DataArray:
    """The events that have the quantity: of others it is NaN throughout."""
    return variable.dropna("event", how="all") if "event" in variable.dims else variable


def nuisance_table(model: Model, priors: Priors, z: Array) -> pd.DataFrame:
    """Prior against posterior of every walked parameter in its own units, with the verdict."""
    table = prior_against_posterior(model, z)
    physical = model.space.to_parameters(z)
    rows = []
    sources = {name: prior.source for name, prior in priors.parameters.items()}
    sources |= {spec.name: effect.source for effect in model.effects for spec in effect.specs}
    for name, prior in zip(model.space.names, model.space.distributions, strict=True):
        spec = model.specs[name]
        rows.append(
            {
                "name": name,
                "block": spec.block,
                "unit": spec.unit,
                "meaning": spec.meaning,
                "source": sources[name],
                "prior_mean": prior.mean(),
                "prior_sd": prior.sd(),
                **{k: float(v) for k, v in described(np.asarray(physical[name])).items()},
            }
        )
    return pd.DataFrame(rows).merge(table, on="name", validate="one_to_one")


def thrust_baselines(model: Model) -> pd.DataFrame:
    """Thrusts by the methods this package replaces, from every event that fires.

    Where totals rows and telemetry are fitted together the pooled estimates of either kind are left
    out: they are not of all events.
    """
    parts = [
        thrust_methods(model),
        burn_methods(model),
        perturbation_bars(model, model.space.centre()),
    ]
    kept = [part for part in parts if not part.empty]
    table = pd.concat(kept, ignore_index=True) if kept else pd.DataFrame()
    if model.totals and model.telemetry and not table.empty:
        table = table[table["event"] != ""].reset_index(drop=True)
    return table


def predictive_table(fit: Fit) -> pd.DataFrame:
    """Measured on-times against replicates of the same biases; nothing where none are flown again.

    ``tail_probability`` is the smaller of the shares of replicates above and below the measurement.
    """
    predictive = fit.groups["posterior_predictive"]
    if "on_time_s" not in predictive:
        return pd.DataFrame()
    replicate = predictive["on_time_s"].dropna("event", how="all")
    events, thrusters = replicate.coords["event"].values, replicate.coords["thruster"].values
    measured = fit.groups["observed_data"]["on_time_s"].sel(event=events).values
    draws = replicate.values.reshape(-1, *measured.shape)
    above = (draws > measured).mean(0)
    columns = {
        "measured_s": measured,
        **described(draws, "s"),
        "tail_probability": np.minimum(above, 1.0 - above),
    }
    return by_event(events, "thruster", thrusters, columns)


def balance_table(model: Model, fit: Fit, z: Array, series: Sequence[EventSeries]) -> pd.DataFrame:
    """Momentum left over per event and axis, against the noise the model allows for.

    Delivered minus gained: of a totals row over the event, of telemetry at the last usable row.
    z (n, d) are the posterior draws.
    """
    parts = []
    for term in model.totals:
        residual = fit.groups["posterior_predictive"]["balance_residual_n_m_s"]
        draws = residual.sel(event=list(term.event_ids)).values.reshape(-1, len(term.event_ids), 3)
        covariance = term.at(model.points(z)).system.covariance
        noise = np.sqrt(np.diagonal(covariance[..., :3, :3], axis1=-2, axis2=-1).mean(0))
        parts.append(_balance(term.event_ids, draws.mean(0), draws.std(0, ddof=1), noise))
    parts += [
        _balance([one.event], -one.residual[-1:], one.residual_sd[-1:], one.noise_sd[-1:])
        for one in series
    ]
    return pd.concat(parts, ignore_index=True)


def _balance(ids: Sequence[str], left: Array, spread: Array, noise: Array) -> pd.DataFrame:
    columns = {
        "residual_n_m_s": left,
        "sd_n_m_s": spread,
        "noise_sd_n_m_s": noise,
        "standardised": left / noise,
    }
    return by_event(ids, "axis", tuple("xyz"), columns)


def delta_v_table(model: Model, fit: Fit) -> pd.DataFrame:
    """Printed ΔV against the on-board computation, rows that declare a computed ΔV only.

    ``computed_sd_mm_s`` is the spread of the computation itself, ``noise_sd_mm_s`` that of the
    printed figure about it: the root mean square over the posterior, since variances add.
    """
    columns = ["event", "printed_mm_s", "computed_mean_mm_s", "computed_sd_mm_s", "noise_sd_mm_s"]
    channels = [term.computed for term in model.totals if term.computed is not None]
    if not channels:
        return pd.DataFrame(columns=columns)
    (channel,) = channels
    software = np.stack([fit.posterior[name].values.reshape(-1) for name in SOFTWARE], axis=-1)
    computed = predicted_delta_v(channel, software) * MM_PER_M
    values = (
        np.array(model.totals_rows.event_ids)[channel.used],
        channel.printed_m_s * MM_PER_M,
        computed.mean(0),
        computed.std(0, ddof=1),
        _channel_noise_m_s(model, fit) * MM_PER_M,
    )
    return pd.DataFrame(dict(zip(columns, values, strict=True)))


def _channel_noise_m_s(model: Model, fit: Fit) -> float:
    """Root mean square over the posterior, or the value that the priors fix: that has no draws."""
    if CHANNEL_NOISE in model.space.fixed:
        return float(model.space.fixed[CHANNEL_NOISE])
    return float(np.sqrt((fit.posterior[CHANNEL_NOISE].values ** 2).mean()))


def event_table(events: Sequence[ReducedEvent], series: Sequence[EventSeries]) -> pd.DataFrame:
    """Rows read and used per telemetry event, and the share of them inside the noise's band."""
    return pd.DataFrame(
        {
            "event": [event.id for event in events],
            "kind": [event.kind for event in events],
            "source": [event.source for event in events],
            "duration_s": [event.reading.end_s - event.reading.start_s for event in events],
            "rows_read": [event.reading.rows for event in events],
            "rows_used": [event.statistics.rows for event in events],
            **{
                f"inside_90_{axis}": [float(one.inside[i]) for one in series]
                for i, axis in enumerate("xyz")
            },
        }
    )


def conflict_sentences(nuisances: pd.DataFrame) -> list[str]:
    """Conflicts between priors and data, in a sentence each."""
    return [
        f"{row['name']}: the data pull it {row['surprise']:+.1f} standard deviations from its "
        f"prior ({row['prior_mean']:.4g} ± {row['prior_sd']:.2g} → {row['mean']:.4g} ± "
        f"{row['sd']:.2g} {row['unit']})."
        for _, row in nuisances[nuisances["verdict"] == "conflict"].iterrows()
    ]


def wide_sentences(names: Sequence[str], z: Array) -> list[str]:
    """Walked parameters whose draws z (n, d) are wider than their priors: several modes, as a rule.

    Data that tell nothing of a parameter leave it as wide as its prior. Where they pull it to two
    places, mean and interval describe neither.
    """
    return [
        f"{name}: the posterior is {width:.1f} times as wide as the prior: it has more than one "
        "mode, or a long tail; look at its figure before you use its mean and interval."
        for name, width in zip(names, z.std(axis=0), strict=True)
        if width > WIDER
    ]


def thrust_conflicts(summary: pd.DataFrame) -> pd.DataFrame:
    """Prior against posterior of thrusts, which no table of walked parameters has, by one rule.

    The common thrust; where it agrees with its prior, every thruster's level.
    """
    for quantity in ("thrust_common_n", "thrust_level_n"):
        rows = summary[(summary["quantity"] == quantity) & (summary["prior_sd"] > 0)]
        moved = ((rows["mean"] - rows["prior_mean"]) / rows["prior_sd"]).to_numpy()
        width = (rows["sd"] / rows["prior_sd"]).to_numpy()
        judged = conflicts(list(rows["name"]), moved, width)
        rows = rows.reset_index(drop=True).assign(
            surprise=judged["surprise"], verdict=judged["verdict"]
        )
        result = rows[rows["verdict"] == "conflict"]
        if len(result):
            break
    return result


def worst_convergence(summary: pd.DataFrame) -> tuple[float, float, float]:
    """Largest R-hat, smallest bulk and smallest tail effective sample size over all scalars.

    Scalars that do not vary (fixed by the priors) have no sample size and are left out.
    """
    varying = summary[summary["sd"] > 0]
    return (
        float(varying["rhat"].max()),
        float(varying["ess_bulk"].min()),
        float(varying["ess_tail"].min()),
    )
