"""Where a fit came from: inputs are found again, and only as they were."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest
from event_cases import simulated
from prediction_cases import model, write_chained, write_earlier, write_run_folder
from totals_cases import B_BRANCH, FLIGHT

from cassini_bayes.balance.totals_system import NOISE
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry import read_event
from cassini_bayes.files.storage import digest
from cassini_bayes.pipeline.inputs import read_inputs
from cassini_bayes.pipeline.run_file import check_run
from cassini_bayes.prediction.sources import learn_from_fit, locate, read_sources, sources_of


def test_inputs_are_found_from_a_run_folder_elsewhere(tmp_path: Path) -> None:
    """From where the run's record says; what has changed there is named, what is gone is not."""
    inputs, run = tmp_path / "study" / "inputs", tmp_path / "far" / "away" / "run"
    inputs.mkdir(parents=True)
    run.mkdir(parents=True)
    table = inputs / "priors.toml"
    table.write_text("a = 1\n")
    record = {"sha256": {"inputs/priors.toml": digest(table)}, "base": "../../../study"}
    (run / "provenance.json").write_text(json.dumps(record))
    assert locate(run / "fit.nc", "inputs/priors.toml", "--priors") == table
    table.write_text("a = 2\n")
    with pytest.raises(
        InputError,
        match=r"study/inputs/priors.toml, which has changed; restore it, name an unchanged copy",
    ):
        locate(run / "fit.nc", "inputs/priors.toml", "--priors")
    table.unlink()
    with pytest.raises(InputError, match="got no such file; name it with --priors"):
        locate(run / "fit.nc", "inputs/priors.toml", "--priors")


def test_a_spacecraft_file_that_has_changed_is_named(tmp_path: Path) -> None:
    """Of a spacecraft in a file of its own, draws are taken with that file as it was alone: it is
    in the record beside the priors, and records without it are taken as before.
    """
    craft, priors = tmp_path / "craft" / "mine.toml", tmp_path / "inputs" / "priors.toml"
    for path in (craft, priors):
        path.parent.mkdir()
    craft.write_bytes((resources.files("cassini_bayes.spacecraft") / "cassini.toml").read_bytes())
    priors.write_text(
        B_BRANCH.read_text().replace('name = "cassini"', 'file = "../craft/mine.toml"')
    )
    events = f"{FLIGHT}:2009-08-22-bias"
    said = check_run({"events": [events], "priors": "inputs/priors.toml"}, "run.toml")
    before = read_inputs(said, tmp_path).digests
    assert before["craft/mine.toml"] == digest(craft)
    fit = tmp_path / "run" / "fit.nc"
    fit.parent.mkdir()
    record = {"sha256": dict(before), "base": ".."}
    (fit.parent / "provenance.json").write_text(json.dumps(record))
    assert locate(fit, "inputs/priors.toml", "--priors") == priors
    craft.write_text(craft.read_text() + "\n# changed\n")
    changed = r"expected craft/mine.toml as it was .*got .*craft/mine.toml, which has changed"
    with pytest.raises(InputError, match=changed):
        locate(fit, "inputs/priors.toml", "--priors")
    after = read_inputs(said, tmp_path).digests
    assert [name for name in after if after[name] != before[name]] == ["craft/mine.toml"]
    del record["sha256"]["craft/mine.toml"]
    (fit.parent / "provenance.json").write_text(json.dumps(record))
    assert locate(fit, "inputs/priors.toml", "--priors") == priors


def test_an_event_named_by_its_file_is_found_and_read(tmp_path: Path) -> None:
    """``event.toml`` in a run's record has the event's digest: unchanged it is found, and only so.
    Named with ``events`` it stands for its folder as well.
    """
    named, priors = str(tmp_path / "ev" / "event.toml"), model().priors
    shutil.copytree(simulated() / "bias", tmp_path / "ev")
    fit = write_run_folder(tmp_path)
    event = read_event(tmp_path / "ev", priors.spacecraft)
    record = {"sha256": {named: event.digest}, "base": ""}
    (fit.parent / "provenance.json").write_text(json.dumps(record))
    assert locate(fit, named, "--events", priors) == tmp_path / "ev"
    with pytest.raises(InputError, match="got no such file"):  # no folder around is the event
        locate(fit, "event.toml", "--events", priors)
    sources = read_sources(fit, named, B_BRANCH)
    assert [row.id for row in sources.events] == [event.id]
    with Path(named).open("a") as stream:
        stream.write("# changed\n")
    with pytest.raises(InputError, match="which has changed"):
        locate(fit, named, "--events", priors)


