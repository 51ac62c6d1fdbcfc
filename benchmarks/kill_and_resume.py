"""Kill one run with SIGKILL at ten random moments, resume it each time, and compare its draws.

Shows that a run that was killed in its warm start, while sampling and while writing its results
ends with the draws, bit for bit, of a run left alone; a table says where each kill fell. The
moments are random (``--seed``) within those three stages, whose lengths the uninterrupted run
gives. The check works in a folder of its own with a copy of the package, so that editing the code
meanwhile disturbs nothing; started again, it keeps the uninterrupted run it has already made.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import numpy as np
import tomli_w

from cassini_bayes import __version__
from cassini_bayes.files.storage import is_leftover, write_text
from cassini_bayes.results.record import GROUPS, read_fit

ROOT = Path(__file__).parents[1]
STAGES = ("warm start", "sampling", "writing results")
# What a run says on standard error when a stage begins, and at its end.
BEGINS = ("collapsed parameters", "warm start: log evidence", "drawing thrusts back")
ENDS = re.compile(r"\] (NOT CONVERGED|converged) in")
POLL_S = 0.002
PATIENCE_S = 1_800.0


class Child(Protocol):
    """A started run: its process, and whether it has ended."""

    @property
    def pid(self) -> int:
        """Process id."""

    def poll(self) -> int | None:
        """Exit status; None while it runs."""

    def wait(self) -> int:
        """Exit status, once it has ended."""


Start = Callable[[Sequence[str], Path], Child]
"""Start ``cassini-bayes`` with arguments, its output going to a file."""


@dataclass(frozen=True)
class Kill:
    """One kill: when it was meant, and what was found afterwards."""

    stage: str  # it fell in, by what the run had printed
    delay_s: float  # after the first line of the stage that was aimed at
    last_line: str
    blocks: int
    has_fit: bool
    leftovers: int


@dataclass(frozen=True)
class Comparison:
    """The killed run against the one left alone."""

    kills: tuple[Kill, ...]
    variables: int
    different: tuple[str, ...]
    posterior_sha256: tuple[str, str]  # left alone, killed
    same_summary: bool

    @property
    def identical(self) -> bool:
        """Whether every array of fit.nc and the summary agree bit for bit."""
        return not self.different and self.same_summary


def stage_lengths(log: str) -> tuple[float, ...]:
    """Seconds of each stage, from the times a run prints at the head of its lines."""
    times: list[float] = []
    for line in log.splitlines():
        wanted = BEGINS[len(times)] if len(times) < len(BEGINS) else None
        if (wanted and wanted in line) or (wanted is None and ENDS.search(line)):
            times.append(float(line[1:].split(" s]")[0]))
    if len(times) != len(BEGINS) + 1:
        raise RuntimeError(f"a run should print {len(BEGINS) + 1} such lines:\n{log}")
    return tuple(later - earlier for earlier, later in pairwise(times))


def kill_once(
    start: Start, arguments: Sequence[str], folder: Path, log: Path, stage: int, delay_s: float
) -> Kill | None:
    """Start or resume, SIGKILL ``delay_s`` into a stage; None when the run ended before."""
    child = start(_command(arguments, folder), log)
    give_up = time.monotonic() + PATIENCE_S
    while BEGINS[stage] not in log.read_text():
        if child.poll() is not None:
            return None
        if time.monotonic() > give_up:
            os.kill(child.pid, signal.SIGKILL)
            raise RuntimeError(f"waited in vain for {BEGINS[stage]!r}")
        time.sleep(POLL_S)
    time.sleep(delay_s)
    if child.poll() is not None:
        return None
    os.kill(child.pid, signal.SIGKILL)
    status = child.wait()
    if status != -signal.SIGKILL:
        return None
    text = log.read_text()
    lines = text.splitlines()
    reached = max(i for i, begin in enumerate(BEGINS) if begin in text)
    return Kill(
        stage=STAGES[reached],
        delay_s=delay_s,
        last_line=lines[-1] if lines else "",
        blocks=len(list(folder.glob("checkpoint/block_*.npz"))),
        has_fit=(folder / "fit.nc").exists(),
        leftovers=sum(map(is_leftover, folder.rglob("*"))),
    )


def _command(arguments: Sequence[str], folder: Path) -> list[str]:
    resume = ["--resume"] if (folder / "resolved.toml").exists() else []
    return [*arguments, "--out", str(folder), *resume]


def kill_and_resume(
    start: Start,
    arguments: Sequence[str],
    work: Path,
    rng: np.random.Generator,
    kills: Sequence[int],
    log: Callable[[str], None],
    latest: float = 0.9,
) -> Comparison:
    """Run ``arguments`` once alone and once killed in the stages ``kills``; compare the results.

    ``kills`` are indices of :data:`STAGES`, in order; each falls within the share ``latest`` of its
    stage, as long as the run left alone took for it. ``work`` gets the folders ``alone`` and
    ``killed``.
    """
    alone, killed = work / "alone", work / "killed"
    if not (alone / "done").exists():
        shutil.rmtree(alone, ignore_errors=True)
        status = start(_command(arguments, alone), work / "alone.log").wait()
        if status not in (0, 1):
            raise RuntimeError((work / "alone.log").read_text())
        (alone / "done").write_text(str(status))
    lengths = stage_lengths((work / "alone.log").read_text())
    log("left alone: " + ", ".join(f"{s} {t:.1f} s" for s, t in zip(STAGES, lengths, strict=True)))
    shutil.rmtree(killed, ignore_errors=True)
    done: list[Kill] = []
    for number, stage in enumerate(kills):
        # Sampling goes on from the last block, so its later kills must not wait for all of it.
        share = 1.0 / kills.count(stage) if STAGES[stage] == "sampling" else 1.0
        delay = float(rng.uniform(0.0, latest * share * lengths[stage]))
        kill = None
        while kill is None:
            printed = work / f"kill_{number:02d}.log"
            kill = kill_once(start, arguments, killed, printed, stage, delay)
            delay /= 2.0  # the run had ended: a shorter wait is left of what it has to do
        log(f"kill {number + 1}: {kill.stage}, {kill.delay_s:.2f} s in, after {kill.last_line!r}")
        done.append(kill)
    status = start(_command(arguments, killed), work / "final.log").wait()
    if status != int((alone / "done").read_text()):
        raise RuntimeError((work / "final.log").read_text())
    return compare(alone, killed, tuple(done))


def compare(alone: Path, killed: Path, kills: tuple[Kill, ...]) -> Comparison:
    """Every array of both fit.nc, byte by byte, and both summaries."""
    one, other = read_fit(alone / "fit.nc"), read_fit(killed / "fit.nc")
    different, variables = [], 0
    sums = (hashlib.sha256(), hashlib.sha256())
    for group in GROUPS:
        names = set(map(str, one.groups[group].variables))
        for name in sorted(names | set(map(str, other.groups[group].variables))):
            variables += 1
            pair = [
                fit.groups[group][name].values if name in fit.groups[group].variables else None
                for fit in (one, other)
            ]
            content = [None if values is None else _content(values) for values in pair]
            if content[0] != content[1]:
                different.append(f"{group}/{name}")
            if group == "posterior":
                for total, part in zip(sums, content, strict=True):
                    total.update(part or b"")
    summaries = [(folder / "summary.csv").read_bytes() for folder in (alone, killed)]
    return Comparison(
        kills,
        variables,
        tuple(different),
        (sums[0].hexdigest(), sums[1].hexdigest()),
        summaries[0] == summaries[1],
    )


def _content(values: np.ndarray) -> bytes:
    numbers = values.dtype.kind in "fiub"
    body = values.tobytes() if numbers else "\0".join(map(str, values.reshape(-1))).encode()
    return f"{values.dtype} {values.shape} ".encode() + body


def start_process(code: Path) -> Start:
    """Start the command line in a process of its own, with the package found in ``code``."""

    def start(arguments: Sequence[str], log: Path) -> Child:
        environment: Mapping[str, str] = {
            **os.environ,
            "PYTHONPATH": str(code),
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        with log.open("wb") as stream:
            return subprocess.Popen(  # noqa: S603 (this package's own command line)
                # -P: not the package in the current folder
                [
                    sys.executable,
                    "-P",
                    "-c",
                    "from cassini_bayes.cli import main; main()",
                    *arguments,
                ],
                stdout=stream,
                stderr=stream,
                env=environment,
            )

    return start


def page(result: Comparison, command: str, seed: int, code_sha256: str) -> str:
    """The results page (Markdown)."""
    rows = [
        f"| {i} | {kill.stage} | {kill.delay_s:.2f} | {kill.blocks} | "
        f"{'yes' if kill.has_fit else 'no'} | {kill.leftovers} | {kill.last_line.strip()} |"
        for i, kill in enumerate(result.kills, 1)
    ]
    verdict = (
        f"All {result.variables} arrays of `fit.nc` (posterior, prior, predictive draws, log "
        "densities, data) and `summary.csv` are **identical bit for bit**."
        if result.identical
        else f"**DIFFERENT**: {', '.join(result.different) or 'summary.csv'}"
    )
    versions = ", ".join(f"{name} {_version(name)}" for name in ("numpy", "emcee", "scipy"))
    return "\n".join(
        [
            "# A run killed ten times and resumed",
            "",
            "One run of the eight flight events is killed with SIGKILL, resumed with `--resume`,",
            "killed again, and in the end compared with a run left alone. The moments are random",
            "within the warm start, the sampling and the writing of the results.",
            "",
            f"- command: `{command}`",
            f"- seed of the moments: {seed}",
            f"- package: cassini_bayes {__version__}, code SHA-256 `{code_sha256[:16]}…`",
            f"- versions: Python {platform.python_version()}, {versions}",
            "",
            verdict,
            "",
            f"- posterior of the run left alone, SHA-256: `{result.posterior_sha256[0]}`",
            f"- posterior of the killed run, SHA-256: `{result.posterior_sha256[1]}`",
            "",
            "Each row is what one kill left: the stage it fell in, seconds since the stage aimed",
            "at had begun, finished checkpoint blocks, whether `fit.nc` stood there complete,",
            "half-written temporary files (removed by `--resume`), and the last line printed.",
            "",
            "| kill | fell in | s | blocks | fit.nc | leftovers | last line |",
            "| --- | --- | --- | --- | --- | --- | --- |",
            *rows,
            "",
        ]
    )


def _version(name: str) -> str:
    from importlib.metadata import version

    return version(name)


def main() -> None:
    """Do the check on the flight run and print (and, if asked, write) its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, default=ROOT / "runs" / "flight_2009_2010.toml")
    parser.add_argument("--work", type=Path, default=ROOT / "runs" / "kill-and-resume")
    parser.add_argument("--seed", type=int, default=20_261_121)
    parser.add_argument("--page", type=Path, default=None)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    code = options.work / "code"
    if not code.exists():
        shutil.copytree(ROOT / "cassini_bayes", options.work / "copying" / "cassini_bayes")
        (options.work / "copying").rename(code)
    table = tomllib.loads(options.run.read_text())
    base = options.run.parent.resolve()
    table["events"] = [str(base / reference) for reference in table["events"]]
    table["priors"] = str(base / table["priors"])
    table["output"] = {**table.get("output", {}), "report": False}  # drawn from fit.nc, no draws
    run_file = options.work / "run.toml"
    write_text(run_file, tomli_w.dumps(table))
    result = kill_and_resume(
        start_process(code),
        ["run", str(run_file)],
        options.work,
        np.random.default_rng(options.seed),
        kills=(0, 0, 0, 1, 1, 1, 1, 2, 2, 2),
        log=lambda text: print(text, flush=True),
    )
    total = hashlib.sha256()
    for path in sorted(code.rglob("*.py")):
        total.update(path.read_bytes())
    parts = ["python benchmarks/kill_and_resume.py"]
    if options.page is not None:
        parts.append(f"--page {options.page}")
    text = page(result, " ".join(parts), options.seed, total.hexdigest())
    print(text)
    if options.page is not None:
        write_text(options.page, text)
    sys.exit(0 if result.identical else 1)


if __name__ == "__main__":
    main()
