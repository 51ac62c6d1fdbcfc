"""Linear algebra has one thread, whether its library is loaded before or after the limit is set."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from cassini_bayes.computing.threads import VARIABLES, one_thread

COUNT = (
    "import threadpoolctl; "
    "print(max(found['num_threads'] for found in threadpoolctl.threadpool_info()))"
)


def threads(*lines: str) -> int:
    """Threads of the linear algebra of a new process, which may have two."""
    environment = {**os.environ, **dict.fromkeys(VARIABLES, "2")}
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return int(done.stdout)


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core has one thread")
def test_libraries_loaded_before_and_after_are_limited() -> None:
    """numpy's own linear algebra, loaded first, inside the block, or without it (the control)."""
    limited = "with one_thread():"
    face = "from cassini_bayes.computing.threads import one_thread"
    assert threads(face, limited, "    import numpy", f"    {COUNT}") == 1
    assert threads("import numpy", face, limited, f"    {COUNT}") == 1
    assert threads("import numpy", COUNT) == 2


def test_the_environment_is_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was set is set again, what was not is not; processes started meanwhile inherit 1."""
    monkeypatch.setenv(VARIABLES[0], "3")
    monkeypatch.delenv(VARIABLES[1], raising=False)
    with one_thread():
        assert all(os.environ[name] == "1" for name in VARIABLES)
    assert os.environ[VARIABLES[0]] == "3"
    assert VARIABLES[1] not in os.environ
