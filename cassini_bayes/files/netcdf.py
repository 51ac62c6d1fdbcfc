"""NetCDF of this package: groups read whole, once seal and declared size have been looked at.

The HDF5 library may run for ever on a damaged file, and holds the process meanwhile. So a file of
this package ends with a seal, the digest of all before it, which NetCDF readers pass over. What is
sealed is read by h5py alone: xarray's engine takes five milliseconds a variable.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
import xarray as xr

from cassini_bayes.errors import InputError
from cassini_bayes.files.reading import open_file

MOST_BYTES: Final = 4 << 30  # of one group in memory; compressed, a small file may declare any size
_FIX: Final = "run the fit again, or restore the file"
_OTHER: Final = "name a file that this package wrote, or restore this one if it is damaged"
_SEAL: Final = b"\ncassini_bayes sha256 "
# what HDF5 and the libraries above it raise about bytes that are no such file
_DAMAGE: Final = (
    OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError, IndexError, MemoryError,
    OverflowError,
)  # fmt: skip
_DIMENSION_ONLY: Final = b"This is a netCDF dimension but not a netCDF variable."
_OF_THE_FORMAT: Final = {
    "CLASS", "NAME", "REFERENCE_LIST", "DIMENSION_LIST", "_NCProperties", "_Netcdf4Coordinates",
    "_Netcdf4Dimid",
}  # fmt: skip
_LENGTH: Final = len(_SEAL) + hashlib.sha256().digest_size


def sealed(content: bytes) -> bytes:
    """A NetCDF file's content with the seal behind it."""
    return content + _SEAL + hashlib.sha256(content).digest()


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
        The file cannot be read, is not NetCDF, is truncated, is not what was sealed, lacks a group
        or variable, or declares more than :data:`MOST_BYTES`.
    """
    is_sealed = _check_seal(path, what)
    if not is_sealed and not h5py.is_hdf5(path):
        raise InputError(str(path), what, "a file that is not NetCDF", _OTHER)
    try:
        if is_sealed:
            with h5py.File(path) as file:
                found = {name: _read(file[name], needed) for name, needed in groups.items()}
                return found, _attributes(file)
        # what xarray's engine reads before it can be thrown away without a complaint on stderr
        with h5py.File(path) as file:
            file.attrs.get("_nc3_strict")
        with xr.open_dataset(path, engine="h5netcdf") as root:
            attributes = dict(root.attrs)
        return {name: _loaded(path, name, needed) for name, needed in groups.items()}, attributes
    except _DAMAGE as error:
        text = str(error)
        reason = f"{type(error).__name__}: {text.splitlines()[0] if text else 'unreadable'}"
        raise InputError(str(path), what, reason, _FIX) from None


def _check_seal(path: Path, what: str) -> bool:
    """Refuse what was changed since it was sealed; files of earlier versions have no seal."""
    with open_file(path, what) as stream:
        size = stream.seek(0, io.SEEK_END)
        stream.seek(max(0, size - _LENGTH))
        mark, result = (tail := stream.read())[: len(_SEAL)], tail[len(_SEAL) :]
        if mark != _SEAL:
            return False
        stream.seek(0)
        digest, left = hashlib.sha256(), size - _LENGTH
        while left and (block := stream.read(min(left, 1 << 20))):
            digest.update(block)
            left -= len(block)
    if digest.digest() != result:
        raise InputError(str(path), what, "one that was damaged after it was written", _FIX)
    return True


def _read(group: Any, needed: Sequence[str]) -> xr.Dataset:  # h5py carries no types
    """A group as h5netcdf writes it, decoded by xarray."""
    scales, there = {}, {}
    for name, own in group.items():
        if own.attrs.get("CLASS") == b"DIMENSION_SCALE":
            scales[own.attrs["_Netcdf4Dimid"]] = name
        if not own.attrs.get("NAME", b"").startswith(_DIMENSION_ONLY):
            there[name] = own
    _check_group(group.name[1:], sum(own.nbytes for own in there.values()), needed, there)
    variables = {}
    for name, own in there.items():
        dims = [scales[i] for i in own.attrs["_Netcdf4Coordinates"]] if own.shape else []
        is_text = h5py.check_string_dtype(own.dtype) is not None
        values = np.asarray(own.asstr()[()]).astype(np.str_) if is_text else own[()]
        variables[name] = xr.Variable(dims, values, _attributes(own))
    return xr.decode_cf(xr.Dataset(variables, attrs=_attributes(group))).load()


def _attributes(item: Any) -> dict[str, Any]:
    """Attributes of a file, group or variable without those of the format, single numbers bare."""
    return {
        name: "" if isinstance(own, h5py.Empty) else own[0] if np.shape(own) == (1,) else own
        for name, own in item.attrs.items()
        if name not in _OF_THE_FORMAT
    }


def _loaded(path: Path, group: str, needed: Sequence[str]) -> xr.Dataset:
    with xr.open_dataset(path, group=group, engine="h5netcdf") as dataset:
        _check_group(group, dataset.nbytes, needed, dataset)
        return dataset.load()


def _check_group(name: str, size: int, needed: Sequence[str], there: Container[object]) -> None:
    if size > MOST_BYTES:
        raise ValueError(f"group {name} declares {size:,} bytes")
    if missing := [own for own in needed if own not in there]:
        raise KeyError(f"no {missing[0]} in group {name}")
