"""How fast telemetry is fitted: from data to effective draws, against four other samplers.

Ratios in one run, as a page with tables and a figure. Parts that are finished are kept
(``--parts``), so that a run can be taken up again or one part repeated: delete its file. Of the
other samplers (benchmarks/README.md) those that are not installed are left out. Everything runs on
one core; times are processor time where a busy machine would spoil wall time, and say so.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from speed import own, page, reduction
from speed.peers import PEERS, peer_row
from speed.problem import ROOT, event_folders, reduced_events

from cassini_bayes import __version__
from cassini_bayes.computing.arrays import joined
from cassini_bayes.files.storage import write_text

Row = dict[str, Any]
LONG = ("reduction-long", "reduction-file")  # minutes each, so kept until asked for again
PACKAGES = ("emcee", "zeus-mcmc", "dynesty", "nautilus-sampler", "numpy")


def main() -> None:
    """Run the parts that are not finished, then write the page."""
    options = read_options()
    if options.core is not None:
        os.sched_setaffinity(0, {options.core})
    folders = event_folders(options.parts / "events")
    if options.anew:
        for path in options.parts.glob("*.json"):
            if options.long or path.stem not in LONG:
                path.unlink()
    for name, work in parts(folders, options).items():
        if options.only and not any(name.startswith(wanted) for wanted in options.only):
            continue
        path = options.parts / f"{name}.json"
        if path.exists():
            continue
        print(f"== {name}", flush=True)
        rows = work()
        write_text(path, json.dumps({"circumstances": circumstances(), "rows": rows}, indent=1))
        for row in rows:
            print("  ", json.dumps(row, default=str), flush=True)
    found = {
        path.stem: json.loads(path.read_text()) for path in sorted(options.parts.glob("*.json"))
    }
    target = options.page or options.parts / "speed.md"
    page.write(target, found, options.quick, options.note)
    print(f"page: {target}")


def read_options() -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="short runs, to see that all works")
    parser.add_argument("--anew", action="store_true", help="measure finished parts again, too")
    parser.add_argument("--page", type=Path, help="the .md file (default: with the parts)")
    parser.add_argument("--note", default="", help="a sentence for the head of the page")
    parser.add_argument("--parts", type=Path, default=None, help="folder of finished parts")
    parser.add_argument("--only", nargs="*", default=[], help="parts whose names begin like this")
    parser.add_argument("--core", type=int, default=None, help="run on this processor core alone")
    parser.add_argument("--budget", type=float, default=60.0, help="seconds for each peer")
    parser.add_argument("--steps", type=int, default=5_000, help="most steps of the whole fits")
    parser.add_argument("--long", action="store_true", help="1e8 rows and a 10 GB file as well")
    options = parser.parse_args()
    if options.parts is None:
        options.parts = ROOT / "build" / ("speed-quick" if options.quick else "speed")
    if options.quick:
        options.budget = min(options.budget, 3.0)
    return options


def parts(folders: list[Path], options: argparse.Namespace) -> dict[str, Callable[[], list[Row]]]:
    """Every part of the benchmark by name, in order."""
    quick = options.quick
    chosen: dict[str, Callable[[], list[Row]]] = {
        "calls-samples": partial(samples_part, folders, quick),
        "calls-events": partial(events_part, folders, quick),
        "reduction": partial(reduction_part, folders, options),
        "fit-one": lambda: [own.fit_row(folders[:1], "one bias", options.steps, quick)],
        "fit-seven": lambda: [
            own.fit_row(folders, "six biases and a slew set", options.steps, quick)
        ],
    }
    if options.long:
        scratch = options.parts / "scratch"
        chosen["reduction-long"] = lambda: [reduction.reduce_row(folders[0], 10**8)]
        chosen["reduction-file"] = lambda: [reduction.file_row(folders[-1], 1e10, scratch)]
    missing = [name for name in PEERS if importlib.util.find_spec(name) is None]
    if missing:
        print(f"not installed, left out (benchmarks/README.md): {', '.join(missing)}")
    for noise in (True, False):
        suffix = "noise" if noise else "white"
        chosen[f"own-{suffix}"] = partial(own_part, folders, noise, options)
        for name in PEERS:
            if name not in missing:
                chosen[f"peer-{suffix}-{name}"] = partial(peer_part, name, noise, folders, options)
    return chosen


def own_part(folders: list[Path], noise: bool, options: argparse.Namespace) -> list[Row]:
    """Our sampler on its own likelihood; its draws are the reference for the others."""
    row, draws = own.sampler_row(folders[:1], noise)
    np.save(reference_path(options.parts, noise), draws)
    return [row]


def reference_path(folder: Path, noise: bool) -> Path:
    """Where reference draws lie."""
    return folder / f"reference-{'noise' if noise else 'white'}.npy"


def peer_part(
    name: str, noise: bool, folders: list[Path], options: argparse.Namespace
) -> list[Row]:
    """One other sampler on the same posterior."""
    reference = np.load(reference_path(options.parts, noise))
    return [peer_row(name, noise, folders, options.budget, reference)]


def samples_part(folders: list[Path], quick: bool) -> list[Row]:
    """Time of a likelihood call against the number of samples."""
    event = reduced_events(folders[:1])[0]
    samples = joined(tuple(event.rows))
    counts = [1_000, 10_000] if quick else [1_000, 10_000, 100_000, 1_000_000]
    return own.sample_growth(event, samples, counts, 3 if quick else 41)


def events_part(folders: list[Path], quick: bool) -> list[Row]:
    """Time of a likelihood call against the number of joint events."""
    (event,) = reduced_events(folders[:1])
    counts = [1, 2, 4] if quick else [1, 2, 4, 8, 16, 32, 64]
    return own.event_growth(event, counts, 3 if quick else 5)


def reduction_part(folders: list[Path], options: argparse.Namespace) -> list[Row]:
    """Rows per second, and memory, of reading and of reducing."""
    scratch = options.parts / "scratch"
    if options.quick:
        return [
            reduction.reading_row(folders[0], 20_000, scratch),
            reduction.reduce_row(folders[0], 20_000),
        ]
    return [
        reduction.reading_row(folders[0], 1_000_000, scratch),
        reduction.reduce_row(folders[0], 10**6),
        reduction.reduce_row(folders[0], 10**7),
    ]


def circumstances() -> Row:
    """What a figure depends on."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "version": __version__,
        "python": platform.python_version(),
        "processor": processor(),
        "load": os.getloadavg()[0],
        "cores": os.cpu_count(),
        "date": time.strftime("%Y-%m-%d"),
        "packages": versions,
    }


def processor() -> str:
    """Name of the processor."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.machine()


if __name__ == "__main__":
    main()
