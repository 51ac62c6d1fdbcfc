"""Run files: what to fit, with which priors, model, sampler and output (TOML)."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import nearest
from cassini_bayes.sampling.ensembles import SamplerSettings
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class ModelTable(_Table):
    """``[model]``: choices beyond the standard terms."""

    pulse_shape: str = "first_order"
    delta_v: Literal["as-declared", "ignore", "as-measured"] = "as-declared"
    effects: list[str] = []


class SamplerTable(_Table):
    """``[sampler]``: see :class:`cassini_bayes.sampling.ensembles.SamplerSettings`."""

    ensembles: int = Field(4, ge=2, le=64)
    walkers: int = Field(0, ge=0)
    target_ess: int = Field(2_000, ge=100)
    first_check: int = Field(200, ge=20)
    max_steps: int = Field(5_000, ge=100)
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
        names = [entry.name for entry in path.parent.glob("*.toml")]
        raise InputError(
            str(path), "a run file", "no such file", nearest(path.name, names)
        ) from error
    except OSError as error:
        raise InputError(
            str(path), "a run file", error.strerror or str(error), "name a readable TOML file"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(
            str(path), "UTF-8 text", f"other bytes at byte {error.start}", "save it as UTF-8"
        ) from error
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(str(path), "valid TOML", str(error), "mend that line") from error
    return check_run(table, str(path))


def check_run(table: dict[str, Any], where: str) -> RunFile:
    """Validate a run table, rewriting the first error as an :class:`InputError`."""
    try:
        run = RunFile.model_validate(table)
    except ValidationError as error:
        # a misspelt key comes before the one that is then missing
        first = min(error.errors(), key=lambda found: found["type"] != "extra_forbidden")
        raise _refusal(where, first["type"], first["loc"], first["msg"], first.get("input")) from (
            error
        )
    if run.model.pulse_shape not in PULSE_SHAPES:
        raise InputError(
            f"{where}: model.pulse_shape",
            f"one of {', '.join(PULSE_SHAPES)}",
            repr(run.model.pulse_shape),
            nearest(run.model.pulse_shape, PULSE_SHAPES),
        )
    return run


def _refusal(
    where: str, kind: str, place: tuple[int | str, ...], message: str, value: object
) -> InputError:
    """What pydantic found, in this package's words."""
    key = ".".join(str(part) for part in place)
    at, got = f"{where}: {key}", repr(value)
    if kind == "extra_forbidden":
        owner = RunFile if len(place) == 1 else _TABLES[str(place[0])]
        names = list(owner.model_fields)
        return InputError(
            at, f"one of {', '.join(names)}", "an unknown key", nearest(str(place[-1]), names)
        )
    if kind == "missing":
        return InputError(at, "a value", "nothing", f"add {key} = …")
    if kind == "model_type":
        return InputError(at, f"a table [{key}]", got, f"write its keys below a line [{key}]")
    if kind == "too_short":
        return InputError(at, "at least one", "an empty list", f'write e.g. {key} = ["file.csv"]')
    if kind == "list_type":
        fix = f"write {key} = [{json.dumps(value)}]" if isinstance(value, str) else "use brackets"
        return InputError(at, "a list of texts", got, fix)
    if kind == "literal_error":
        choices = get_args(ModelTable.model_fields["delta_v"].annotation)
        return InputError(at, f"one of {', '.join(choices)}", got, nearest(str(value), choices))
    expected = message.removeprefix("Input should be ").replace("a valid string", "a text")
    return InputError(
        at, expected.replace("a valid integer", "a whole number"), got, f"change {key}"
    )


_TABLES: dict[str, type[_Table]] = {
    "model": ModelTable,
    "sampler": SamplerTable,
    "output": OutputTable,
}
