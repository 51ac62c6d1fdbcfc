"""Pieces of work are kept one by one, done once, and the same whoever does them."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cassini_bayes.computing.workers import LocalWorkers
from cassini_bayes.errors import CassiniBayesError
from cassini_bayes.files.checkpoint import CheckpointStore, RecordStore
from cassini_bayes.files.pieces import finished, run_pieces

PIECES = {f"piece_{i}": (i,) for i in range(6)}
Arrays = dict[str, NDArray[np.generic]]


def drawn(scale: float, number: int) -> Arrays:
    """Random numbers of a piece's own stream."""
    return {"x": scale * np.random.default_rng(number).normal(size=3)}


def kept(folder: Path) -> dict[str, bytes]:
    """Content of every finished file."""
    return {path.name: path.read_bytes() for path in folder.glob("*.npz")}


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_pieces_are_the_same_on_any_number_of_processes(tmp_path: Path, processes: int) -> None:
    """Every piece is there and what the function gives; a second call has nothing to do."""
    store, workers = CheckpointStore(tmp_path, "own"), LocalWorkers(processes)
    told = list(run_pieces(drawn, 2.0, PIECES, store, workers))
    assert told == [(done, 6) for done in range(7)]
    for name, (number,) in PIECES.items():
        np.testing.assert_array_equal(finished(store, name)["x"], drawn(2.0, number)["x"])
    assert list(run_pieces(drawn, 2.0, PIECES, store, workers)) == [(6, 6)]


@pytest.mark.parametrize("processes", [1, 2])
def test_only_missing_and_damaged_pieces_are_done(tmp_path: Path, processes: int) -> None:
    """Finished files are left as they are."""
    store, workers = CheckpointStore(tmp_path, "own"), LocalWorkers(processes)
    list(run_pieces(drawn, 2.0, PIECES, store, workers))
    before = kept(tmp_path)
    (tmp_path / "piece_1.npz").unlink()
    (tmp_path / "piece_4.npz").write_bytes(before["piece_4.npz"][:50])
    times = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
    with pytest.raises(CassiniBayesError, match="piece_1 is missing"):
        finished(store, "piece_1")
    steps = list(run_pieces(drawn, 2.0, PIECES, store, workers))
    assert steps == [(4, 6), (5, 6), (6, 6)]
    assert kept(tmp_path) == before
    done = {n for n in times if (tmp_path / n).stat().st_mtime_ns != times[n]}
    assert done == {"piece_4.npz"}


def killed(parent: int, number: int) -> Arrays:
    """Kill this worker at one piece, the others being done by then."""
    if number == 5 and os.getpid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)
    return drawn(1.0, number)


def test_a_killed_worker_is_said_in_one_line_and_costs_what_was_under_way(tmp_path: Path) -> None:
    """Finished pieces stay; the same call goes on."""
    store = CheckpointStore(tmp_path, "own")
    with pytest.raises(CassiniBayesError, match="worker process was killed"):
        list(run_pieces(killed, os.getpid(), PIECES, store, LocalWorkers(2)))
    assert "piece_5.npz" not in kept(tmp_path)
    before = kept(tmp_path)
    assert list(run_pieces(drawn, 1.0, PIECES, store, LocalWorkers(2)))[-1] == (6, 6)
    assert before.items() <= kept(tmp_path).items()


def test_records_of_something_else_are_missing(tmp_path: Path) -> None:
    """A JSON record comes back if what it says it was made by is what is asked for."""
    store = RecordStore(tmp_path, {"seed": 5, "code": "abc"})
    record = {"seed": 5, "code": "abc", "value": [1.0, None]}
    store.save("one", record)
    assert store.load("one") == record
    assert store.load("two") is None
    assert RecordStore(tmp_path, {"seed": 6}).load("one") is None
    (tmp_path / "one.json").write_text((tmp_path / "one.json").read_text()[:-4])
    assert store.load("one") is None
