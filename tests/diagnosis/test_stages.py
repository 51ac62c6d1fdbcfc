"""Stages of a diagnosis: what is finished is not worked out again, and progress is told."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import Barrier, BrokenBarrierError

import numpy as np
import pytest

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.processes import PART, over_parts
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.diagnosis.stages import StageRunner
from cassini_bayes.errors import InputError
from cassini_bayes.files.checkpoint import CheckpointStore


def mode_of(seed: int, made: list[int]) -> Mode:
    """A mode of some digits; says that it was made."""
    made.append(seed)
    rng = np.random.default_rng(seed)
    return Mode(rng.standard_normal(4), np.asfortranarray(rng.standard_normal((4, 4))), 0.1 * seed)


def stages(crew: StageRunner, made: list[int], failing: int = -1) -> list[Mode]:
    """Two stages of three pieces, of which one may fail."""

    def piece(seed: int) -> Mode:
        if seed == failing:
            raise KeyboardInterrupt
        return mode_of(seed, made)

    first = crew.results("first", [partial(piece, seed) for seed in range(3)], Mode)
    second = crew.results("second", [partial(piece, seed) for seed in range(3, 6)], Mode)
    return [*first, *second]


def crew_in(folder: Path, told: Callable[[str, int, int], None] | None = None) -> StageRunner:
    """One process that keeps what it finishes."""
    store = CheckpointStore(folder, "own")
    return StageRunner(1, store) if told is None else StageRunner(1, store, told)


@pytest.mark.parametrize("failing", range(6))
def test_what_is_finished_is_not_worked_out_again(failing: int, tmp_path: Path) -> None:
    """Stopped at any piece: together both make every piece once, and the modes are the same."""
    whole = stages(crew_in(tmp_path / "whole"), [])
    made: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        stages(crew_in(tmp_path / "stopped"), made, failing)
    assert made == list(range(failing))
    found = stages(crew_in(tmp_path / "stopped"), made)
    assert sorted(made) == list(range(6))
    for one, other in zip(whole, found, strict=True):
        np.testing.assert_array_equal(one.factor, other.factor)
        assert one.factor.flags.f_contiguous == other.factor.flags.f_contiguous
        assert (one.log_evidence, one.is_whole) == (other.log_evidence, other.is_whole)


def test_progress_counts_what_was_there(tmp_path: Path) -> None:
    """Every stage from what is kept to its end; a stage without a name is not told."""
    told: list[tuple[str, int, int]] = []
    stages(crew_in(tmp_path), [])
    with pytest.raises(ZeroDivisionError):
        crew_in(tmp_path).results("", [lambda: 1 // 0], None)
    crew = crew_in(tmp_path, lambda *one: told.append(one))
    stages(crew, [])
    crew.results("", [lambda: 1.0, lambda: 2.0], None)
    crew.results("third", [lambda: 1.0, lambda: 2.0], float)
    assert told == [
        *(("first", 3, 3), ("second", 3, 3)),
        *(("third", 0, 2), ("third", 1, 2), ("third", 2, 2)),
    ]


def test_a_piece_that_is_alone_has_threads_for_its_batches() -> None:
    """Parts of its batches are worked out side by side; with one process they are not."""

    def piece(wait_s: float) -> float:
        together = Barrier(2)

        def density(part: Array) -> Array:
            together.wait(wait_s)
            return part[:, 0]

        return float(over_parts(density, np.ones((PART + 1, 1))).sum())

    assert StageRunner(2).results("", [partial(piece, 20.0)], float) == [PART + 1.0]
    with pytest.raises(BrokenBarrierError):
        StageRunner(1).results("", [partial(piece, 0.3)], float)


def test_pieces_of_another_diagnosis_are_refused(tmp_path: Path) -> None:
    """Never silently continued."""
    stages(crew_in(tmp_path), [])
    with pytest.raises(InputError, match="one of another run"):
        stages(StageRunner(1, CheckpointStore(tmp_path, "other")), [])
