"""Events of a mission as its file names them."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import pytest
import tomli_w
from event_cases import PRIORS, simulated
from mission_cases import mission_table, utc
from totals_cases import ROOT

from cassini_bayes.errors import InputError
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.model.mission.inputs import read_mission
from cassini_bayes.model.mission.mission_file import read_mission_file
from cassini_bayes.spacecraft.parameters import NOISE_LEVELS


def test_an_event_may_be_named_by_its_file(tmp_path: Path) -> None:
    """``event.toml`` stands for its folder: the same event, with the same digest."""
    priors = read_toml(ROOT / "priors" / "cassini_mission.toml", "priors")
    telemetry = read_toml(PRIORS, "priors")["parameters"]
    priors["parameters"] |= {name: telemetry[name] for name in NOISE_LEVELS}
    (tmp_path / "priors.toml").write_text(tomli_w.dumps(priors), "utf-8")
    digests = []
    for name in (simulated() / "bias", simulated() / "bias" / "event.toml"):
        trend = {"reference_epoch": date(2010, 5, 1)}
        mission = {"events": [str(name)], "priors": "priors.toml", "trend": trend}
        (tmp_path / "mission.toml").write_text(tomli_w.dumps(mission), "utf-8")
        file = read_mission_file(tmp_path / "mission.toml")
        digests.append(read_mission(file, tmp_path, "mission.toml").digests)
    assert digests[0] == digests[1]
    assert list(digests[0]) == ["bias"]


def test_a_swap_is_to_a_branch_of_the_spacecraft(tmp_path: Path) -> None:
    """Another one would stay unseen where no event is later. It is told before events are read."""
    swap = {"epoch": utc(2009, 3, 12), "what": "branch_swap", "source": "x"}
    for branch, message in (("Q", r"m: dated\[1\]\.branch: .*got 'Q'"), ("B", "events.csv")):
        mission = mission_table(dated=[{**swap, "branch": branch}])
        with pytest.raises(InputError, match=message):
            read_mission(mission, tmp_path, "m")
