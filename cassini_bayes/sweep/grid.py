"""Run many independent cells in parallel, each kept in a file of its own as soon as it is done.

A cell's numbers depend on its inputs alone, never on the process that works it out, so one process,
several, or a Dask cluster give the same files, and a killed grid goes on with the missing ones.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.processes import end_with_parent
from cassini_bayes.errors import CassiniBayesError, InputError
from cassini_bayes.files.checkpoint import CheckpointStore

Arrays = dict[str, NDArray[np.generic]]


@dataclass(frozen=True)
class Workers:
    """Where cells are worked out: an executor, and how an argument they share reaches it."""

    executor: Executor
    share: Callable[[Any], Any]


@contextmanager
def workers_at(jobs: int, dask: str | None) -> Iterator[Workers]:
    """Local processes (one job: this one), or the workers of a Dask cluster at an address.

    An address looks like tcp://host:8786.

    Raises
    ------
    InputError
        Dask is not installed, or nothing answers at the address.
    """
    if dask is None:
        with _local(jobs) as pool:
            yield Workers(pool, lambda shared: shared)
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "--dask", "Dask's distributed", "not installed", "install cassini_bayes[dask]"
        ) from error
    try:
        # not the default client: xarray would ask a failed one for the lock of every file it writes
        client: Any = Client(  # type: ignore[no-untyped-call]
            dask, timeout="10s", set_as_default=False
        )
    except (OSError, ValueError) as error:
        raise InputError(
            "--dask", "a Dask scheduler", f"none at {dask}", "start one, or leave --dask out"
        ) from error
    with client, client.get_executor(pure=False) as pool:
        yield Workers(pool, lambda shared: client.scatter(shared, broadcast=True))


def _local(jobs: int) -> Executor:
    if jobs == 1:
        return ThreadPoolExecutor(max_workers=1)
    return ProcessPoolExecutor(jobs, initializer=end_with_parent, initargs=(os.getpid(),))


def run_cells(
    work: Callable[..., Arrays],
    shared: object,
    cells: Mapping[str, Sequence[object]],
    store: CheckpointStore,
    workers: Workers,
) -> Iterator[tuple[int, int]]:
    """Work out the cells that ``store`` lacks as ``work(shared, *arguments)``, in any order.

    Yields (done, all) at the start and whenever a cell has been stored.
    """
    missing = [name for name in cells if store.load(name) is None]
    done = len(cells) - len(missing)
    yield done, len(cells)
    if not missing:
        return
    handle = workers.share(shared)
    pending = {workers.executor.submit(work, handle, *cells[name]): name for name in missing}
    try:
        for future in as_completed(pending):
            store.save(pending[future], future.result())
            done += 1
            yield done, len(cells)
    finally:
        for future in pending:
            future.cancel()


def stored_cell(store: CheckpointStore, name: str) -> Arrays:
    """Arrays of a finished cell.

    Raises
    ------
    CassiniBayesError
        The cell is missing.
    """
    arrays = store.load(name)
    if arrays is None:
        raise CassiniBayesError(f"{store.folder}: cell {name} is missing: run the sweep again")
    return arrays
