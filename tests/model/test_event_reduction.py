"""Event folders to Gram matrices: cached by content, never stale, never for another branch."""

from __future__ import annotations

import copy
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from event_cases import events, priors, simulated
from run_cases import B_BRANCH

from cassini_bayes.computing.arrays import joined
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry import Chunk, event_from_frame, read_event
from cassini_bayes.events.telemetry.tail import last_time
from cassini_bayes.model import event_reduction, reduce_event, reduce_samples
from cassini_bayes.model.event_reduction import store_reduction
from cassini_bayes.priors.reader import read_priors


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
    other_place = tmp_path / "bias"
    shutil.copytree(simulated() / "bias", other_place)
    text = (other_place / "telemetry.csv").read_text()
    (other_place / "telemetry.csv").write_text("\n".join(text.splitlines()[:-5]) + "\n")
    assert reduce_event(other_place, priors(), "first_order").key != fresh.key
    # mistakes are judged by the priors' values: what was found of another thrust is another's
    thrust = replace(priors().parameters["thrust_common_n"], distribution=None, fixed=1.5)
    changed = replace(priors(), parameters={**priors().parameters, "thrust_common_n": thrust})
    assert reduce_event(simulated() / "bias", changed, "first_order").key != fresh.key


def test_a_wrong_guess_of_the_last_time_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The guess from the file's tail only spares a pass."""
    (fresh,) = events("bias")
    monkeypatch.setattr(event_reduction, "last_time", lambda _: 1.0)
    again = reduce_event(simulated() / "bias", priors(), "first_order")
    assert again.sampling.duration_s == fresh.sampling.duration_s
    assert np.array_equal(again.statistics.projection, fresh.statistics.projection)


def test_long_reading_tells_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines of progress with rows, share and time left, all of the rows by the last one."""
    monkeypatch.setattr(event_reduction, "_LOG_EVERY_S", 0.0)
    lines: list[str] = []
    reduced = reduce_event(simulated() / "bias", priors(), "first_order", log=lines.append)
    assert lines[-2].startswith(f"bias: {reduced.reading.rows:,} rows read, 100% of the time, 0 s")


@pytest.mark.parametrize(("kept", "passes"), [(200_000, 1), (10, 4)])
def test_a_file_is_parsed_once_unless_it_is_long(
    monkeypatch: pytest.MonkeyPatch, kept: int, passes: int
) -> None:
    """Whoever asks for rows gets those that are kept; a long file is streamed anew, the same."""
    original, opened = event_reduction.read_chunks, []

    def counted(*arguments: Any, **options: Any) -> Iterator[Chunk]:
        opened.append(1)
        return original(*arguments, **options)

    monkeypatch.setattr(event_reduction, "read_chunks", counted)
    monkeypatch.setattr(event_reduction, "MOST_KEPT", kept)
    event = reduce_event(simulated() / "bias", priors(), "first_order")
    first, second = ([own.time_s for own in event.rows] for _ in range(2))
    assert len(opened) == passes
    assert np.array_equal(np.concatenate(first), np.concatenate(second))
    assert sum(map(len, first)) == event.reading.rows


def test_rows_do_not_travel_with_an_event() -> None:
    """A copy for another process is small, and reads the file itself."""
    (event,) = events("bias")
    read = [len(own) for own in event.rows]
    kept = copy.deepcopy(event.rows)  # by the same protocol as pickle
    assert kept._rows._kept is None
    assert [len(own) for own in kept] == read


def test_samples_in_memory_reduce_like_those_of_the_file() -> None:
    """The same rows, the same Gram matrices and counters gained, without a folder."""
    (event,) = events("bias")
    samples = joined(list(event.rows))
    layout = event.statistics.layout
    again = reduce_samples("bias", "bias", layout.wheels, layout.thrusters, samples, event.sampling)
    assert again.statistics.gram == pytest.approx(event.statistics.gram, rel=1e-12)
    assert again.reading == replace(event.reading, mends=())
    assert (again.id, again.kind, again.fires) == (event.id, event.kind, event.fires)


def test_last_time_of_a_tail(tmp_path: Path) -> None:
    """The last row's time; 1 where the tail does not tell."""
    path = tmp_path / "telemetry.csv"
    event = replace(read_event(simulated() / "bias", priors().spacecraft), telemetry=path)
    path.write_text("q1,time_s\n0,0\n0,12.5\n\n")
    assert last_time(event) == 12.5
    path.write_text("q1,time_s\n0,0\n0,nonsense\n")
    assert last_time(event) == 1.0
    path.unlink()
    assert last_time(event) == 1.0


