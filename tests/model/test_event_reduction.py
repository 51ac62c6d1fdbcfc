"""Event folders to Gram matrices: cached by content, never stale, never for another branch."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from event_cases import events, priors, simulated

from cassini_bayes.errors import InputError
from cassini_bayes.model import event_reduction
from cassini_bayes.model.event_reduction import last_time, reduce_event, store_reduction


def test_the_cache_gives_the_same_and_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What comes from the cache equals what was reduced, without reading the telemetry again."""
    (fresh,) = events("bias")
    store_reduction(fresh, tmp_path)

    def never(*_: object, **__: object) -> None:
        raise AssertionError("read again")

    monkeypatch.setattr(event_reduction, "read_chunks", never)
    again = reduce_event(simulated() / "bias", priors(), "first_order", tmp_path)
    assert np.array_equal(again.statistics.gram, fresh.statistics.gram)
    assert (again.reading, again.key, again.sampling) == (fresh.reading, fresh.key, fresh.sampling)


def test_a_damaged_or_foreign_cache_is_not_used(tmp_path: Path) -> None:
    """A cut archive is reduced again; another pulse shape or telemetry has another key."""
    (fresh,) = events("bias")
    store_reduction(fresh, tmp_path)
    archive = tmp_path / f"{fresh.key}.npz"
    archive.write_bytes(archive.read_bytes()[:1000])
    again = reduce_event(simulated() / "bias", priors(), "first_order", tmp_path)
    assert np.array_equal(again.statistics.gram, fresh.statistics.gram)
    other = reduce_event(simulated() / "bias", priors(), "rectangular")
    assert other.key != fresh.key
    copy = tmp_path / "bias"
    shutil.copytree(simulated() / "bias", copy)
    text = (copy / "telemetry.csv").read_text()
    (copy / "telemetry.csv").write_text("\n".join(text.splitlines()[:-5]) + "\n")
    assert reduce_event(copy, priors(), "first_order").key != fresh.key


def test_a_wrong_guess_of_the_last_time_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The guess from the file's tail only spares a pass."""
    (fresh,) = events("bias")
    monkeypatch.setattr(event_reduction, "last_time", lambda _: 1.0)
    again = reduce_event(simulated() / "bias", priors(), "first_order")
    assert again.sampling.duration_s == fresh.sampling.duration_s
    assert np.array_equal(again.statistics.projection, fresh.statistics.projection)


def test_long_reading_tells_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines of progress with rows, share and time left, all of the rows by the last one."""
    monkeypatch.setattr(event_reduction, "_TELL_S", 0.0)
    lines: list[str] = []
    reduced = reduce_event(simulated() / "bias", priors(), "first_order", say=lines.append)
    assert lines[-2].startswith(f"bias: {reduced.reading.rows:,} rows read, 100% of the time, 0 s")


def test_last_time_of_a_tail(tmp_path: Path) -> None:
    """The last row's time; 1 where the tail does not tell."""
    path = tmp_path / "telemetry.csv"
    path.write_text("q1,time_s\n0,0\n0,12.5\n\n")
    assert last_time(path) == 12.5
    path.write_text("q1,time_s\n0,0\n0,nonsense\n")
    assert last_time(path) == 1.0
    assert last_time(tmp_path / "missing.csv") == 1.0


def test_counters_gained_are_those_of_the_file() -> None:
    """On-times and pulses of the record are the last reading minus the first."""
    (event,) = events("bias")
    lines = (simulated() / "bias" / "telemetry.csv").read_text().splitlines()
    header, last = lines[0].split(","), lines[-1].split(",")
    for k, name in enumerate(event.event.thrusters):
        assert event.reading.on_time_s[k] == float(last[header.index(f"on_time_{name}_s")])
        assert event.reading.pulses[k] == float(last[header.index(f"pulses_{name}")])
    assert event.reading.rows == len(lines) - 1


def test_another_branch_is_refused(tmp_path: Path) -> None:
    """Priors of one branch say nothing of the other's thrusters."""
    copy = tmp_path / "bias"
    shutil.copytree(simulated() / "bias", copy)
    text = (copy / "event.toml").read_text().replace('branch = "B"', 'branch = "A"')
    (copy / "event.toml").write_text(text)
    with pytest.raises(InputError, match="branch"):
        reduce_event(copy, priors(), "first_order")
