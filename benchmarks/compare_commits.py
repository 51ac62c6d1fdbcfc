"""Compare what two commits calculate on this machine, bit for bit, by the command line alone.

``python benchmarks/compare_commits.py OLD NEW`` makes a git worktree of each commit and has both
simulate, fit, diagnose, predict and sweep; then every array, table and JSON number that they wrote
is compared. Nothing of the package is imported, so that modules may move between the commits.

- Fits and diagnoses of both commits read the telemetry that OLD has simulated, sweeps and
  predictions the fit that OLD has made: differences do not pile up.
- Both commits work side by side, each on a core of its own: some five minutes where these are free.
- What differs by less than a billionth of its size is called rounding: a sum in another order.
- Where draws part, means and widths are compared in Monte Carlo standard errors. They agree if none
  of all n differences exceeds the bound that n normal ones exceed with probability 0.001 (Šidák).
  Numbers without an error of their own then follow from such draws: told, not judged. So are
  R-hat and the like beside rounding, which are made of ranks.
- Texts, files and names in data files have to be the same; pages and figures are only looked at.

Exit status 0: equal or agreeing; 1: not, or a command failed.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import pandas as pd
import tomli_w
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import norm

from cassini_bayes.computing.arrays import Array

Verdict = Literal["equal", "rounding", "draws", "no error", "different", "one side"]
Log = Callable[[str], None]

ROOT: Final = Path(__file__).parents[1]
ROUNDING: Final = 1e-9
LEVEL: Final = 1e-3
LEAST_SPREAD: Final = 0.1  # of squares, as kurtosis less one: two values as likely have none
DRAW_DIMS: Final = ("chain", "draw", "replicate")
# Numbers with their Monte Carlo standard errors, in tables and JSON alike.
ERRORS: Final = {
    "mean": "mcse_mean",
    "shift_sd": "shift_error",
    "width_ratio": "width_error",
    "log_evidence": "log_evidence_se",
    "log_bayes_factor": "log_evidence_se",
    "log_bayes_factor_nats": "log_evidence_se_nats",
}
# Made of ranks: two draws that change places by rounding move them by more than rounding.
OF_RANKS: Final = {"rhat", "ess_bulk", "ess_tail", "pareto_k"}
NOT_COMPARED: Final = {"command", "seconds", "started_utc", "code_sha256", "identity"}
SKIPPED: Final = {"checkpoint", "cells", "statistics", "provenance.json"}
DATA: Final = {".nc", ".csv", ".json", ".toml"}
TELLING: Final = 40  # lines of details
NUMBER: Final = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w)")  # not those of a name
TRACEBACK: Final = "Traceback (most recent call last)"
STATUS: Final = "exit status"
IN_ORDER: Final = " in order"
OLD, NEW = "old", "new"


# What is compared, and the verdict on it.


@dataclass(frozen=True)
class Finding:
    """One variable, column or number of an artefact.

    ``size`` is relative to the largest number of the variable, except for ``draws``: the largest
    difference in Monte Carlo standard errors, over ``scalars`` means and widths.
    """

    artefact: str
    name: str
    verdict: Verdict
    size: float = 0.0
    scalars: int = 0
    note: str = ""


def compare_arrays(old: NDArray[Any], new: NDArray[Any]) -> tuple[Verdict, float]:
    """Equal bit for bit, by rounding, or apart by how much of the largest number."""
    if old.dtype == new.dtype and old.shape == new.shape and old.tobytes() == new.tobytes():
        return "equal", 0.0
    numbers = old.dtype.kind in "fiub" and new.dtype.kind in "fiub"
    if old.shape != new.shape or not numbers:
        same = old.shape == new.shape and list(map(str, old.flat)) == list(map(str, new.flat))
        return ("equal", 0.0) if same else ("different", math.inf)
    one, other = old.astype(np.float64), new.astype(np.float64)
    inside = np.isfinite(one)
    if not np.array_equal(one[~inside], other[~inside], equal_nan=True):
        return "different", math.inf
    if not np.isfinite(other[inside]).all():
        return "different", math.inf
    if not inside.any():
        return "equal", 0.0
    largest = float(np.abs(one[inside]).max())
    size = float(np.abs(other[inside] - one[inside]).max()) / (largest or 1.0)
    if size == 0.0:
        return ("equal" if old.dtype == new.dtype else "rounding"), 0.0
    return ("rounding" if size <= ROUNDING else "different"), size


def parted(old: Array, new: Array, ess: tuple[float, float]) -> tuple[float, int]:
    """Largest difference of means and widths of draws (n, k), in standard errors, and how many.

    ``ess`` are the effective numbers of draws on both sides. Widths are compared by the logarithms
    of standard deviations, whose error is that of draws with the kurtosis they have.
    """
    worst = 0.0
    for one, other in zip(old.T, new.T, strict=True):
        if not (np.isfinite(one).all() and np.isfinite(other).all()):
            same = np.isnan(one).all() and np.isnan(other).all()
            worst = worst if same else math.inf
            continue
        means = float(one.mean()), float(other.mean())
        sds = float(one.std()), float(other.std())
        if min(sds) == 0.0:  # what does not vary is equal or it is not
            worst = worst if means[0] == means[1] and sds[0] == sds[1] else math.inf
            continue
        sizes = zip((one, other), means, sds, strict=True)
        kurtosis = max(float((((own - m) / sd) ** 4).mean()) for own, m, sd in sizes)
        width_error = math.sqrt(max(kurtosis - 1.0, LEAST_SPREAD) / 4.0 * sum(1.0 / n for n in ess))
        mean_error = math.hypot(*(sd / math.sqrt(n) for sd, n in zip(sds, ess, strict=True)))
        apart = abs(means[0] - means[1]) / mean_error, abs(math.log(sds[1] / sds[0])) / width_error
        worst = max(worst, *apart)
    return worst, 2 * old.shape[1]


def compare_datasets(
    artefact: str,
    old: xr.Dataset,
    new: xr.Dataset,
    ess: Callable[[str], tuple[float, float] | None] = lambda _: None,
) -> list[Finding]:
    """Every variable of two datasets; ``ess`` are effective draws by name, None: all of them."""
    found = []
    for name in _names(map(str, old.variables), map(str, new.variables)):
        if name not in old.variables or name not in new.variables:
            found.append(_one_sided(artefact, name, name in old.variables))
            continue
        one, other = old[name], new[name]
        verdict, size = compare_arrays(one.values, other.values)
        if name in DRAW_DIMS:  # a run may keep another number of draws where they part
            verdict = _unless_different(verdict)
        if verdict != "different":
            found.append(Finding(artefact, name, verdict, size, note=_shapes(one, other)))
            continue
        drawn = [dim for dim in DRAW_DIMS if dim in one.dims]
        rest = [dim for dim in one.dims if dim not in DRAW_DIMS]
        numbers = one.dtype.kind in "fiub" and other.dtype.kind in "fiub"
        alike = one.dims == other.dims and all(one.sizes[d] == other.sizes[d] for d in rest)
        if not drawn or not alike or not numbers:
            found.append(Finding(artefact, name, "different", size, note=_shapes(one, other)))
            continue
        flat = [
            own.transpose(*drawn, *rest).values.astype(np.float64).reshape(_size(own, drawn), -1)
            for own in (one, other)
        ]
        most = float(len(flat[0])), float(len(flat[1]))
        effective = [min(own, n) for own, n in zip(ess(name) or most, most, strict=True)]
        worst, scalars = parted(flat[0], flat[1], (effective[0], effective[1]))
        found.append(Finding(artefact, name, "draws", worst, scalars))
    return found


def _size(values: xr.DataArray, dims: Sequence[str]) -> int:
    return int(np.prod([values.sizes[dim] for dim in dims]))


def _shapes(old: xr.DataArray, new: xr.DataArray) -> str:
    return "" if old.sizes == new.sizes else f"{dict(old.sizes)} → {dict(new.sizes)}"


def _names(old: Iterable[str], new: Iterable[str]) -> list[str]:
    """Names of either side, in the order of the old one."""
    return list(dict.fromkeys([*old, *new]))


def _one_sided(artefact: str, name: str, is_old: bool) -> Finding:
    return Finding(artefact, name, "one side", note=f"{OLD if is_old else NEW} only")


def compare_fits(
    artefact: str,
    old: Mapping[str, xr.Dataset],
    new: Mapping[str, xr.Dataset],
    summaries: tuple[pd.DataFrame, pd.DataFrame] | None = None,
) -> list[Finding]:
    """Groups of two fit.nc; effective draws are those of the summaries, all draws of a prior."""
    found = []
    for group in _names(old, new):
        if group not in old or group not in new:
            found.append(_one_sided(artefact, group, group in old))
            continue

        def ess(name: str, group: str = group) -> tuple[float, float] | None:
            if summaries is None or "prior" in group:
                return None
            one, other = (_effective(summary, name) for summary in summaries)
            return one, other

        where = f"{artefact}:{group.strip('/')}" if group.strip("/") else artefact
        found += compare_datasets(where, old[group], new[group], ess)
        attributes = [dict(side[group].attrs) for side in (old, new)]
        found += compare_trees(f"{where} attributes", *attributes)
    return found


def _effective(summary: pd.DataFrame, quantity: str) -> float:
    """Fewest effective draws of a quantity, or of all where the summary does not have it."""
    rows = summary[summary["quantity"] == quantity]
    values = (rows if len(rows) else summary)[["ess_bulk", "ess_tail"]].to_numpy(dtype=np.float64)
    return float(np.nanmin(values))


def compare_tables(
    artefact: str, old: Sequence[Sequence[str]], new: Sequence[Sequence[str]]
) -> list[Finding]:
    """Two CSVs column by column; rows are matched by their texts where they are not the same."""
    if list(map(list, old)) == list(map(list, new)):
        return [Finding(artefact, name, "equal") for name in (old[0] if old else ())]
    one, other = _columns(old), _columns(new)
    found = [
        _one_sided(artefact, name, name in one)
        for name in _names(one, other)
        if name not in one or name not in other
    ]
    both = [name for name in one if name in other]
    one, other, lost = _matched(both, one, other)
    found += [_one_sided(artefact, f"row {row}", is_old) for row, is_old in lost]
    for name in both:
        values = _numbers(one[name]), _numbers(other[name])
        if values[0] is None or values[1] is None:
            text, note = compare_texts(one[name], other[name])
            found.append(Finding(artefact, name, text, note=note))
            continue
        verdict, size = compare_arrays(values[0], values[1])
        error = ERRORS.get(name, "")
        errors = _numbers(one.get(error, ())), _numbers(other.get(error, ()))
        if verdict == "different":
            worst, count = _in_errors(values, errors)
            if count:
                found.append(Finding(artefact, name, "draws", worst, count))
                continue
        found.append(Finding(artefact, name, _unless_different(verdict), size))
    return found


def _unless_different(verdict: Verdict) -> Verdict:
    """A number that differs has no error stated; whether that is right, the part's draws tell."""
    return "no error" if verdict == "different" else verdict


