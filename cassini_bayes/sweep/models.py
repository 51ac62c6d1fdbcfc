"""What a sweep needs of a model: its likelihood, the priors that act, draws of every quantity."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import xarray as xr

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import nearest
from cassini_bayes.model.posterior import Event, Model, build_model, log_likelihood
from cassini_bayes.model.totals import DeltaVUse
from cassini_bayes.priors.chaining import WHEEL_INERTIA, inertia_wheels
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.priors.reader import Priors
from cassini_bayes.priors.starts import Starts
from cassini_bayes.results.groups import build_fit
from cassini_bayes.spacecraft import Spacecraft


class SweepModel(Protocol):
    """A model as a sweep sees it: walked parameters, a collapsed likelihood, draws of the rest."""

    @property
    def space(self) -> ParameterSpace:
        """The walked parameters."""

    @property
    def starts(self) -> Starts:
        """Where searches for the mode begin."""

    @property
    def collapsed(self) -> tuple[str, ...]:
        """Parameters whose priors act although they are integrated out."""

    def log_likelihood(self, z: Array) -> Array:
        """Log likelihood (n,) at walked coordinates z (n, d), everything linear integrated out."""

    def quantities(self, z: Array, rng: np.random.Generator) -> xr.Dataset:
        """Every quantity of the posterior at z (n, d): dims (chain 1, draw n, ...)."""


class ModelFactory(Protocol):
    """Makes the same model with other priors, or without one of its events."""

    @property
    def priors(self) -> Priors:
        """The priors of the baseline."""

    @property
    def event_ids(self) -> tuple[str, ...]:
        """Ids of all events."""

    def build(self, priors: Priors, without: str = "") -> SweepModel:
        """The model with these priors, leaving out the event named ``without``."""


@dataclass(frozen=True)
class SweptModel:
    """A model as a :class:`SweepModel`."""

    model: Model

    @property
    def space(self) -> ParameterSpace:
        """The walked parameters."""
        return self.model.space

    @property
    def starts(self) -> Starts:
        """Where searches for the mode begin."""
        return self.model.starts

    @property
    def collapsed(self) -> tuple[str, ...]:
        """Parameters whose priors act although they are integrated out."""
        return self.model.integrated

    def log_likelihood(self, z: Array) -> Array:
        """Collapsed log likelihood (n,) at z (n, d)."""
        return log_likelihood(self.model, z)

    def quantities(self, z: Array, rng: np.random.Generator) -> xr.Dataset:
        """Every quantity of the posterior at z (n, d)."""
        density = np.zeros((1, len(z)))
        fit = build_fit(self.model, z[None], density, rng, {}, 1, replicate_rows=False)
        return fit.posterior


@dataclass(frozen=True)
class Factory:
    """The events of a run with the choices of its run file."""

    events: tuple[Event, ...]
    priors: Priors
    pulse_shape: str = "first_order"
    delta_v: DeltaVUse = "as-declared"

    @property
    def event_ids(self) -> tuple[str, ...]:
        """Ids of all events."""
        return tuple(event.id for event in self.events)

    def build(self, priors: Priors, without: str = "") -> SweptModel:
        """The model with these priors, leaving out the event named ``without``."""
        kept = [event for event in self.events if event.id != without]
        return SweptModel(
            build_model(kept, priors, pulse_shape=self.pulse_shape, delta_v=self.delta_v)
        )


def scalar_names(dataset: xr.Dataset) -> tuple[str, ...]:
    """Names of every scalar that varies, as in summary.csv: ``thrust_n[<event>,<thruster>]``."""
    return tuple(
        name
        for name, values in _scalars(dataset)
        if np.isfinite(values).all() and np.ptp(values) > 0
    )


def _scalars(dataset: xr.Dataset) -> list[tuple[str, Array]]:
    result = []
    for quantity, variable in dataset.data_vars.items():
        dims = variable.dims[2:]
        values = variable.values.reshape(-1, *variable.shape[2:])
        for place in np.ndindex(variable.shape[2:]):
            labels = [
                str(variable.coords[dim].values[i]) for dim, i in zip(dims, place, strict=True)
            ]
            name = f"{quantity}[{','.join(labels)}]" if labels else str(quantity)
            result.append((name, np.asarray(values[(slice(None), *place)], dtype=np.float64)))
    return result


def chosen_names(dataset: xr.Dataset, patterns: Sequence[str], where: str) -> tuple[str, ...]:
    """Scalars that the patterns name, in the fit's order.

    A pattern is a scalar's name, a quantity's name (all its elements), or either with ``*``.

    Raises
    ------
    InputError
        A pattern that names nothing.
    """
    names = scalar_names(dataset)
    kept: set[str] = set()
    for pattern in patterns:
        plain = pattern.replace("[", "[[]")  # brackets are part of names, not sets of letters
        hits = [n for n in names if fnmatch.fnmatchcase(n, plain) or n.split("[")[0] == pattern]
        if not hits:
            raise InputError(
                where,
                "quantities of the posterior, as in summary.csv",
                repr(pattern),
                nearest(pattern, dict.fromkeys([*(n.split("[")[0] for n in names), *names])),
            )
        kept.update(hits)
    return tuple(name for name in names if name in kept)


def values_of(dataset: xr.Dataset, names: Sequence[str]) -> Array:
    """Draws (n, q) of named scalars; NaN where the data set has none (an event left out)."""
    result = dict(_scalars(dataset))
    n = dataset.sizes["chain"] * dataset.sizes["draw"]
    return np.stack([result.get(name, np.full(n, np.nan)) for name in names], axis=-1)


def units_of(dataset: xr.Dataset, names: Sequence[str]) -> tuple[str, ...]:
    """Unit of every named scalar."""
    return tuple(str(dataset[name.split("[")[0]].attrs["units"]) for name in names)


def walked_values(
    dataset: xr.Dataset, names: Sequence[str], spacecraft: Spacecraft
) -> dict[str, Array]:
    """Draws (n,) of named parameters, whichever way the data set keeps them.

    Raises
    ------
    InputError
        The data set has no draws of one of them.
    """
    scalars = dict(_scalars(dataset))
    wheels = inertia_wheels(dataset, spacecraft)
    result = {}
    for name in names:
        kept = f"{WHEEL_INERTIA}[{wheels[name]}]" if name in wheels else name
        if kept not in scalars:
            raise InputError(
                "fit.nc: posterior",
                f"draws of the parameter {name}",
                "none",
                "fit the run again with this version",
            )
        result[name] = scalars[kept]
    return result
