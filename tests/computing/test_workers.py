"""Workers: no more processes than cores, one thread of linear algebra in each."""

from __future__ import annotations

import os

import pytest
from threadpoolctl import threadpool_info

from cassini_bayes.computing import workers
from cassini_bayes.computing.workers import LocalWorkers, cores, workers_at
from cassini_bayes.errors import InputError


@pytest.mark.parametrize(("jobs", "processes"), [(1, 1), (2, 2), (64, 3), (None, 3)])
def test_there_are_no_more_processes_than_cores(
    monkeypatch: pytest.MonkeyPatch, jobs: int | None, processes: int
) -> None:
    """What is too much is cut, and said once; without a number there is one for each core."""
    monkeypatch.setattr(workers, "cores", lambda: 3)
    said: list[str] = []
    with workers_at(jobs, None, said.append) as found:
        assert found == LocalWorkers(processes)
    assert said == (["64 jobs on 3 cores: 3 processes"] if jobs == 64 else [])


def test_cores_are_those_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    """A container's share, not the machine; where no system says, all there are."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {1, 5})
    assert cores() == 2
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    assert cores() == 7


def threads(_: object, number: int) -> tuple[int, int]:
    """Process and most threads of its linear algebra."""
    del number
    return os.getpid(), max(found["num_threads"] for found in threadpool_info())


@pytest.mark.parametrize("processes", [1, 2])
def test_a_worker_has_one_thread(processes: int) -> None:
    """In this process, and in each of the forked ones."""
    found = dict(LocalWorkers(processes).results(threads, None, [(i,) for i in range(4)]))
    assert sorted(found) == [0, 1, 2, 3]
    assert {most for _, most in found.values()} == {1}
    assert (os.getpid() in {process for process, _ in found.values()}) == (processes == 1)


def test_nobody_at_the_address_is_said() -> None:
    """An address where no scheduler answers."""
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match="Dask scheduler"), workers_at(1, "nonsense://nowhere"):
        pass
