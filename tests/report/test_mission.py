"""Reports of missions: figures are named by what they show and their branch."""

from __future__ import annotations

import pytest

from cassini_bayes.report.mission import CAPTIONS, _caption


@pytest.mark.parametrize("branch", ["A", "main_a", "x.y-2"])
@pytest.mark.parametrize("what", CAPTIONS)
def test_a_caption_names_the_branch(what: str, branch: str) -> None:
    """Also one whose name has an underscore."""
    assert _caption(f"{what}_{branch}") == f"Branch {branch}: {CAPTIONS[what]}"
