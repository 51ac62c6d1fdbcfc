"""An event in memory, or in the columns of others, is reduced as its folder is."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from totals_cases import ROOT

import cassini_bayes
from cassini_bayes.diagnosis.read import read_events
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry import TelemetryEvent
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.model import ReducedEvent
from cassini_bayes.pipeline.inputs import read_inputs
from cassini_bayes.pipeline.run_file import check_run

EXAMPLE = ROOT / "docs" / "examples" / "own_csv"
PRIORS = ROOT / "priors" / "cassini_b_branch_telemetry.toml"
DESCRIPTION = {
    "id": "may",
    "kind": "bias",
    "epoch": "2010-05-01T06:00:00Z",
    "branch": "B",
    "wheels": [1, 2, 4],
    "source": "simulation",
}


def in_memory(**attitude: Any) -> TelemetryEvent:
    """The tutorial's recording as a data frame; other keys of its attitude."""
    channels = read_toml(EXAMPLE / "channels.toml", "a channel map")
    channels["channels"]["attitude"].update(attitude)
    frame = pd.read_csv(EXAMPLE / "may.csv", sep=";")
    return cassini_bayes.event_from_frame(frame, DESCRIPTION, "cassini", channels)


def folder_of(place: Path) -> Path:
    """The same as an event folder."""
    lines = [f"{key} = {value!r}\n" for key, value in DESCRIPTION.items()]
    lines += [f'telemetry = "{EXAMPLE / "may.csv"}"\n', f'channels = "{EXAMPLE}/channels.toml"\n']
    place.mkdir()
    (place / "event.toml").write_text("".join(lines))
    return place


@cache
def reduced() -> ReducedEvent:
    """The event in memory, reduced."""
    return cassini_bayes.reduce_event(in_memory(), cassini_bayes.read_priors(PRIORS), "first_order")


def test_memory_and_folder_give_the_same_statistics(tmp_path: Path) -> None:
    """Gram matrices of the data frame and of the folder agree to the rounding of dates."""
    priors = cassini_bayes.read_priors(PRIORS)
    other = cassini_bayes.reduce_event(folder_of(tmp_path / "may"), priors, "first_order")
    assert reduced().reading == other.reading
    assert reduced().reading.content == other.reading.content
    for name, values in vars(reduced().statistics).items():
        if isinstance(values, np.ndarray):
            np.testing.assert_array_equal(values, getattr(other.statistics, name))


def test_an_event_in_memory_is_checked_as_a_folder_is() -> None:
    """Negative control: the inverse attitude is found in the motion, whatever it came from."""
    priors = cassini_bayes.read_priors(PRIORS)
    event = in_memory(direction="inertial_to_body")
    with pytest.raises(InputError, match="quaternions that look body → J2000"):
        cassini_bayes.reduce_event(event, priors, "first_order")


def test_a_diagnosis_takes_an_event_in_memory() -> None:
    """What reads events for a diagnosis takes the object where it takes a folder."""
    events = read_events([in_memory()], PRIORS)
    assert [event.id for event in events.telemetry] == ["may"]


def test_the_map_is_in_the_provenance(tmp_path: Path) -> None:
    """A run's digests have the event, with all that it is made from, and the map by itself."""
    folder = folder_of(tmp_path / "may")
    run = check_run({"events": [str(folder)], "priors": str(PRIORS)}, "test")
    digests = read_inputs(run, Path()).digests
    event = cassini_bayes.read_event(folder / "event.toml", "cassini")
    assert event.channels is not None
    assert digests[str(folder)] == event.digest
    assert digests[f"channels of {folder}"] == event.channels.digest
