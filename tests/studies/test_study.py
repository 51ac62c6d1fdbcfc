"""A study: the same results on any number of workers, after any stop; one frame for its page."""

from __future__ import annotations

import itertools
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import run_cases
from numpy.typing import NDArray
from study_cases import study_in

from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.code import identity
from cassini_bayes.studies.repeated import Repeated
from cassini_bayes.studies.study import Study


@dataclass(frozen=True)
class Coin(Repeated):
    """Repetitions that are plain random numbers."""

    per_file = 2

    def identity(self) -> str:
        return identity(["coin", self.seed], [], "errors")

    def repetition(self, index: int) -> dict[str, NDArray[Any] | float | bool]:
        rng = np.random.default_rng((self.seed, index))
        return {"ranks": rng.uniform(size=3), "heads": bool(rng.uniform() < 0.5)}


def repeated(study: Study, seed: int = 5) -> dict[str, NDArray[np.generic]]:
    """Seven repetitions, in whole files."""
    return study.repeat("coin", "a coin", Coin(seed=seed), 7)


def test_order_and_number_of_workers_change_nothing(tmp_path: Path) -> None:
    """One process, two and three: the same arrays and the same files, byte for byte."""
    found = [repeated(study_in(tmp_path / str(jobs), jobs=jobs)) for jobs in (1, 2, 3)]
    assert found[0]["ranks"].shape == (8, 3)
    files = []
    for i, arrays in enumerate(found):
        assert all(np.array_equal(arrays[key], found[0][key]) for key in found[0])
        paths = sorted((tmp_path / str(i + 1)).rglob("*.npz"))
        files.append([(path.name, path.read_bytes()) for path in paths])
    assert files[0] == files[1] == files[2]
    assert len(files[0]) == 4
    expected = [Coin(seed=5).repetition(i)["ranks"] for i in range(8)]
    np.testing.assert_array_equal(found[0]["ranks"], expected)


def test_another_seed_starts_anew_and_loses_nothing(tmp_path: Path) -> None:
    """What belongs to other settings has a folder of its own."""
    first = repeated(study_in(tmp_path))
    other = repeated(study_in(tmp_path), seed=6)
    assert not np.array_equal(first["ranks"], other["ranks"])
    assert len(list(tmp_path.rglob("*.npz"))) == 8
    again = repeated(study_in(tmp_path))
    assert np.array_equal(first["ranks"], again["ranks"])


def test_a_study_killed_at_any_file_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGKILL before and within the writing of each file: the end is that of one left alone."""
    alone = repeated(study_in(tmp_path / "alone"))
    save = CheckpointStore.save
    for kill, within in itertools.product(range(4), (False, True)):
        folder = tmp_path / f"{kill}-{within}"
        count = itertools.count()

        def deadly(
            store: CheckpointStore, name: str, arrays: Any, at: int = kill, half: bool = within,
            count: Any = count,
        ) -> None:  # fmt: skip
            if next(count) == at:
                if half:
                    monkeypatch.setattr(Path, "replace", lambda *_: os.kill(os.getpid(), 9))
                    save(store, name, arrays)
                os.kill(os.getpid(), signal.SIGKILL)
            save(store, name, arrays)

        pid = os.fork()
        if not pid:
            try:
                monkeypatch.setattr(CheckpointStore, "save", deadly)
                repeated(study_in(folder))
            finally:
                os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == -signal.SIGKILL
        assert len(list(folder.rglob("r*.npz"))) == kill
        again = repeated(study_in(folder))
        assert all(np.array_equal(again[key], alone[key]) for key in alone)


def test_a_page_says_what_made_it_and_nothing_of_the_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Title, text, command, seed, versions and code; tables and figures beside it."""
    monkeypatch.chdir(tmp_path)
    inside, outside = str(tmp_path / "runs" / "x.toml"), "/elsewhere/of/mine/y.toml"
    command = ["cassini-bayes", "calibrate", inside, "--priors", outside]
    study = Study(
        7, tmp_path, tmp_path / "out" / "a.md", study_in(tmp_path).workers, command, print
    )
    table = pd.DataFrame({"x": [1.23456789]})
    study.publish("A title", "A text.\n\n", "errors", {"": table, "-b": "c\n1\n"}, {"": b"PNG"})
    text = (tmp_path / "out" / "a.md").read_text()
    assert text.startswith("# A title\n\nA text.\n\nMade by `cassini-bayes calibrate runs/x.toml")
    assert "--priors y.toml` (seed 7) with cassini_bayes" in text
    assert "Python 3" in text
    assert "numpy" in text
    assert "SHA-256 of the code" in text
    assert str(tmp_path) not in text
    assert "elsewhere" not in text
    assert (tmp_path / "out" / "a.csv").read_text() == "x\n1.23457\n"
    assert (tmp_path / "out" / "a-b.csv").read_text() == "c\n1\n"
    assert (tmp_path / "out" / "a.png").read_bytes() == b"PNG"


def test_studies_are_started_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """--trials scales every part, --quick and --jobs and --seed and --out do what they say."""
    from cassini_bayes.studies import totals_campaign

    seen: list[tuple[Study, dict[str, int]]] = []

    def taken(study: Study, events: str, priors: str, numbers: dict[str, int]) -> bool:
        assert Path(events).name == "flight_2009_2010.csv"
        assert Path(priors).suffix == ".toml"
        seen.append((study, dict(numbers)))
        return len(seen) > 1

    monkeypatch.setattr(totals_campaign, "calibrate_totals", taken)
    start = ["calibrate", "totals", "--out", str(tmp_path), "--seed", "3", "--jobs", "64"]
    assert run_cases.command([*start, "--trials", "20"]) == 1
    said = capsys.readouterr()
    assert said.out == f"{tmp_path / 'totals-sbc.md'}\n"
    assert said.err.count("64 jobs on") == 1
    assert run_cases.command([*start, "--quick", "--quiet"]) == 0
    assert capsys.readouterr().err == ""
    assert [numbers["none"] for _, numbers in seen] == [20, 200]
    assert [numbers["rectangular-pulses"] for _, numbers in seen] == [2, 60]
    assert {study.seed for study, _ in seen} == {3}
    assert run_cases.command([*start, "--trials", "20", "--quick"]) == 2
    assert "either --trials or --quick" in capsys.readouterr().err
