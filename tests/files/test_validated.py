"""What pydantic refuses is said with the dotted key, the nearest name and what is allowed."""

from __future__ import annotations

from typing import Any, Literal

import pytest
from pydantic import Field

from cassini_bayes.errors import InputError
from cassini_bayes.files.validated import Table, validated


class Wheel(Table):
    """An entry of an array of tables."""

    name: str = Field(min_length=1)
    axis: list[float] = Field(min_length=3, max_length=3)


class Inner(Table):
    """A table of a dictionary of tables."""

    unit: str
    law: Literal["fixed", "adaptive"] = "fixed"


class Outer(Table):
    """A file."""

    events: list[str] = Field(min_length=1, examples=[["file.csv"]])
    seed: int = Field(3, ge=0)
    wheel: list[Wheel] = Field([])
    parameters: dict[str, Inner] = Field({})
    triple: tuple[int, int] | None = None


GOOD: dict[str, Any] = {"events": ["x"], "wheel": [{"name": "w1", "axis": [0.0, 0.0, 1.0]}]}
ENTRY = {"name": "w2", "axis": [0.0, 1.0, 0.0]}


def test_a_good_table_is_an_object() -> None:
    """Defaults are filled in."""
    assert validated(Outer, GOOD, "here").seed == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"evnts": 1}, "here: evnts: expected one of events, seed, wheel, .*did you mean 'events'"),
        ({"seed": True}, r"here: seed: expected a whole number .*got True; change seed"),
        ({"seed": -1}, "expected greater than or equal to 0, got -1"),
        ({"events": "x"}, r'expected a list, got .x.; write events = \["x"\]'),
        ({"events": []}, r'a list of at least one, got \[\]; write e.g. events = \["file.csv"\]'),
        ({"events": [1]}, r"events\[1\]: expected a text, got 1"),
        ({"wheel": [{**ENTRY, "axsi": 1}]}, r"wheel\.w2\.axsi: .*did you mean 'axis'"),
        ({"wheel": [ENTRY, {"name": "w3"}]}, r"wheel\.w3\.axis: expected a value, .*; add axis ="),
        ({"wheel": [{"axis": [0.0, 1.0, 0.0]}]}, r"wheel\[1\]\.name: expected a value"),
        ({"wheel": [{**ENTRY, "axis": [0.0]}]}, r"w2\.axis: expected a list of at least 3"),
        ({"wheel": [{**ENTRY, "axis": [0.0] * 4}]}, r"w2\.axis: expected a list of at most 3"),
        (
            {"wheel": [{**ENTRY, "axis": [0.0, "1", 0.0]}]},
            r"w2\.axis\[2\]: expected a valid number",
        ),
        (
            {"wheel": [{**ENTRY, "axis": [0.0, float("inf"), 0.0]}]},
            r"w2\.axis\[2\]: expected a finite number, got inf",
        ),
        ({"wheel": 3}, r"wheel: expected a list, got 3; use brackets"),
        ({"parameters": {"unit": {"unti": "m"}}}, r"parameters\.unit\.unti: .*mean 'unit'"),
        ({"parameters": {"x": 3}}, r"a table \[parameters\.x\], got 3"),
        ({"parameters": {"x": {"unit": "m", "law": "fixd"}}}, "one of fixed, adaptive.*'fixed'"),
    ],
)
def test_a_mistake_is_one_line(change: dict[str, Any], message: str) -> None:
    """Unknown and missing keys, types, ranges, lengths, in tables, arrays and dictionaries."""
    with pytest.raises(InputError, match=message) as caught:
        validated(Outer, {**GOOD, **change}, "here")
    assert str(caught.value).isprintable()
    assert "pydantic" not in str(caught.value)


def test_a_misspelt_key_comes_before_the_one_it_leaves_missing() -> None:
    """Both are wrong; the first says more."""
    with pytest.raises(InputError, match="evnts"):
        validated(Outer, {"evnts": ["x"]}, "here")
