"""Work on several cores: batches cut into parts, ensembles in lock-step, forked processes.

The likelihood spends its time in compiled code that lets other threads run, and costs less per
point in large batches. Neither the cut nor the order of what is evaluated together depends on the
number of threads, so results do not either. Linear algebra has one thread each.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from typing import Any, Final, TypeVar

import numpy as np

from cassini_bayes.computing.arrays import Array, joined
from cassini_bayes.computing.threads import one_thread
from cassini_bayes.errors import CassiniBayesError

LogDensity = Callable[[Array], Array]
Item = TypeVar("Item")
Result = TypeVar("Result")
PART: Final = 200  # points: large enough for vectors, small enough for the processor's cache


class _OtherFailedError(Exception):
    """Another ensemble failed: this one need not go on."""


@contextmanager
def in_parts(log_density: LogDensity, threads: int) -> Iterator[LogDensity]:
    """The log density with batches (n, d) cut into parts of :data:`PART` points, on threads."""
    with _likelihood_threads(threads) as pool:
        yield partial(_over_parts, pool, log_density)


@contextmanager
def spare_threads(threads: int) -> Iterator[None]:
    """Threads for :func:`over_parts` while one piece of work is all there is."""
    with _likelihood_threads(threads) as pool:
        before = _spare.set(pool)
        try:
            yield
        finally:
            _spare.reset(before)


@contextmanager
def _likelihood_threads(threads: int) -> Iterator[ThreadPoolExecutor | None]:
    """Threads whose linear algebra has one each; None for fewer than two."""
    if threads < 2:
        yield None
        return
    with one_thread(), ThreadPoolExecutor(threads, "likelihood") as pool:
        yield pool


def over_parts(log_density: LogDensity, z: Array) -> Array:
    """The log density (n,) of a batch (n, d) in parts, on spare threads if this one has any."""
    return _over_parts(_spare.get(), log_density, z)


def _over_parts(pool: ThreadPoolExecutor | None, log_density: LogDensity, z: Array) -> Array:
    parts = _parts(z)
    evaluated = map if pool is None or len(parts) == 1 else pool.map
    return joined(list(evaluated(log_density, parts)))


def in_processes(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    processes: int,
) -> list[Result]:
    """Results of independent pieces of work, in their order; see :func:`as_finished`."""
    results = dict(as_finished(function, items, processes))
    return [results[place] for place in sorted(results)]


def as_finished(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    processes: int,
    meanwhile: Callable[[], object] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Places and results of independent pieces of work, as processes forked from this one end them.

    For work that holds the interpreter's lock much of its time. Function and items are inherited,
    results come back by pickle through a pipe; ``meanwhile`` is called while the others work. With
    one process all is done in this one. Where forking is not the system's way there are threads
    instead.

    Raises
    ------
    Whatever the first piece that failed raised.
    CassiniBayesError
        A process was killed.
    """
    work = [(function, item) for item in items]
    if processes < 2 or len(work) < 2:
        if meanwhile is not None:
            meanwhile()
        yield from ((place, function(item)) for place, (_, item) in enumerate(work))
        return
    if sys.platform != "linux":
        with one_thread(), ThreadPoolExecutor(processes, "work") as threads:
            pending = {threads.submit(function, item): i for i, (_, item) in enumerate(work)}
            yield from _gathered(pending, meanwhile)
        return
    context = multiprocessing.get_context("fork")
    stop = context.RawValue("b", 0)  # not an Event: it waits for ever for a waiter that was killed
    most = min(processes, len(work))
    with ProcessPoolExecutor(most, context, _inherit, (work, os.getpid(), stop)) as pool:
        try:
            yield from _gathered(
                {pool.submit(_inherited, i): i for i in range(len(work))}, meanwhile
            )
        except BaseException as failure:  # interrupted, given up, or a piece failed
            stop.value = 1
            pool.shutdown(wait=False, cancel_futures=True)
            if isinstance(failure, BrokenProcessPool):
                raise CassiniBayesError(
                    "a worker process was killed, maybe for want of memory: start the same command "
                    "again, with fewer jobs; or give fewer rows of telemetry a second"
                ) from failure
            raise