def _in_errors(
    values: tuple[Array | None, Array | None], errors: tuple[Array | None, Array | None]
) -> tuple[float, int]:
    """Largest difference in standard errors, and how many differences have one.

    Numbers without an error have to be equal, or there is none of them all.
    """
    if any(own is None or len(own) == 0 for own in (*values, *errors)):
        return math.inf, 0
    one, other, its, again = (np.asarray(own) for own in (*values, *errors))
    both = np.hypot(its, again)
    has_error = np.isfinite(both) & (both > 0.0) & np.isfinite(one) & np.isfinite(other)
    rest = ~has_error & ~((one == other) | (np.isnan(one) & np.isnan(other)))
    if rest.any() or not has_error.any():
        return math.inf, 0
    return float((np.abs(one - other)[has_error] / both[has_error]).max()), int(has_error.sum())


def _columns(table: Sequence[Sequence[str]]) -> dict[str, list[str]]:
    header, rows = (list(table[0]), table[1:]) if table else ([], [])
    return {name: [row[i] if i < len(row) else "" for row in rows] for i, name in enumerate(header)}


def _numbers(texts: Sequence[str]) -> Array | None:
    """A column as numbers, an empty cell as NaN; None where it holds a text."""
    try:
        return np.array([float(text) if text.strip() else math.nan for text in texts])
    except ValueError:
        return None


