"""Feed damaged files to every reader: each is taken or refused in one line, at once.

``python tests/fuzz --long`` runs 100,000 of them, ``--page FILE`` writes the count.
Every input has a random stream of its own, given by the seed, the reader and its number: a fault
names them, and ``--reader NAME --only NUMBER`` makes that input again.
"""

from __future__ import annotations

import argparse
import platform
import signal
import sys
import time
import traceback
import warnings
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from mutations import NUMBERS, OF, mutated
from readers import Good, good_files

from cassini_bayes.errors import CassiniBayesError

SHORT: Final = 1_000
LONG: Final = 100_000
MOST_SECONDS: Final = 2.0
"""Of processor time for one input."""
MOST_CHARACTERS: Final = 2_000
COST_MS: Final = {
    "priors": 40.0,
    "resolved": 30.0,
    "provenance": 30.0,
    "fit": 20.0,
    "fit without seal": 100.0,
    "beliefs": 10.0,
    "checked telemetry": 300.0,
    "stored run": 150.0,
    "HDF5": 400.0,
    "MATLAB": 400.0,
}
"""Readers that take longer than a few milliseconds get fewer inputs."""
USUAL_MS: Final = 4.0


class TooSlowError(BaseException):
    """An input took more than its time; no ``except Exception`` may swallow it."""


@dataclass
class Tally:
    """What became of a reader's inputs."""

    taken: int = 0
    refused: int = 0
    longest_s: float = 0.0
    longest: str = "0"
    faults: list[str] = field(default_factory=list)


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Stop what takes more processor time than this, were it for ever."""

    def ring(*_: object) -> None:
        raise TooSlowError

    earlier = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, earlier)


def shares(names: Sequence[str], number: int) -> dict[str, int]:
    """Inputs of each reader: the same time for each, but at least a hundredth of all."""
    weight = {name: 1.0 / max(COST_MS.get(name, 0.0), USUAL_MS) for name in names}
    total = sum(weight.values())
    return {name: max(number // 100, round(number * weight[name] / total)) for name in names}


def damaged(good: Good, seed: int, number: int) -> bytes:
    """One input."""
    rng = np.random.default_rng([seed, zlib.crc32(good.reader.encode()), number])
    choices = NUMBERS if good.reader.startswith("checked") else OF[good.door.suffix]
    return mutated(good.content, choices, rng)


def feed(good: Good, content: bytes, tally: Tally, label: str) -> None:
    """Read one input and count what became of it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / good.door.name
        path.write_bytes(content)
        began = time.process_time()
        try:
            # a warning would reach the user as two lines about this package's own code
            with within(MOST_SECONDS), warnings.catch_warnings():
                warnings.simplefilter("error")
                good.door.read(path)
            tally.taken += 1
        except CassiniBayesError as error:
            message = str(error)
            if message.isprintable() and len(message) <= MOST_CHARACTERS:
                tally.refused += 1
            else:
                tally.faults.append(f"{label}: a message that is no line: {message[:200]!r}")
        except TooSlowError:
            tally.faults.append(f"{label}: more than {MOST_SECONDS:g} s")
        except Exception as error:  # noqa: BLE001 (what the fuzzer is for)
            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(last.filename).name}:{last.lineno}"
            tally.faults.append(f"{label}: {type(error).__name__} at {place}: {error}"[:300])
        took_s = time.process_time() - began
        if took_s > tally.longest_s:
            tally.longest_s, tally.longest = took_s, label


def fuzz(seed: int, number: int, tell: bool = False) -> dict[str, Tally]:
    """Feed ``number`` inputs to all readers together."""
    tallies = {}
    goods = good_files()
    for name, share in shares(list(goods), number).items():
        tally = tallies[name] = Tally()
        feed(goods[name], goods[name].content, Tally(), name)  # what is compiled or imported once
        for i in range(share):
            feed(goods[name], damaged(goods[name], seed, i), tally, f"{name} {i}")
        if tell:
            sys.stdout.write(line_of(name, tally) + "\n")
            sys.stdout.writelines(f"    {fault}\n" for fault in tally.faults[:20])
            sys.stdout.flush()
    return tallies


def line_of(name: str, tally: Tally) -> str:
    """A row of the page."""
    inputs, number = tally.taken + tally.refused + len(tally.faults), tally.longest.split()[-1]
    return (
        f"| {name} | {inputs:,} | {tally.taken:,} | {tally.refused:,} | {len(tally.faults)} |"
        f" {tally.longest_s:.2f} ({number}) |"
    )


def page_of(tallies: dict[str, Tally], seed: int, command: str) -> str:
    """The count as a page."""
    inputs = sum(tally.taken + tally.refused for tally in tallies.values())
    faults = [fault for tally in tallies.values() for fault in tally.faults]
    lines = [
        "# Damaged files",
        "",
        f"{inputs + len(faults):,} damaged files, fed to every reader of the package (its tests'",
        "`tests/fuzz/readers.py`): bytes changed, cut out and doubled, lines and columns moved,",
        "cells, keys, values and numbers replaced, one to three at a time. Each has to be taken,",
        "or refused in one line by an error of the package, within"
        f" {MOST_SECONDS:g} s of processor time;",
        "a warning of a library counts as a fault.",
        "",
        f"**{len(faults)} faults; the longest took"
        f" {max(t.longest_s for t in tallies.values()):.2f} s.**",
        "",
        "| reader | inputs | taken | refused | faults | longest, s (its number) |",
        "| --- | --- | --- | --- | --- | --- |",
        *(line_of(name, tally) for name, tally in tallies.items()),
        "",
        *(f"* {fault}" for fault in faults),
        ""
        if faults
        else "`telemetry` and `totals` are readers; `checked …` are the checks of"
        " [mistakes](../topics/plausibility.md) behind them.",
        "",
        f"`{command}`, seed {seed}, Python {platform.python_version()}, numpy {np.__version__}.",
        "",
    ]
    return "\n".join(lines)


def main() -> int:
    """Run from a shell."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--long", action="store_true", help=f"{LONG:,} inputs")
    parser.add_argument("--number", type=int, default=SHORT, help="how many inputs otherwise")
    parser.add_argument("--seed", type=int, default=20_261_122)
    parser.add_argument("--page", type=Path, help="where the count is written")
    parser.add_argument("--reader", help="one input of this reader alone")
    parser.add_argument("--only", type=int, default=0, help="its number")
    given = parser.parse_args()
    if given.reader:
        good, tally = good_files()[given.reader], Tally()
        content = damaged(good, given.seed, given.only)
        sys.stdout.buffer.write(content + b"\n")
        feed(good, content, tally, f"{given.reader} {given.only}")
        sys.stdout.write(f"{tally}\n")
        return len(tally.faults)
    tallies = fuzz(given.seed, LONG if given.long else given.number, tell=True)
    if given.page:
        command = " ".join(["python", "tests/fuzz", *sys.argv[1:]])
        given.page.write_text(page_of(tallies, given.seed, command))
    return min(1, sum(len(tally.faults) for tally in tallies.values()))
