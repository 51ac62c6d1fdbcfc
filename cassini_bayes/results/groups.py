"""The groups of a fit's record, assembled from a model and its walked draws.

Where a variable has an event dimension and an event has no such quantity (the thrusts of a slew),
it is NaN there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import xarray as xr

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.draws import (
    DrawnTerm,
    Draws,
    draw,
    draw_prior,
    drawn_terms,
    event_log_density,
)
from cassini_bayes.model.posterior import Model
from cassini_bayes.model.terms import TORQUE, Variable
from cassini_bayes.model.thrusts import normal_log_density, thrust_log_prior
from cassini_bayes.results.record import AXES, Coordinates, Fit, dataset_of, labelled
from cassini_bayes.results.replicates import channel_replicates
from cassini_bayes.spacecraft.parameters import TORQUES

DENSITY: Final = "event_data"
"""Log density of the data where the events are not all of one kind."""
DENSITY_MEANING: Final = "log density of the event's data, everything else given"


def build_fit(
    model: Model,
    z: Array,
    log_density: Array,
    rng: np.random.Generator,
    attributes: Mapping[str, str | float | int],
    prior_size: int = 4_000,
    *,
    drawn: Draws | None = None,
    replicate_rows: bool = True,
) -> Fit:
    """Assemble every group from walked draws z (M, n, d) with log_density (M, n).

    What is integrated out is drawn from its exact conditional (unless ``drawn`` already is, from
    the stream that goes on as ``rng``), replicates and prior draws are added; ``replicate_rows`` of
    telemetry looks at its rows again.
    """
    m, n, d = z.shape
    flat, shape = z.reshape(-1, d), (m, n)
    draws = draw(model, flat, rng) if drawn is None else drawn
    prior = draw_prior(model, prior_size, rng)
    coordinates = coordinates_of(model)
    density = event_log_density(model, flat, draws)
    groups = drawn_groups(model, draws, prior, shape, rng)
    lp: Variable = ((), log_density.reshape(-1), "1", "log posterior density in z")
    added: dict[str, Mapping[str, Variable]] = {
        "log_likelihood": {density_name(model): (("event",), density, "1", DENSITY_MEANING)},
        "log_prior": _log_prior(model, flat, draws),
    }
    groups |= {name: dataset_of(variable, coordinates, shape) for name, variable in added.items()}
    groups["sample_stats"] = xr.merge(
        [dataset_of({"lp": lp}, coordinates, shape), groups["sample_stats"]], join="exact"
    )
    if replicate_rows:
        for name, channels in channel_replicates(model, flat, draws, n, coordinates, rng).items():
            groups[name] = xr.merge([groups[name], channels], join="exact")
    branch = ("event", [model.branch] * len(model.event_ids))
    of_events = {name: group for name, group in groups.items() if "event" in group.dims}
    groups |= {name: group.assign_coords(branch=branch) for name, group in of_events.items()}
    return Fit(groups, dict(attributes))


def drawn_groups(
    model: Model, draws: Draws, prior: Draws, shape: tuple[int, int], rng: np.random.Generator
) -> dict[str, xr.Dataset]:
    """The groups that follow from draws of everything, and from as many as may be of its prior.

    ``shape`` (chains, draws) is that of ``draws``.
    """
    coordinates, before = coordinates_of(model), (1, prior.size)
    terms, terms_before = (
        drawn_terms(model, model.points_at(given.parameters, given.size), given)
        for given in (draws, prior)
    )
    statistics = merged(model, [term.statistics(thrust) for term, thrust, _ in terms])
    drawn = {
        "posterior": (_posterior(model, draws, terms), shape),
        "posterior_predictive": (_predictive(model, terms, rng), shape),
        "sample_stats": (statistics, shape),
        "prior": (_posterior(model, prior, terms_before), before),
        "prior_predictive": (_predictive(model, terms_before, rng), before),
    }
    return {
        **{name: dataset_of(own, coordinates, size) for name, (own, size) in drawn.items()},
        "observed_data": _dataset(model, [term.observed() for term in model.terms]),
        "constant_data": _constants(model),
    }


def coordinates_of(model: Model) -> Coordinates:
    """Labels of every dimension: all events, the branch's thrusters, the wheels in use, axes."""
    wheels = model.spacecraft.wheels
    return {
        "event": list(model.event_ids),
        "thruster": list(model.thrusters),
        "wheel": [wheel.name for wheel in wheels if wheel.number in model.wheels],
        "axis": list(AXES),
    }


def density_name(model: Model) -> str:
    """Variable of the log density of data: the terms' own name where all have the same."""
    names = {term.density_name for term in model.terms if term.events}
    return names.pop() if len(names) == 1 else DENSITY


def merged(model: Model, parts: Sequence[Mapping[str, Variable]]) -> dict[str, Variable]:
    """Quantities of all terms, each at its own events among all of them, NaN elsewhere."""
    coordinates = coordinates_of(model)
    used = [i for i, w in enumerate(model.spacecraft.wheels) if w.number in model.wheels]
    result: dict[str, Variable] = {}
    for events, part in zip(model.events_of_term, parts, strict=True):
        for name, (dims, given, unit, meaning) in part.items():
            values = given[..., used] if dims[-1:] == ("wheel",) else given
            if dims[:1] == ("event",):
                lead = values.shape[: values.ndim - len(dims)]
                full = np.full((*lead, *(len(coordinates[dim]) for dim in dims)), np.nan)
                full = result[name][1] if name in result else full
                full[(*(slice(None) for _ in lead), events)] = values
                values = full
            result.setdefault(name, (dims, values, unit, meaning))
    return result


