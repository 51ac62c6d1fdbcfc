"""The frozen record of one fit, and its NetCDF file (an ArviZ InferenceData layout)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cassini_bayes.files.netcdf import read_groups, sealed
from cassini_bayes.files.storage import write_bytes
from cassini_bayes.model.terms import Variable

FIT_FILE: Final = "fit.nc"
"""Name of a fit in the folder of its run."""
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
Coordinates = Mapping[str, Sequence[str] | Sequence[int]]


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


def dataset_of(
    variables: Mapping[str, Variable], coordinates: Coordinates, shape: tuple[int, int]
) -> xr.Dataset:
    """Draws as a dataset: name → (dims, (chains · draws, ...), unit, long name); shape (M, n)."""
    data = {}
    for name, (dims, values, unit, meaning) in variables.items():
        sizes = tuple(len(coordinates[dim]) for dim in dims)
        full = np.broadcast_to(values, (shape[0] * shape[1], *sizes))
        array = labelled(("chain", "draw", *dims), full.reshape(*shape, *sizes), unit, meaning)
        data[name] = array.assign_coords({dim: coordinates[dim] for dim in dims})
    return xr.Dataset(data, coords={"chain": np.arange(shape[0]), "draw": np.arange(shape[1])})


def labelled(
    dims: tuple[str, ...], values: NDArray[np.generic] | float, unit: str, meaning: str
) -> xr.DataArray:
    """Values with their unit and meaning as attributes."""
    return xr.DataArray(values, dims=dims, attrs={"units": unit, "long_name": meaning})


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
    write_bytes(path, sealed(bytes(content)))


def read_fit(path: Path, groups: Sequence[str] = GROUPS) -> Fit:
    """Read a fit written by :func:`save_fit`, or some of its groups.

    Raises
    ------
    InputError
        The file is missing, is not NetCDF, is truncated, or lacks a group.
    """
    return Fit(*read_groups(path, dict.fromkeys(groups, ()), "a fit.nc of this package"))