def _matched(
    names: Sequence[str], old: Mapping[str, list[str]], new: Mapping[str, list[str]]
) -> tuple[dict[str, list[str]], dict[str, list[str]], list[tuple[str, bool]]]:
    """Columns of the rows that both have, in one order, and the rows of one side only.

    Rows are known by their cells in columns that hold the same texts in some order, the n-th of a
    kind as such.
    """
    texts = [n for n in names if _numbers(old[n]) is None and sorted(old[n]) == sorted(new[n])]
    texts = texts or [n for n in names if _numbers(old[n]) is None][:1]
    keys = []
    for side in (old, new):
        seen: dict[tuple[str, ...], int] = {}
        rows = list(zip(*(side[name] for name in texts), strict=True))
        rows = rows or [()] * len(next(iter(side.values()), []))
        own = []
        for row in rows:
            seen[row] = seen.get(row, 0) + 1
            own.append((*row, str(seen[row])))
        keys.append(own)
    if keys[0] == keys[1]:
        return dict(old), dict(new), []
    places = [{key: i for i, key in enumerate(own)} for own in keys]
    shared = [key for key in keys[0] if key in places[1]]
    lost = [(" ".join(key), True) for key in keys[0] if key not in places[1]]
    lost += [(" ".join(key), False) for key in keys[1] if key not in places[0]]
    one, other = (
        {name: [side[name][place[key]] for key in shared] for name in names}
        for side, place in zip((old, new), places, strict=True)
    )
    return one, other, lost


def _first_difference(old: Sequence[str], new: Sequence[str]) -> str:
    if len(old) != len(new):
        return f"{len(old)} rows → {len(new)} rows"
    pairs = ((a, b) for a, b in zip(old, new, strict=True) if a != b)
    one, other = next(pairs, ("", ""))
    return f"{one[:60]!r} → {other[:60]!r}"


def compare_texts(old: Sequence[str], new: Sequence[str]) -> tuple[Verdict, str]:
    """Texts one by one: the same, the same but for numbers in them, or different."""
    if list(old) == list(new):
        return "equal", ""
    note = _first_difference(old, new)
    masked = [[NUMBER.sub("#", text) for text in side] for side in (old, new)]
    return ("no error" if masked[0] == masked[1] else "different"), note


def compare_trees(artefact: str, old: Any, new: Any) -> list[Finding]:
    """Two JSON trees leaf by leaf; lists of named things are matched by name."""
    one, other = dict(leaves(old)), dict(leaves(new))
    found = []
    for path in _names(one, other):
        if path not in one or path not in other:
            found.append(_one_sided(artefact, path, path in one))
            continue
        a, b = one[path], other[path]
        if not (_is_number(a) and _is_number(b)):
            text, note = compare_texts([f"{a}"], [f"{b}"])
            if text == "different" and path.endswith(IN_ORDER) and sorted(a) == sorted(b):
                text = "no error"  # the same things: chance may order what is nearly alike
            found.append(Finding(artefact, path, text, note=note))
            continue
        verdict, size = compare_arrays(np.array([float(a)]), np.array([float(b)]))
        if verdict == "different":
            head, _, last = path.rpartition(".")
            error = f"{head}.{ERRORS[last]}" if last in ERRORS else ""
            error = error.removeprefix(".")
            errors = tuple(_as_array(side.get(error)) for side in (one, other))
            worst, count = _in_errors((_as_array(a), _as_array(b)), (errors[0], errors[1]))
            if count:
                found.append(Finding(artefact, path, "draws", worst, count))
                continue
        found.append(Finding(artefact, path, _unless_different(verdict), size))
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _as_array(value: Any) -> Array | None:
    return np.array([float(value)]) if _is_number(value) else None