def test_counters_gained_are_those_of_the_file() -> None:
    """On-times and pulses of the record are the last reading minus the first."""
    (event,) = events("bias")
    lines = (simulated() / "bias" / "telemetry.csv").read_text().splitlines()
    header, last = lines[0].split(","), lines[-1].split(",")
    for k, name in enumerate(event.statistics.layout.thrusters):
        assert event.reading.on_time_s[k] == float(last[header.index(f"on_time_{name}_s")])
        assert event.reading.pulses[k] == float(last[header.index(f"pulses_{name}")])
    assert event.reading.rows == len(lines) - 1


def test_priors_of_totals_are_refused() -> None:
    """They lack what telemetry needs: the parameter is named, and what to add."""
    totals = read_priors(B_BRANCH)
    with pytest.raises(InputError, match=r"rate_noise_rad_s: .*needed by telemetry"):
        reduce_event(simulated() / "bias", totals, "first_order")


def test_another_branch_is_refused(tmp_path: Path) -> None:
    """Priors of one branch say nothing of the other's thrusters."""
    other_place = tmp_path / "bias"
    shutil.copytree(simulated() / "bias", other_place)
    text = (other_place / "event.toml").read_text().replace('branch = "B"', 'branch = "A"')
    (other_place / "event.toml").write_text(text)
    with pytest.raises(InputError, match="branch"):
        reduce_event(other_place, priors(), "first_order")


@pytest.mark.parametrize("late_s", [-4e3, -300.0, 3e3, 9.8e8, 1.7e12])
def test_a_first_row_later_than_the_event_is_long_is_refused(late_s: float) -> None:
    """Another epoch, or a clock's count for time: torque noise would lie before the first row.

    With 9.8e8 s an inertia was 2.5 standard deviations off, and nothing was said but a note.
    """
    folder, spacecraft = simulated() / "bias", priors().spacecraft
    rows = pd.read_csv(folder / "telemetry.csv")
    late = rows.assign(time_s=rows["time_s"] + late_s)
    event = event_from_frame(late, folder, spacecraft)
    with pytest.raises(InputError) as caught:
        reduce_event(event, priors(), "first_order")
    assert caught.value.expected.startswith("the time of the first row")
    assert ("give epoch" in caught.value.fix) == (late_s < 1e12)


def test_a_burn_without_motion_is_refused_in_a_line() -> None:
    """It can be read, with counters and velocity change, and is no data of a momentum balance."""
    folder, spacecraft = simulated() / "bias", priors().spacecraft
    rows = pd.read_csv(folder / "telemetry.csv")
    counters = [name for name in rows.columns if name.startswith(("time", "on_time", "pulses"))]
    burn = rows[counters].assign(**{f"delta_v_{axis}_m_s": 0.0 for axis in "xyz"})
    said = {
        "id": "burn",
        "kind": "delta_v",
        "epoch": "2010-05-01T06:00:00Z",
        "branch": "B",
        "wheels": [1, 2, 4],
        "source": "simulation",
        "delta_v_source": "measured",
    }
    event = event_from_frame(burn, said, spacecraft)
    with pytest.raises(InputError, match="at least 5 rows with attitude, body rates and wheel"):
        reduce_event(event, priors(), "first_order")
