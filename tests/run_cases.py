"""A small run that ends in seconds, and the command line started inside or beside this process."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import tomli_w

from cassini_bayes.cli import main

ROOT = Path(__file__).parents[1]
FLIGHT = ROOT / "cassini_bayes" / "published" / "flight_2009_2010.csv"
B_BRANCH = ROOT / "priors" / "cassini_b_branch_2010.toml"
A_BRANCH = ROOT / "priors" / "cassini_a_branch_2005.toml"
EVENTS = ("2009-08-22-bias", "2009-10-05-bias")
RECORD = 'events = ["e.csv"]\npriors = "p.toml"\n[sampler]\nseed = 1\n'
"""What makes a folder a run's."""


def small_table() -> dict[str, object]:
    """A run file's content: two flight events, two short ensembles, no report."""
    return {
        "events": [f"{FLIGHT}:{event}" for event in EVENTS],
        "priors": str(B_BRANCH),
        "model": {"delta_v": "ignore"},
        "sampler": {
            "ensembles": 2,
            "walkers": 56,
            "target_ess": 100,
            "first_check": 64,
            "max_steps": 100,
        },
        "output": {"report": False, "draws_per_ensemble": 500, "prior_draws": 500},
    }


def write_run(folder: Path, table: dict[str, object] | None = None) -> Path:
    """A run file in ``folder``."""
    path = folder / "small.toml"
    path.write_text(tomli_w.dumps(small_table() if table is None else table))
    return path


def command(arguments: Sequence[str]) -> int:
    """Exit status of the command line, run in this process."""
    before, sys.argv = sys.argv, ["cassini-bayes", *arguments]
    try:
        main()
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 1
    finally:
        sys.argv = before
    return 0


def logged(arguments: Sequence[str], log: Path) -> int:
    """The same, its output sent to ``log``; what it loads and compiles, children have already."""
    with log.open("w") as stream, redirect_stdout(stream), redirect_stderr(stream):
        return command(arguments)


@dataclass
class Forked:
    """The command line in a child process that need not import anything again."""

    pid: int
    status: int | None = None

    @classmethod
    def start(cls, arguments: Sequence[str], log: Path) -> Forked:
        """Fork, send the child's output to ``log`` and run the command there."""
        stream = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        pid = os.fork()
        if pid:
            os.close(stream)
            return cls(pid)
        status = 99
        try:
            os.dup2(stream, 1)
            os.dup2(stream, 2)
            sys.stdout = os.fdopen(1, "w", closefd=False)
            sys.stderr = os.fdopen(2, "w", closefd=False)
            status = command(arguments)
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(status)

    def poll(self) -> int | None:
        """Exit status, negative for a signal; None while it runs."""
        return self._ended(os.WNOHANG)

    def wait(self) -> int:
        """Exit status, once it has ended."""
        status = self._ended(0)
        assert status is not None
        return status

    def _ended(self, options: int) -> int | None:
        if self.status is None:
            pid, raw = os.waitpid(self.pid, options)
            if pid:
                self.status = os.waitstatus_to_exitcode(raw)
        return self.status