def _gathered(
    pending: Mapping[Future[Result], int], meanwhile: Callable[[], object] | None
) -> Iterator[tuple[int, Result]]:
    if meanwhile is not None:
        meanwhile()
    for future in as_completed(pending):
        yield pending[future], future.result()


_work: list[tuple[Callable[[Any], Any], Any]] = []  # of a forked process
# of the thread that has them: neither their own work nor other threads wait for them
_spare: ContextVar[ThreadPoolExecutor | None] = ContextVar("spare threads", default=None)


def _inherit(work: list[tuple[Callable[[Any], Any], Any]], parent: int, stop: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent says that it was interrupted
    threading.Thread(target=_end_in_time, args=(parent, stop), daemon=True).start()
    _spare.set(None)  # threads do not come along
    gc.freeze()  # a collection would copy all that is inherited
    _work[:] = work


def _end_in_time(parent: int, stop: Any) -> None:
    """End this worker when its parent gives up, or was killed: it would wait for work for ever."""
    while os.getppid() == parent and not stop.value:
        time.sleep(0.5)
    os._exit(1)


def _inherited(place: int) -> Any:
    function, item = _work[place]
    return function(item)


def _parts(z: Array) -> list[Array]:
    return np.array_split(z, max(1, -(-len(z) // PART)))


class LockStep:
    """A log density shared by several walks: what they ask for is evaluated as one batch.

    Each walk calls :meth:`of` its place from a thread of its own and waits there until all the
    others that have not ended ask as well. So what is evaluated together depends on the walks
    alone, not on how fast their threads are.
    """

    def __init__(self, log_density: LogDensity, walks: int) -> None:
        self._log_density = log_density
        self._walking = walks
        self._asked: dict[int, Array] = {}
        self._answers: dict[int, Array] = {}
        self._failed: BaseException | None = None
        self._turn = threading.Condition()

    def of(self, place: int) -> LogDensity:
        """The log density as one walk calls it."""

        def evaluate(z: Array) -> Array:
            with self._turn:
                self._asked[place] = z
                self._evaluate_if_all_ask()
                self._turn.wait_for(lambda: place in self._answers or self._failed is not None)
                if place not in self._answers:
                    raise _OtherFailedError
                return self._answers.pop(place)

        return evaluate

    def end(self, failure: BaseException | None = None) -> None:
        """A walk has ended; after a failure all others end, too."""
        with self._turn:
            self._walking -= 1
            self._failed = self._failed or failure
            self._evaluate_if_all_ask()
            self._turn.notify_all()

    def _evaluate_if_all_ask(self) -> None:
        if self._failed is not None or not self._asked or len(self._asked) < self._walking:
            return
        places = sorted(self._asked)
        batch = [self._asked.pop(place) for place in places]
        edges = np.cumsum([len(z) for z in batch])[:-1]
        try:
            values = self._log_density(np.concatenate(batch))
        except BaseException as failure:
            self._failed = failure
            self._turn.notify_all()
            raise
        self._answers.update(zip(places, np.split(values, edges), strict=True))
        self._turn.notify_all()


def in_lock_step(
    log_density: LogDensity, walks: Sequence[Callable[[LogDensity], Result]]
) -> list[Result]:
    """Run walks side by side, each given the shared log density, and return their results.

    Raises
    ------
    Whatever the first walk that failed raised.
    """
    shared = LockStep(log_density, len(walks))

    def run(place: int) -> Result:
        try:
            result = walks[place](shared.of(place))
        except BaseException as failure:
            shared.end(failure)
            raise
        shared.end()
        return result

    with ThreadPoolExecutor(len(walks), thread_name_prefix="ensemble") as pool:
        try:
            futures = [pool.submit(run, place) for place in range(len(walks))]
            for future in futures:
                future.exception()
        except BaseException as failure:  # interrupted from outside: let the threads end
            shared.end(failure)
            raise
    for future in futures:
        failed = future.exception()
        if failed is not None and not isinstance(failed, _OtherFailedError):
            raise failed
    return [future.result() for future in futures]
