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
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes.balance.physics import Physics, physics_of
from cassini_bayes.balance.statistics import Samples, Sampling
from cassini_bayes.balance.statistics.columns import direction_cosines, effective_increments
from cassini_bayes.events.telemetry import read_chunks
from cassini_bayes.model.event_reduction import ReducedEvent, samples_of
from cassini_bayes.model.posterior import Model
from cassini_bayes.results.baselines import (
    MEAN,
    MINIMUM_ON_TIME_S,
    PER_EVENT,
    POOLED,
    correction_factor,
    perturbed,
)
from cassini_bayes.spacecraft import Spacecraft, thruster_directions
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

Array = NDArray[np.float64]
MEAN_OF_COUPLES: Final = "mean of the paired thrusters, per event"
UNCORRECTED: Final = ", uncorrected"
BY_R: Final = ", divided by R"
BURN: Final = "velocity change over on-time, per event"
MOST_ROWS: Final = 50_000


@dataclass(frozen=True)
class PlainRows:
    """Rows on which all channels of an event were sampled; counters from their first reading on.

    ``corrected_s`` (n, K) are pulses' effective on-times by paper 000's ratio, cumulative.
    """

    time_s: Array  # (n,)
    attitude: Array  # (n, 3, 3) inertial to body
    rate_rad_s: Array  # (n, 3)
    wheel_rad_s: Array  # (n, W)
    on_time_s: Array  # (n, K)
    pulses: Array  # (n, K)


