"""The study of mistakes: honest sets pass, and the page counts what was named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from study_cases import study_in

from cassini_bayes.studies.mistakes import (
    CASES,
    KINDS,
    MISTAKEN,
    VERDICTS,
    Honest,
    run_mistakes,
)
from cassini_bayes.studies.study import Arrays, Study

PRIORS = Path(__file__).parents[2] / "priors" / "cassini_b_branch_telemetry.toml"


def test_an_honest_set_passes_twice_alike() -> None:
    """A set has a random stream of its own; without mistakes nothing is refused."""
    first, again = (Honest(PRIORS, 3).repetition(0) for _ in range(2))
    assert first["effect"] == -1
    assert [VERDICTS[verdict] for verdict in np.asarray(first["verdict"])] == ["passed"] * 3
    assert all(np.array_equal(first[key], again[key]) for key in first)


def test_the_page_counts_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Verdicts made up: one event flagged, every mistake named in one of two sets."""
    named = [VERDICTS.index(MISTAKEN[name].names[0]) for name, _ in CASES]
    honest = np.zeros((4, len(KINDS)), dtype=np.int64)
    honest[1, 0] = VERDICTS.index("flagged")
    made_up: dict[str, Arrays] = {
        "honest": {
            "effect": np.array([-1, 0, -1, 1]),
            "verdict": honest,
            "misfit": np.ones((4, len(KINDS))),
        },
        "mistaken": {"verdict": np.array([named, np.zeros_like(named)])},
    }
    monkeypatch.setattr(Study, "repeat", lambda _, name, *__: made_up[name])
    study = study_in(tmp_path)
    run_mistakes(study, PRIORS, {"honest": 4, "mistaken": 2})
    page = study.page.read_text()
    assert "| bias | yes | 2 | 0 | 1 | 1.0 |" in page
    assert "Not passed: set 1, bias, thrust_scale: flagged (misfit 1.0)." in page
    assert page.count("| 2 | 1 | 0 | 0 | 1 |") == len(CASES)
