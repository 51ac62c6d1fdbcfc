"""NetCDF of this package: groups read whole, once seal and declared size have been looked at.

The HDF5 library may run for ever on a damaged file, and holds the process meanwhile. So a file of
this package ends with a seal, the digest of all before it, which NetCDF readers pass over.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import h5py
import xarray as xr

from cassini_bayes.errors import InputError
from cassini_bayes.files.reading import open_file

MOST_BYTES: Final = 4 << 30  # of one group in memory; compressed, a small file may declare any size
_FIX: Final = "run the fit again, or restore the file"
_SEAL: Final = b"\ncassini_bayes sha256 "
# what HDF5 and the libraries above it raise about bytes that are no such file
_DAMAGE: Final = (
    OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError, IndexError, MemoryError,
    OverflowError,
)  # fmt: skip
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
    _check_seal(path, what)
    try:
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


def _check_seal(path: Path, what: str) -> None:
    """Refuse what was changed since it was sealed; files of earlier versions have no seal."""
    with open_file(path, what) as stream:
        size = stream.seek(0, io.SEEK_END)
        stream.seek(max(0, size - _LENGTH))
        mark, result = (tail := stream.read())[: len(_SEAL)], tail[len(_SEAL) :]
        if mark != _SEAL:
            return
        stream.seek(0)
        digest, left = hashlib.sha256(), size - _LENGTH
        while left and (block := stream.read(min(left, 1 << 20))):
            digest.update(block)
            left -= len(block)
    if digest.digest() != result:
        raise InputError(str(path), what, "one that was damaged after it was written", _FIX)


def _loaded(path: Path, group: str, needed: Sequence[str]) -> xr.Dataset:
    with xr.open_dataset(path, group=group, engine="h5netcdf") as dataset:
        if dataset.nbytes > MOST_BYTES:
            raise ValueError(f"group {group} declares {dataset.nbytes:,} bytes")
        if missing := [name for name in needed if name not in dataset]:
            raise KeyError(f"no {missing[0]} in group {group}")
        return dataset.load()
