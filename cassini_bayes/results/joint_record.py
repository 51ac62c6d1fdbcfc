"""The record of a fit of telemetry events, with totals rows or without.

Variables are those of a totals fit, and the inertia both ways. Where a variable has an event
dimension and an event has no such quantity (the thrusts of a slew), it is NaN there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cassini_bayes.balance.telemetry_terms import INITIAL_SD_N_M_S
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.posterior import Model, full_parameters, physics_at
from cassini_bayes.model.predictive import (
    balance_residual,
    jacobian_expansion_error,
    on_time_stretch,
    replicate_on_times,
)
from cassini_bayes.model.totals import SOFTWARE, THRUST_COMMON, TORQUES, linear_system
from cassini_bayes.results.inertia import ELEMENTS, WITHOUT_WHEELS, elements_of, without_wheels
from cassini_bayes.results.joint_draws import (
    Draws,
    draw_all,
    event_log_density,
    prior_sample,
    thrust_places,
)
from cassini_bayes.results.record import (
    AXES,
    Coordinates,
    Fit,
    Variable,
    dataset_of,
    normal_log_density,
    thrust_log_prior,
)
from cassini_bayes.results.replicates import REPLICATED_ROWS, channel_datasets, labelled, replicated
from cassini_bayes.results.time_series import balances, shown_places
from cassini_bayes.spacecraft.pulses import effective_on_time

Array = NDArray[np.float64]


def build_fit(
    model: Model,
    events: Sequence[ReducedEvent],
    z: Array,
    log_density: Array,
    rng: np.random.Generator,
    attributes: Mapping[str, str | float | int],
    prior_size: int = 4_000,
    *,
    replicate: bool = True,
) -> tuple[Fit, Draws]:
    """Assemble every group from walked draws z (M, n, d) with log_density (M, n).

    ``events`` are the telemetry events in the model's order; the sample returned holds what was
    drawn back from its exact conditional, in flattened order. ``replicate`` telemetry reads the
    events' files again.
    """
    m, n, d = z.shape
    flat = z.reshape(-1, d)
    sample, prior = draw_all(model, flat, rng), prior_sample(model, prior_size, rng)
    prior_z = model.space.to_standard(prior.parameters)
    coordinates, shape, before = joint_coordinates(model), (m, n), (1, prior_size)
    density = event_log_density(model, flat, sample)
    blocks = {
        block.replace(" ", "_").replace("-", "_"): ((), terms, "1", f"log prior, block {block}")
        for block, terms in _log_prior(model, flat, sample).items()
    }
    stats: dict[str, Variable] = {
        "lp": ((), log_density.reshape(-1), "1", "log posterior density in z")
    }
    if model.totals is not None:
        totals = sample.totals(model)
        error = jacobian_expansion_error(
            model.totals, full_parameters(model, flat), totals.thrust_n
        )
        label = "exact minus expanded log response Jacobian of the totals rows"
        stats["jacobian_expansion_error"] = ((), error, "1", label)
    label = "log density of the event's data, everything else given"
    groups = {
        "posterior": _posterior(model, events, flat, sample, shape),
        "prior": _posterior(model, events, prior_z, prior, before),
        "posterior_predictive": _predictive(model, flat, sample, rng, shape),
        "prior_predictive": _predictive(model, prior_z, prior, rng, before),
        "log_likelihood": dataset_of(
            {"event_data": (("event",), density, "1", label)}, coordinates, shape
        ),
        "log_prior": dataset_of(blocks, coordinates, shape),
        "sample_stats": dataset_of(stats, coordinates, shape),
        "observed_data": _observed(model, events),
        "constant_data": _constants(model, events),
    }
    if replicate and model.telemetry:
        found = _replicates(model, events, flat, sample, n, rng)
        for name, channels in zip(("posterior_predictive", "observed_data"), found, strict=True):
            groups[name] = xr.merge([groups[name], channels], join="exact")
    return Fit(groups, dict(attributes)), sample


def _replicates(
    model: Model,
    events: Sequence[ReducedEvent],
    z: Array,
    sample: Draws,
    chain_length: int,
    rng: np.random.Generator,
) -> tuple[xr.Dataset, xr.Dataset]:
    """Replicated and measured channels of the telemetry events, at the draws of the figures."""
    shown = shown_places(len(z))
    rows = balances(model, events, z[shown], sample.at(shown), REPLICATED_ROWS)
    found, origin = [replicated(own, rng) for own in rows], np.divmod(shown, chain_length)
    return channel_datasets(found, joint_coordinates(model), used_wheels(model), origin)


def joint_coordinates(model: Model) -> Coordinates:
    """Labels of every dimension: all events, the branch's thrusters, the wheels in use, axes."""
    used = set(used_wheels(model))
    return {
        "event": list(model.event_ids),
        "thruster": list(model.spacecraft.thruster_names(model.branch)),
        "wheel": [wheel.name for wheel in model.spacecraft.wheels if wheel.number in used],
        "axis": list(AXES),
    }


