"""What a diagnosis reads is checked as what a fit reads: mistakes are not taken for physics."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from event_cases import PRIORS, simulated

from cassini_bayes.diagnosis.read import read_events
from cassini_bayes.errors import InputError

RATES = [f"rate_{axis}_rad_s" for axis in "xyz"]
WHEELS = ["rwa1_rpm", "rwa2_rpm", "rwa4_rpm"]
ATTITUDE = ["q1", "q2", "q3", "q4"]
Change = Callable[[pd.DataFrame], None]


def degrees(table: pd.DataFrame) -> None:
    """Body rates in deg/s."""
    table[RATES] = np.degrees(table[RATES])


def radians(table: pd.DataFrame) -> None:
    """Wheel rates in rad/s."""
    table[WHEELS] *= 2.0 * np.pi / 60.0


def scalar_first(table: pd.DataFrame) -> None:
    """Quaternions with the scalar first."""
    table[ATTITUDE] = np.roll(table[ATTITUDE].to_numpy(), 1, axis=1)


def inverse(table: pd.DataFrame) -> None:
    """Quaternions of the inverse rotation."""
    table[ATTITUDE[:3]] *= -1.0


def changed(folder: Path, event: str, change: Change) -> Path:
    """A copy of a simulated event with changed telemetry."""
    copy = folder / event
    shutil.copytree(simulated() / event, copy)
    table = pd.read_csv(copy / "telemetry.csv")
    change(table)
    table.to_csv(copy / "telemetry.csv", index=False)
    return copy


@pytest.mark.parametrize(
    ("event", "change", "told"),
    [
        ("slews", degrees, "deg/s"),
        ("bias", radians, "rad/s"),
        ("slews", scalar_first, "scalar-first"),
        ("slews", inverse, "body → J2000"),
    ],
)
def test_a_mistake_is_named_before_any_cause(
    tmp_path: Path, event: str, change: Change, told: str
) -> None:
    """Units and conventions that a fit refuses are refused by a diagnosis, by the same name."""
    with pytest.raises(InputError, match=told):
        read_events([str(changed(tmp_path, event, change))], PRIORS)


def test_events_of_another_branch_are_refused(tmp_path: Path) -> None:
    """A-branch telemetry with B-branch priors is told, not explained by a cause."""
    copy = changed(tmp_path, "bias", lambda _: None)
    text = (copy / "event.toml").read_text(encoding="utf-8")
    (copy / "event.toml").write_text(text.replace('branch = "B"', 'branch = "A"'), encoding="utf-8")
    with pytest.raises(InputError, match="branch"):
        read_events([str(copy)], PRIORS)


def test_honest_events_are_read() -> None:
    """The same events without a mistake pass."""
    events = read_events([str(simulated() / name) for name in ("bias", "slews")], PRIORS)
    assert [event.id for event in events.telemetry] == ["bias", "slews"]


def test_two_processes_read_the_same_and_name_the_first_mistake(tmp_path: Path) -> None:
    """Events, in their order, as one process reads them; of two bad ones the first is named."""
    names = [str(simulated() / name) for name in ("bias", "slews")]
    one, two = (read_events(names, PRIORS, processes=n).telemetry for n in (1, 2))
    for old, new in zip(one, two, strict=True):
        assert (old.id, old.digest) == (new.id, new.digest)
        assert np.array_equal(old.statistics.gram, new.statistics.gram)
    for name in ("bias", "slews"):
        shutil.copytree(simulated() / name, tmp_path / name)
    lacks = [tmp_path / name / "telemetry.csv" for name in ("bias", "slews")]
    for path in lacks:
        path.unlink()
    with pytest.raises(InputError, match="bias"):
        read_events([str(path.parent) for path in lacks], PRIORS, processes=2)
