"""Make the pins of tests/test_pinned.py again, and say which numbers moved.

Run it only where a change of numbers is meant, and say why in the changelog::

    python tests/make_pinned.py            # numbers anew, at the points there are
    python tests/make_pinned.py --points   # points, modes and factors anew as well

What is new in the tables of tests/pinned_cases.py, or walks other parameters than before, gets its
points by the first as well.
"""

from __future__ import annotations

import argparse
import json
import platform
from collections.abc import Mapping
from typing import Any

import numpy as np
import test_pinned
from pinned_cases import CAUSES, SUBJECTS, Subject, mode_and_factor

from cassini_bayes.computing.arrays import Array

NEAR, FAR = 18, 4  # points within the posterior, and drawn from half the prior
SEED = 1


def points_of(subject: Subject) -> Array:
    """Points (n, d): about the mode, from the prior, and its centre."""
    rng = np.random.default_rng(SEED)
    mode, factor = mode_and_factor(subject)
    near = mode + rng.standard_normal((NEAR, len(mode))) @ factor.T
    far = 0.5 * rng.standard_normal((FAR, len(mode)))
    return np.concatenate([near, far, np.zeros((1, len(mode)))])


def chosen(known: Mapping[str, Array], walked: dict[str, list[str]]) -> dict[str, Array]:
    """All points, modes and factors: those known, where the same parameters are walked, or new.

    ``walked`` is brought up to date. In single precision: they need not be exact, as pins are
    taken where they lie.
    """
    found: dict[str, Array] = {}
    for name, make in SUBJECTS.items():
        key, names, old = f"points: {name}", list(make().names), walked.get(name, [])
        if key in known and sorted(names) == sorted(old):
            found[key] = known[key][:, [old.index(own) for own in names]]
        else:
            found[key] = points_of(make())
        walked[name] = names
    for name, cause in CAUSES.items():
        keys, names = (f"mode: {name}", f"factor: {name}"), list(cause.subject().names)
        is_known = keys[0] in known and names == walked.get(name)
        values = [known[key] for key in keys] if is_known else cause.sought()[:2]
        found |= dict(zip(keys, values, strict=True))
        walked[name] = names
    return {name: np.ascontiguousarray(v, dtype=np.float32) for name, v in found.items()}


def text(record: dict[str, Any]) -> str:
    """JSON with a line for every pin, so that a difference shows which moved."""
    parts = []
    for key, value in record.items():
        lines = [
            f"  {json.dumps(k, ensure_ascii=False)}: {json.dumps(v)}" for k, v in value.items()
        ]
        parts.append(f'"{key}": {{\n' + ",\n".join(lines) + "\n }")
    return "{\n " + ",\n ".join(parts) + "\n}\n"


def main() -> None:
    """Make points, if asked for, then numbers; print what moved."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", action="store_true", help="choose new points as well")
    options = parser.parse_args()
    before: dict[str, Any] = {"walked": {}, "numbers": {}}
    known: Mapping[str, Array] = {}
    if test_pinned.NUMBERS.exists():
        before = json.loads(test_pinned.NUMBERS.read_text(encoding="utf-8"))
        known = {} if options.points else test_pinned.inputs()
    points = chosen(known, before["walked"])
    np.savez_compressed(test_pinned.INPUTS, **points)
    test_pinned.NUMBERS.write_text(text(before), encoding="utf-8")
    test_pinned.inputs.cache_clear()
    numbers = {name: compute().tolist() for name, compute in test_pinned.ALL.items()}
    made_with = {"python": platform.python_version(), "numpy": np.__version__}
    record = {"made with": made_with, "walked": before["walked"], "numbers": numbers}
    test_pinned.NUMBERS.write_text(text(record), encoding="utf-8")
    for name, values in numbers.items():
        old = before["numbers"].get(name)
        if old != values:
            is_new = old is None or np.shape(old) != np.shape(values)
            moved = "new" if is_new else f"{np.abs(np.subtract(values, old)).max():.3g}"
            print(f"{name}: {moved}")  # noqa: T201 (a script)


if __name__ == "__main__":
    main()
