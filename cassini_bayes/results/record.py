"""The frozen record of one fit, and its NetCDF file (an ArviZ InferenceData layout)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cassini_bayes.balance.physics import Parameters
from cassini_bayes.files.netcdf import read_groups
from cassini_bayes.files.storage import write_bytes
from cassini_bayes.model.posterior import (
    LinearDraws,
    ThrustDraws,
    collapse,
    draw_common,
    draw_linear,
)
from cassini_bayes.model.predictive import (
    balance_residual,
    event_log_likelihood,
    jacobian_expansion_error,
    on_time_stretch,
    replicate_on_times,
)
from cassini_bayes.model.totals import (
    SOFTWARE,
    TORQUES,
    LinearBlock,
    TotalsModel,
    linear_system,
)

Array = NDArray[np.float64]

GROUPS: Final = (
    "posterior",
    "posterior_predictive",
    "prior",
    "prior_predictive",
    "log_likelihood",
    "log_prior",
    "sample_stats",
    "observed_data",
    "constant_data",
)
AXES: Final = ("x", "y", "z")


@dataclass(frozen=True)
class Fit:
    """Draws and data of one fit: ArviZ groups as xarray datasets, and attributes of the whole.

    ``attributes`` holds plain numbers and strings (evidence, stop rule, versions, seed).
    """

    groups: Mapping[str, xr.Dataset]
    attributes: Mapping[str, str | float | int]

    @property
    def posterior(self) -> xr.Dataset:
        """Posterior draws, dims (chain, draw, ...); a chain is one ensemble."""
        return self.groups["posterior"]

    @property
    def prior(self) -> xr.Dataset:
        """Prior draws of the same variables."""
        return self.groups["prior"]


def draws_of(
    model: TotalsModel, z: Array, rng: np.random.Generator
) -> tuple[dict[str, Array | float], LinearDraws]:
    """Physical parameters and a draw of the thrusts and torques at posterior points z (n, d)."""
    parameters = model.space.to_parameters(z)
    system = linear_system(model, parameters)
    return parameters, draw_linear(model, system, collapse(model, system), rng)


def prior_draws(
    model: TotalsModel, n: int, rng: np.random.Generator
) -> tuple[dict[str, Array | float], LinearDraws]:
    """Parameters, thrusts and torques drawn from their priors, before any data."""
    linear = model.linear
    parameters = model.space.to_parameters(model.space.sample(rng, n))
    n_events = len(model.stack.event_ids)
    thrusts = prior_thrusts(linear, parameters, (n, n_events), rng)
    torque = rng.standard_normal((n, n_events, 3))
    return parameters, LinearDraws(
        thrust_n=thrusts.thrust_n,
        common_n=thrusts.common_n,
        level_n=thrusts.level_n,
        external_torque_n_m=linear.torque_mean_n_m + linear.torque_sd_n_m * torque,
        software=prior_software(model, n, rng),
    )


def prior_thrusts(
    linear: LinearBlock, parameters: Parameters, shape: tuple[int, int], rng: np.random.Generator
) -> ThrustDraws:
    """Thrusts drawn from their prior, for ``shape`` = (draws n, events E)."""
    n = shape[0]
    common = np.broadcast_to(
        np.asarray(
            parameters[_COMMON] if linear.common_is_walked else linear.common_mean_n, dtype=float
        ),
        (n,),
    )
    if linear.chained is not None:
        own = rng.standard_normal((*shape, linear.own.shape[1]))
        spread = rng.standard_normal((n, linear.shared.shape[1])) @ linear.shared.T
        level = linear.chained.levels_n(parameters) + spread
        common = draw_common(linear, common, level, rng)
        return ThrustDraws(level[:, None, :] + own @ linear.own.T, common, level)
    individual = linear.individual_sd_n * rng.standard_normal((n, linear.shared.shape[0]))
    common = common + linear.common_sd_n * rng.standard_normal(n)
    own = rng.standard_normal((*shape, linear.own.shape[1]))
    level = common[:, None] + individual
    return ThrustDraws(level[:, None, :] + own @ linear.own.T, common, level)


def prior_software(model: TotalsModel, n: int, rng: np.random.Generator) -> Array:
    """Constants of the on-board ΔV computation drawn from their prior, (n, 2)."""
    if model.computed is None:
        return np.zeros((n, 2))
    return np.asarray(
        model.computed.prior_mean + model.computed.prior_sd * rng.standard_normal((n, 2))
    )


_COMMON: Final = "thrust_common_n"


def build_fit(
    model: TotalsModel,
    z: Array,
    log_density: Array,
    rng: np.random.Generator,
    attributes: Mapping[str, str | float | int],
    prior_size: int = 4_000,
) -> Fit:
    """Assemble every group from walked draws.

    z (M, n, d) posterior coordinates, log_density (M, n). Thrusts and torques are drawn from their
    exact conditional, replicates and prior draws are added.
    """
    m, n, d = z.shape
    flat = z.reshape(-1, d)
    parameters, draws = draws_of(model, flat, rng)
    prior_parameters, prior_linear = prior_draws(model, prior_size, rng)
    block_terms = {
        block: terms.copy() for block, terms in model.space.log_prior_by_block(flat).items()
    }
    for block, terms in _collapsed_log_prior(model, parameters, draws).items():
        block_terms[block] = block_terms.get(block, 0.0) + terms
    expansion = jacobian_expansion_error(model, parameters, draws.thrust_n)
    groups = {
        "posterior": _parameter_dataset(model, parameters, draws, (m, n)),
        "prior": _parameter_dataset(model, prior_parameters, prior_linear, (1, prior_size)),
        "posterior_predictive": _predictive_dataset(model, parameters, draws, rng, (m, n)),
        "prior_predictive": _predictive_dataset(
            model, prior_parameters, prior_linear, rng, (1, prior_size)
        ),
        "log_likelihood": _dataset(
            {
                "totals": (
                    ("event",),
                    event_log_likelihood(model, parameters, draws),
                    "1",
                    "log density of the event's figures, all parameters given",
                )
            },
            model,
            (m, n),
        ),
        "log_prior": _dataset(
            {
                block.replace(" ", "_").replace("-", "_"): (
                    (),
                    terms,
                    "1",
                    f"log prior density, block {block}",
                )
                for block, terms in block_terms.items()
            },
            model,
            (m, n),
        ),
        "sample_stats": _dataset(
            {
                "lp": ((), log_density.reshape(-1), "1", "log posterior density in z"),
                "jacobian_expansion_error": (
                    (),
                    expansion,
                    "1",
                    "exact minus expanded log response Jacobian",
                ),
            },
            model,
            (m, n),
        ),
        "observed_data": _observed(model),
        "constant_data": _constants(model),
    }
    return Fit(groups, dict(attributes))


def _collapsed_log_prior(
    model: TotalsModel, parameters: Parameters, draws: LinearDraws
) -> dict[str, Array]:
    """Log prior densities (n,) of what is integrated out, per block, at its draws.

    Levels given the common one, departures given the levels, torques, software; a width of zero
    adds nothing.
    """
    linear = model.linear
    thrust = thrust_log_prior(
        linear, parameters, ThrustDraws(draws.thrust_n, draws.common_n, draws.level_n)
    )
    torque = draws.external_torque_n_m - linear.torque_mean_n_m
    found = {
        "thrust": thrust,
        "torque": normal_log_density(torque, linear.torque_sd_n_m).sum((-2, -1)),
    }
    if model.computed is not None:
        shift = draws.software - model.computed.prior_mean
        found["flight software"] = normal_log_density(shift, model.computed.prior_sd).sum(-1)
    return found


def thrust_log_prior(linear: LinearBlock, parameters: Parameters, draws: ThrustDraws) -> Array:
    """Log prior density (n,) of drawn thrusts: common level, thrusters' levels, departures."""
    mean = np.asarray(parameters.get(_COMMON, linear.common_mean_n))
    departure = draws.thrust_n - draws.level_n[:, None, :]
    if linear.chained is not None:
        departures = draws.level_n - linear.chained.levels_n(parameters)
        level = np.asarray(np.linalg.solve(linear.shared, departures.T).T, dtype=np.float64)
        scale = np.log(np.diagonal(linear.shared)).sum()
        thrust = normal_log_density(level, 1.0).sum(-1) - scale
    else:
        thrust = normal_log_density(draws.common_n - mean, linear.common_sd_n)
        individual = draws.level_n - draws.common_n[:, None]
        thrust = thrust + normal_log_density(individual, linear.individual_sd_n).sum(-1)
    if linear.own.shape[1]:
        white = departure @ np.linalg.pinv(linear.own).T
        scale = 0.5 * np.linalg.slogdet(linear.own.T @ linear.own)[1]
        thrust = thrust + (normal_log_density(white, 1.0).sum(-1) - scale).sum(-1)
    return np.asarray(thrust)


