"""Where independent pieces of work are done: processes of this machine, or a Dask cluster.

A piece's result depends on its arguments alone, never on who works it out or in which order.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from threadpoolctl import threadpool_limits

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.computing.processes import as_finished
from cassini_bayes.errors import InputError

Result = TypeVar("Result")
Work = Callable[..., Result]
Arguments = tuple[object, ...]


class Workers(Protocol):
    """Who works."""

    def results(
        self, work: Work[Result], shared: object, tasks: Sequence[Arguments]
    ) -> Iterator[tuple[int, Result]]:
        """Place and result of every ``work(shared, *task)``, as they are finished.

        Raises
        ------
        Whatever the first piece that failed raised.
        """


@dataclass(frozen=True)
class LocalWorkers:
    """Processes forked from this one, which inherit what the tasks share; one: this process."""

    processes: int

    def results(
        self, work: Work[Result], shared: object, tasks: Sequence[Arguments]
    ) -> Iterator[tuple[int, Result]]:
        yield from as_finished(lambda task: _alone(work, shared, *task), tasks, self.processes)


@dataclass(frozen=True)
class DaskWorkers:
    """The workers of a cluster."""

    client: Any  # the library carries no types

    def results(
        self, work: Work[Result], shared: object, tasks: Sequence[Arguments]
    ) -> Iterator[tuple[int, Result]]:
        handle = self.client.scatter(shared, broadcast=True)
        with self.client.get_executor(pure=False) as pool:
            pending = {pool.submit(_alone, work, handle, *task): i for i, task in enumerate(tasks)}
            try:
                for future in as_completed(pending):
                    yield pending[future], future.result()
            finally:
                for future in pending:
                    future.cancel()


def _alone(work: Work[Result], *arguments: object) -> Result:
    with threadpool_limits(1):  # there is a process for every core already
        return work(*arguments)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def workers_at(jobs: int | None, dask: str | None, log: Log = silent) -> Iterator[Workers]:
    """Local processes, or the workers of a Dask cluster at an address.

    Parameters
    ----------
    jobs
        Local processes, None for one on each core; no more than that are started, and ``log`` is
        told so.
    dask
        An address like tcp://host:8786.

    Raises
    ------
    InputError
        Dask is not installed, or nothing answers at the address.
    """
    if dask is None:
        most = cores()
        if jobs is not None and jobs > most:
            log(f"{jobs} jobs on {most} cores: {most} processes")
        yield LocalWorkers(most if jobs is None else min(jobs, most))
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "--dask", "Dask's distributed", "not installed", "install cassini_bayes[dask]"
        ) from error
    try:
        # not the default client: xarray would ask a failed one for the lock of every file it writes
        client: Any = Client(  # type: ignore[no-untyped-call]  # Dask has no types
            dask, timeout="10s", set_as_default=False
        )
    except (OSError, ValueError) as error:
        raise InputError(
            "--dask", "a Dask scheduler", f"none at {dask}", "start one, or leave --dask out"
        ) from error
    with client:
        yield DaskWorkers(client)
