"""Results kept file by file: blocks of a sampling run, repetitions of a study; atomic, no pickle.

Every block carries the end state of its ensembles (positions, log densities, random state), so the
run can go on from any of them; a damaged last block costs that block only.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.errors import InputError
from cassini_bayes.files.arrays import read_arrays, write_arrays
from cassini_bayes.files.json_file import json_of, read_json
from cassini_bayes.files.storage import write_text

FORMAT = 1


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
        write_arrays(self.folder / f"{name}.npz", {"header": header, **arrays})

    def load(self, name: str) -> dict[str, NDArray[np.generic]] | None:
        """Arrays saved under a name; None when there is no such file or it is damaged.

        Raises
        ------
        InputError
            The file belongs to another run (other data, priors, settings or version).
        """
        path = self.folder / f"{name}.npz"
        try:
            arrays = read_arrays(path, "a checkpoint")
            stored = arrays.pop("header", np.empty(0))
            header = json_of(stored.tobytes(), str(path), "a checkpoint")
        except InputError:
            return None
        if header.get("format") != FORMAT or header.get("identity") != self.identity:
            raise InputError(
                str(path),
                "a checkpoint of this run (same events, priors, settings and version)",
                "one of another run",
                "undo the change and use --resume, or start anew with --force",
            )
        return arrays


@dataclass(frozen=True)
class RecordStore:
    """A folder of JSON records; one that was not made by ``made_by`` counts as missing."""

    folder: Path
    made_by: Mapping[str, object]

    def save(self, name: str, record: Mapping[str, Any]) -> None:
        """Write a record, which says what it was made by, to ``<name>.json`` atomically."""
        write_text(self.folder / f"{name}.json", json.dumps(record) + "\n")

    def load(self, name: str) -> dict[str, Any] | None:
        """A record; None when there is none, it is damaged, or something else made it."""
        try:
            record = read_json(self.folder / f"{name}.json", "a record")
        except InputError:
            return None
        is_ours = all(record.get(key) == value for key, value in self.made_by.items())
        return record if is_ours else None