def used_wheels(model: Model) -> tuple[int, ...]:
    """Numbers of the wheels that any event of the model uses, in file order."""
    used = {number for terms in model.telemetry for number in terms.statistics.layout.wheels}
    if model.totals is not None:
        prime = model.totals.stack.wheel_is_used
        wheels = zip(model.spacecraft.wheels, prime, strict=True)
        used |= {wheel.number for wheel, is_used in wheels if is_used}
    return tuple(wheel.number for wheel in model.spacecraft.wheels if wheel.number in used)


def spread_over_events(values: Array, places: Sequence[int], n_events: int) -> Array:
    """Values (n, E', ...) of some events at their places among all of them, NaN elsewhere."""
    full = np.full((len(values), n_events, *values.shape[2:]), np.nan)
    full[:, list(places)] = values
    return full


def _posterior(
    model: Model,
    events: Sequence[ReducedEvent],
    z: Array,
    sample: Draws,
    shape: tuple[int, int],
) -> xr.Dataset:
    variables: dict[str, Variable] = {}
    if sample.thrusts is not None:
        variables |= _thrust_variables(model, events, z, sample)
    n_events, rows = len(model.event_ids), len(model.event_ids) - len(model.telemetry)
    start = np.stack([own[:, :3] for own in sample.own], axis=1)
    places = range(rows, n_events)
    variables |= {
        "external_torque_n_m": (
            ("event", "axis"),
            sample.torque_n_m,
            "N m",
            "steady external torque, body axes",
        ),
        "initial_momentum_n_m_s": (
            ("event", "axis"),
            spread_over_events(start, places, n_events),
            "N m s",
            "total angular momentum at the first row, body axes",
        ),
        **_inertia_variables(model, z),
        **_parameter_variables(model, sample),
    }
    return dataset_of(variables, joint_coordinates(model), shape)


def _thrust_variables(
    model: Model, events: Sequence[ReducedEvent], z: Array, sample: Draws
) -> dict[str, Variable]:
    thrusts = sample.thrusts
    assert thrusts is not None  # asked for where events fire
    places, n_events = thrust_places(model), len(model.event_ids)
    per_on_time = thrusts.thrust_n * _stretch(model, events, z)
    both = ("event", "thruster")
    return {
        "thrust_n": (
            both,
            spread_over_events(thrusts.thrust_n, places, n_events),
            "N",
            "steady thrust in the event",
        ),
        "thrust_level_n": (
            ("thruster",),
            thrusts.level_n,
            "N",
            "thruster's level over all events: common plus individual",
        ),
        "thrust_common_n": ((), thrusts.common_n, "N", "common level of the branch"),
        "impulse_per_on_time_n": (
            both,
            spread_over_events(per_on_time, places, n_events),
            "N",
            "impulse delivered per second of commanded on-time, tail-off included",
        ),
    }


