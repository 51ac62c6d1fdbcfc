"""Time of a diagnosis over the whole catalogue, as a user runs it: three and six events, two cores.

``cassini-bayes diagnose`` in a process of its own, from event folders to the written report, with
held-out gain: wall time, processor seconds and the load of the machine. With nothing hidden (most
causes lie near the best and are sampled), with faults of several kinds (a second cause is looked
for), one that bends the baseline to its walls, two at once, and one that is in no catalogue.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from speed.problem import PRIORS, event_folders

from cassini_bayes import __version__
from cassini_bayes.files.storage import write_text

HIDDEN: dict[str, list[dict[str, Any]]] = {
    "nothing": [],
    "a leak of 0.1 mN": [{"name": "thruster_leak:z3", "parameters": {"leak_n": 1.0e-4}}],
    "a leak of 0.4 mN": [{"name": "thruster_leak:z3", "parameters": {"leak_n": 4.0e-4}}],
    "a tail-off of 0.12 s": [{"name": "tail_off", "parameters": {"tau_fall_s": 0.12}}],
    "Z2 at 70 %": [{"name": "thruster_degraded:z2", "parameters": {"thrust_factor": 0.7}}],
    "an inertia of 84 %": [{"name": "inertia:xx", "parameters": {"inertia_xx_kg_m2": 5_500.0}}],
    "an oscillation of 0.05 Hz": [
        {
            "name": "flexible_mode",
            "parameters": {
                "frequency_hz": 0.05,
                "damping": 0.01,
                "inertia_fraction": 0.02,
                "amplitude_rad_s": 2.0e-5,
                "axis": 2,
            },
        }
    ],
    "a leak of 0.03 mN and a tail-off of 0.09 s": [
        {"name": "thruster_leak:z3", "parameters": {"leak_n": 3.0e-5}},
        {"name": "tail_off", "parameters": {"tau_fall_s": 0.09}},
    ],
    "a tachometer's scale that grows with speed": [
        {"name": "tachometer_scale", "parameters": {"slope_per_rpm": 1.0e-5}}
    ],
}
SETS = {
    "three": ("bias-1", "bias-2", "slews"),
    "six": (*(f"bias-{i}" for i in range(1, 6)), "slews"),
}
GOALS_S = {"three": 15.0, "six": 60.0}


def main() -> None:
    """Time the diagnoses chosen and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", type=Path, default=Path("build/speed/diagnosis.md"))
    parser.add_argument("--parts", type=Path, default=Path("build/speed/diagnosis"))
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    rows = []
    for hidden, effects in HIDDEN.items():
        folder = options.parts / slug(hidden)
        folders = event_folders(folder, len(SETS["six"]) - 1, effects)
        for name, events in SETS.items():
            chosen = [own for own in folders if own.name in events]
            each = [row(name, hidden, chosen, options.parts) for _ in range(options.repeats)]
            rows.append(middle(each))
            print(rows[-1], flush=True)
    write_text(options.page, page(rows, options.repeats))


def slug(words: str) -> str:
    """Words as the name of a folder."""
    return re.sub(r"[^a-z0-9.]+", "-", words.lower())


def middle(each: list[dict[str, Any]]) -> dict[str, Any]:
    """The repeat of median wall time, with the range of all."""
    ordered = sorted(each, key=lambda row: row["wall_s"])
    ends = {"least_s": ordered[0]["wall_s"], "most_s": ordered[-1]["wall_s"]}
    return ordered[len(ordered) // 2] | ends


def row(name: str, hidden: str, folders: list[Path], parts: Path) -> dict[str, Any]:
    """Time one diagnosis."""
    out = parts / f"{name}-{slug(hidden)}"
    command = [sys.executable, "-m", "cassini_bayes", "diagnose", *map(str, folders)]
    command += ["--priors", str(PRIORS), "--out", str(out), "--force", "--quiet"]
    load = os.getloadavg()[0]
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)  # noqa: S603 (our own command)
    wall = time.perf_counter() - began
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    return {
        "events": name,
        "hidden": hidden,
        "wall_s": wall,
        "cpu_s": now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime,
        "load": load,
        "first": found["causes"][0]["name"],
        "probability": found["causes"][0]["probability"],
    }


def _met(row: dict[str, Any]) -> str:
    return "yes" if row["wall_s"] <= GOALS_S[row["events"]] else "no"


def _range(row: dict[str, Any]) -> str:
    """Of repeats, where there were some."""
    ends = row["least_s"], row["most_s"]
    return "" if ends[0] == ends[1] else f" ({ends[0]:.1f}-{ends[1]:.1f})"


def _often(repeats: int) -> str:
    return "once" if repeats == 1 else f"{repeats} times: the median, and the range in brackets"


def page(rows: list[dict[str, Any]], repeats: int) -> str:
    """The results page."""
    lines = [
        f"| {row['events']} | {row['hidden']} | {row['first']} ({row['probability']:.3f}) |"
        f" {row['wall_s']:.1f}{_range(row)} |"
        f" {row['cpu_s']:.0f} | {row['load']:.1f} |"
        f" {GOALS_S[row['events']]:.0f}: {_met(row)} |"
        for row in rows
    ]
    return f"""# Speed of a diagnosis

How long does `cassini-bayes diagnose` take over the whole catalogue? From event folders at 1 Hz
(biases of 790 to 1,200 rows, a slew set of 3,601) to the report, as a process of its own: start,
held-out gain and figures are included, compiled code comes from the cache. {os.cpu_count()}
cores; version {__version__}. Each was run {_often(repeats)}.
Goals are those for all that may be hidden: 15 s for three events, 60 s for six.
*Load* is that of the machine before the start, which what ended a minute ago still counts in.

| events | hidden | first cause (its probability) | wall (s) | processor (s) | load | goal (s) |
| --- | --- | --- | --- | --- | --- | --- |
{chr(10).join(lines)}

Made by `python benchmarks/diagnosis_speed.py --page docs/results/diagnosis-speed.md`.
"""


if __name__ == "__main__":
    main()
