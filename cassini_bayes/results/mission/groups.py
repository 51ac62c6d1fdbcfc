"""A fitted mission in the layout of any fit: events of both branches in one ``fit.nc``.

Every part of a mission is a model of the usual kind, so its groups are made as those of a single
fit at the mission's draws; events carry their branch as the coordinate ``branch``, and parameters
that every branch has for itself carry it in their names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from cassini_bayes.balance.physics import Parameters
from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.draws import Draws, density_at, draw_own, draw_own_prior
from cassini_bayes.model.mission.losses import prior_losses
from cassini_bayes.model.mission.model import MissionModel, Part
from cassini_bayes.model.terms import Variable
from cassini_bayes.model.thrusts import ThrustDraws
from cassini_bayes.results.fitting import IMPORTANCE_MET
from cassini_bayes.results.groups import (
    DENSITY,
    DENSITY_MEANING,
    drawn_groups,
    log_prior_variables,
)
from cassini_bayes.results.mission.fitting import MissionFit
from cassini_bayes.results.mission.trend import MissionDraws
from cassini_bayes.results.record import Fit, dataset_of, labelled

BranchLevels = Mapping[str, tuple[Array, Array]]
"""Branch → thrusts in its events and their levels at the reference pressure, both (n, E, K)."""


def mission_fit_record(fit: MissionFit, draws: MissionDraws, rng: np.random.Generator) -> Fit:
    """All groups of a fitted mission; replicates of telemetry rows are left out.

    Raises
    ------
    xarray.AlignmentError
        Never for a mission that was read: its events have different ids.
    """
    model, n = fit.model, len(draws.z)
    levels = {name: (own.thrust_n, own.level_n) for name, own in draws.branches.items()}
    z_before = model.space.sample(rng, n)
    levels_before = _prior_levels(fit, z_before, rng)
    result: dict[str, list[xr.Dataset]] = {}
    for part in model.parts:
        after, before = (
            _part_draws(model, part, *given, rng)
            for given in ((draws.z, levels, True), (z_before, levels_before, False))
        )
        of_part = drawn_groups(part.model, after, before, (1, n), rng)
        of_part["log_likelihood"] = _density(part, after)
        for name, group in of_part.items():
            result.setdefault(name, []).append(_of_events(group))
    groups = {name: _joined(parts, model) for name, parts in result.items()}
    for name, z in (("posterior", draws.z), ("prior", z_before)):
        groups[name] = groups[name].assign(walked_draws(model, z))
    blocks = model.space.log_prior_by_block(draws.z)
    groups["log_prior"] = dataset_of(log_prior_variables(blocks), {}, (1, n))
    fixed = {
        name: labelled((), v, model.units[name], name) for name, v in model.space.fixed.items()
    }
    groups["constant_data"] = groups["constant_data"].assign(fixed)
    attributes = {
        "log_evidence": fit.log_evidence_total,
        "log_evidence_se": fit.log_evidence_se,
        "pareto_k": fit.pareto_k,
        "stop_rule": IMPORTANCE_MET if fit.converged else "not converged",
    }
    return Fit(groups, attributes)


def _part_draws(
    model: MissionModel,
    part: Part,
    z: Array,
    levels: BranchLevels,
    conditional: bool,
    rng: np.random.Generator,
) -> Draws:
    """Draws of one part: its own parameters, its thrusts, and what its events have of their own.

    The last are drawn given the data, or before any (``conditional`` False).
    """
    n, own_model = len(z), part.model
    parameters: Parameters = model.space.to_parameters(z)
    relative = model.relative_pressures(parameters, n)
    values = model.of_part(part, parameters, relative)
    thrust, level = (
        item[:, part.places] for item in levels.get(part.branch, (np.zeros((n, 0, 0)),) * 2)
    )
    thrusts = ThrustDraws(thrust, np.zeros(n), level[:, -1] if level.shape[1] else level.sum(1))
    points = own_model.points_at(values, n)
    if conditional:
        terms = [term.at(points) for term in own_model.terms]
        integrated = draw_own(own_model, terms, thrust, rng)
    else:
        integrated = draw_own_prior(own_model, n, rng)
    return Draws(points.parameters, thrusts, integrated)


def _prior_levels(fit: MissionFit, z: Array, rng: np.random.Generator) -> BranchLevels:
    """Thrusts and levels of every branch before any data, at prior draws z (n, d)."""
    parameters, n = fit.model.space.to_parameters(z), len(z)
    relative = fit.model.relative_pressures(parameters, n)
    result = {}
    for branch in fit.model.branches:
        shape = (n, len(branch.events), len(branch.thrusters))
        shared = rng.standard_normal((n, branch.levels.shape[1] + branch.ageing.shape[1]))
        lost = prior_losses(fit.prior, shape, rng).lost(*shape[1:])
        level = branch.common_n * (1.0 - lost) + branch.levels_at(shared)
        departures = (
            rng.standard_normal((*shape[:2], branch.departures.shape[1])) @ branch.departures.T
        )
        scale = branch.scale_at(parameters, relative)
        result[branch.branch] = (scale[..., None] * level + departures, level)
    return result


def _density(part: Part, draws: Draws) -> xr.Dataset:
    """Log density of each of a part's events given everything."""
    model = part.model
    values = density_at(model, model.points_at(draws.parameters, draws.size), draws)
    variable: Variable = (("event",), values, "1", DENSITY_MEANING)
    return dataset_of({DENSITY: variable}, {"event": list(model.event_ids)}, (1, draws.size))


def _of_events(group: xr.Dataset) -> xr.Dataset:
    """What a group says event by event: the rest is the mission's, not a part's."""
    return group[[name for name, values in group.data_vars.items() if "event" in values.dims]]


def _joined(parts: Sequence[xr.Dataset], model: MissionModel) -> xr.Dataset:
    """The groups of all parts, events in the mission's order; NaN where one has no such thing."""
    events = model.circumstances.events
    joined = xr.concat(parts, dim="event", join="outer", data_vars="all", coords="minimal",
                       compat="override")  # fmt: skip
    ordered = joined.sel(event=[event.id for event in events]) if "event" in joined.dims else joined
    return ordered.assign_coords(
        branch=("event", [event.branch for event in events]),
        epoch=("event", [event.epoch.isoformat() for event in events]),
    )


def walked_draws(model: MissionModel, z: Array) -> dict[str, xr.DataArray]:
    """The mission's walked parameters."""
    return {
        name: labelled(("chain", "draw"), np.asarray(value)[None], model.units[name], name)
        for name, value in model.space.to_parameters(z).items()
        if np.ndim(value)
    }
