"""The review of a fit with telemetry: the tables of a totals fit, and what telemetry adds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.observability import observability
from cassini_bayes.model.posterior import Model, full_parameters
from cassini_bayes.model.totals import linear_system, prior_centre
from cassini_bayes.priors.reader import Priors
from cassini_bayes.results.baselines import perturbation_bars
from cassini_bayes.results.inertia import (
    WITH_WHEELS,
    WITHOUT_WHEELS,
    inertia_draws,
    inertia_table,
    physicality,
)
from cassini_bayes.results.inertia_baselines import inertia_methods
from cassini_bayes.results.record import Fit
from cassini_bayes.results.review import (
    VARIANT_COLUMNS,
    Review,
    TelemetryReview,
    conflict_sentences,
    delta_v_table,
    nuisance_table,
    predictive_table,
    summarise,
)
from cassini_bayes.results.sensitivity import error_budget
from cassini_bayes.results.telemetry_baselines import burn_methods, thrust_methods, torque_methods
from cassini_bayes.results.time_series import EventSeries, event_series

Array = NDArray[np.float64]
_BALANCE_COLUMNS = (
    "event",
    "axis",
    "residual_n_m_s",
    "sd_n_m_s",
    "noise_sd_n_m_s",
    "standardised",
)


def assemble_joint_review(
    name: str,
    model: Model,
    events: tuple[ReducedEvent, ...],
    priors: Priors,
    fit: Fit,
    z: Array,
    *,
    convergence: pd.DataFrame,
    facts: Mapping[str, str],
    warnings: Sequence[str],
    rng: np.random.Generator,
) -> Review:
    """Build every table of a review; z (n, d) are the posterior draws of the fit, flattened."""
    nuisances = nuisance_table(model, priors, z)
    series = event_series(model, events, z, rng)
    tensors = tensors_of(fit)
    physical = physicality(tensors[0])
    telemetry = TelemetryReview(
        events=event_table(events, series),
        inertia=inertia_table(*tensors),
        physicality=physical.sentence,
        inertia_methods=inertia_methods(model, events),
        torque_methods=torque_methods(model, events),
        observability=observability(model),
        series=series,
        mends=tuple(f"{e.event.id}: {line}" for e in events for line in e.reading.mends),
    )
    found = list(warnings)
    if physical.not_positive > 0 or physical.breaks_triangle > 0:
        found.append(physical.sentence)
    return Review(
        name=name,
        fit=fit,
        summary=summarise(fit),
        nuisances=nuisances,
        budget=error_budget(model, z) if model.fired_ids else pd.DataFrame(),
        baseline=_baseline(model, events),
        predictive=_predictive(model, fit),
        balance=pd.concat([_totals_balance(model, fit, z), _closure(series)], ignore_index=True),
        delta_v=_delta_v(model, fit),
        variants=pd.DataFrame(columns=list(VARIANT_COLUMNS)),
        convergence=convergence,
        facts=facts,
        warnings=(*found, *conflict_sentences(nuisances)),
        telemetry=telemetry,
    )


def tensors_of(fit: Fit) -> tuple[Array, Array, Array]:
    """Inertia draws of a fit: with the wheels, without their spin inertia, and of the prior."""
    constants = {
        str(name): float(variable.values)
        for name, variable in fit.groups["constant_data"].data_vars.items()
        if variable.ndim == 0
    }
    found = []
    for dataset, pattern in (
        (fit.posterior, WITH_WHEELS),
        (fit.posterior, WITHOUT_WHEELS),
        (fit.prior, WITH_WHEELS),
    ):
        names = [str(name) for name in dataset.data_vars if str(name).startswith("inertia_")]
        draws = {name: dataset[name].values.reshape(-1) for name in names}
        found.append(inertia_draws(draws, constants, pattern))
    return found[0], found[1], found[2]


def event_table(events: Sequence[ReducedEvent], series: Sequence[EventSeries]) -> pd.DataFrame:
    """Rows read and used per telemetry event, and the share of them inside the noise's band."""
    return pd.DataFrame(
        {
            "event": [event.event.id for event in events],
            "kind": [event.event.kind for event in events],
            "source": [event.event.source for event in events],
            "duration_s": [event.reading.end_s - event.reading.start_s for event in events],
            "rows_read": [event.reading.rows for event in events],
            "rows_used": [event.statistics.rows for event in events],
            **{
                f"inside_90_{axis}": [float(own.inside[i]) for own in series]
                for i, axis in enumerate("xyz")
            },
        }
    )


def _baseline(model: Model, events: tuple[ReducedEvent, ...]) -> pd.DataFrame:
    parts = [thrust_methods(model, events), burn_methods(model, events)]
    if model.totals is not None:
        parts.append(perturbation_bars(model.totals, prior_centre(model.totals)))
    kept = [part for part in parts if not part.empty]
    table = pd.concat(kept, ignore_index=True) if kept else pd.DataFrame()
    if model.totals is not None and model.telemetry and not table.empty:
        # pooled estimates of either kind are not of all events
        table = table[table["event"] != ""].reset_index(drop=True)
    return table


def _predictive(model: Model, fit: Fit) -> pd.DataFrame:
    """Replicated on-times of the totals rows; nothing without any."""
    if model.totals is None:
        return pd.DataFrame()
    table = predictive_table(fit)
    return table[table["event"].isin(model.totals.stack.event_ids)].reset_index(drop=True)


def _totals_balance(model: Model, fit: Fit, z: Array) -> pd.DataFrame:
    if model.totals is None:
        return pd.DataFrame(columns=list(_BALANCE_COLUMNS))
    rows = len(model.totals.stack.event_ids)
    residual = fit.groups["posterior_predictive"]["balance_residual_n_m_s"].values[:, :, :rows]
    draws = residual.reshape(-1, rows, 3)
    covariance = linear_system(model.totals, full_parameters(model, z)).covariance
    noise = np.sqrt(np.diagonal(covariance[..., :3, :3], axis1=-2, axis2=-1).mean(0))
    ids = model.totals.stack.event_ids
    return _balance(ids, draws.mean(0), draws.std(0, ddof=1), noise)


def _closure(series: Sequence[EventSeries]) -> pd.DataFrame:
    """What is left at the last usable row of every telemetry event, against its noise.

    Delivered minus gained, as for totals rows.
    """
    left = -np.stack([own.residual[-1] for own in series])
    spread = np.stack([own.residual_sd[-1] for own in series])
    noise = np.stack([own.noise_sd[-1] for own in series])
    return _balance([own.event for own in series], left, spread, noise)


def _balance(ids: Sequence[str], left: Array, spread: Array, noise: Array) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "event": np.repeat(ids, 3),
            "axis": np.tile(list("xyz"), len(ids)),
            "residual_n_m_s": left.reshape(-1),
            "sd_n_m_s": spread.reshape(-1),
            "noise_sd_n_m_s": noise.reshape(-1),
            "standardised": (left / noise).reshape(-1),
        }
    )


def _delta_v(model: Model, fit: Fit) -> pd.DataFrame:
    return pd.DataFrame() if model.totals is None else delta_v_table(model.totals, fit)
