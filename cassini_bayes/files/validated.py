"""A table of a file as a checked object: what pydantic refuses, in this package's words."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any, Final, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import choose

Model = TypeVar("Model", bound=BaseModel)


_EXPECTED: Final = {
    "string_type": "a text",
    "string_too_short": "a text that is not empty",
    "string_pattern_mismatch": "a text of the pattern {pattern}",
    "int_type": "a whole number (an integer)",
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
}


class Table(BaseModel):
    """A table of a file: unknown keys are refused, values never change.

    Strict: a quoted number or a boolean is a mistake, not a number, and so are nan and inf.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def validated(model: type[Model], table: Mapping[str, Any], where: str) -> Model:
    """The table of a file as an object of ``model``.

    Raises
    ------
    InputError
        Unknown key (with the nearest one), missing key, wrong type or range. The dotted key goes
        by the names of entries that have one, else by their place, counted from 1:
        ``wheel.rwa1.axis``, ``thruster[3].position[1]``.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        # a misspelt key is also a missing one: naming it says more
        first = min(error.errors(), key=lambda found: found["type"] != "extra_forbidden")
        raise _refusal(model, table, where, dict(first)) from None


def _refusal(
    model: type[BaseModel], table: Mapping[str, Any], where: str, found: Mapping[str, Any]
) -> InputError:
    kind, loc, value = found["type"], found["loc"], found["input"]
    key, got = _dotted(loc, table, kind == "missing"), repr(value)
    last = next((part for part in reversed(loc) if isinstance(part, str)), "")
    fields = _owner(model, loc[:-1]).model_fields
    expected, fix = _expected(found), f"change {key}"
    if kind == "extra_forbidden":
        known = list(fields)
        expected, got, fix = f"one of {', '.join(known)}", "an unknown key", choose(last, known)
    elif kind == "missing":
        expected, got, fix = "a value", "nothing", f"add {key.rpartition('.')[2]} = …"
    elif kind in ("model_type", "dict_type"):
        expected, fix = f"a table [{key}]", f"write its keys below a line [{key}]"
    elif kind in ("list_type", "tuple_type"):
        expected = "a list"
        fix = f"write {last} = [{json.dumps(value)}]" if isinstance(value, str) else "use brackets"
    elif kind == "too_short" and last in fields and (examples := fields[last].examples):
        fix = f"write e.g. {last} = {json.dumps(examples[0])}"
    elif kind == "literal_error":
        choices = re.findall(r"'([^']*)'", found["ctx"]["expected"])
        expected, fix = f"one of {', '.join(choices)}", choose(str(value), choices)
    return InputError(f"{where}: {key}", expected, got, fix)


def _expected(found: Mapping[str, Any]) -> str:
    context = {key: "one" if value == 1 else value for key, value in found.get("ctx", {}).items()}
    plain: str = found["msg"].removeprefix("Value error, ")
    plain = plain.removeprefix("Input should ").removeprefix("be ")
    return _EXPECTED[found["type"]].format(**context) if found["type"] in _EXPECTED else plain


def _dotted(loc: tuple[int | str, ...], table: Any, missing: bool) -> str:
    """Dotted key of a location, without pydantic's marks of what it tried there."""
    text, value = "", table
    for depth, part in enumerate(loc, start=1):
        if isinstance(part, str) and isinstance(value, Mapping):
            if part in value or (missing and depth == len(loc)):
                text, value = f"{text}.{part}" if text else part, value.get(part)
        elif isinstance(part, int) and isinstance(value, list | tuple):
            value = value[part] if part < len(value) else None
            text += f".{name}" if (name := _name(value)) else f"[{part + 1}]"
    return text


def _name(entry: object) -> str | None:
    """The name or id of an entry of an array of tables, if it has one."""
    names = [entry.get(key) for key in ("name", "id")] if isinstance(entry, Mapping) else []
    return next((name for name in names if isinstance(name, str) and name), None)


def _owner(model: type[BaseModel], loc: tuple[int | str, ...]) -> type[BaseModel]:
    """The model of the table at a location; keys of a dictionary and places in lists are passed."""
    for part in loc:
        field = model.model_fields.get(str(part))
        model = (field and _model_in(field.annotation)) or model
    return model


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((result for a in get_args(annotation) if (result := _model_in(a))), None)
