"""Stages of a diagnosis: shared out among processes, and kept as soon as they are finished.

The stages of a diagnosis follow each other as the data have it, whoever works on them. So a piece
of work is kept under the number of its stage and its place there, and a diagnosis that was killed
takes from its folder what is there and works out the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Final, TypeVar

from cassini_bayes.computing.processes import as_finished, spare_threads
from cassini_bayes.computing.threads import one_thread
from cassini_bayes.files.as_arrays import arrays_of, value_of
from cassini_bayes.files.checkpoint import CheckpointStore

Result = TypeVar("Result")
Progress = Callable[[str, int, int], None]


def no_progress(what: str, done: int, total: int) -> None:
    """Report nothing."""
    del what, done, total


@dataclass(frozen=True)
class StageRunner:
    """Processes, the folder of what they have finished, who is told how far a stage has got.

    Neither changes a result. ``progress`` gets the stage's name, how much is done, of how much.
    """

    processes: int = 1
    store: CheckpointStore | None = None
    progress: Progress = no_progress
    _stages: Iterator[int] = field(default_factory=count, init=False, repr=False, compare=False)

    def results(
        self,
        what: str,
        work: Sequence[Callable[[], Result]],
        kind: Any,
        meanwhile: Callable[[], object] | None = None,
    ) -> list[Result]:
        """Results of the pieces of a stage, in their order.

        Parameters
        ----------
        what
            Name of the stage, for progress; nobody is told of one without.
        work
            The pieces, independent of each other.
        kind
            Type of the results, or a list with that of each; None for what is not to be kept.
        meanwhile
            Called while others work.
        """
        stage = next(self._stages)
        kinds = kind if isinstance(kind, list) else [kind] * len(work)
        names = [f"stage_{stage:03d}_{place:03d}" for place in range(len(work))]
        results: dict[int, Result] = {}
        for place, name in enumerate(names):
            arrays = None if self.store is None or kinds[place] is None else self.store.load(name)
            if arrays is not None:
                results[place] = value_of(kinds[place], arrays)
        missing = [place for place in range(len(work)) if place not in results]
        self._report(what, len(results), len(work))
        due = [work[place] for place in missing]
        # linear algebra rounds by its threads: one, whoever works
        with one_thread(), spare_threads(self.processes if len(due) == 1 else 1):
            for i, result in as_finished(_called, due, self.processes, meanwhile):
                place = missing[i]
                results[place] = self._kept(names[place], kinds[place], result)
                self._report(what, len(results), len(work))
        return [results[place] for place in range(len(work))]

    def _kept(self, name: str, kind: Any, result: Result) -> Result:
        """A result as it will be read back, so that it does not matter when it was worked out."""
        if self.store is None or kind is None:
            return result
        arrays = arrays_of(result)
        self.store.save(name, arrays)
        kept: Result = value_of(kind, arrays)
        return kept

    def _report(self, what: str, done: int, total: int) -> None:
        if what and total > 1:
            self.progress(what, done, total)


SERIAL: Final = StageRunner()
"""One process that keeps nothing."""


def _called(work: Callable[[], Result]) -> Result:
    return work()
