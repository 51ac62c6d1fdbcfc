"""The papers' least squares on telemetry, beside which the posterior stands.

Thrust (paper 000 eqs. 15-23, paper 003 eqs. 5-8): per row the momentum gained, I Δω + ΔH_w +
∫ ω × (I ω + H_w) dt, is set against lever arms times commanded on-times. One unknown per thruster
or per couple that always fires together gives the individual Z and paired Y thrusts at once (their
columns share no axis), one for all couples' thrusters the mean Y thrust, one for all the mean of
eight. Pulses are taken as rectangular; the estimates are then divided by R (paper 000, § V) or by T
(paper 003 eq. 7). Rows are independent and equally good to these methods,
and everything that is not asked for is taken as known; the bars come from perturbing it by
hand-picked amounts (paper 003).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.statistics.columns import effective_increments
from cassini_bayes.computing.arrays import Array, joined, picked
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.posterior import Model
from cassini_bayes.model.telemetry import TelemetryTerm
from cassini_bayes.model.terms import Points
from cassini_bayes.results.baselines import (
    MEAN,
    PER_EVENT,
    POOLED,
    assumed_points,
    correction_factor,
    estimate_rows,
)
from cassini_bayes.spacecraft import thruster_directions
from cassini_bayes.spacecraft.attitude import direction_cosines
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

MEAN_OF_COUPLES: Final = "mean of the paired thrusters, per event"
UNCORRECTED: Final = ", uncorrected"
BY_R: Final = ", divided by R"
BURN: Final = "velocity change over on-time, per event"
MOST_ROWS: Final = 50_000


@dataclass(frozen=True)
class PlainRows:
    """Rows on which all channels of an event were sampled; counters from their first reading on."""

    time_s: Array  # (n,)
    attitude: Array  # (n, 3, 3) inertial to body
    rate_rad_s: Array  # (n, 3)
    wheel_rad_s: Array  # (n, W)
    on_time_s: Array  # (n, K)
    pulses: Array  # (n, K)


def plain_rows(event: ReducedEvent) -> PlainRows:
    """Rows with every channel, thinned evenly where there are more than ``MOST_ROWS``."""
    every = max(1, -(-event.reading.rows // MOST_ROWS))
    parts = []
    done = 0
    for samples in event.rows:
        whole = samples.has_state & (samples.has_counters if event.fires else True)
        rows = np.flatnonzero(whole)
        kept = rows[(-done) % every :: every]
        done += len(rows)
        parts.append(picked(samples, kept))
    rows_of = joined(parts)
    return PlainRows(
        rows_of.time_s,
        direction_cosines(rows_of.attitude),
        rows_of.rate_rad_s,
        rows_of.wheel_rad_s,
        rows_of.on_time_s - rows_of.on_time_s[:1],
        rows_of.pulses - rows_of.pulses[:1],
    )


def thrust_methods(model: Model) -> pd.DataFrame:
    """Thrust by the papers' methods from every telemetry event that fires.

    Columns as of :func:`cassini_bayes.results.baselines.perturbation_bars`. Methods without a
    suffix are divided by T; the suffixes say what else was done.
    """
    points = assumed_points(model, model.space.centre())
    batch, physics, names = points.parameters, points.physics(()), model.thrusters
    fired = [term for term in model.telemetry if term.event.fires]
    gathered: list[tuple[Array, Array]] = []
    rows: list[dict[str, object]] = []
    for term in fired:
        data = plain_rows(term.event)
        gained = momentum_gained(term, physics, data)
        columns = physics.arms_m[:, None] * data.on_time_s[:, None, :]
        gathered.append((gained, columns))
        couples = term.event.sampling.couples
        paired = sorted(k for couple in couples if len(couple) > 1 for k in couple)
        groups = {MEAN_OF_COUPLES: paired, MEAN: list(range(len(names)))}
        estimates = {
            PER_EVENT: individual_and_paired(columns, gained, couples),
            **{name: mean_thrust(columns, gained, group) for name, group in groups.items()},
        }
        on_time, pulses = data.on_time_s[-1], data.pulses[-1]
        factors = {
            "": correction_factor(on_time, pulses, batch),
            UNCORRECTED: np.ones((len(gained), len(on_time))),
            BY_R: ratio(data, batch),
        }
        rows += _thrust_rows(names, term.id, estimates, factors, on_time, groups)
    if len(gathered) > 1:
        rows += _pooled(names, points, [term.event for term in fired], gathered)
    return pd.DataFrame(rows)


def burn_methods(model: Model) -> pd.DataFrame:
    """Mean thrust along the measured velocity change of every burn (paper 000 App. D).

    M ΔV over the on-time of the thrusters that push that way, divided by T; columns as of
    :func:`cassini_bayes.results.baselines.perturbation_bars`.
    """
    batch = assumed_points(model, model.space.centre()).parameters
    directions = thruster_directions(model.spacecraft, model.branch)
    rows: list[dict[str, object]] = []
    for event in (term.event for term in model.telemetry):
        if event.delta_v is None:
            continue
        on_time, pulses = np.array(event.reading.on_time_s), np.array(event.reading.pulses)
        axis = int(np.argmax(np.abs(event.delta_v.last_m_s)))
        along = directions[axis] * np.sign(event.delta_v.last_m_s[axis])
        pushing = np.flatnonzero((along > 0.5) & (on_time > 0))
        names = [model.thrusters[k] for k in pushing]
        momentum = batch["mass_kg"] * abs(float(event.delta_v.last_m_s[axis]))
        factor = correction_factor(on_time, pulses, batch)
        for suffix, correction in (("", factor), (UNCORRECTED, np.ones_like(factor))):
            seconds = (along[pushing] * on_time[pushing] * correction[:, pushing]).sum(-1)
            values = np.tile((momentum / seconds)[:, None], len(pushing))
            total = np.full(len(pushing), on_time[pushing].sum())
            rows += estimate_rows(BURN + suffix, event.id, names, values, total, on_time[pushing])
    return pd.DataFrame(rows)


def torque_methods(model: Model) -> pd.DataFrame:
    """External torque from the wheels' drift over every quiescent event (paper 000 App. A).

    T diag(I_w) Δρ over the time, from straight lines through the wheel rates; columns event, axis,
    estimate_n_m, bar_rss_n_m.
    """
    physics = assumed_points(model, model.space.centre()).physics(())
    tables = []
    for term in model.telemetry:
        if term.event.kind == "quiescent":
            torque = drift_torque(term, physics, plain_rows(term.event))
            bars = np.sqrt(((torque[1:] - torque[0]) ** 2).sum(0))
            columns = {"estimate_n_m": torque[0], "bar_rss_n_m": bars}
            tables.append(pd.DataFrame({"event": term.id, "axis": list("xyz"), **columns}))
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def drift_torque(term: TelemetryTerm, physics: Physics, data: PlainRows) -> Array:
    """T diag(I_w) times the drift rates of the wheels, (n, 3) N m: straight lines through rows."""
    drift = np.polynomial.polynomial.polyfit(data.time_s, data.wheel_rad_s, 1)[1]
    return np.asarray(term.balance.wheel_weights(physics) @ drift)


def momentum_gained(term: TelemetryTerm, physics: Physics, data: PlainRows) -> Array:
    """I Δω + ΔH_w + ∫ ω × (I ω + H_w) dt per row, (n, rows, 3) N m s (paper 000 eq. 15)."""
    weights = term.balance.wheel_weights(physics)
    body = np.einsum("nij,tj->nti", physics.inertia_kg_m2, data.rate_rad_s)
    momentum = body + np.einsum("niw,tw->nti", weights, data.wheel_rad_s)
    torque = np.cross(data.rate_rad_s, momentum)
    steps = np.diff(data.time_s)[:, None]
    turned = np.cumsum(0.5 * (torque[:, 1:] + torque[:, :-1]) * steps, axis=1)
    gyroscopic = np.concatenate([np.zeros_like(torque[:, :1]), turned], axis=1)
    return np.asarray(momentum - momentum[:, :1] + gyroscopic)


def individual_and_paired(columns: Array, gained: Array, couples: Sequence[Sequence[int]]) -> Array:
    """Thrust per thruster, one unknown per couple (paper 000 eqs. 18-21); NaN where none fired.

    columns (n, rows, 3, K), gained (n, rows, 3) → (n, K).
    """
    members = np.zeros((len(couples), columns.shape[-1]))
    for g, couple in enumerate(couples):
        members[g, list(couple)] = 1.0
    grouped = columns @ members.T
    fired = np.any(grouped != 0.0, axis=(0, 1, 2))
    result = np.full((len(columns), len(couples)), np.nan)
    result[:, fired] = _solve(grouped[..., fired], gained)
    place = members.argmax(0)
    return np.asarray(result[:, place])


def mean_thrust(columns: Array, gained: Array, thrusters: Sequence[int]) -> Array:
    """One thrust for several thrusters (paper 000 eqs. 22-23), (n, K); NaN for the others.

    The rows of axes about which these thrusters have no torque say nothing and have no weight.
    """
    result = np.full((len(columns), columns.shape[-1]), np.nan)
    if len(thrusters) == 0:
        return result
    summed = columns[..., list(thrusters)].sum(-1, keepdims=True)
    acts = np.any(np.abs(summed[0, ..., 0]) > 1e-9, axis=0)
    if acts.any():
        result[:, list(thrusters)] = _solve(summed[:, :, acts], gained[:, :, acts])
    return result


def _solve(columns: Array, target: Array) -> Array:
    """Least squares over rows and axes for n points: (n, rows, 3, G), (n, rows, 3) → (n, G)."""
    n, unknowns = len(columns), columns.shape[-1]
    design = columns.reshape(n, -1, unknowns)
    right = np.swapaxes(design, 1, 2) @ target.reshape(n, -1, 1)
    normal = np.swapaxes(design, 1, 2) @ design
    return np.asarray((np.linalg.pinv(normal, hermitian=True) @ right)[..., 0])


def ratio(data: PlainRows, parameters: Mapping[str, Array]) -> Array:
    """R of paper 000: impulse over rectangular impulse of the pulses as they were, (n, K).

    Widths come from the counters' increments; 1 where a thruster did not fire.
    """
    on_time, pulses = np.diff(data.on_time_s, axis=0), np.diff(data.pulses, axis=0)
    total = data.on_time_s[-1]
    result = np.ones((len(parameters["tau_fall_s"]), len(total)))
    for i in range(len(result)):
        tau = [float(parameters[f"tau_{part}_s"][i]) for part in ("delay", "rise", "fall")]
        effective = effective_increments(on_time, pulses, partial(_effective, tau_s=tau))[..., 0]
        effective = effective.sum(0)
        result[i] = np.where(total > 0, effective / np.where(total > 0, total, 1.0), 1.0)
    return result


def _effective(width_s: Array, _: Array, tau_s: Sequence[float]) -> Array:
    """Effective time (…, 1) of a pulse by paper 000, whatever their number."""
    return PULSE_SHAPES["published_2005"].effective_time(width_s, *tau_s)[..., None]


def _thrust_rows(
    names: Sequence[str],
    event: str,
    estimates: Mapping[str, Array],
    factors: Mapping[str, Array],
    on_time: Array,
    groups: Mapping[str, Sequence[int]],
) -> list[dict[str, object]]:
    """Table rows of one event; a mean over a group of thrusters is divided by their mean factor."""
    rows: list[dict[str, object]] = []
    for method, values in estimates.items():
        for suffix, factor in factors.items():
            seconds = on_time
            if method in groups:
                members = list(groups[method])
                weight = on_time[members]
                shared = (factor[:, members] * weight).sum(-1) / max(float(weight.sum()), 1e-9)
                factor = np.broadcast_to(shared[:, None], factor.shape)
                seconds = np.full(len(names), weight.sum())
            result = estimate_rows(method + suffix, event, names, values / factor, seconds, on_time)
            rows += _finite(result, values)
    return rows


def _finite(rows: list[dict[str, object]], values: Array) -> list[dict[str, object]]:
    """Rows of the thrusters that a method has an estimate of."""
    return [row for row, value in zip(rows, values[0], strict=True) if np.isfinite(value)]


def _pooled(
    names: Sequence[str],
    points: Points,
    fired: Sequence[ReducedEvent],
    gathered: Sequence[tuple[Array, Array]],
) -> list[dict[str, object]]:
    """All events' rows in one least squares, divided by T."""
    gained = np.concatenate([part[0] for part in gathered], axis=1)
    columns = np.concatenate([part[1] for part in gathered], axis=1)
    values = individual_and_paired(columns, gained, fired[0].sampling.couples)
    on_time = np.sum([event.reading.on_time_s for event in fired], axis=0)
    pulses = np.sum([event.reading.pulses for event in fired], axis=0)
    corrected = values / correction_factor(on_time, pulses, points.parameters)
    return _finite(estimate_rows(POOLED, "", names, corrected, on_time, on_time), values)