def test_what_telemetry_did_not_need_is_asked_for_at_once() -> None:
    """All that the priors lack in one message, and where to put it; a wrong layout comes first."""
    own = model().priors
    kept = {name: prior for name, prior in own.parameters.items() if name not in NOISE}
    bare = replace(own, parameters=kept)
    with pytest.raises(InputError, match="a copy, and name it with --priors") as raised:
        sources_of(replace(model(), priors=bare))
    assert all(name in str(raised.value) for name in NOISE)
    craft = own.spacecraft
    other = replace(craft, axis_pairs={**craft.axis_pairs, "+y": craft.axis_pairs["+x"]})
    with pytest.raises(InputError, match=r"axis_pairs .* expected two axes that share"):
        sources_of(replace(model(), priors=replace(bare, spacecraft=other)))


def test_events_named_by_hand_are_those_of_the_fit(tmp_path: Path) -> None:
    """A copy elsewhere is taken, one with another mass is not."""
    fit = write_run_folder(tmp_path)
    moved = tmp_path / "moved.csv"
    shutil.copy(FLIGHT, moved)
    assert len(read_sources(fit, str(moved)).events) == 8
    changed = FLIGHT.read_text().replace("2379.1", "2379.2")
    assert changed != FLIGHT.read_text()
    moved.write_text(changed)
    with pytest.raises(InputError, match=r"--events .*as they were when the fit was made"):
        read_sources(fit, str(moved))


def fixed_in(priors: str, name: str, value: float, unit: str) -> str:
    """The text of a priors file with a parameter fixed at a value."""
    start = priors.index(f"[parameters.{name}]")
    end = priors.index("\n[", start)
    own = f'[parameters.{name}]\nfixed = {value}\nunit = "{unit}"\nsource = "x"\n'
    return priors[:start] + own + priors[end:]


def test_priors_named_by_hand_leave_free_what_the_fit_drew(tmp_path: Path) -> None:
    """A value fixed there would take the place of the fit's draws, silently."""
    fit = write_run_folder(tmp_path)
    other = tmp_path / "other.toml"
    other.write_text(fixed_in(B_BRANCH.read_text(), "cm_x_m", 0.08, "m"))
    sources = read_sources(fit, priors=other)
    with pytest.raises(InputError, match="cm_x_m is free, as in the fit"):
        learn_from_fit(fit, sources, 1)


def test_a_fit_with_one_wheels_inertia_fixed_is_taken(tmp_path: Path) -> None:
    """``fit.nc`` has it beside the free ones, all draws alike; another value there is refused."""
    own, other = tmp_path / "own.toml", tmp_path / "other.toml"
    for path, value in ((own, 0.161), (other, 0.1611)):
        text = fixed_in(B_BRANCH.read_text(), "rwa1_inertia_kg_m2", value, "kg m2")
        path.write_text(text)
    fit = write_run_folder(tmp_path, priors=own)
    learned = learn_from_fit(fit, read_sources(fit), 1)
    assert learned.physics.parameters["rwa1_inertia_kg_m2"] == 0.161
    with pytest.raises(InputError, match=r"rwa1_inertia_kg_m2 is 0.161, as in the fit, got 0.1611"):
        learn_from_fit(fit, read_sources(fit, priors=other), 1)


def test_the_earlier_fit_of_the_priors_is_that_of_the_run(tmp_path: Path) -> None:
    """Replaced since, it is named; as it was (control) the sources are read."""
    earlier, fit = write_chained(tmp_path)
    priors = read_sources(fit).priors
    assert priors.earlier is not None
    assert Path(priors.earlier.path) == earlier
    write_earlier(earlier, seed=3)
    with pytest.raises(InputError, match=r"first/fit.nc, which its priors begin with, .*another"):
        read_sources(fit)
