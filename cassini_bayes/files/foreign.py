"""Foreign HDF5 and MATLAB files as columns, read in a process of their own.

The libraries that read them may run for ever on a damaged file, take all memory for a small one
that declares a large array, or crash. So a child process reads, with limits of time and memory, and
hands back plain numbers and text; nothing of Python's own is ever unpacked.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from cassini_bayes.errors import InputError
from cassini_bayes.files.arrays import read_arrays
from cassini_bayes.files.json_file import read_json
from cassini_bayes.files.reading import open_file

SUFFIXES: Final = {".h5": "HDF5", ".hdf5": "HDF5", ".he5": "HDF5", ".mat": "MATLAB"}
MOST_SECONDS: Final = 120
_CHILD: Final = Path(__file__).with_name("foreign_child.py")


@dataclass(frozen=True)
class ForeignColumns:
    """Columns of a file: names of those that can be read, why not the others, and values."""

    names: tuple[str, ...]
    refused: dict[str, str]
    columns: dict[str, NDArray[Any]]


def read_foreign(path: Path, wanted: Sequence[str] = ()) -> ForeignColumns:
    """Names of a file's columns, and the values of those wanted.

    A column is a vector of numbers or of text, a field of a table, or a column of a matrix,
    ``name[1]``. Names of HDF5 go by ``group/name``, those of MATLAB by ``struct.field``.

    Raises
    ------
    InputError
        No such file, another kind, a damaged one, or one that asks for too much time or memory.
    """
    kind = SUFFIXES[path.suffix.lower()]
    what = f"{'an' if kind == 'HDF5' else 'a'} {kind} file"
    with open_file(path, what):
        pass  # a regular file: the libraries open it by name
    with tempfile.TemporaryDirectory() as folder:
        listing, archive = Path(folder) / "names.json", Path(folder) / "columns.npz"
        command = [sys.executable, "-P", str(_CHILD), str(path.absolute()), kind, folder]
        try:
            done = subprocess.run(  # noqa: S603 - this interpreter, a file of this package
                command,
                input=json.dumps(list(wanted)),
                capture_output=True,
                text=True,
                timeout=MOST_SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise _refusal(path, what, f"one not read in {MOST_SECONDS} s") from None
        if done.returncode or not listing.exists():
            last = (done.stderr.strip().splitlines() or ["its reader died"])[-1]
            raise _refusal(path, what, last)
        record = read_json(listing, "names of columns")
        names, refused = record["names"], record["refused"]
        values = read_arrays(archive, "columns") if wanted else {}
    columns = {name: values[str(i)] for i, name in enumerate(wanted) if str(i) in values}
    return ForeignColumns(tuple(names), refused, columns)


def _refusal(path: Path, what: str, got: str) -> InputError:
    return InputError(str(path), what, got, "write the file again, or export a CSV")