def _stretch(model: Model, events: Sequence[ReducedEvent], z: Array) -> Array:
    """Effective over commanded on-time (n, E', K) of the events that fire."""
    full = full_parameters(model, z)
    parts = []
    if model.totals is not None:
        parts.append(on_time_stretch(model.totals, linear_system(model.totals, full)))
    physics = physics_at(model, full)
    for event in events:
        if not event.fires:
            continue
        on_time, pulses = np.array(event.reading.on_time_s), np.array(event.reading.pulses)
        fired = (on_time > 0) & (pulses > 0)
        safe = np.where(fired, on_time, 1.0)
        effective = effective_on_time(
            event.sampling.pulse_shape,
            safe,
            np.where(fired, pulses, 1.0),
            *(np.broadcast_to(tau, (len(z),))[:, None] for tau in physics.tau_s),
        )
        parts.append(np.where(fired, effective / safe, 1.0)[:, None])
    return np.concatenate(parts, axis=1)


def _inertia_variables(model: Model, z: Array) -> dict[str, Variable]:
    if not model.telemetry:
        return {}
    full = full_parameters(model, z)
    hub = without_wheels(physics_at(model, full), model.spacecraft, used_wheels(model))
    values = np.broadcast_to(elements_of(hub), (len(z), len(ELEMENTS)))
    label = "inertia about the centre of mass less the wheels' spin inertia, Σ I_w a aᵀ"
    return {
        WITHOUT_WHEELS.format(element): (
            (),
            values[:, i],
            "kg m2",
            f"{element} element of the {label}",
        )
        for i, element in enumerate(ELEMENTS)
    }


def _parameter_variables(model: Model, sample: Draws) -> dict[str, Variable]:
    """Walked parameters; wheel inertias together, those integrated out elsewhere left out."""
    variables: dict[str, Variable] = {}
    used = used_wheels(model)
    wheels = [wheel.inertia_parameter for wheel in model.spacecraft.wheels if wheel.number in used]
    if set(wheels) & set(model.space.names):
        columns = [np.broadcast_to(sample.parameters[name], (sample.size,)) for name in wheels]
        stacked = np.stack(columns, axis=-1)
        variables["rwa_inertia_kg_m2"] = (("wheel",), stacked, "kg m2", "spin inertia of a wheel")
    if model.totals is not None and model.totals.computed is not None:
        for column, name in enumerate(SOFTWARE):
            spec = model.specs[name]
            variables[name] = ((), sample.software[:, column], spec.unit, spec.meaning)
    mass = _mass(model, sample)
    if mass is not None:
        variables["mass_kg"] = (("event",), mass, "kg", "wet mass, of events that need it")
    for name in model.space.names:
        if name in wheels or name in (THRUST_COMMON, "mass_kg"):
            continue
        spec = model.specs[name]
        variables[name] = ((), np.asarray(sample.parameters[name]), spec.unit, spec.meaning)
    return variables


def _mass(model: Model, sample: Draws) -> Array | None:
    """Wet mass (n, E) of totals rows with a velocity change and of burns, NaN elsewhere."""
    values = np.full((sample.size, len(model.event_ids)), np.nan)
    if model.totals is not None and "mass_factor" in sample.parameters:
        factor = np.broadcast_to(sample.parameters["mass_factor"], (sample.size,))
        table = model.totals.stack.mass_kg
        values[:, : len(table)] = factor[:, None] * table
    burns = {own.event_id for own in model.delta_v}
    for place, name in enumerate(model.event_ids):
        if name in burns:
            values[:, place] = sample.parameters["mass_kg"]
    return values if np.isfinite(values).any() else None


def _predictive(
    model: Model,
    z: Array,
    sample: Draws,
    rng: np.random.Generator,
    shape: tuple[int, int],
) -> xr.Dataset:
    """Replicated on-times and balances of the totals rows."""
    if model.totals is None:
        return dataset_of({}, joint_coordinates(model), shape)
    full, totals = full_parameters(model, z), sample.totals(model)
    residual = balance_residual(model.totals, linear_system(model.totals, full), totals)[..., :3]
    on_time = replicate_on_times(model.totals, full, totals, rng)
    places, n_events = range(on_time.shape[1]), len(model.event_ids)
    return dataset_of(
        {
            "on_time_s": (
                ("event", "thruster"),
                spread_over_events(on_time, places, n_events),
                "s",
                "commanded on-time of the same bias flown again (totals rows)",
            ),
            "balance_residual_n_m_s": (
                ("event", "axis"),
                spread_over_events(residual, places, n_events),
                "N m s",
                "thruster impulse plus torque minus the wheels' momentum change (totals rows)",
            ),
        },
        joint_coordinates(model),
        shape,
    )


