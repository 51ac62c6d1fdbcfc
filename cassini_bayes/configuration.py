"""Run files: what to fit, with which priors, model, sampler and output (TOML)."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cassini_bayes.checks import nearest
from cassini_bayes.errors import InputError
from cassini_bayes.sampling import SamplerSettings


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class ModelTable(_Table):
    """``[model]``: choices beyond the standard terms."""

    pulse_shape: str = "first_order"
    delta_v: Literal["as-declared", "ignore", "as-measured"] = "as-declared"


class SamplerTable(_Table):
    """``[sampler]``: see :class:`cassini_bayes.sampling.SamplerSettings`."""

    ensembles: int = Field(4, ge=2, le=64)
    walkers: int = Field(0, ge=0)
    target_ess: int = Field(2_000, ge=100)
    first_check: int = Field(200, ge=20)
    max_steps: int = Field(20_000, ge=100)
    independence_share: float = Field(0.7, ge=0.0, le=0.9)
    seed: int = Field(2010, ge=0)

    def settings(self) -> SamplerSettings:
        """The same as a plain record."""
        return SamplerSettings(**self.model_dump())


class OutputTable(_Table):
    """``[output]``: what to keep and to draw."""

    folder: str = ""
    draws_per_ensemble: int = Field(4_000, ge=500)
    prior_draws: int = Field(4_000, ge=500)
    report: bool = True


class RunFile(_Table):
    """A run file with every default filled in; paths are relative to the run file."""

    events: list[str] = Field(min_length=1)
    priors: str
    source: str = "flight"
    model: ModelTable = ModelTable()
    sampler: SamplerTable = SamplerTable()
    output: OutputTable = OutputTable()


def read_run_file(path: Path) -> RunFile:
    """Read and check a run file.

    Raises
    ------
    InputError
        Missing file, TOML syntax, unknown key (with the nearest one), wrong type or range.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError as error:
        raise InputError(str(path), "a run file", "no such file", "check the path") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            str(path), "a readable UTF-8 file", str(error), "check the file"
        ) from error
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(str(path), "valid TOML", str(error), "mend that line") from error
    return check_run(table, str(path))


def check_run(table: dict[str, Any], where: str) -> RunFile:
    """Validate a run table, rewriting the first error as an :class:`InputError`."""
    try:
        return RunFile.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        got = repr(first.get("input"))
        if first["type"] == "extra_forbidden":
            owner = RunFile if len(first["loc"]) == 1 else _TABLES[str(first["loc"][0])]
            names = list(owner.model_fields)
            raise InputError(
                f"{where}: {key}",
                f"one of {', '.join(names)}",
                "an unknown key",
                nearest(str(first["loc"][-1]), names),
            ) from error
        if first["type"] == "missing":
            raise InputError(f"{where}: {key}", "a value", "nothing", f"add {key} = …") from error
        raise InputError(
            f"{where}: {key}", first["msg"].removeprefix("Input should be "), got, f"change {key}"
        ) from error


_TABLES: dict[str, type[_Table]] = {
    "model": ModelTable,
    "sampler": SamplerTable,
    "output": OutputTable,
}
