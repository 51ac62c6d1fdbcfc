"""Checkpoints of a sampling run: one file per finished block, atomic, read without pickle.

Every block carries the end state of its ensembles (positions, log densities, random state), so the
run can go on from any of them; a damaged last block costs that block only.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.errors import InputError
from cassini_bayes.files.storage import atomic_write

FORMAT = 1
_BROKEN_ARCHIVE: Final = (zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True)
class CheckpointStore:
    """A folder of checkpoint files that belong to one run.

    ``identity`` names what the run depends on (configuration, data, priors, code); a file with
    another identity is refused, never silently continued.
    """

    folder: Path
    identity: str

    def save(self, name: str, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Write named arrays to ``<name>.npz`` atomically."""
        header = np.frombuffer(
            json.dumps({"format": FORMAT, "identity": self.identity}).encode(), dtype=np.uint8
        )
        with atomic_write(self.folder / f"{name}.npz") as temporary, temporary.open("wb") as stream:
            np.savez(stream, allow_pickle=False, header=header, **arrays)

    def load(self, name: str) -> dict[str, NDArray[np.generic]] | None:
        """Arrays saved under a name; None when there is no such file or it is damaged.

        Raises
        ------
        InputError
            The file belongs to another run (other data, priors, settings or version).
        """
        path = self.folder / f"{name}.npz"
        try:
            # opened here: numpy leaves the file open when it is no archive
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                arrays = {key: file[key] for key in file.files}
            header = json.loads(arrays.pop("header").tobytes())
        except (OSError, TypeError, ValueError, KeyError, EOFError, *_BROKEN_ARCHIVE):
            return None
        if header.get("format") != FORMAT or header.get("identity") != self.identity:
            raise InputError(
                str(path),
                "a checkpoint of this run (same events, priors, settings and version)",
                "one of another run",
                "undo the change and use --resume, or start anew with --force",
            )
        return arrays

    def exists(self) -> bool:
        """Whether any checkpoint has been written."""
        return any(self.folder.glob("*.npz"))
