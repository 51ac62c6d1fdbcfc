"""The process that reads a foreign HDF5 or MATLAB file for :mod:`cassini_bayes.files.foreign`.

Run as a script: ``foreign_child.py PATH KIND FOLDER``, names of the wanted columns as a JSON list
on standard input. Writes ``FOLDER/names.json`` and ``FOLDER/columns.npz``. It knows nothing of the
package, so that it starts fast.
"""

from __future__ import annotations

import json
import math
import resource
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

MOST_MEMORY: Final = 8 << 30
MOST_VALUES: Final = 1 << 27  # of a column: a gigabyte of numbers
MOST_WIDE: Final = 64  # columns of a matrix
MOST_TEXT: Final = 64  # characters of a time
MOST_NAMES: Final = 10_000
DEEPEST: Final = 32

NamedColumn = tuple[str, Any]  # name → array, or why there is none


def main(path: str, kind: str, folder: str) -> None:
    """Read names, and the columns wanted."""
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    wanted = json.load(sys.stdin)
    names: list[str] = []
    refused: dict[str, str] = {}
    arrays: dict[str, NDArray[Any]] = {}
    places = {name: str(i) for i, name in enumerate(wanted)}
    for name, result in _columns(path, kind):
        if isinstance(result, str):
            refused[name] = result
            continue
        names.append(name)
        if name in places:
            arrays[places[name]] = result() if callable(result) else result
        if len(names) + len(refused) > MOST_NAMES:
            raise ValueError(f"more than {MOST_NAMES:,} columns")
    if wanted:
        np.savez(Path(folder) / "columns.npz", allow_pickle=False, **arrays)
    record = json.dumps({"names": names, "refused": refused})
    (Path(folder) / "names.json").write_text(record, encoding="utf-8")


def _columns(path: str, kind: str) -> Iterator[NamedColumn]:
    with Path(path).open("rb") as stream:
        start = stream.read(520)
    if b"\x89HDF\r\n\x1a\n" in (start[:8], start[512:520]):
        yield from _hdf5_columns(path, "." if kind == "MATLAB" else "/")
    elif kind == "MATLAB":
        yield from _matlab_columns(path)
    else:
        raise ValueError("other bytes than those that HDF5 begins with")


def _hdf5_columns(path: str, separator: str) -> Iterator[NamedColumn]:
    import h5py

    datasets: list[tuple[str, Any]] = []

    def visit(name: str, item: Any) -> None:
        if name.count("/") >= DEEPEST or len(datasets) >= MOST_NAMES:
            raise ValueError(f"more than {DEEPEST} levels or {MOST_NAMES:,} data sets")
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            datasets.append((name, item))

    # links to other files are not followed
    with h5py.File(path, "r") as file:
        file.visititems(visit)
        for name, dataset in datasets:
            yield from _dataset_columns(name.replace("/", separator), dataset)


def _dataset_columns(name: str, dataset: Any) -> Iterator[NamedColumn]:
    import h5py

    if dataset.shape is None or math.prod(dataset.shape) > MOST_VALUES:
        yield name, f"{dataset.shape} values; at most {MOST_VALUES:,}"
    elif dataset.is_virtual or dataset.external:
        yield name, "kept in another file"
    elif dataset.dtype.names:
        for field in dataset.dtype.names:
            yield from _array_columns(f"{name}.{field}", dataset[field])
    elif text := h5py.check_string_dtype(dataset.dtype):
        if dataset.ndim != 1 or (text.length or 0) > MOST_TEXT:
            yield name, "text that is no column of times"
        else:
            yield name, lambda: _texts(dataset.asstr()[...])
    elif dataset.dtype.kind not in "fiub":
        yield name, f"no numbers but {dataset.dtype}"
    else:
        values = dataset[...]
        yield from _array_columns(name, values.T if "MATLAB_class" in dataset.attrs else values)


def _matlab_columns(path: str) -> Iterator[NamedColumn]:
    from scipy.io import loadmat

    for name, value in loadmat(path, chars_as_strings=True).items():
        if not name.startswith("__"):
            yield from _value_columns(name, value, 1)


def _value_columns(name: str, value: Any, depth: int) -> Iterator[NamedColumn]:
    """Columns of a variable; those of a structure by its fields."""
    if depth > DEEPEST:
        yield name, f"more than {DEEPEST} levels of structures"
    elif not isinstance(value, np.ndarray):
        yield name, f"no array but {type(value).__name__}"
    elif value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            yield from _value_columns(f"{name}.{field}", value.reshape(-1)[0][field], depth + 1)
    else:
        yield from _array_columns(name, value)


def _array_columns(name: str, values: NDArray[Any]) -> Iterator[NamedColumn]:
    """A vector, or the columns of a matrix; rows go along the side too long for columns."""
    if values.dtype.kind == "U" and values.ndim == 1:
        yield name, _texts(values) if values.dtype.itemsize <= 4 * MOST_TEXT else "long text"
        return
    if values.dtype.kind not in "fiub":
        yield name, f"no numbers but {values.dtype}"
        return
    if values.ndim > 2 or values.ndim == 0:
        yield name, f"{values.ndim} dimensions; one or two make columns"
        return
    if values.ndim == 2 and values.shape[1] > MOST_WIDE:
        values = values.T
    if values.ndim == 1 or 1 in values.shape:
        yield name, values.reshape(-1).astype(np.float64)
    elif values.shape[1] > MOST_WIDE:
        yield name, f"a matrix of {values.shape}; at most {MOST_WIDE} columns"
    else:
        for i in range(values.shape[1]):
            yield f"{name}[{i + 1}]", values[:, i].astype(np.float64)


def _texts(values: NDArray[Any]) -> NDArray[Any]:
    texts = [str(value) for value in values.tolist()]
    if any(len(text) > MOST_TEXT for text in texts):
        raise ValueError(f"text of more than {MOST_TEXT} characters")
    return np.array(texts, dtype=f"U{MOST_TEXT}")


if __name__ == "__main__":
    main(*sys.argv[1:])
