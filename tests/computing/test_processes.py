"""Batches on threads and walks in lock-step: the same numbers, and failures that end all walks."""

from __future__ import annotations

import os
import threading
from functools import partial

import numpy as np
import pytest

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.processes import (
    PART,
    LogDensity,
    in_lock_step,
    in_parts,
    in_processes,
    over_parts,
    spare_threads,
)


def square(z: Array) -> Array:
    """A log density, −½ |z|²."""
    return np.asarray(-0.5 * (z**2).sum(-1))


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("points", [1, PART, PART + 1, 5 * PART + 3])
def test_parts_give_what_the_whole_gives(threads: int, points: int) -> None:
    """A batch cut up is evaluated once per point, in order, whatever the number of threads."""
    z = np.random.default_rng(1).standard_normal((points, 4))
    seen: list[int] = []

    def counted(part: Array) -> Array:
        seen.append(len(part))
        return square(part)

    with in_parts(counted, threads) as density:
        np.testing.assert_array_equal(density(z), square(z))
    assert sum(seen) == points
    assert max(seen) <= PART


def test_spare_threads_share_the_parts_of_a_batch() -> None:
    """Two parts are worked out at the same time while there are spare threads, and not after."""
    z = np.zeros((PART + 1, 2))
    together = threading.Barrier(2)

    def meets(part: Array, wait_s: float = 20.0) -> Array:
        together.wait(wait_s)
        return square(part)

    with spare_threads(2):
        np.testing.assert_array_equal(over_parts(meets, z), square(z))
    with pytest.raises(threading.BrokenBarrierError):
        over_parts(partial(meets, wait_s=0.3), z)


def test_spare_threads_are_those_of_the_thread_that_has_them() -> None:
    """Other threads, threads of the pool itself and forked processes do their work alone."""
    z = np.zeros((PART + 1, 2))
    alone = partial(over_parts, square)
    with spare_threads(2):
        np.testing.assert_array_equal(over_parts(lambda part: alone(z)[: len(part)], z), square(z))
        assert in_processes(lambda _: float(alone(z)[0]), range(2), 2) == [0.0, 0.0]
        elsewhere: list[bool] = []

        def work() -> None:
            with in_parts(square, 2) as density, spare_threads(2):
                elsewhere.append(bool((density(z) == alone(z)).all()))

        other = threading.Thread(target=work)
        other.start()
        other.join()
        assert elsewhere == [True]
        np.testing.assert_array_equal(alone(z), square(z))  # its own are still there


def walk(density: LogDensity, start: float, steps: int) -> list[float]:
    """Steps that depend on what the density said."""
    values, at = [], start
    for _ in range(steps):
        at = float(density(np.array([[at, start]]))[0])
        values.append(at)
    return values


def test_walks_side_by_side_do_what_each_does_alone() -> None:
    """Walks of different length in lock-step end with their own results, batched together."""
    lengths = [5, 1, 9, 7]
    batches: list[int] = []

    def counted(z: Array) -> Array:
        batches.append(len(z))
        return square(z)

    walks = [partial(walk, start=0.1 * i, steps=n) for i, n in enumerate(lengths)]
    together = in_lock_step(counted, walks)
    assert together == [walk(square, 0.1 * i, n) for i, n in enumerate(lengths)]
    assert batches == [sum(n > step for n in lengths) for step in range(max(lengths))]


def test_what_is_evaluated_together_does_not_depend_on_speed() -> None:
    """A walk that dawdles is waited for."""
    batches: list[list[float]] = []
    late = threading.Event()

    def noted(z: Array) -> Array:
        batches.append(sorted(z[:, 1].tolist()))
        late.set()
        return square(z)

    def slow(density: LogDensity) -> list[float]:
        late.wait(0.2)
        return walk(density, 2.0, 2)

    in_lock_step(noted, [partial(walk, start=1.0, steps=2), slow])
    assert batches == [[1.0, 2.0], [1.0, 2.0]]


@pytest.mark.parametrize("where", ["density", "walk"])
def test_a_failure_ends_all_walks_with_its_own_error(where: str) -> None:
    """The error that came first is raised, and no thread waits for ever."""

    def breaks(z: Array) -> Array:
        if where == "density":
            raise ValueError("no density here")
        return square(z)

    def failing(density: LogDensity) -> list[float]:
        density(np.zeros((1, 2)))
        raise ValueError("no walk here")

    walks = [partial(walk, start=0.5, steps=3), failing]
    with pytest.raises(ValueError, match=f"no {where} here"):
        in_lock_step(breaks, walks)


@pytest.mark.parametrize("system", ["linux", "another"])
@pytest.mark.parametrize("processes", [1, 2, 4])
def test_pieces_come_back_in_order(
    processes: int, system: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Independent pieces give the same list on any number of processes."""
    monkeypatch.setattr("sys.platform", system)
    found = in_processes(lambda item: item**2, range(20), processes)
    assert found == [i**2 for i in range(20)]


def test_pieces_are_worked_in_other_processes() -> None:
    """With two processes or more nothing is done in this one; with one all is."""
    own = os.getpid()
    assert own not in in_processes(lambda _: os.getpid(), range(4), 2)
    assert in_processes(lambda _: os.getpid(), range(4), 1) == [own] * 4


@pytest.mark.parametrize("processes", [1, 3])
def test_a_piece_that_fails_raises_its_error(processes: int) -> None:
    """The error of a piece is not lost in a process."""

    def fails(item: int) -> int:
        if item == 3:
            raise ValueError("piece three")
        return item

    with pytest.raises(ValueError, match="piece three"):
        in_processes(fails, range(6), processes)
