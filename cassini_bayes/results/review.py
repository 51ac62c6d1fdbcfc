"""Everything a report shows, as tables: assembled from a model and its fit, drawn nowhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from cassini_bayes.balance.computed_delta_v import predicted_delta_v
from cassini_bayes.computing.arviz_import import arviz
from cassini_bayes.model.observability import Observability
from cassini_bayes.model.posterior import Model
from cassini_bayes.model.totals import SOFTWARE, TotalsTerm, linear_system, prior_centre
from cassini_bayes.priors.reader import Priors
from cassini_bayes.results.baselines import perturbation_bars
from cassini_bayes.results.record import Fit
from cassini_bayes.results.sensitivity import error_budget, prior_against_posterior
from cassini_bayes.results.time_series import EventSeries
from cassini_bayes.sampling.ensembles import stored_ess

Array = NDArray[np.float64]

HDI_PROBABILITY: Final = 0.90
MM_PER_M: Final = 1e3
VARIANT_COLUMNS: Final = (
    "variant",
    "event",
    "thruster",
    "mean_n",
    "sd_n",
    "hdi_90_low_n",
    "hdi_90_high_n",
)


@dataclass(frozen=True)
class Review:
    """Tables, fit and facts of one run; plots and report only read it.

    Column names carry units. Every interval is a 90 % highest-density interval.
    """

    name: str
    fit: Fit
    summary: pd.DataFrame
    nuisances: pd.DataFrame
    budget: pd.DataFrame
    baseline: pd.DataFrame
    predictive: pd.DataFrame
    balance: pd.DataFrame
    delta_v: pd.DataFrame
    variants: pd.DataFrame
    convergence: pd.DataFrame
    facts: Mapping[str, str]
    warnings: tuple[str, ...]
    telemetry: TelemetryReview | None = None  # of runs with telemetry only


@dataclass(frozen=True)
class TelemetryReview:
    """What a review of telemetry has beyond one of totals rows.

    ``events`` lists rows read and used, ``inertia`` the tensor both ways, ``inertia_methods`` the
    papers' least squares and ``torque_methods`` the drift of the wheels beside the posterior;
    ``series`` are the balances row by row.
    """

    events: pd.DataFrame
    inertia: pd.DataFrame
    physicality: str
    inertia_methods: pd.DataFrame
    torque_methods: pd.DataFrame
    observability: Observability
    series: tuple[EventSeries, ...]
    mends: tuple[str, ...]

    def tables(self) -> dict[str, pd.DataFrame]:
        """The tables by the name of their file."""
        return {
            "telemetry": self.events,
            "inertia": self.inertia,
            "inertia_methods": self.inertia_methods,
            "torque_methods": self.torque_methods,
            "observability": self.observability.table,
            **{f"series_{i}": series.table() for i, series in enumerate(self.series, start=1)},
        }


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


def summarise(fit: Fit) -> pd.DataFrame:
    """One row per scalar of the posterior: moments, interval, prior, effective sizes, R-hat.

    Chains are ensembles. Split R-hat is ArviZ's, effective sample sizes are the smaller of ArviZ's
    over ensembles and over walkers (:func:`cassini_bayes.sampling.ensembles.stored_ess`).
    """
    posterior, prior = fit.posterior, fit.prior
    walkers = int(fit.attributes["walkers"])
    rows = []
    for quantity, everywhere in posterior.data_vars.items():
        variable = _where_it_is(everywhere)
        dims = [str(dim) for dim in variable.dims[2:]]
        before = prior[quantity].sel({dim: variable.coords[dim] for dim in dims})
        alone = variable.to_dataset(name=str(quantity))
        rhat, error = arviz().rhat(alone)[quantity], arviz().mcse(alone, method="mean")[quantity]
        for place in np.ndindex(variable.shape[2:]):
            labels = {
                dim: str(variable.coords[dim].values[i]) for dim, i in zip(dims, place, strict=True)
            }
            chains = variable.values[(slice(None), slice(None), *place)]
            values = chains.reshape(-1)
            bulk, tail = stored_ess(chains, walkers)
            prior_values = before.values[(slice(None), slice(None), *place)].reshape(-1)
            low, high = hdi(values)
            index = f"[{','.join(labels.values())}]" if labels else ""
            rows.append(
                {
                    "name": f"{quantity}{index}",
                    "quantity": quantity,
                    "event": labels.get("event", ""),
                    "item": next((v for d, v in labels.items() if d != "event"), ""),
                    "unit": variable.attrs["units"],
                    "mean": values.mean(),
                    "sd": values.std(ddof=1),
                    "median": np.median(values),
                    "hdi_90_low": float(low),
                    "hdi_90_high": float(high),
                    "prior_mean": prior_values.mean(),
                    "prior_sd": prior_values.std(ddof=1),
                    "ess_bulk": bulk,
                    "ess_tail": tail,
                    "rhat": float(rhat.values[place]),
                    "mcse_mean": float(error.values[place]),
                }
            )
    return pd.DataFrame(rows)


def _where_it_is(variable: xr.DataArray) -> xr.DataArray:
    """The events that have the quantity: of others it is NaN throughout."""
    return variable.dropna("event", how="all") if "event" in variable.dims else variable


def nuisance_table(model: TotalsTerm | Model, priors: Priors, z: Array) -> pd.DataFrame:
    """Prior against posterior of every walked parameter in its own units, with the verdict."""
    table = prior_against_posterior(model, z)
    physical = model.space.to_parameters(z)
    rows = []
    for name in model.space.names:
        prior = priors.parameters[name]
        assert prior.distribution is not None  # walked parameters have one
        values = np.asarray(physical[name])
        low, high = hdi(values)
        rows.append(
            {
                "name": name,
                "block": prior.spec.block,
                "unit": prior.spec.unit,
                "meaning": prior.spec.meaning,
                "source": prior.source,
                "prior_mean": prior.distribution.mean(),
                "prior_sd": prior.distribution.sd(),
                "mean": values.mean(),
                "sd": values.std(ddof=1),
                "hdi_90_low": float(low),
                "hdi_90_high": float(high),
            }
        )
    return pd.DataFrame(rows).merge(table, on="name", validate="one_to_one")


def predictive_table(fit: Fit) -> pd.DataFrame:
    """Measured on-times against replicates of the same biases.

    ``tail_probability`` is the smaller of the shares of replicates above and below the measurement.
    """
    replicate = fit.groups["posterior_predictive"]["on_time_s"]
    measured = fit.groups["observed_data"]["on_time_s"].values
    draws = replicate.values.reshape(-1, *measured.shape)
    low, high = hdi(draws)
    above = (draws > measured).mean(0)
    events, thrusters = replicate.coords["event"].values, replicate.coords["thruster"].values
    return pd.DataFrame(
        {
            "event": np.repeat(events, len(thrusters)),
            "thruster": np.tile(thrusters, len(events)),
            "measured_s": measured.reshape(-1),
            "mean_s": draws.mean(0).reshape(-1),
            "sd_s": draws.std(0, ddof=1).reshape(-1),
            "hdi_90_low_s": low.reshape(-1),
            "hdi_90_high_s": high.reshape(-1),
            "tail_probability": np.minimum(above, 1.0 - above).reshape(-1),
        }
    )


def balance_table(model: TotalsTerm, fit: Fit, z: Array) -> pd.DataFrame:
    """Momentum left over per event and axis, against the noise the model allows for."""
    residual = fit.groups["posterior_predictive"]["balance_residual_n_m_s"]
    events, axes = residual.coords["event"].values, residual.coords["axis"].values
    draws = residual.values.reshape(-1, len(events), len(axes))
    covariance = linear_system(model, model.space.to_parameters(z)).covariance
    noise = np.sqrt(np.diagonal(covariance[..., :3, :3], axis1=-2, axis2=-1).mean(0))
    return pd.DataFrame(
        {
            "event": np.repeat(events, len(axes)),
            "axis": np.tile(axes, len(events)),
            "residual_n_m_s": draws.mean(0).reshape(-1),
            "sd_n_m_s": draws.std(0, ddof=1).reshape(-1),
            "noise_sd_n_m_s": noise.reshape(-1),
            "standardised": (draws.mean(0) / noise).reshape(-1),
        }
    )


def delta_v_table(model: TotalsTerm, fit: Fit) -> pd.DataFrame:
    """Printed ΔV against the on-board computation, events that declare a computed ΔV only.

    ``computed_sd_mm_s`` is the spread of the computation itself, ``noise_sd_mm_s`` that of the
    printed figure about it.
    """
    channel = model.computed
    if channel is None:
        return pd.DataFrame(
            columns=[
                "event",
                "printed_mm_s",
                "computed_mean_mm_s",
                "computed_sd_mm_s",
                "noise_sd_mm_s",
            ]
        )
    software = np.stack([fit.posterior[name].values.reshape(-1) for name in SOFTWARE], axis=-1)
    computed = predicted_delta_v(channel, software) * MM_PER_M
    noise = fit.posterior["delta_v_noise_m_s"].values.mean() * MM_PER_M
    return pd.DataFrame(
        {
            "event": np.array(model.stack.event_ids)[channel.used],
            "printed_mm_s": channel.printed_m_s * MM_PER_M,
            "computed_mean_mm_s": computed.mean(0),
            "computed_sd_mm_s": computed.std(0, ddof=1),
            "noise_sd_mm_s": noise,
        }
    )


def thrust_variant(name: str, model: TotalsTerm, thrust_n: Array) -> pd.DataFrame:
    """Thrust posterior under one use of ΔV, long format; thrust_n (n, E, K)."""
    low, high = hdi(thrust_n)
    stack = model.stack
    return pd.DataFrame(
        {
            "variant": name,
            "event": np.repeat(stack.event_ids, len(stack.thrusters)),
            "thruster": np.tile(stack.thrusters, len(stack.event_ids)),
            "mean_n": thrust_n.mean(0).reshape(-1),
            "sd_n": thrust_n.std(0, ddof=1).reshape(-1),
            "hdi_90_low_n": low.reshape(-1),
            "hdi_90_high_n": high.reshape(-1),
        }
    )


def assemble_review(
    name: str,
    model: TotalsTerm,
    priors: Priors,
    fit: Fit,
    z: Array,
    *,
    variants: Sequence[pd.DataFrame],
    convergence: pd.DataFrame,
    facts: Mapping[str, str],
    warnings: Sequence[str],
) -> Review:
    """Build every table of a review; z (n, d) are the posterior draws of the fit, flattened."""
    nuisances = nuisance_table(model, priors, z)
    baseline = perturbation_bars(model, prior_centre(model))
    return Review(
        name=name,
        fit=fit,
        summary=summarise(fit),
        nuisances=nuisances,
        budget=error_budget(model, z),
        baseline=baseline,
        predictive=predictive_table(fit),
        balance=balance_table(model, fit, z),
        delta_v=delta_v_table(model, fit),
        variants=(
            pd.concat(variants, ignore_index=True)
            if variants
            else pd.DataFrame(columns=list(VARIANT_COLUMNS))
        ),
        convergence=convergence,
        facts=facts,
        warnings=(*warnings, *conflict_sentences(nuisances)),
    )


def conflict_sentences(nuisances: pd.DataFrame) -> list[str]:
    """Conflicts between priors and data, said in a sentence each."""
    return [
        f"{row['name']}: the data pull it {row['surprise']:+.1f} standard deviations from its "
        f"prior ({row['prior_mean']:.4g} ± {row['prior_sd']:.2g} → {row['mean']:.4g} ± "
        f"{row['sd']:.2g} {row['unit']})."
        for _, row in nuisances[nuisances["verdict"] == "conflict"].iterrows()
    ]


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
