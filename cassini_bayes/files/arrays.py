"""Named arrays in one file (NPZ), written atomically, read without pickle and without surprises.

Arrays are stored, not compressed, so what an archive declares has to fit into its own size: that
is checked before anything of that size is made.
"""

from __future__ import annotations

import io
import math
import tokenize
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from cassini_bayes.errors import InputError
from cassini_bayes.files.reading import open_file
from cassini_bayes.files.storage import atomic_write

_SUFFIX: Final = ".npy"
# what zipfile and numpy raise about bytes that are no archive of arrays
_DAMAGE: Final = (
    zipfile.BadZipFile, tokenize.TokenError, NotImplementedError, RuntimeError, MemoryError,
    OSError, EOFError, ValueError, KeyError, SyntaxError, TypeError,
)  # fmt: skip


def write_arrays(path: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Write named arrays atomically.

    Raises
    ------
    InputError
        The place cannot be written.
    ValueError
        An array of objects, which would need pickle.
    """
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def read_arrays(path: Path, what: str) -> dict[str, NDArray[np.generic]]:
    """Arrays written by :func:`write_arrays`.

    Raises
    ------
    InputError
        No such file, no archive, a damaged one, one with pickled objects, or one that declares more
        than it holds.
    """
    with open_file(path, what) as stream:
        try:
            size = stream.seek(0, io.SEEK_END)
            with zipfile.ZipFile(stream) as archive:
                members = archive.infolist()
                if any(member.compress_type != zipfile.ZIP_STORED for member in members):
                    raise ValueError("compressed")
                if sum(member.file_size for member in members) > size:
                    raise ValueError("declares more than it holds")
                return {
                    member.filename.removesuffix(_SUFFIX): _array(archive.read(member))
                    for member in members
                }
        except _DAMAGE as error:
            reason = f"{type(error).__name__}: {error}"
            raise InputError(str(path), what, reason, "remove the damaged file") from None


def _array(content: bytes) -> NDArray[Any]:
    """One array from the bytes of its member, which its header may not exceed."""
    stream = io.BytesIO(content)
    version = npy.read_magic(stream)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read_header(stream)
    if math.prod(shape) * dtype.itemsize > len(content):
        raise ValueError("an array declares more than it holds")
    stream.seek(0)
    return np.asarray(npy.read_array(stream, allow_pickle=False))
