"""What a run depended on: versions, digests of data, priors and code, seed, command line."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import cassini_bayes
from cassini_bayes.errors import InputError
from cassini_bayes.files.code import code_digest
from cassini_bayes.files.json_file import read_json
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.pipeline.run_file import RunFile
from cassini_bayes.prediction.sources import RESOLVED

DRAWN_BY: Final = ("pipeline.inputs", "results.fitting")
"""Modules whose code, with all that they import, the draws of a run depend on."""
MOST_NAMED: Final = 4
"""Changes that a refusal names."""
OF_LENGTH: Final = ("max_steps", "target_ess")
"""Settings of the sampler that say how many draws there are, and change none of them."""
NOT_OF_DRAWS: Final = (
    "output.folder",
    "output.prior_draws",
    "output.report",
    *(f"sampler.{name}" for name in OF_LENGTH),
)
"""Settings that no draw depends on."""
LIBRARIES: Final = ("numpy", "scipy", "emcee", "arviz", "xarray", "h5netcdf", "pandas", "corner")


@dataclass(frozen=True)
class Provenance:
    """The record of a run; ``identity`` is the hash of all that its draws depend on.

    ``base`` is the folder that the paths of its inputs are relative to, as seen from its own.
    """

    identity: str
    versions: Mapping[str, str]
    digests: Mapping[str, str]
    seed: int
    command: tuple[str, ...]
    started_utc: str
    code_sha256: str
    base: str = ""

    def relative_to(self, base: Path, folder: Path) -> Provenance:
        """The record in a ``folder`` whose inputs are named from a ``base`` folder on."""
        return replace(self, base=Path(os.path.relpath(base, folder)).as_posix())

    def as_json(self) -> str:
        """The record as indented JSON."""
        return json.dumps(
            {
                "format": 1,
                "package": {
                    "cassini_bayes": cassini_bayes.__version__,
                    "code_sha256": self.code_sha256,
                },
                "versions": dict(self.versions),
                "sha256": dict(self.digests),
                "identity": self.identity,
                "seed": self.seed,
                "command": list(self.command),
                "started_utc": self.started_utc,
                "base": self.base,
            },
            indent=2,
        )


def provenance_of(
    run: RunFile, digests: Mapping[str, str], spacecraft_digest: str, command: Sequence[str]
) -> Provenance:
    """Collect the record of a run before it starts; digests are name → SHA-256 of its inputs."""
    depends_on = {
        "data": dict(digests),
        "spacecraft": spacecraft_digest,
        "source": run.source,
        "events": list(run.events),
        "accept": sorted(run.accept),
        "leave_out": run.leave_out,
        "model": run.model.model_dump(),
        "sampler": run.sampler.model_dump(exclude=set(OF_LENGTH)),
        "draws_per_ensemble": run.output.draws_per_ensemble,
        "code": code_digest(*DRAWN_BY),
    }
    return recorded(depends_on, digests, run.sampler.seed, command)


def recorded(
    depends_on: Mapping[str, Any], digests: Mapping[str, str], seed: int, command: Sequence[str]
) -> Provenance:
    """The record of what begins now and depends on some plain JSON, and on the libraries."""
    versions = library_versions()
    whole = json.dumps({**depends_on, "libraries": versions}, sort_keys=True)
    return Provenance(
        identity=hashlib.sha256(whole.encode()).hexdigest(),
        versions=versions,
        digests=dict(digests),
        seed=seed,
        command=tuple(os.fspath(part) for part in command),
        started_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        code_sha256=code_digest("cli"),
    )


def read_provenance(path: Path) -> Provenance:
    """The record of a finished run.

    Raises
    ------
    InputError
        The file is missing, or is no such record.
    """
    result = read_json(path, "the record of a run")
    try:
        return Provenance(
            identity=str(result["identity"]),
            versions=dict(result["versions"]),
            digests=dict(result["sha256"]),
            seed=int(result["seed"]),
            command=tuple(map(str, result["command"])),
            started_utc=str(result["started_utc"]),
            code_sha256=str(result["package"]["code_sha256"]),
            base=str(result.get("base", "")),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            str(path), "the record of a run", f"none ({error})", "run the fit again"
        ) from error


def refuse_other_run(path: Path, now: Provenance, settings: Mapping[str, Any]) -> None:
    """Refuse to resume what began with other inputs; without a readable record, blocks decide.

    Parameters
    ----------
    path
        The record of the run that is to go on, beside the settings that it began with.
    now
        That of the one that wants to.
    settings
        Its resolved settings, to name what was changed.

    Raises
    ------
    InputError
        The record at ``path`` is of a run with another identity.
    """
    try:
        earlier = read_json(path, "the record of a run")
        if earlier["identity"] == now.identity:
            return
    except (InputError, KeyError):
        return
    changed = [*_changed(_began_with(path), settings), *_changed_record(earlier, now)]
    raise InputError(
        str(path),
        "the events, priors, settings and versions that this run began with",
        f"others: {in_words(changed)}" if changed else "other code",
        "undo the change and use --resume, or start anew with --force",
    )


def in_words(changes: Sequence[str]) -> str:
    """The first of some changes in words, and how many more there are."""
    more = f" and {len(changes) - MOST_NAMED} more" if len(changes) > MOST_NAMED else ""
    return f"{', '.join(changes[:MOST_NAMED])}{more}"


def changed_inputs(path: Path, digests: Mapping[str, str]) -> tuple[str, ...]:
    """Inputs, name → SHA-256, whose content no input of a run's record has; none without one.

    Names are not compared: folders move, and are then called otherwise.
    """
    try:
        known = set(read_provenance(path).digests.values())
    except InputError:
        return ()
    return tuple(
        f"the content of {name}" for name, own in digests.items() if known and own not in known
    )


def _began_with(path: Path) -> Mapping[str, Any]:
    """Settings that a run says it is of; none where they cannot be read."""
    try:
        return read_toml(path.with_name(RESOLVED), "the settings of a run")
    except InputError:
        return {}


def _changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Settings that differ, each with what it was, by dotted names; all tables, no outputs."""
    if not before:
        return []
    old, new = (_flat(table) for table in (before, after))
    names = [name for name in {**new, **old} if name not in NOT_OF_DRAWS]
    return [
        f"{name} = {new.get(name, 'not given')} (was {old.get(name, 'not given')})"
        for name in names
        if old.get(name) != new.get(name)
    ]


def _flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in table.items():
        inner = isinstance(value, Mapping)
        result.update(_flat(value, f"{before}{key}.") if inner else {f"{before}{key}": value})
    return result


def _changed_record(earlier: Mapping[str, Any], now: Provenance) -> list[str]:
    """Files whose content is another, and libraries of another version."""
    before, versions = earlier.get("sha256", {}), earlier.get("versions", {})
    files = (name for name, own in now.digests.items() if before.get(name, own) != own)
    return [f"the content of {name}" for name in files] + [
        f"{name} {own} (was {versions[name]})"
        for name, own in now.versions.items()
        if versions.get(name, own) != own
    ]


def library_versions() -> dict[str, str]:
    """Versions of Python and of the libraries that results depend on."""
    return {
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in LIBRARIES},
    }