def normal_log_density(values: Array, sd: Array | float) -> Array:
    """log N(values; 0, sd²), 0 where sd is 0 (a fixed parameter has no density)."""
    scale = np.where(np.asarray(sd) > 0, sd, 1.0)
    density = -0.5 * (values / scale) ** 2 - np.log(scale * np.sqrt(2.0 * np.pi))
    return np.where(np.asarray(sd) > 0, density, 0.0)


Variable = tuple[tuple[str, ...], Array, str, str]
Coordinates = Mapping[str, list[str] | list[int]]


def _dataset(
    variables: Mapping[str, Variable], model: TotalsModel, shape: tuple[int, int]
) -> xr.Dataset:
    return dataset_of(variables, _coordinates(model), shape)


def _coordinates(model: TotalsModel) -> dict[str, list[str] | list[int]]:
    prime = model.stack.wheel_is_used
    return {
        "event": list(model.stack.event_ids),
        "thruster": list(model.stack.thrusters),
        "wheel": [w.name for w, used in zip(model.spacecraft.wheels, prime, strict=True) if used],
        "axis": list(AXES),
    }


def dataset_of(
    variables: Mapping[str, Variable], coordinates: Coordinates, shape: tuple[int, int]
) -> xr.Dataset:
    """Draws as a dataset: name → (dims, (chains · draws, ...), unit, long name); shape (M, n)."""
    data = {}
    for name, (dims, values, unit, long_name) in variables.items():
        sizes = tuple(len(coordinates[dim]) for dim in dims)
        full = np.broadcast_to(values, (shape[0] * shape[1], *sizes))
        data[name] = xr.DataArray(
            full.reshape(*shape, *sizes),
            dims=("chain", "draw", *dims),
            coords={dim: coordinates[dim] for dim in dims},
            attrs={"units": unit, "long_name": long_name},
        )
    return xr.Dataset(data, coords={"chain": np.arange(shape[0]), "draw": np.arange(shape[1])})


