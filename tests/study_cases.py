"""A study that is run in this process, silently."""

from __future__ import annotations

from pathlib import Path

from cassini_bayes.computing.workers import LocalWorkers
from cassini_bayes.studies.study import Study


def study_in(folder: Path, page: Path | None = None, seed: int = 5, jobs: int = 1) -> Study:
    """A study that keeps its repetitions in a folder."""

    def silent(what: str, done: int, total: int) -> None:
        assert what
        assert 0 <= done <= total

    place = folder / "page.md" if page is None else page
    return Study(seed, folder, place, LocalWorkers(jobs), ["cassini-bayes", "study"], silent)
