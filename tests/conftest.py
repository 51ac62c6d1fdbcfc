"""What every test relies on: one BLAS thread, figures without a screen, repeatable hypothesis.

``slow.txt`` lists the tests and fixtures that take long. Tests that are not there and need nothing
that is there are marked ``quick``; where several workers share the tests, files with the longest
ones come first, so that all workers end together.
"""

from __future__ import annotations

import gc
import os
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

# Before numpy or matplotlib is imported by any test module.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
os.environ["MPLBACKEND"] = "Agg"

# Files of tests are in memory where it has room (a run leaves some 150 MB): a disk takes 4 ms to
# make a file safe and 1 ms to remove it, which is a tenth of the time of tests that write.
MEMORY = Path("/dev/shm")  # noqa: S108  only where nobody has chosen a place
has_room = os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > 2 << 30
if has_room and "TMPDIR" not in os.environ:
    os.environ["TMPDIR"] = tempfile.tempdir = str(MEMORY)

import hypothesis
import pytest

# The same examples on every run: a failure is the change's, not the day's. Deadlines off: a busy
# machine is no failure.
hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None)
hypothesis.settings.load_profile("repeatable")


def slow_tests() -> dict[str, float]:
    """Seconds by function, test or fixture, without parameters."""
    text = Path(__file__).with_name("slow.txt").read_text()
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    return {name: float(seconds) for seconds, name in lines}


@pytest.fixture(scope="module")
def short_warm_start() -> Iterator[None]:
    """Fits whose proposal and evidence come from a quarter of the draws.

    For tests of what is done with a fit: the warm start's draws are a third of its time. Children
    have it too where they are forked.
    """
    from cassini_bayes.sampling.warmstart import warm_start

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(warm_start.__kwdefaults__, "draws", 1_000)
        yield


@pytest.fixture
def usual_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Conditions are drawn without the drive of wheels, which is then the first.

    For tests of single flights that were chosen, among campaigns' draws, from before it was drawn.
    """
    from cassini_bayes.studies import conditions

    levels = {name: own for name, own in conditions.LEVELS.items() if name != "drive"}
    monkeypatch.setattr(conditions, "LEVELS", levels)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark quick tests; put the longest files first where workers share them."""
    slow = slow_tests()
    for item in items:
        file, needed = item.nodeid.partition("::")[0], getattr(item, "fixturenames", ())
        names = {item.nodeid.partition("[")[0], *(f"{file}::{name}" for name in needed)}
        if not names & slow.keys():
            item.add_marker("quick")
    if not hasattr(config, "workerinput"):
        return
    seconds: dict[str, float] = defaultdict(float)
    for name, own in slow.items():
        seconds[name.partition("::")[0]] += own
    items.sort(key=lambda item: -seconds[item.nodeid.partition("::")[0]])


def pytest_collection_finish() -> None:
    """Collect garbage as rarely as the command line does, and leave out what stays for all tests.

    Each full collection looks at every test and module: in files that draw, a sixth of the time.
    """
    gc.set_threshold(100_000)
    gc.freeze()


def pytest_configure(config: pytest.Config) -> None:
    """Give each of several workers its share of the cores: what a test starts keeps to it."""
    if not hasattr(config, "workerinput") or not hasattr(os, "sched_getaffinity"):
        return
    workers = config.workerinput["workercount"]
    share = sorted(os.sched_getaffinity(0))[: max(1, len(os.sched_getaffinity(0)) // workers)]
    os.sched_getaffinity = lambda _: set(share)