def _parameter_dataset(
    model: TotalsModel, parameters: Parameters, draws: LinearDraws, shape: tuple[int, int]
) -> xr.Dataset:
    variables: dict[str, Variable] = {
        "thrust_n": (("event", "thruster"), draws.thrust_n, "N", "steady thrust in the event"),
        "thrust_level_n": (
            ("thruster",),
            draws.level_n,
            "N",
            "thruster's level over all events: common plus individual",
        ),
        "thrust_common_n": ((), draws.common_n, "N", "common level of the branch"),
        "impulse_per_on_time_n": (
            ("event", "thruster"),
            draws.thrust_n * on_time_stretch(model, linear_system(model, parameters)),
            "N",
            "impulse delivered per second of commanded on-time, tail-off included",
        ),
        "external_torque_n_m": (
            ("event", "axis"),
            draws.external_torque_n_m,
            "N m",
            "steady external torque, body axes",
        ),
    }
    size = len(draws.thrust_n)
    wheel_inertia = {
        w.inertia_parameter: w
        for w, used in zip(model.spacecraft.wheels, model.stack.wheel_is_used, strict=True)
        if used
    }
    free = set(model.space.names)
    if free & set(wheel_inertia):
        columns = [np.broadcast_to(parameters[name], (size,)) for name in wheel_inertia]
        variables["rwa_inertia_kg_m2"] = (
            ("wheel",),
            np.stack(columns, axis=-1),
            "kg m2",
            "spin inertia of a wheel",
        )
    if "mass_factor" in parameters:
        mass = np.broadcast_to(parameters["mass_factor"], (size,))[:, None] * model.stack.mass_kg
        variables["mass_kg"] = (("event",), mass, "kg", "wet mass: table mass times factor")
    if model.computed is not None:
        for column, name in enumerate(SOFTWARE):
            spec = model.specs[name]
            variables[name] = ((), draws.software[:, column], spec.unit, spec.meaning)
    for name in model.space.names:
        if name in wheel_inertia or name == _COMMON:
            continue
        spec = model.specs[name]
        variables[name] = ((), np.asarray(parameters[name]), spec.unit, spec.meaning)
    return _dataset(variables, model, shape)