def leaves(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Paths and values of a JSON tree, without the keys that say how and when it was made."""
    if isinstance(tree, Mapping):
        for key, value in tree.items():
            if key not in NOT_COMPARED:
                yield from leaves(value, f"{path}.{key}" if path else str(key))
    elif isinstance(tree, list):
        labels = [own.get("name") if isinstance(own, Mapping) else None for own in tree]
        named = len(set(labels)) == len(tree) and None not in labels
        if named:
            yield f"{path}{IN_ORDER}", labels
        for place, value in enumerate(tree):
            yield from leaves(value, f"{path}[{labels[place] if named else place}]")
    else:
        yield path, tree


# The verdict on all.


def bound(scalars: int) -> float:
    """What the largest of n normal differences exceeds with probability 0.001 (Šidák)."""
    if scalars == 0:
        return math.inf
    return float(norm.isf(-0.5 * math.expm1(math.log1p(-LEVEL) / scalars)))


@dataclass(frozen=True)
class Comparison:
    """All findings, by part of the comparison; ``pages`` are those looked at only."""

    findings: Mapping[str, Sequence[Finding]]
    pages: Sequence[str] = ()
    used: Mapping[str, tuple[Used, Used]] = field(default_factory=dict)

    @property
    def scalars(self) -> int:
        """Number of means, widths and evidences that are judged by their errors."""
        return sum(own.scalars for part in self.findings.values() for own in part)

    def has(self, part: str, *verdicts: Verdict) -> bool:
        """Whether there are such findings in a part."""
        return any(own.verdict in verdicts for own in self.findings[part])

    def fails(self, part: str, own: Finding) -> bool:
        """Whether a finding is more than rounding and chance."""
        if own.verdict in ("equal", "rounding"):
            return False
        if own.verdict == "draws":
            return own.size > bound(self.scalars)
        if own.verdict == "no error":
            # follows from draws that part, or from ranks of draws that differ by rounding
            ranked = re.split(r"[.:]", own.name)[-1] in OF_RANKS
            return not self.has(part, "draws", *(("rounding",) if ranked else ()))
        return True

    @property
    def empty(self) -> list[str]:
        """Parts in which no file was compared."""
        return [
            name
            for name, part in self.findings.items()
            if all(own.artefact == STATUS for own in part)
        ]

    @property
    def agrees(self) -> bool:
        """Whether nothing fails, and something was compared in every part."""
        found = self.findings.items()
        return not self.empty and not any(self.fails(name, f) for name, part in found for f in part)


COLUMNS: Final = ("artefact", "all", "equal", "rounding", "draws part", "no error", "failed")


def table(result: Comparison) -> list[list[str]]:
    """A row for every artefact: how many variables, and the largest difference of each kind."""
    rows = []
    for part, findings in result.findings.items():
        for artefact in dict.fromkeys(own.artefact for own in findings):
            own = [finding for finding in findings if finding.artefact == artefact]
            kinds: dict[Verdict, list[Finding]] = {
                kind: [f for f in own if f.verdict == kind]
                for kind in ("equal", "rounding", "draws", "no error")
            }
            failed = sum(result.fails(part, f) for f in own)
            rows.append(
                [
                    artefact,
                    str(len(own)),
                    str(len(kinds["equal"])),
                    _counted(kinds["rounding"], ".0e"),
                    _counted(kinds["draws"], ".2f", " σ"),
                    _counted(kinds["no error"], ".1e"),
                    str(failed) if failed else "",
                ]
            )
    return rows


def _counted(findings: Sequence[Finding], style: str, unit: str = "") -> str:
    if not findings:
        return ""
    return f"{len(findings)} (≤ {max(own.size for own in findings):{style}}{unit})"


def details(result: Comparison) -> list[str]:
    """A line for whatever is neither equal nor rounding: what fails first, the largest first."""
    found = [
        (result.fails(part, own), own.verdict == "draws", own.size, own)
        for part, findings in result.findings.items()
        for own in findings
        if own.verdict not in ("equal", "rounding")
    ]
    found.sort(key=lambda entry: (not entry[0], not entry[1], -entry[2]))
    words = {
        "draws": "{size:.2f} Monte Carlo standard errors over {scalars} means and widths",
        "no error": "{size:.1e} of its size, no error stated {note}",
        "different": "different {note}",
        "one side": "{note}",
    }
    return [
        f"{'FAILED ' if fails else ''}{own.artefact}: {own.name}: "
        + words[own.verdict].format(size=own.size, scalars=own.scalars, note=own.note).strip()
        for fails, _, _, own in found
    ]


def sentence(result: Comparison) -> str:
    """What came of it, in a sentence."""
    everything = [own for part in result.findings.values() for own in part]
    failed = sum(result.fails(name, own) for name, part in result.findings.items() for own in part)
    if result.empty:
        return f"NOT COMPARED: {', '.join(result.empty)}; DIFFERENT: {failed}."
    if all(own.verdict == "equal" for own in everything):
        return f"All {len(everything)} variables are equal bit for bit."
    counts = f"{sum(own.verdict == 'equal' for own in everything)} of {len(everything)}"
    head = f"{counts} variables are equal bit for bit; "
    if failed:
        return f"{head}DIFFERENT: {failed}."
    worst = max((own.size for own in everything if own.verdict == "draws"), default=None)
    if worst is None:
        return f"{head}the others differ by rounding."
    return (
        f"{head}the others agree: draws that part by at most {worst:.2f} Monte Carlo standard "
        f"errors, bound {bound(result.scalars):.2f} for {result.scalars} means and widths."
    )


def plain_table(rows: Sequence[Sequence[str]]) -> str:
    """Columns of equal width."""
    everything = [list(COLUMNS), *rows]
    widths = [max(len(row[i]) for row in everything) for i in range(len(COLUMNS))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in everything
    )


def page(result: Comparison, old: str, new: str) -> str:
    """The results page (Markdown)."""
    lines = details(result)
    seconds = [
        f"| {name} | {' | '.join(f'{s.wall_s:.0f} ({s.cpu_s:.0f})' for s in both)} |"
        for name, both in result.used.items()
    ]
    parts = [
        f"# {old} against {new}",
        sentence(result),
        "Sizes of differences without an error are shares of the variable's largest number, σ is a "
        f"Monte Carlo standard error. Rounding: up to {ROUNDING:g} of the size.",
        "\n".join(
            [
                f"| {' | '.join(COLUMNS)} |",
                f"|{' --- |' * len(COLUMNS)}",
                *(f"| {' | '.join(row)} |" for row in table(result)),
            ]
        ),
        *(["## Not equal", "\n".join(f"- {line}" for line in lines)] if lines else []),
        *(
            ["## Pages and figures that differ", "\n".join(f"- {name}" for name in result.pages)]
            if result.pages
            else []
        ),
        "## Seconds (of a processor)",
        "\n".join([f"| command | {OLD} | {NEW} |", "| --- | --- | --- |", *seconds]),
    ]
    return "\n\n".join(parts) + "\n"


# Files of both sides.


def compare_folders(part: str, old: Path, new: Path, roots: Sequence[Path]) -> list[Finding]:
    """Every data file below two folders; texts are compared without the ``roots`` in them."""
    found = []
    for name in _names(*(_files(folder, DATA) for folder in (old, new))):
        one, other = old / name, new / name
        artefact = f"{part}/{name}"
        if not one.exists() or not other.exists():
            found.append(_one_sided(artefact, "the file", one.exists()))
        elif one.suffix == ".nc":
            groups = [xr.open_groups(path, engine="h5netcdf") for path in (one, other)]
            found += compare_fits(artefact, groups[0], groups[1], _summaries(one, other))
        elif one.suffix == ".csv":
            found += compare_tables(artefact, *(_rows(path, roots) for path in (one, other)))
        else:
            found += compare_trees(artefact, *(_tree(path, roots) for path in (one, other)))
    return found


def differing_pages(part: str, old: Path, new: Path, roots: Sequence[Path]) -> list[str]:
    """Pages and figures that are not the same, or on one side only."""
    found = []
    for name in _names(*(_files(folder, None) for folder in (old, new))):
        paths = old / name, new / name
        if not all(path.exists() for path in paths):
            found.append(f"{part}/{name} ({OLD if paths[0].exists() else NEW} only)")
        elif _content(paths[0], roots) != _content(paths[1], roots):
            found.append(f"{part}/{name}")
    return found


def _files(folder: Path, suffixes: Iterable[str] | None) -> list[str]:
    """Names of files with one of the suffixes; None: of pages and figures."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    names = [path.relative_to(folder) for path in found]
    return [
        str(name)
        for name in names
        if not set(name.parts) & SKIPPED
        and (name.suffix in suffixes if suffixes is not None else name.suffix not in DATA)
    ]


def _summaries(old: Path, new: Path) -> tuple[pd.DataFrame, pd.DataFrame] | None:
    paths = [path.with_name("summary.csv") for path in (old, new)]
    if not all(path.exists() for path in paths):
        return None
    one, other = (pd.read_csv(path) for path in paths)
    return one, other


def _without(text: str, roots: Sequence[Path]) -> str:
    for root in roots:
        text = text.replace(str(root), "…")
    return text


def _rows(path: Path, roots: Sequence[Path]) -> list[list[str]]:
    return list(csv.reader(_without(path.read_text(encoding="utf-8"), roots).splitlines()))


def _tree(path: Path, roots: Sequence[Path]) -> Any:
    text = _without(path.read_text(encoding="utf-8"), roots)
    return json.loads(text) if path.suffix == ".json" else tomllib.loads(text)


def _content(path: Path, roots: Sequence[Path]) -> bytes:
    if path.suffix in (".png", ".pdf"):
        return path.read_bytes()
    text = _without(path.read_text(encoding="utf-8", errors="replace"), roots)
    return re.sub(r"\bin [\d.]+ s\b", "in … s", text).encode()


# Two commits at work.


class Used(NamedTuple):
    """What a command ended with and took: exit status, seconds by the clock and of a processor."""

    status: int
    wall_s: float
    cpu_s: float


class Commands:
    """Runs commands of both sides, and ends those still running when asked to stop."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: set[int] = set()
        self._stopped = False

    def run(self, command: Sequence[str], folder: Path, log: Path, core: int | None) -> Used:
        """Run a command in a folder that has the package, its output going to a file."""
        environment = {
            **os.environ,
            "PYTHONPATH": str(folder),
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        if core is not None:
            os.sched_setaffinity(0, {core})  # of this thread, and of the processes it starts
        log.parent.mkdir(parents=True, exist_ok=True)
        began = time.monotonic()
        with log.open("wb") as stream:
            with self._lock:
                if self._stopped:
                    return Used(-signal.SIGTERM, 0.0, 0.0)
                child = subprocess.Popen(  # noqa: S603 (this package's own command line)
                    command, stdout=stream, stderr=stream, cwd=folder, env=environment
                )
                self._running.add(child.pid)
            _, raw, usage = os.wait4(child.pid, 0)
            with self._lock:
                self._running.discard(child.pid)
        child.returncode = os.waitstatus_to_exitcode(raw)
        cpu_s = usage.ru_utime + usage.ru_stime
        return Used(child.returncode, time.monotonic() - began, cpu_s)

    def stop(self) -> None:
        """End what is running; start nothing more."""
        with self._lock:
            self._stopped = True
            for pid in self._running:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGTERM)


@dataclass(frozen=True)
class Side:
    """One commit: its worktree, the folder of what it writes, and the core it has."""

    name: str
    code: Path
    out: Path
    core: int | None

    def input_of(self, run_file: str) -> dict[str, Any]:
        """Events and priors of one of the commit's own run files, as absolute paths."""
        path = self.code / "runs" / run_file
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        events = [str((path.parent / event).resolve()) for event in content["events"]]
        return {"events": events, "priors": str((path.parent / content["priors"]).resolve())}

    def page_at(self, page: str) -> list[str]:
        """Options that send a study's page there: by its folder since all studies run alike."""
        if (self.code / "cassini_bayes" / "studies" / "study.py").exists():
            return ["--out", str((self.out / page).parent)]
        return ["--page", str(self.out / page)]

    def write(self, name: str, content: Mapping[str, Any]) -> str:
        """A TOML file for one of the commands; its path."""
        path = self.out / "files" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(tomli_w.dumps(content), encoding="utf-8")
        return str(path)


Step = Callable[[Side, Side], list[str]]
"""Arguments of the command line, for a side; the old side's outputs are what both read."""

LEAK: Final = {"name": "thruster_leak:z3", "parameters": {"leak_n": 2e-4}}


def scenario(side: Side, effects: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Two biases of some 400 s and slews about all axes, at 1 Hz."""
    limits = {"rate_rad_s": 1.5e-3, "acceleration_rad_s2": 2.0e-5}
    turns = ((20.0, [1.0, 0.0, 0.0]), (220.0, [0.0, 1.0, 0.0]), (420.0, [0.0, 0.0, 1.0]))
    slews = [{"start_s": at, "axis": axis, "angle_rad": 0.12, **limits} for at, axis in turns]
    rates = [-200.0, 300.0, 250.0], [150.0, -100.0, -50.0], [-300.0, 200.0, 250.0]
    biases = [
        {
            "id": name,
            "kind": "bias",
            "epoch": datetime(2010, month, 1, tzinfo=UTC),
            "from_rpm": rates[place],
            "to_rpm": rates[place + 1],
            "settle_s": 100.0,
        }
        for place, (name, month) in enumerate((("first", 5), ("second", 6)))
    ]
    quiet = {
        "id": "slews",
        "kind": "slew",
        "epoch": datetime(2010, 7, 1, tzinfo=UTC),
        "from_rpm": [500.0, -350.0, 420.0],
        "duration_s": 640.0,
        "slew": slews,
    }
    return {
        "spacecraft": {"name": "cassini", "branch": "B", "wheels": [1, 2, 4]},
        "truth": {"draw_from": side.input_of("telemetry_demo.toml")["priors"], "mass_kg": 2380.0},
        "start": {"attitude_spread": 1.0, "rate_rad_s": 2e-5},
        "telemetry": {
            "attitude_noise_rad": 2e-5,
            "rate_noise_rad_s": 2e-6,
            "wheel_noise_rpm": 0.2,
            "wheel_resolution_rpm": 0.0,
            "on_time_resolution_s": 0.001,
            "delta_v": "measured",
            "delta_v_noise_m_s": 1e-5,
        },
        "event": [*biases, quiet],
        "effect": list(effects),
    }


def simulate(name: str, effects: Sequence[Mapping[str, Any]]) -> Step:
    """Simulate the scenario with effects hidden in it."""

    def step(side: Side, old: Side) -> list[str]:
        del old
        path = side.write(f"{name}.toml", scenario(side, effects))
        return ["simulate", path, "--out", str(side.out / name / "events"), "--seed", "7"]

    return step


def fit_telemetry(side: Side, old: Side) -> list[str]:
    """A bias and slews as telemetry, another bias as a totals row, in one posterior."""
    events = old.out / "simulated" / "events"
    chosen = [str(events / "first"), str(events / "slews"), f"{events / 'totals.csv'}:second"]
    priors = side.input_of("telemetry_demo.toml")["priors"]
    where = ["--priors", priors, "--source", "simulation", "--out", str(side.out / "telemetry/run")]
    return ["fit", *chosen, *where]


def diagnose_telemetry(side: Side, old: Side) -> list[str]:
    """Three events with a leak."""
    events = old.out / "leaking" / "events"
    chosen = [str(events / name) for name in ("first", "second", "slews")]
    priors = side.input_of("telemetry_demo.toml")["priors"]
    return ["diagnose", *chosen, "--priors", priors, "--out", str(side.out / "diagnosis/run")]


def diagnose_totals(side: Side, old: Side) -> list[str]:
    """The flight biases as totals rows."""
    del old
    own = side.input_of("flight_2009_2010.toml")
    where = ["--priors", own["priors"], "--out", str(side.out / "published/totals")]
    return ["diagnose", *own["events"], *where]


def diagnose_published(side: Side, old: Side) -> list[str]:
    """Printed thrusts, test bed, A branch and on-times."""
    del old
    return ["diagnose-published", *side.page_at("published/page")]


def flight_file(side: Side) -> str:
    """The flight run with few draws."""
    sampler = {"ensembles": 2, "target_ess": 400, "first_check": 100, "seed": 20_100_329}
    output = {"report": False, "draws_per_ensemble": 1_000, "prior_draws": 1_000}
    own = side.input_of("flight_2009_2010.toml")
    return side.write("flight.toml", {**own, "sampler": sampler, "output": output})


def run_flight(side: Side, old: Side) -> list[str]:
    """The eight flight biases."""
    del old
    return ["run", flight_file(side), "--out", str(side.out / "flight/run")]


def sweep(side: Side, old: Side) -> list[str]:
    """Some priors of the old side's flight run changed, and events left out, by weights.

    A sweep writes its own folder, ``sweep``, beside the fit.
    """
    shutil.copy(old.out / "flight/run/fit.nc", side.out)
    content = {
        "quantities": ["thrust_level_n", "thrust_common_n", "tau_fall_s"],
        "blocks": ["centre of mass", "tail-off"],
        "refit": "never",
        "draws": 1_000,
        "grid": {"widths": [0.5, 2.0], "shifts": [1.0], "families": ["student-t"], "events": True},
    }
    spec = ["--spec", side.write("sweep.toml", content)]
    options = ["--fit", str(side.out), "--jobs", "1", "--no-report"]
    return ["sweep", flight_file(side), *spec, *options]


def leave_one_out(side: Side, old: Side) -> list[str]:
    """Four of the flight biases, each predicted from the others."""
    del old
    own = side.input_of("flight_2009_2010.toml")
    header, *rows = Path(own["events"][0]).read_text(encoding="utf-8").splitlines()
    kept = list(dict.fromkeys(row.split(",")[0] for row in rows))[:4]
    path = side.out / "files" / "four.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    few = [row for row in rows if row.split(",")[0] in kept]
    path.write_text("\n".join([header, *few]) + "\n", encoding="utf-8")
    where = [*side.page_at("prediction/leave_one_out/page.md"), "--events", str(path)]
    return ["calibrate", "prediction", *where, "--priors", own["priors"]]


def predict(side: Side, old: Side) -> list[str]:
    """A bias to come, from the old side's flight run."""
    own = side.input_of("flight_2009_2010.toml")
    bias = "rwa1: -1118 -> 626, rwa2: 1290 -> 1300, rwa4: 330 -> -729"
    fit = ["--fit", str(old.out / "flight/run/fit.nc"), "--events", own["events"][0]]
    where = ["--priors", own["priors"], "--out", str(side.out / "prediction/next")]
    return ["predict", *fit, "--bias", bias, *where]


PARTS: Final[Mapping[str, Sequence[Step]]] = {
    "simulated": (simulate("simulated", ()),),
    "leaking": (simulate("leaking", (LEAK,)),),
    "telemetry": (fit_telemetry,),
    "diagnosis": (diagnose_telemetry,),
    "flight": (run_flight,),
    "sweep": (sweep,),
    "prediction": (predict, leave_one_out),
    "published": (diagnose_totals, diagnose_published),
}
NEEDS: Final = {
    "telemetry": ("simulated",),
    "diagnosis": ("leaking",),
    "sweep": ("flight",),
    "prediction": ("flight",),
}


def chosen_parts(only: str) -> list[str]:
    """Parts by name with what they need, in order; all by default."""
    names = [name.strip() for name in only.split(",") if name.strip()] or list(PARTS)
    unknown = [name for name in names if name not in PARTS]
    if unknown:
        raise SystemExit(f"--only: {', '.join(unknown)}: not among {', '.join(PARTS)}")
    wanted = {*names, *(need for name in names for need in NEEDS.get(name, ()))}
    return [name for name in PARTS if name in wanted]


def compare_sides(sides: Sequence[Side], parts: Sequence[str], log: Log) -> Comparison:
    """Run all commands of the parts on both sides, side by side, and compare what they wrote."""
    old, new = sides
    commands = Commands()
    findings: dict[str, list[Finding]] = {}
    pages: list[str] = []
    used: dict[str, tuple[Used, Used]] = {}
    with ThreadPoolExecutor(2) as pool:
        try:
            for part in parts:
                findings[part] = []
                for number, step in enumerate(PARTS[part]):
                    label = part if len(PARTS[part]) == 1 else f"{part} {number + 1}"
                    asked = [step(side, old) for side in sides]
                    log(f"{label}: cassini-bayes {asked[0][0]} …")
                    jobs = [
                        pool.submit(_run, commands, side, arguments, label)
                        for side, arguments in zip(sides, asked, strict=True)
                    ]
                    used[label] = jobs[0].result(), jobs[1].result()
                    findings[part] += _statuses(label, sides, used[label])
                folders = old.out / part, new.out / part
                roots = [side_root for side in sides for side_root in (side.code, side.out)]
                compared = compare_folders(part, *folders, roots)
                pages += differing_pages(part, *folders, roots)
                findings[part] += compared
                _tell(part, findings[part], used, log)
        except BaseException:
            commands.stop()
            raise
    return Comparison(findings, pages, used)


def _tell(
    part: str, found: Sequence[Finding], used: Mapping[str, tuple[Used, Used]], log: Log
) -> None:
    apart = sum(own.verdict != "equal" for own in found)
    took = [own for label, own in used.items() if label.split(" ")[0] == part]
    times = [
        f"{name} {sum(own[i].wall_s for own in took):.0f} s, "
        f"processor {sum(own[i].cpu_s for own in took):.0f} s"
        for i, name in enumerate((OLD, NEW))
    ]
    told = f"{apart} of {len(found)} variables not equal" if apart else f"{len(found)} equal"
    log(f"{part}: {told} ({'; '.join(times)})")


def _run(commands: Commands, side: Side, arguments: Sequence[str], label: str) -> Used:
    command = [sys.executable, "-m", "cassini_bayes", *arguments]
    return commands.run(command, side.code, _log(side, label), side.core)


def _log(side: Side, label: str) -> Path:
    return side.out / "logs" / f"{label.replace(' ', '_')}.log"


def _statuses(label: str, sides: Sequence[Side], used: tuple[Used, Used]) -> list[Finding]:
    """Exit statuses: 0, or 1 (not converged, a check failed) on both sides, without a traceback."""
    found = []
    for side, own in zip(sides, used, strict=True):
        text = _log(side, label).read_text(errors="replace")
        if own.status not in (0, 1) or own.status != used[0].status or TRACEBACK in text:
            last = [line for line in text.splitlines() if line][-1:]
            note = f"{side.name} ended with {own.status}: {' '.join(last)[:300]}"
            found.append(Finding(STATUS, label, "different", note=note))
    return found or [Finding(STATUS, label, "equal")]


# Worktrees.


def git(*arguments: str) -> str:
    """Output of a git command in this repository."""
    done = subprocess.run(  # noqa: S603 (git, by name)
        ["git", "-C", str(ROOT), *arguments],  # noqa: S607
        check=True,
        capture_output=True,
        text=True,
    )
    return done.stdout.strip()


@contextmanager
def worktrees(commits: Sequence[str], work: Path) -> Iterator[list[Path]]:
    """Temporary worktrees of some commits, removed whatever happens."""
    found: list[Path] = []
    try:
        for place, commit in enumerate(commits):
            path = work / (OLD, NEW)[place] / "code"
            path.parent.mkdir(parents=True, exist_ok=True)
            found.append(path)
            git("worktree", "add", "--quiet", "--detach", str(path), commit)
        yield found
    finally:
        for path in found:
            with suppress(
                subprocess.CalledProcessError
            ):  # one that was not finished is no worktree
                git("worktree", "remove", "--force", str(path))


def check_code(side: Side) -> None:
    """Make sure that a side's processes find the package in its worktree."""
    log = side.out / "logs" / "where.log"
    command = [sys.executable, "-c", "import cassini_bayes; print(cassini_bayes.__file__)"]
    Commands().run(command, side.code, log, None)
    where = log.read_text(errors="replace").strip()
    if not where.startswith(str(side.code)):
        raise SystemExit(f"{side.name}: the package is found at {where}, not in {side.code}")


def _end(number: int, frame: object) -> None:
    del frame
    raise SystemExit(128 + number)


def main() -> None:
    """Compare two commits; print the table, and write the page if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", help="commit that is right")
    parser.add_argument("new", help="commit to compare with it")
    parser.add_argument("--out", type=Path, help="folder for the page (comparison.md)")
    parser.add_argument("--only", default="", help=f"some of {','.join(PARTS)}")
    parser.add_argument("--keep", type=Path, help="folder in which to keep what both wrote")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, _end)
    parts = chosen_parts(options.only)
    began = time.monotonic()

    def log(text: str) -> None:
        print(f"[{time.monotonic() - began:6.1f} s] {text}", flush=True)

    commits = [git("rev-parse", "--verify", f"{c}^{{commit}}") for c in (options.old, options.new)]
    cores = sorted(os.sched_getaffinity(0))
    work = Path(tempfile.mkdtemp(prefix="compare-commits-")).resolve()
    try:
        with worktrees(commits, work) as codes:
            sides = [
                Side(name, code, work / name / "out", cores[place % len(cores)])
                for place, (name, code) in enumerate(zip((OLD, NEW), codes, strict=True))
            ]
            for side in sides:
                check_code(side)
            log(f"{OLD} {commits[0][:10]}, {NEW} {commits[1][:10]}: {', '.join(parts)}")
            result = compare_sides(sides, parts, log)
    finally:
        if options.keep is not None:
            for name in (OLD, NEW):
                shutil.copytree(work / name / "out", options.keep / name, dirs_exist_ok=True)
        shutil.rmtree(work, ignore_errors=True)
    print(f"\n{plain_table(table(result))}\n")
    lines = details(result)
    for line in lines[:TELLING]:
        print(line)
    if len(lines) > TELLING:
        print(f"… and {len(lines) - TELLING} more")
    for name in result.pages:
        print(f"page or figure that differs: {name}")
    print(sentence(result))
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        path = options.out / "comparison.md"
        path.write_text(page(result, commits[0][:10], commits[1][:10]), encoding="utf-8")
        print(path)
    log("done")
    sys.exit(0 if result.agrees else 1)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
