"""Archives of arrays come back exactly; one that declares more than it holds is refused unread."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from numpy.lib import format as npy

from cassini_bayes.errors import InputError
from cassini_bayes.files.arrays import read_arrays, write_arrays

ARRAYS: Final = {
    "z": np.random.default_rng(0).normal(size=(2, 5, 3)),
    "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "names": np.array(["z1b", "y2b"]),
    "none": np.array([], dtype=np.str_),
    "no rows": np.empty((0, 4)),
    "one": np.array(3),
    "flags": np.array([True, False]),
}


def test_arrays_come_back_exactly(tmp_path: Path) -> None:
    """Names, order, types, shapes and every bit, also of what has no entries."""
    write_arrays(tmp_path / "a.npz", ARRAYS)
    found = read_arrays(tmp_path / "a.npz", "arrays")
    assert list(found) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)
        np.testing.assert_array_equal(found[name], array)


def header(shape: tuple[int, ...], descr: str = "<f8") -> bytes:
    """The bytes with which numpy announces an array."""
    stream = io.BytesIO()
    npy.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def archive(content: bytes, method: int = zipfile.ZIP_STORED) -> bytes:
    """An archive with one member."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as file:
        file.writestr("x.npy", content)
    return stream.getvalue()


def with_declared_size(size: int) -> bytes:
    """An archive whose member claims another size, in the directory at its end."""
    content = bytearray(archive(header((1,)) + bytes(8)))
    place = content.index(b"PK\x01\x02") + 24
    content[place : place + 4] = struct.pack("<I", size)
    return bytes(content)


BOMBS: Final[dict[str, Callable[[], bytes]]] = {
    "zeros": lambda: archive(header((1 << 20,)) + bytes(8 << 20), zipfile.ZIP_DEFLATED),
    "a shape of terabytes": lambda: archive(header((1 << 40,)) + bytes(8)),
    "a shape beyond integers": lambda: archive(header((1 << 40, 1 << 40)) + bytes(8)),
    "a directory of gigabytes": lambda: with_declared_size((1 << 32) - 2),
    "objects": lambda: archive(header((1,), "|O") + bytes(8)),
    "deep header": lambda: archive(b"\x93NUMPY\x01\x00" + struct.pack("<H", 9000) + b"(" * 9000),
    "no header": lambda: archive(b"\x93NUMPY"),
    "another format": lambda: archive(b"\x93NUMPY\x09\x00" + bytes(100)),
    "nothing": lambda: b"",
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_more_than_is_there_is_refused(tmp_path: Path, bomb: str) -> None:
    """Compressed, declared in a header or in the directory, or to be unpickled: one line."""
    path = tmp_path / "bomb.npz"
    path.write_bytes(BOMBS[bomb]())
    assert path.stat().st_size < 1 << 16
    with pytest.raises(InputError, match=r"bomb\.npz") as caught:
        read_arrays(path, "arrays")
    assert str(caught.value).isprintable()


def test_what_the_bombs_are_made_of_is_read(tmp_path: Path) -> None:
    """Negative control: the same members with honest sizes."""
    (tmp_path / "good.npz").write_bytes(archive(header((2,)) + np.array([1.0, 2.0]).tobytes()))
    np.testing.assert_array_equal(read_arrays(tmp_path / "good.npz", "arrays")["x"], [1.0, 2.0])


def test_damage_anywhere_is_one_line_or_harmless(tmp_path: Path) -> None:
    """Random bytes in random places: an archive is read, or refused; nothing else is raised."""
    rng = np.random.default_rng(5)
    path = tmp_path / "a.npz"
    write_arrays(path, ARRAYS)
    good = path.read_bytes()
    refused = 0
    for _ in range(400):
        content = bytearray(good)
        for place in rng.integers(len(good), size=rng.integers(1, 4)):
            content[place] = rng.integers(256)
        path.write_bytes(bytes(content))
        try:
            read_arrays(path, "arrays")
        except InputError:
            refused += 1
    assert refused > 100