def _predictive_dataset(
    model: TotalsModel,
    parameters: Parameters,
    draws: LinearDraws,
    rng: np.random.Generator,
    shape: tuple[int, int],
) -> xr.Dataset:
    residual = balance_residual(model, linear_system(model, parameters), draws)[..., :3]
    return _dataset(
        {
            "on_time_s": (
                ("event", "thruster"),
                replicate_on_times(model, parameters, draws, rng),
                "s",
                "commanded on-time of the same bias flown again",
            ),
            "balance_residual_n_m_s": (
                ("event", "axis"),
                residual,
                "N m s",
                "thruster impulse plus torque minus the wheels' momentum change, at the data",
            ),
        },
        model,
        shape,
    )


def _observed(model: TotalsModel) -> xr.Dataset:
    stack, coordinates = model.stack, _coordinates(model)
    return xr.Dataset(
        {
            "on_time_s": xr.DataArray(
                stack.on_time_s,
                dims=("event", "thruster"),
                attrs={"units": "s", "long_name": "commanded on-time"},
            ),
            "pulses": xr.DataArray(
                stack.pulses,
                dims=("event", "thruster"),
                attrs={"units": "1", "long_name": "number of pulses"},
            ),
            "delta_v_m_s": xr.DataArray(
                stack.delta_v_m_s,
                dims=("event", "axis"),
                attrs={"units": "m s-1", "long_name": "velocity change, body axes"},
            ),
        },
        coords={name: coordinates[name] for name in ("event", "thruster", "axis")},
    )


def _constants(model: TotalsModel) -> xr.Dataset:
    stack, coordinates = model.stack, _coordinates(model)
    prime = stack.wheel_is_used
    rpm = 60.0 / (2.0 * np.pi)
    data: dict[str, xr.DataArray] = {
        "duration_s": xr.DataArray(
            stack.duration_s, dims="event", attrs={"units": "s", "long_name": "bias duration"}
        ),
        "rwa_start_rpm": xr.DataArray(
            stack.wheel_start_rad_s[:, prime] * rpm,
            dims=("event", "wheel"),
            attrs={"units": "rpm", "long_name": "wheel rate at the start"},
        ),
        "rwa_end_rpm": xr.DataArray(
            stack.wheel_end_rad_s[:, prime] * rpm,
            dims=("event", "wheel"),
            attrs={"units": "rpm", "long_name": "wheel rate at the end"},
        ),
        "thrust_predicted_n": xr.DataArray(
            stack.thrust_predicted_n,
            dims="event",
            attrs={"units": "N", "long_name": "thrust printed with the event"},
        ),
    }
    for name, value in model.space.fixed.items():
        spec = model.specs[name]
        data[name] = xr.DataArray(value, attrs={"units": spec.unit, "long_name": spec.meaning})
    for name, value in zip(TORQUES, model.linear.torque_mean_n_m, strict=True):
        data[f"prior_mean_{name}"] = xr.DataArray(
            value, attrs={"units": "N m", "long_name": "prior mean of the steady external torque"}
        )
    return xr.Dataset(data, coords={name: coordinates[name] for name in ("event", "wheel")})


def save_fit(fit: Fit, path: Path) -> None:
    """Write the fit as NetCDF 4, atomically; ``arviz.from_netcdf`` reads it.

    The file is made in memory: the HDF5 library survives no full disk (it ends the process).

    Raises
    ------
    InputError
        The place cannot be written; an earlier file stays as it was.
    """
    groups = {f"/{name}": fit.groups[name] for name in GROUPS}
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs=dict(fit.attributes)), **groups})
    encoding = {
        group: {
            key: {"zlib": True, "complevel": 1}
            for key, variable in dataset.data_vars.items()
            if variable.ndim > 1
        }
        for group, dataset in groups.items()
    }
    content = tree.to_netcdf(engine="h5netcdf", encoding=encoding)
    write_bytes(path, bytes(content))


def read_fit(path: Path) -> Fit:
    """Read a fit written by :func:`save_fit`.

    Raises
    ------
    InputError
        The file is missing, is not NetCDF, is truncated, or lacks a group.
    """
    return Fit(*read_groups(path, dict.fromkeys(GROUPS, ()), "a fit.nc of this package"))
