"""Which branch an event has to be of, and where both go."""

from __future__ import annotations

import pytest

from cassini_bayes.errors import InputError
from cassini_bayes.events.branches import require_branch


def test_another_branch_is_sent_to_a_mission_file() -> None:
    """The refusal names the event and the way to fit both; the priors' own branch is taken."""
    require_branch("event a", "B", "B")
    with pytest.raises(InputError, match=r"event a: branch.*cassini-bayes trend MISSION.toml"):
        require_branch("event a", "A", "B")