def _log_prior(model: Model, z: Array, sample: Draws) -> dict[str, Array]:
    """Log prior densities (n,) per block, walked and integrated out; a width of zero adds none."""
    found = {block: terms.copy() for block, terms in model.space.log_prior_by_block(z).items()}
    torque = sample.torque_n_m - model.torque_mean_n_m
    added = {"torque": normal_log_density(torque, model.torque_sd_n_m).sum((-2, -1))}
    if sample.thrusts is not None:
        added["thrust"] = thrust_log_prior(model.thrust_prior, sample.parameters, sample.thrusts)
    pairs = zip(model.telemetry, sample.own, strict=True)
    starts = [
        normal_log_density(own[:, :3] - terms.initial_mean_n_m_s, INITIAL_SD_N_M_S).sum(-1)
        for terms, own in pairs
    ]
    if starts:
        added["initial momentum"] = np.sum(starts, axis=0)
    if model.totals is not None and model.totals.computed is not None:
        computed = model.totals.computed
        shift = sample.software - computed.prior_mean
        added["flight software"] = normal_log_density(shift, computed.prior_sd).sum(-1)
    for block, terms in added.items():
        found[block] = found.get(block, 0.0) + terms
    return found


def _observed(model: Model, events: Sequence[ReducedEvent]) -> xr.Dataset:
    """On-times and pulses of every event that fires, ΔV of the totals rows."""
    coordinates = joint_coordinates(model)
    n_events, thrusters = len(model.event_ids), coordinates["thruster"]
    on_time, pulses = np.full((2, n_events, len(thrusters)), np.nan)
    delta_v = np.full((n_events, 3), np.nan)
    rows = n_events - len(model.telemetry)
    if model.totals is not None:
        stack = model.totals.stack
        on_time[:rows], pulses[:rows] = stack.on_time_s, stack.pulses
        delta_v[:rows] = stack.delta_v_m_s
    for place, event in enumerate(events, start=rows):
        if event.fires:
            on_time[place], pulses[place] = event.reading.on_time_s, event.reading.pulses
    return xr.Dataset(
        {
            "on_time_s": labelled(("event", "thruster"), on_time, "s", "commanded on-time"),
            "pulses": labelled(("event", "thruster"), pulses, "1", "number of pulses"),
            "delta_v_m_s": labelled(
                ("event", "axis"), delta_v, "m s-1", "ΔV of a totals row, body axes"
            ),
        },
        coords={name: coordinates[name] for name in ("event", "thruster", "axis")},
    )


def _constants(model: Model, events: Sequence[ReducedEvent]) -> xr.Dataset:
    n_events = len(model.event_ids)
    first = n_events - len(model.telemetry)
    duration, used, read, printed = np.full((4, n_events), np.nan)
    if model.totals is not None:
        duration[:first] = model.totals.stack.duration_s
        printed[:first] = model.totals.stack.thrust_predicted_n
    for place, event in enumerate(events, start=first):
        duration[place] = event.reading.end_s - event.reading.start_s
        used[place], read[place] = event.statistics.rows, event.reading.rows
    data = {
        "duration_s": labelled(("event",), duration, "s", "duration of the event"),
        "rows_read": labelled(("event",), read, "1", "rows of telemetry read"),
        "rows_used": labelled(("event",), used, "1", "rows of telemetry in the momentum balance"),
        "thrust_predicted_n": labelled(("event",), printed, "N", "thrust printed with the row"),
    }
    for name, value in model.space.fixed.items():
        spec = model.specs[name]
        data[name] = labelled((), np.asarray(value), spec.unit, spec.meaning)
    for name, value in zip(TORQUES, model.torque_mean_n_m, strict=True):
        meaning = "prior mean of the steady external torque"
        data[f"prior_mean_{name}"] = labelled((), np.asarray(value), "N m", meaning)
    kinds = ["totals"] * first + [event.event.kind for event in events]
    coords = {"event": list(model.event_ids), "kind": ("event", kinds)}
    return xr.Dataset(data, coords=coords)
