"""Results as arrays and back: every kind that is kept, bit by bit, and nothing else."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cassini_bayes.computing.arrays import Array
from cassini_bayes.files.as_arrays import arrays_of, value_of
from cassini_bayes.files.checkpoint import CheckpointStore


@dataclass(frozen=True)
class Inner:
    """Arrays and a number that no decimal has exactly."""

    point: Array
    size: float = 0.1 + 0.2


@dataclass(frozen=True)
class Outer:
    """Something of everything."""

    inner: Inner
    pair: tuple[Inner, int]
    name: str
    is_whole: bool
    maybe: Inner | None = None


OUTER = Outer(Inner(np.arange(3.0) / 7.0), (Inner(np.zeros((0, 2))), 3), "Z3 ± 1", True)


def same(one: Any, other: Any) -> bool:
    """Whether two results are the same to the last bit, by what their arrays hold."""
    mine, theirs = arrays_of(one), arrays_of(other)
    return mine.keys() == theirs.keys() and all(
        mine[key].tobytes() == theirs[key].tobytes() and mine[key].shape == theirs[key].shape
        for key in mine
    )


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (Outer, OUTER),
        (Inner | None, None),
        (Inner | None, Inner(np.array([np.nan, np.inf, -0.0]))),
        (float | None, float(np.nextafter(1.0, 2.0))),
        (tuple[Inner, float], (Inner(np.ones(2)), 2.5)),
        (tuple[Inner, ...], tuple(Inner(np.full(2, i)) for i in range(12))),
        (tuple[Inner, ...], ()),
        (list, [{"a": [0.1, None, "x"], "b": {"c": True}}]),
        (dict, {"none": 1e-300}),
    ],
)
def test_what_is_kept_comes_back(kind: Any, value: Any, tmp_path: Path) -> None:
    """Through a file, of the type that the annotation says."""
    store = CheckpointStore(tmp_path, "own")
    store.save("piece", arrays_of(value))
    stored = store.load("piece")
    assert stored is not None
    found = value_of(kind, stored)
    assert type(found) is type(value)
    assert same(found, value)


def test_a_plain_record_keeps_its_order_and_types() -> None:
    """JSON has no tuples: a record is what JSON makes of it, before it is kept as after."""
    record = [{"z": 1, "a": [0.1, None]}]
    assert value_of(list, arrays_of(record)) == json.loads(json.dumps(record))


def test_what_arrays_cannot_stand_for_is_refused() -> None:
    """An object of a class that is no record: there is no pickle to fall back upon."""
    with pytest.raises(TypeError, match=r"value\.0: no arrays stand for object"):
        arrays_of((object(),))