def plain_rows(event: ReducedEvent, spacecraft: Spacecraft) -> PlainRows:
    """Rows with every channel, thinned evenly where there are more than ``MOST_ROWS``."""
    every = max(1, -(-event.reading.rows // MOST_ROWS))
    parts = []
    seen = 0
    for chunk in read_chunks(event.event, spacecraft):
        samples = samples_of(chunk)
        whole = samples.has_state & (samples.has_counters if event.fires else True)
        rows = np.flatnonzero(whole)
        kept = rows[(-seen) % every :: every]
        seen += len(rows)
        parts.append(Samples(*(getattr(samples, name)[kept] for name in _CHANNELS)))
    rows_of = Samples.joined(parts)
    return PlainRows(
        rows_of.time_s,
        direction_cosines(rows_of.attitude),
        rows_of.rate_rad_s,
        rows_of.wheel_rad_s,
        rows_of.on_time_s - rows_of.on_time_s[:1],
        rows_of.pulses - rows_of.pulses[:1],
    )


_CHANNELS: Final = ("time_s", "attitude", "rate_rad_s", "wheel_rad_s", "on_time_s", "pulses")


def thrust_methods(model: Model, events: Sequence[ReducedEvent]) -> pd.DataFrame:
    """Thrust by the papers' methods from every telemetry event that fires.

    Columns as of :func:`cassini_bayes.results.baselines.perturbation_bars`. Methods without a
    suffix are divided by T; the suffixes say what else was done.
    """
    batch, physics = assumed_physics(model)
    gathered: list[tuple[Array, Array]] = []
    rows: list[dict[str, object]] = []
    for terms, event in zip(model.telemetry, events, strict=True):
        if not event.fires:
            continue
        data = plain_rows(event, model.spacecraft)
        gained = momentum_gained(physics, terms.wheel_places, data)
        columns = physics.arms_m[:, None] * data.on_time_s[:, None, :]
        gathered.append((gained, columns))
        couples = event.sampling.couples
        estimates = {
            PER_EVENT: individual_and_paired(columns, gained, couples),
            MEAN_OF_COUPLES: mean_thrust(columns, gained, _paired(couples)),
            MEAN: mean_thrust(columns, gained, range(columns.shape[-1])),
        }
        on_time, pulses = data.on_time_s[-1], data.pulses[-1]
        factors = {
            "": correction_factor(on_time, pulses, batch),
            UNCORRECTED: np.ones((len(gained), len(on_time))),
            BY_R: ratio(event.sampling, data, batch),
        }
        rows += _thrust_rows(model, event.event.id, estimates, factors, on_time, couples)
    if len(gathered) > 1:
        rows += _pooled(model, batch, events, gathered)
    return pd.DataFrame(rows)


def burn_methods(model: Model, events: Sequence[ReducedEvent]) -> pd.DataFrame:
    """Mean thrust along the measured velocity change of every burn (paper 000 App. D).

    M ΔV over the on-time of the thrusters that push that way, divided by T; columns as of
    :func:`cassini_bayes.results.baselines.perturbation_bars`.
    """
    batch, _ = assumed_physics(model)
    directions = thruster_directions(model.spacecraft, model.branch)
    names = model.spacecraft.thruster_names(model.branch)
    rows: list[dict[str, object]] = []
    for event in events:
        if event.delta_v is None:
            continue
        on_time, pulses = np.array(event.reading.on_time_s), np.array(event.reading.pulses)
        axis = int(np.argmax(np.abs(event.delta_v.last_m_s)))
        along = directions[axis] * np.sign(event.delta_v.last_m_s[axis])
        pushing = np.flatnonzero((along > 0.5) & (on_time > 0))
        momentum = batch["mass_kg"] * abs(float(event.delta_v.last_m_s[axis]))
        factor = correction_factor(on_time, pulses, batch)
        for suffix, correction in (("", factor), (UNCORRECTED, np.ones_like(factor))):
            seconds = (along[pushing] * on_time[pushing] * correction[:, pushing]).sum(-1)
            total = float(on_time[pushing].sum())
            rows += [
                _row(BURN + suffix, event.event.id, names[k], momentum / seconds, total, on_time[k])
                for k in pushing
            ]
    return pd.DataFrame(rows)


def torque_methods(model: Model, events: Sequence[ReducedEvent]) -> pd.DataFrame:
    """External torque from the wheels' drift over every quiescent event (paper 000 App. A).

    T diag(I_w) Δρ over the time, from straight lines through the wheel rates; columns event, axis,
    estimate_n_m, bar_rss_n_m.
    """
    _, physics = assumed_physics(model)
    rows: list[dict[str, object]] = []
    for terms, event in zip(model.telemetry, events, strict=True):
        if terms.statistics.kind != "quiescent":
            continue
        data = plain_rows(event, model.spacecraft)
        torque = drift_torque(physics, terms.wheel_places, data)
        bars = np.sqrt(((torque[1:] - torque[0]) ** 2).sum(0))
        for axis, name in enumerate("xyz"):
            rows.append(
                {
                    "event": event.event.id,
                    "axis": name,
                    "estimate_n_m": torque[0, axis],
                    "bar_rss_n_m": bars[axis],
                }
            )
    return pd.DataFrame(rows)


def drift_torque(physics: Physics, wheels: tuple[int, ...], data: PlainRows) -> Array:
    """T diag(I_w) times the drift rates of the wheels, (n, 3) N m: straight lines through rows."""
    drift = np.polynomial.polynomial.polyfit(data.time_s, data.wheel_rad_s, 1)[1]
    return np.asarray(physics.wheel_weights[..., list(wheels)] @ drift)


def assumed_physics(model: Model) -> tuple[dict[str, Array], Physics]:
    """Prior means, then one point per perturbation of paper 003: parameters (n,), and physics."""
    space = model.space
    means = {n: d.mean() for n, d in zip(space.names, space.distributions, strict=True)}
    nominal = {**space.fixed, **means}
    points = [nominal, *perturbed(model.specs, nominal)]
    batch = {name: np.array([point[name] for point in points]) for name in nominal}
    absent = {n: np.zeros(len(points)) for n in model.absent_wheel_parameters}
    fires = bool(model.fired_ids)
    return batch, physics_of(model.spacecraft, model.branch, {**batch, **absent}, fires=fires)


def momentum_gained(physics: Physics, wheels: tuple[int, ...], data: PlainRows) -> Array:
    """I Δω + ΔH_w + ∫ ω × (I ω + H_w) dt per row, (n, rows, 3) N m s (paper 000 eq. 15)."""
    weights = physics.wheel_weights[..., list(wheels)]
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
    found = np.full((len(columns), len(couples)), np.nan)
    found[:, fired] = _solve(grouped[..., fired], gained)
    place = members.argmax(0)
    return np.asarray(found[:, place])


def mean_thrust(columns: Array, gained: Array, thrusters: Sequence[int] | range) -> Array:
    """One thrust for several thrusters (paper 000 eqs. 22-23), (n, K); NaN for the others.

    The rows of axes about which these thrusters have no torque say nothing and have no weight.
    """
    found = np.full((len(columns), columns.shape[-1]), np.nan)
    if len(thrusters) == 0:
        return found
    summed = columns[..., list(thrusters)].sum(-1, keepdims=True)
    acts = np.any(np.abs(summed[0, ..., 0]) > 1e-9, axis=0)
    if acts.any():
        found[:, list(thrusters)] = _solve(summed[:, :, acts], gained[:, :, acts])
    return found


def _solve(columns: Array, target: Array) -> Array:
    """Least squares over rows and axes for n points: (n, rows, 3, G), (n, rows, 3) → (n, G)."""
    n, unknowns = len(columns), columns.shape[-1]
    design = columns.reshape(n, -1, unknowns)
    right = np.swapaxes(design, 1, 2) @ target.reshape(n, -1, 1)
    normal = np.swapaxes(design, 1, 2) @ design
    return np.asarray((np.linalg.pinv(normal, hermitian=True) @ right)[..., 0])


def _paired(couples: Sequence[Sequence[int]]) -> list[int]:
    return sorted(k for couple in couples if len(couple) > 1 for k in couple)


def ratio(sampling: Sampling, data: PlainRows, parameters: Mapping[str, Array]) -> Array:
    """R of paper 000: impulse over rectangular impulse of the pulses as they were, (n, K).

    Widths come from the counters' increments; 1 where a thruster did not fire.
    """
    on_time, pulses = np.diff(data.on_time_s, axis=0), np.diff(data.pulses, axis=0)
    total = data.on_time_s[-1]
    found = np.ones((len(parameters["tau_fall_s"]), len(total)))
    for i in range(len(found)):
        reference = tuple(float(parameters[f"tau_{p}_s"][i]) for p in ("delay", "rise", "fall"))
        shape = PULSE_SHAPES["published_2005"]
        own = Sampling(
            shape, (reference[0], reference[1], reference[2]), 0.0, sampling.couples, 1.0
        )
        effective = effective_increments(on_time, pulses, own)[..., 0].sum(0)
        found[i] = np.where(total > 0, effective / np.where(total > 0, total, 1.0), 1.0)
    return found


def _thrust_rows(
    model: Model,
    event: str,
    estimates: Mapping[str, Array],
    factors: Mapping[str, Array],
    on_time: Array,
    couples: Sequence[Sequence[int]],
) -> list[dict[str, object]]:
    """Table rows of one event; a mean over thrusters is divided by their mean factor."""
    rows: list[dict[str, object]] = []
    names = model.spacecraft.thruster_names(model.branch)
    groups = {MEAN: list(range(len(names))), MEAN_OF_COUPLES: _paired(couples)}
    for method, values in estimates.items():
        for suffix, factor in factors.items():
            if method in groups:
                members = groups[method]
                weight = on_time[members]
                shared = (factor[:, members] * weight).sum(-1) / max(float(weight.sum()), 1e-9)
                factor = np.broadcast_to(shared[:, None], factor.shape)
                seconds = np.full(len(names), weight.sum())
            else:
                seconds = on_time
            for k in range(len(names)):
                if np.isfinite(values[0, k]):
                    own = values[:, k] / factor[:, k]
                    rows.append(_row(method + suffix, event, names[k], own, seconds[k], on_time[k]))
    return rows


def _row(
    method: str, event: str, thruster: str, values: Array, counted_s: float, on_time_s: float
) -> dict[str, object]:
    shifts = values[1:] - values[0]
    valid = bool(counted_s >= MINIMUM_ON_TIME_S)
    return {
        "method": method,
        "event": event,
        "thruster": thruster,
        "estimate_n": values[0],
        "bar_rss_n": float(np.sqrt((shifts**2).sum())),
        "bar_worst_n": float(np.abs(shifts).sum()),
        "on_time_s": on_time_s,
        "valid": valid,
        "note": "" if valid else f"on-time below {MINIMUM_ON_TIME_S:g} s",
    }


def _pooled(
    model: Model,
    batch: Mapping[str, Array],
    events: Sequence[ReducedEvent],
    gathered: Sequence[tuple[Array, Array]],
) -> list[dict[str, object]]:
    """All events' rows in one least squares, divided by T."""
    fired = [event for event in events if event.fires]
    gained = np.concatenate([part[0] for part in gathered], axis=1)
    columns = np.concatenate([part[1] for part in gathered], axis=1)
    values = individual_and_paired(columns, gained, fired[0].sampling.couples)
    on_time = np.sum([event.reading.on_time_s for event in fired], axis=0)
    pulses = np.sum([event.reading.pulses for event in fired], axis=0)
    values = values / correction_factor(on_time, pulses, batch)
    names = model.spacecraft.thruster_names(model.branch)
    return [
        _row(POOLED, "", names[k], values[:, k], on_time[k], on_time[k])
        for k in range(len(names))
        if np.isfinite(values[0, k])
    ]