def _posterior(model: Model, draws: Draws, terms: Sequence[DrawnTerm]) -> dict[str, Variable]:
    """Thrusts, torques, wheels, what terms have of their own, and the walked parameters."""
    torque = draws.torque_n_m
    variables = {
        **_thrust_variables(model, draws, terms),
        TORQUE: (("event", "axis"), torque, "N m", "steady external torque, body axes"),
    }
    wheels = [w.inertia_parameter for w in model.spacecraft.wheels if w.number in model.wheels]
    if set(wheels) & set(model.space.names):
        columns = [np.broadcast_to(draws.parameters[name], (draws.size,)) for name in wheels]
        stacked = np.stack(columns, axis=-1)
        variables["rwa_inertia_kg_m2"] = (("wheel",), stacked, "kg m2", "spin inertia of a wheel")
    variables |= merged(model, [term.variables(item) for term, _, item in terms])
    integrated = {
        name: item[name]
        for term, item in zip(model.terms, draws.integrated, strict=True)
        for name in term.integrated
    }
    walked = {name: np.asarray(draws.parameters[name]) for name in model.space.names}
    for name, values in {**integrated, **walked}.items():
        if name not in variables and name not in wheels:
            spec = model.specs[name]
            variables[name] = ((), values, spec.unit, spec.meaning)
    return variables


def _thrust_variables(
    model: Model, draws: Draws, terms: Sequence[DrawnTerm]
) -> dict[str, Variable]:
    """Thrusts of the events that fire; nothing where none does."""
    if not model.fires:
        return {}
    thrusts, steady = draws.thrusts, "steady thrust in the event"
    level = "thruster's level over all events: common plus individual"
    delivered = "impulse delivered per second of commanded on-time, tail-off included"
    stretch = np.concatenate([term.stretch for term, *_ in terms], axis=1)
    fired = [event.fires for event in model.events]
    each = ("event", "thruster")

    def spread(values: Array) -> Array:
        full = np.full((len(values), len(fired), values.shape[2]), np.nan)
        full[:, fired] = values
        return full

    return {
        "thrust_n": (each, spread(thrusts.thrust_n), "N", steady),
        "thrust_level_n": (("thruster",), thrusts.level_n, "N", level),
        "thrust_common_n": ((), thrusts.common_n, "N", "common level of the branch"),
        "impulse_per_on_time_n": (each, spread(thrusts.thrust_n * stretch), "N", delivered),
    }


def _predictive(
    model: Model, terms: Sequence[DrawnTerm], rng: np.random.Generator
) -> dict[str, Variable]:
    return merged(
        model, [term.replicates(thrust_n, integrated, rng) for term, thrust_n, integrated in terms]
    )


def _log_prior(model: Model, z: Array, draws: Draws) -> dict[str, Variable]:
    """Log prior densities (n,) per block, walked and integrated out; a width of zero adds none."""
    torque = normal_log_density(draws.torque_n_m - model.torque_mean_n_m, model.torque_sd_n_m)
    thrust = thrust_log_prior(model.thrust_prior, draws.parameters, draws.thrusts)
    own = [
        term.log_prior(integrated)
        for term, integrated in zip(model.terms, draws.integrated, strict=True)
    ]
    blocks = dict(model.space.log_prior_by_block(z))
    for part in ({"thrust": thrust} if model.fires else {}, {"torque": torque.sum((-2, -1))}, *own):
        for block, values in part.items():
            blocks[block] = blocks[block] + values if block in blocks else values
    return log_prior_variables(blocks)


def block_variable(block: str) -> str:
    """Variable of the record for the log prior density of a block."""
    return block.replace(" ", "_").replace("-", "_")


def log_prior_variables(blocks: Mapping[str, Array]) -> dict[str, Variable]:
    """Log prior densities (n,) by block as quantities of the record."""
    return {
        block_variable(block): ((), values, "1", f"log prior density, block {block}")
        for block, values in blocks.items()
    }


def _dataset(model: Model, parts: Sequence[Mapping[str, Variable]]) -> xr.Dataset:
    """Known figures of all events."""
    variables, coordinates = merged(model, parts), coordinates_of(model)
    used = dict.fromkeys(dim for dims, *_ in variables.values() for dim in dims)
    return xr.Dataset(
        {name: labelled(*variable) for name, variable in variables.items()},
        coords={dim: coordinates[dim] for dim in used},
    )


def _constants(model: Model) -> xr.Dataset:
    """Known figures of the events, fixed parameters, prior means of the torque."""
    scalars = {
        name: labelled((), value, model.specs[name].unit, model.specs[name].meaning)
        for name, value in model.space.fixed.items()
    }
    meaning = "prior mean of the steady external torque"
    for name, value in zip(TORQUES, model.torque_mean_n_m, strict=True):
        scalars[f"prior_mean_{name}"] = labelled((), value, "N m", meaning)
    kinds = [event.kind for event in model.events]
    known = _dataset(model, [term.constants() for term in model.terms])
    return known.assign(scalars).assign_coords(kind=("event", kinds))
