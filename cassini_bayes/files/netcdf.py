"""NetCDF of this package: groups read whole, once their declared size has been looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import h5py
import xarray as xr

from cassini_bayes.errors import InputError
from cassini_bayes.files.reading import open_file

MOST_BYTES: Final = 4 << 30  # of one group in memory; compressed, a small file may declare any size


def read_groups(
    path: Path, groups: Mapping[str, Sequence[str]], what: str
) -> tuple[dict[str, xr.Dataset], Mapping[str, Any]]:
    """Groups of a NetCDF file, loaded, and the attributes of its root.

    Parameters
    ----------
    path, what
        The file, and what it should be, for messages.
    groups
        Name → variables that it has to have.

    Raises
    ------
    InputError
        The file cannot be read, is not NetCDF, is truncated, lacks a group or variable, or declares
        more than :data:`MOST_BYTES`.
    """
    with open_file(path, what):
        pass  # a regular file: the library opens it by name
    try:
        with h5py.File(path):  # xarray's engine complains when it is thrown away half open
            pass
        with xr.open_dataset(path, engine="h5netcdf") as root:
            attributes = dict(root.attrs)
        return {name: _loaded(path, name, needed) for name, needed in groups.items()}, attributes
    except (OSError, KeyError, ValueError, TypeError, RuntimeError) as error:
        text = str(error)
        reason = f"{type(error).__name__}: {text.splitlines()[0] if text else 'unreadable'}"
        raise InputError(
            str(path), what, reason, "run the fit again, or restore the file"
        ) from None


def _loaded(path: Path, group: str, needed: Sequence[str]) -> xr.Dataset:
    with xr.open_dataset(path, group=group, engine="h5netcdf") as dataset:
        if dataset.nbytes > MOST_BYTES:
            raise ValueError(f"group {group} declares {dataset.nbytes:,} bytes")
        if missing := [name for name in needed if name not in dataset]:
            raise KeyError(f"no {missing[0]} in group {group}")
        return dataset.load()
