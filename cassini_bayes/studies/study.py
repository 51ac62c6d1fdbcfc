"""A study: repetitions that are kept one by one, a judgement, a page.

Whatever a study asks, it is run in the same way: every repetition has a random stream of its own,
given by the seed and its number, so neither the order nor the number of workers changes a result;
finished ones are kept in files that name what they depend on, so a killed study goes on with the
same command, and changed code or data start anew.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes.computing.workers import Workers
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.pieces import finished, run_pieces
from cassini_bayes.report.plots import Figure
from cassini_bayes.report.study_page import Made, write_page
from cassini_bayes.studies.repeated import Repeated

Arrays = dict[str, NDArray[np.generic]]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Study:
    """How a study is run: where finished repetitions are kept, who works, where its page goes.

    ``command`` is the line that started it, ``progress`` is told what, how many are done, of how
    many.
    """

    seed: int
    work: Path
    page: Path
    workers: Workers
    command: Sequence[str]
    progress: Progress

    def repeat(self, name: str, label: str, repeated: Repeated, number: int) -> Arrays:
        """Run the repetitions that are not kept yet; arrays of all, with them as first axis.

        Whole files are worked out: a few more than ``number`` repetitions may come back.
        """
        known = repeated.identity()
        # other code or data have a folder of their own: nothing of theirs is lost
        store = CheckpointStore(self.work / name / known[:12], known)
        files = range(-(-number // repeated.per_file))
        pieces = {f"repetitions_{i:05d}": (i * repeated.per_file,) for i in files}
        for done, total in run_pieces(_block, repeated, pieces, store, self.workers):
            self.progress(label, done * repeated.per_file, total * repeated.per_file)
        blocks = [finished(store, piece) for piece in pieces]
        return {key: np.concatenate([block[key] for block in blocks]) for key in blocks[0]}

    def publish(
        self,
        title: str,
        body: str,
        module: str,
        tables: Mapping[str, pd.DataFrame | str],
        figures: Mapping[str, Figure | bytes],
    ) -> None:
        """Write the page; see :func:`cassini_bayes.report.study_page.write_page`."""
        made = Made(self.command, self.seed, module)
        write_page(self.page, title, body, made, tables, figures)


def _block(repeated: Repeated, first: int) -> Arrays:
    result = [repeated.repetition(first + i) for i in range(repeated.per_file)]
    return {key: np.stack([np.asarray(one[key]) for one in result]) for key in result[0]}
