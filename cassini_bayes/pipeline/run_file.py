"""Run files: what to fit, with which priors, model, sampler and output (TOML)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

from pydantic import Field

from cassini_bayes.errors import InputError
from cassini_bayes.events.settings import EventsTable
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.files.validated import Table, validated
from cassini_bayes.sampling.ensembles import SamplerSettings
from cassini_bayes.spacecraft.pulses import shape_named

OTHERS: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "trend": ("a mission file", "give it to `trend`, or events to `fit --mission`"),
        "truth": ("a scenario file", "give it to `simulate`"),
        "parameters": ("a priors file", "give it to `fit EVENT... --priors`"),
    }
)
"""Tables of files that are no run files, what has them, and what takes that."""

MOST_WALKERS: Final = 10_000
MOST_DRAWS: Final = 1_000_000
"""Judgement: a slip of some zeros is refused before it asks for more memory than there is."""


class ModelTable(Table):
    """``[model]``: choices beyond the standard terms."""

    pulse_shape: str = "first_order"
    delta_v: Literal["as-declared", "ignore", "as-measured"] = "as-declared"
    effects: list[str] = Field([])


class SamplerTable(Table):
    """``[sampler]``: see :class:`cassini_bayes.sampling.ensembles.SamplerSettings`."""

    ensembles: int = Field(4, ge=2, le=64)
    walkers: int = Field(0, ge=0, le=MOST_WALKERS)
    target_ess: int = Field(2_000, ge=100)
    first_check: int = Field(200, ge=20)
    max_steps: int = Field(5_000, ge=100)
    independence_share: float = Field(0.7, ge=0.0, le=0.9)
    seed: int = Field(2010, ge=0)

    def settings(self) -> SamplerSettings:
        """The same as a plain record."""
        return SamplerSettings(**self.model_dump())


class OutputTable(Table):
    """``[output]``: what to keep and to draw."""

    folder: str = ""
    draws_per_ensemble: int = Field(4_000, ge=500, le=MOST_DRAWS)
    prior_draws: int = Field(4_000, ge=500, le=MOST_DRAWS)
    report: bool = True


class RunFile(EventsTable):
    """A run file with every default filled in; paths are relative to the run file."""

    model: ModelTable = ModelTable()
    sampler: SamplerTable = SamplerTable()
    output: OutputTable = OutputTable()


def read_run_file(path: Path, sampler: Mapping[str, int] = MappingProxyType({})) -> RunFile:
    """Read and check a run file; ``sampler`` has settings that are given in place of its own.

    Raises
    ------
    InputError
        Missing file, TOML syntax, unknown key (with the nearest one), wrong type or range.
    """
    table = read_toml(path, "a run file")
    for key, (what, fix) in OTHERS.items():
        if key in table:
            raise InputError(str(path), "a run file", what, fix)
    if sampler and isinstance(own := table.get("sampler", {}), Mapping):
        table = {**table, "sampler": {**own, **sampler}}
    return check_run(table, str(path))


def is_resolved(path: Path, own: str) -> bool:
    """Whether a file is the settings of a run, or of a diagnosis: those with the key ``own``.

    Both have the same name, and so may a file of a user's.
    """
    try:
        return {"events", "priors", own} <= read_toml(path, "the record of a run").keys()
    except InputError:
        return False


def check_run(table: dict[str, Any], where: str) -> RunFile:
    """Check the table of a run file.

    Raises
    ------
    InputError
        Unknown key (with the nearest one), wrong type or range.
    """
    run = validated(RunFile, table, where)
    shape_named(run.model.pulse_shape, f"{where}: model.pulse_shape")
    sampler = run.sampler
    if "first_check" in sampler.model_fields_set and sampler.first_check > sampler.max_steps:
        raise InputError(
            f"{where}: sampler.first_check",
            f"no more steps than max_steps, {sampler.max_steps}",
            f"{sampler.first_check}",
            "lower it, or raise max_steps",
        )
    kept = run.output.draws_per_ensemble
    sampler.settings().check_kept(kept, f"{where}: output.draws_per_ensemble")
    return run
