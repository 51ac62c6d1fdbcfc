"""How clear what Basilisk's flights hide is to the package's linear oracle, and what is as likely.

``basilisk_closed_loop.py`` flies with none of the package's physics, and its own σ knows nothing of
what coarse counters leave open. This one reads trials that kept their telemetry (``--keep``) and
adds to the record of each that hides one catalogued effect what
:mod:`cassini_bayes.studies.blind.recorded` says: σ = √(δᵀV⁻¹δ) with V of the trial's conditions,
and the group of causes that the oracle, not the diagnosis, cannot tell apart. Trials that have it
are not done again. ``basilisk_closed_loop.py --summary`` then counts by it.

It needs the package's environment and no Basilisk.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import asdict
from pathlib import Path

from closed_loop import answers, trials

from cassini_bayes.diagnosis.read import read_events
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import MISTAKES, Policy
from cassini_bayes.studies.blind.recorded import Told, what_can_be_told

UNNAMED = "uncatalogued"


def is_asked(record: answers.Record) -> bool:
    """Whether a trial hides one catalogued effect and has not been asked about yet."""
    return "oracle" not in record and len(record["hidden"]) == 1 and record["stratum"] != UNNAMED


def told(record: answers.Record, folder: Path) -> Told:
    """What the oracle says of a trial."""
    hidden = record["hidden"][0]
    flown = [str(folder / f"{i + 1}-{e}") for i, e in enumerate(record["conditions"]["events"])]
    events = read_events(flown, folder / "priors.toml", policy=Policy(frozenset(MISTAKES)))
    return what_can_be_told(events, hidden["name"], hidden["parameters"], record["baseline"])


def main() -> int:
    """Ask about all trials of a folder; exit status 1 where there are none."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the trials")
    out = parser.parse_args().out
    records = answers.read(out)
    if not records:
        print(f"no trials in {out}: expected numbered JSON files of --trials", file=sys.stderr)
        return 1
    for record in filter(is_asked, records):
        name = f"{record['index']:05d}"
        folder = out / name / "record"
        if not folder.is_dir():
            print(f"{name}: no telemetry was kept (--keep): left as it is", file=sys.stderr)
            continue
        began = time.monotonic()
        try:
            answer = told(record, folder)
        except InputError as refusal:
            print(f"{name}: {refusal}", file=sys.stderr)
            continue
        trials.write({**record, "oracle": asdict(answer)}, out / f"{name}.json")
        hidden = record["hidden"][0]
        size = "no size of its own" if answer.sigma is None else f"{answer.sigma:.1f} σ"
        spent = time.monotonic() - began
        print(
            f"{name} {hidden['name']} ({hidden['sigma']:.1f} σ): {size}; "
            f"{', '.join(answer.group)}; in {spent:.0f} s"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
