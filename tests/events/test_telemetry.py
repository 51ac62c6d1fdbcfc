"""Telemetry is read exactly, mended with a note where that is safe, and refused otherwise."""

from __future__ import annotations

import hashlib
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from event_folder_cases import (
    BIAS,
    CASSINI,
    SLEW,
    THRUSTERS,
    Change,
    Rows,
    bias_rows,
    csv_text,
    motion_rows,
    write_event,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from simulation_cases import BIAS as BIAS_EVENT
from simulation_cases import EPOCH, PARAMETERS

from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry import Chunk, Mends, load_event, read_chunks, read_event
from cassini_bayes.events.telemetry.counters import wrap_sizes
from cassini_bayes.events.telemetry.csv_file import CsvTable
from cassini_bayes.events.telemetry.event import event_path
from cassini_bayes.simulation import scenario_of
from cassini_bayes.spacecraft import load_spacecraft
from cassini_bayes.studies.scenario import simulate_file, write_simulation

ARRAYS = (
    *("time_s", "attitude", "rate_rad_s", "wheel_rpm"),
    *("on_time_s", "pulses", "delta_v_m_s", "tank_pressure_kpa"),
)


def load(folder: Path, mends: Mends | None = None) -> Chunk:
    """All rows of an event folder."""
    return load_event(read_event(folder, CASSINI), CASSINI, mends)


def refusal(folder: Path) -> str:
    """The one-line message about a bad event folder."""
    with pytest.raises(InputError) as caught:
        load(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert "expected" in message
    return message


def same(one: Chunk, other: Chunk) -> bool:
    """Whether two chunks agree in every array, exactly."""
    return all(
        np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True) for name in ARRAYS
    )


def spoilt(change: Change, rows: Rows | None = None) -> Rows:
    """Bias rows after a change."""
    result = bias_rows() if rows is None else rows
    change(result)
    return result


def set_cell(row: int, column: str, value: str) -> Change:
    """A change of one cell; row 0 is line 2 of the file."""
    return lambda rows: rows[row].update({column: value})


# ---------------------------------------------------------------- what is read


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, object]:
    """A simulated bias with channels at different rates, and its telemetry in memory."""
    document = {
        "spacecraft": {"name": "cassini", "branch": "B", "wheels": [1, 2, 4]},
        "truth": {**PARAMETERS, "thrust_common_n": 0.75, "fsw_impulse_offset_s": 0.01},
        "event": [{**BIAS_EVENT, "epoch": EPOCH, "duration_s": 300.0, "settle_s": 0.0}],
        "telemetry": {
            "rate_every_s": 4.0,
            "wheel_every_s": 4.0,
            "counter_every_s": 10.0,
            "delta_v": "measured",
            "pressure": True,
            "rate_noise_rad_s": 2e-6,
            "wheel_noise_rpm": 0.2,
            "attitude_noise_rad": 2e-5,
            "drop_out": 0.05,
        },
    }
    simulation = simulate_file(scenario_of(document), 7)
    folder = tmp_path_factory.mktemp("simulated")
    write_simulation(simulation, folder)
    return folder / "bias", simulation.events[0].telemetry


def test_a_simulated_event_comes_back(simulated: tuple[Path, object]) -> None:
    """Round trip: what the simulation had in memory is what the reader gives, to 12 digits."""
    folder, telemetry = simulated
    event = read_event(folder, CASSINI)
    assert (event.id, event.kind, event.branch) == ("bias", "bias", "B")
    assert (event.wheels, event.thrusters) == ((1, 2, 4), THRUSTERS)
    assert event.delta_v_source == "measured"
    mends = Mends()
    chunk = load_event(event, CASSINI, mends)
    assert mends.found == ()
    columns = telemetry.columns  # type: ignore[attr-defined]
    for array, names in (
        (chunk.rate_rad_s, [f"rate_{axis}_rad_s" for axis in "xyz"]),
        (chunk.wheel_rpm, ["rwa1_rpm", "rwa2_rpm", "rwa4_rpm"]),
        (chunk.on_time_s, [f"on_time_{k}_s" for k in THRUSTERS]),
        (chunk.pulses, [f"pulses_{k}" for k in THRUSTERS]),
        (chunk.delta_v_m_s, [f"delta_v_{axis}_m_s" for axis in "xyz"]),
        (chunk.tank_pressure_kpa[:, None], ["tank_pressure_kpa"]),
        (chunk.attitude, ["q1", "q2", "q3", "q4"]),
    ):
        written = np.stack([columns[name] for name in names], axis=1)
        assert np.isnan(array).sum() > 0 or names == ["q1"]
        np.testing.assert_allclose(array, written, rtol=1e-11, atol=1e-11)
    np.testing.assert_array_equal(chunk.time_s, telemetry.time_s)  # type: ignore[attr-defined]
    assert chunk.first_row == 2


@pytest.mark.parametrize("rows", [1, 7, 64])
def test_the_size_of_chunks_changes_nothing(simulated: tuple[Path, object], rows: int) -> None:
    """What one row says about the next is carried across chunks."""
    event = read_event(simulated[0], CASSINI)
    whole = load_event(event, CASSINI)
    parts = list(read_chunks(event, CASSINI, rows))
    assert [part.first_row for part in parts] == list(range(2, whole.rows + 2, rows))
    for name in ARRAYS:
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(whole, name))


def test_parquet_gives_the_same(simulated: tuple[Path, object], tmp_path: Path) -> None:
    """The same columns in a Parquet file, nulls for what was not sampled; rows count from 1."""
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    source = simulated[0]
    frame = pd.read_csv(source / "telemetry.csv")
    (tmp_path / "event.toml").write_bytes((source / "event.toml").read_bytes())
    frame.to_parquet(tmp_path / "telemetry.parquet")
    mends = Mends()
    read, written = load(tmp_path, mends), load(source)
    for name in ARRAYS:
        np.testing.assert_allclose(getattr(read, name), getattr(written, name), rtol=1e-14)
    assert mends.found == ()
    frame.loc[20, "rate_x_rad_s"] = 0.3
    frame.to_parquet(tmp_path / "telemetry.parquet")
    assert "row 21, column rate_x_rad_s" in refusal(tmp_path)
    frame["q1"] = frame["q1"].astype(str)
    frame.to_parquet(tmp_path / "telemetry.parquet")
    assert "column q1" in refusal(tmp_path)
    (tmp_path / "telemetry.parquet").write_bytes(b"PAR1 no such file")
    assert "a Parquet file" in refusal(tmp_path)


def test_parquet_without_its_library_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The extra is named."""
    write_event(tmp_path, bias_rows())
    (tmp_path / "telemetry.csv").rename(tmp_path / "telemetry.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert "cassini-bayes[parquet]" in refusal(tmp_path)


def test_arrays_are_read_only(tmp_path: Path) -> None:
    """Nobody downstream changes what others read."""
    chunk = load(write_event(tmp_path, bias_rows()))
    with pytest.raises(ValueError, match="read-only"):
        chunk.attitude[0, 0] = 1.0


def test_channels_that_a_file_lacks_are_zero_wide(tmp_path: Path) -> None:
    """A slew has no counters; its pressure is not sampled."""
    event = read_event(write_event(tmp_path, motion_rows(), SLEW), CASSINI)
    chunk = load_event(event, CASSINI)
    assert (event.thrusters, event.delta_v_source) == ((), None)
    assert chunk.on_time_s.shape == chunk.pulses.shape == (40, 0)
    assert chunk.delta_v_m_s.shape == (40, 0)
    assert np.isnan(chunk.tank_pressure_kpa).all()


def test_columns_follow_the_wheels_of_the_event(tmp_path: Path) -> None:
    """Names decide, not places: another order of wheels orders the array."""
    folder = write_event(tmp_path, bias_rows(), {**BIAS, "wheels": "[4, 1, 2]"})
    assert load(folder).wheel_rpm[0].tolist() == [330.0, -1100.5, 1290.0]


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=20))
@settings(max_examples=300)
def test_numbers_are_rounded_correctly(values: list[float]) -> None:
    """Every finite double, written in several ways, is read as Python's own float reads it."""
    path = Path(__file__).parent / "made-up.csv"
    for form in ("{!r}", "{:.12g}", "{:+.17e}", "{:.16E}", " {:.20g} "):
        cells = [form.format(value) for value in values]
        table = CsvTable(path, _Bytes(("a\n" + "\n".join(cells)).encode()))
        (block,) = table.blocks(100, Mends())
        assert block.cells[0].tolist() == [float(cell) for cell in cells]


class _Bytes:
    """Bytes as an open file that gives three at a time."""

    def __init__(self, content: bytes) -> None:
        self._content = content

    def readline(self, _limit: int) -> bytes:
        end = self._content.find(b"\n") + 1 or len(self._content)
        line, self._content = self._content[:end], self._content[end:]
        return line

    def readinto(self, place: memoryview) -> int:
        part, self._content = self._content[:3], self._content[3:]
        place[: len(part)] = part
        return len(part)


@pytest.mark.parametrize(
    "transform",
    [
        lambda text: b"\xef\xbb\xbf" + text,
        lambda text: text.replace(b"\n", b"\r\n"),
        lambda text: text.replace(b"\n", b"\n\n"),
        lambda text: text.replace(b",", b" , "),
        lambda text: text.rstrip(b"\n"),
        lambda text: text.replace(b"1290", b'"1290"'),
        lambda text: text.replace(b"1290", b"+1.29e3"),
    ],
    ids=["mark", "CRLF", "blank lines", "blanks", "no last newline", "quotes", "exponent"],
)
def test_other_editors_are_tolerated(tmp_path: Path, transform: Callable[[bytes], bytes]) -> None:
    """What spreadsheets and editors do to a file changes nothing."""
    text = csv_text(bias_rows()).encode()
    changed = load(write_event(tmp_path / "changed", transform(text)))
    assert same(changed, load(write_event(tmp_path / "plain", text)))


def test_line_numbers_count_blank_lines(tmp_path: Path) -> None:
    """A message names the line that an editor shows."""
    text = csv_text(spoilt(set_cell(3, "q1", "9"))).replace("\n", "\n\n")
    assert "line 9, column q1" in refusal(write_event(tmp_path, text))


def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    """Forty times the rows need the same memory; a file of any size can be streamed."""
    peaks = []
    for count in (5_000, 200_000):
        header, *lines = csv_text(motion_rows(2)).splitlines()
        rest = lines[0].split(",", 1)[1]
        text = "\n".join([header, *(f"{i},{rest}" for i in range(count))])
        event = read_event(write_event(tmp_path, text, SLEW), CASSINI)
        del text
        tracemalloc.start()
        assert sum(chunk.rows for chunk in read_chunks(event, CASSINI, 2_000)) == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]


def test_too_many_rows_at_once_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loading a huge file names the way to stream it."""
    monkeypatch.setattr("cassini_bayes.events.telemetry.reader.MOST_ROWS", 30)
    assert "read_chunks" in refusal(write_event(tmp_path, bias_rows()))


# ---------------------------------------------------------------- event.toml


def test_an_event_named_by_its_file_is_the_folder(tmp_path: Path) -> None:
    """There or not; a folder of that name is one, and any other path stays as it was written."""
    named = tmp_path / "a" / "event.toml"
    assert event_path(named) == event_path(str(named)) == str(tmp_path / "a")
    named.mkdir(parents=True)
    for path in (str(named), "./totals.csv:event.toml", "a//b/"):
        assert event_path(path) == path


def test_an_event_is_described(tmp_path: Path) -> None:
    """Every key, and a digest of both files."""
    folder = write_event(tmp_path / "another name", bias_rows())
    event = read_event(str(folder), CASSINI)
    assert (event.id, event.source) == ("b", "made up")
    assert event.epoch == datetime(2010, 2, 13, 12, tzinfo=UTC)
    digests = [
        hashlib.sha256((folder / name).read_bytes()).hexdigest()
        for name in ("event.toml", "telemetry.csv")
    ]
    assert event.digest == hashlib.sha256(" ".join(digests).encode()).hexdigest()


@pytest.mark.parametrize(
    ("text", "hours"),
    [
        ('"2010-02-13T12:00:00+02:00"', 10),
        ('"2010-02-13T12:00:00"', 12),
        ('"2010-02-13"', 0),
        ("2010-02-13T12:00:00Z", 12),
        ("2010-02-13T12:00:00-01:00", 13),
        ("2010-02-13T12:00:00", 12),
        ("2010-02-13", 0),
    ],
)
def test_epochs_become_utc(tmp_path: Path, text: str, hours: int) -> None:
    """With a zone it is converted, without one it is UTC; TOML's own times will do."""
    event = read_event(write_event(tmp_path, bias_rows(), {**BIAS, "epoch": text}), CASSINI)
    assert event.epoch == datetime(2010, 2, 13, hours, tzinfo=UTC)
    assert event.epoch.tzinfo is UTC


BAD_KEYS = [
    ("id", "12", ["id", "a text", "12"]),
    ("id", '" "', ["a text"]),
    ("kind", '"biases"', ["kind", "did you mean 'bias'"]),
    ("kind", "1", ["slew, bias, quiescent, delta_v"]),
    ("epoch", '"13 Feb 2010"', ["epoch", "ISO 8601", "13 Feb 2010"]),
    ("epoch", "12", ["ISO 8601"]),
    ("epoch", "12:00:00", ["ISO 8601"]),
    ("branch", '"C"', ["branch", "A, B"]),
    ("wheels", '"1 2 4"', ["wheels", "a list of wheels out of [1, 2, 3, 4]"]),
    ("wheels", "[1, 2, 5]", ["[1, 2, 5]"]),
    ("wheels", "[1, 2, 2]", ["each wheel once"]),
    ("wheels", "[true, 2, 3]", ["a list of wheels"]),
    ("wheels", "[]", ["a list of wheels"]),
    ("wheels", "[1.0, 2.0, 4.0]", ["a list of wheels"]),
    ("source", "[]", ["source", "a text"]),
    ("delta_v_source", '"measured"', ["delta_v_source", "no ΔV columns"]),
    ("delta_v_source", '"guessed"', ["measured, computed"]),
    ("wheel", "[1, 2, 4]", ["wheel", "unknown key"]),
    ("id", "unquoted", ["valid TOML"]),
]


@pytest.mark.parametrize(("key", "value", "fragments"), BAD_KEYS)
def test_a_bad_key_is_refused(tmp_path: Path, key: str, value: str, fragments: list[str]) -> None:
    """The message names event.toml, the key, what was found and what would do."""
    message = refusal(write_event(tmp_path, bias_rows(), {**BIAS, key: value}))
    assert "event.toml" in message
    assert all(fragment in message for fragment in fragments), message


@pytest.mark.parametrize("key", list(BIAS))
def test_a_missing_key_is_named(tmp_path: Path, key: str) -> None:
    """Every key but delta_v_source is needed."""
    description = {name: value for name, value in BIAS.items() if name != key}
    assert f"event.toml: {key}" in refusal(write_event(tmp_path, bias_rows(), description))


def test_a_misspelt_key_comes_before_the_one_it_leaves_missing(tmp_path: Path) -> None:
    """The nearest name is given."""
    description = {name.replace("epoch", "epoh"): value for name, value in BIAS.items()}
    assert "did you mean 'epoch'" in refusal(write_event(tmp_path, bias_rows(), description))


def test_folders_that_are_none(tmp_path: Path) -> None:
    """Nothing there, a file, no event.toml, no telemetry, two of them, a folder in its place."""
    assert "nothing there" in refusal(tmp_path / "none")
    folder = write_event(tmp_path / "event", bias_rows())
    assert "expected an event folder, got a file" in refusal(folder / "telemetry.csv")
    (folder / "telemetry.parquet").write_bytes(b"")
    assert "both" in refusal(folder)
    (folder / "telemetry.parquet").unlink()
    (folder / "telemetry.csv").rename(folder / "telemetri.csv")
    assert "telemetri.csv" in refusal(folder)
    (folder / "telemetry.csv").mkdir()
    assert "got a folder" in refusal(folder)
    (folder / "event.toml").unlink()
    assert "no such file" in refusal(folder)
    (folder / "event.toml").write_bytes(b"\xff\xfe\x00")
    assert "UTF-8" in refusal(folder)


# ---------------------------------------------------------------- headers


def drop(*names: str) -> Change:
    """A change that takes columns away."""
    return lambda rows: [row.pop(name) for row in rows for name in names]


def add(name: str, value: str) -> Change:
    """A change that adds a column."""
    return lambda rows: [row.update({name: value}) for row in rows]


BAD_HEADERS = [
    (drop("time_s"), ["'time_s'"]),
    (drop("q3"), ["'q3'", "kind bias needs it"]),
    (drop("rate_z_rad_s"), ["'rate_z_rad_s'"]),
    (drop("rwa4_rpm"), ["'rwa4_rpm'"]),
    (drop("on_time_z2_s"), ["'on_time_z2_s'"]),
    (drop(*(f"pulses_{k}" for k in THRUSTERS)), ["'pulses_z1'", "kind bias needs it"]),
    (drop("pulses_y4"), ["'pulses_y4'"]),
    (add("q5", "0"), ["the unknown column 'q5'"]),
    (add("rate_x_deg_s", "0"), ["'rate_x_deg_s'", "known"]),
    (add("tank_pressure_kpi", "0"), ["did you mean 'tank_pressure_kpa'"]),
    (add("", "0"), ["no name for column 28"]),
    (add("delta_v_x_m_s", "0"), ["'delta_v_y_m_s'", "the other columns need it"]),
    (add("rwa3_rpm", "100"), ["line 2, column rwa3_rpm", "no prime wheel", "got 100"]),
]


def test_a_comment_above_the_names_is_refused(tmp_path: Path) -> None:
    """It is no unknown column: what to delete is told."""
    folder = write_event(tmp_path, bias_rows())
    path = folder / "telemetry.csv"
    path.write_text(f"# from tool X, version 2\n{path.read_text()}")
    assert "got the comment '# from tool X,version 2'; delete the lines above" in refusal(folder)


@pytest.mark.parametrize(("change", "fragments"), BAD_HEADERS)
def test_a_bad_header_is_refused(tmp_path: Path, change: Change, fragments: list[str]) -> None:
    """Missing, unknown, misspelt columns, parts of a channel, idle wheels."""
    message = refusal(write_event(tmp_path, spoilt(change)))
    assert all(fragment in message for fragment in fragments), message


def test_idle_wheels_may_stand_still(tmp_path: Path) -> None:
    """Columns of an idle wheel that are empty or 0 say nothing false."""
    plain = load(write_event(tmp_path / "plain", bias_rows()))
    for value in ("", "0"):
        changed = write_event(tmp_path / f"v{value}", spoilt(add("rwa3_rpm", value)))
        assert same(load(changed), plain)


def test_thrusters_of_the_other_branch_are_refused(tmp_path: Path) -> None:
    """A spacecraft whose branches have thrusters of their own names."""
    twelve = load_spacecraft(Path(__file__).parents[1] / "data" / "spacecraft" / "twelve.toml")
    branches = [set(twelve.thruster_names(branch)) for branch in twelve.branches]
    other = sorted(branches[-1] - branches[0])
    if not other:
        pytest.fail("the test needs a spacecraft whose branches differ")
    wheels = [wheel.number for wheel in twelve.wheels][:3]
    rows = motion_rows()
    for i, row in enumerate(rows):
        for name in ("rwa1_rpm", "rwa2_rpm", "rwa4_rpm"):
            del row[name]
        row.update({f"{twelve.wheel(number).name}_rpm": "10" for number in wheels})
        row[f"on_time_{other[0]}_s"] = "0" if i < 7 else "0.1"
    description = {**SLEW, "branch": f'"{twelve.branches[0]}"', "wheels": str(wheels)}
    event = read_event(write_event(tmp_path, rows, description), twelve)
    with pytest.raises(InputError, match=rf"line 9, column on_time_{other[0]}_s.*branch"):
        load_event(event, twelve)


@pytest.mark.parametrize(
    ("kind", "rows", "missing"),
    [
        ("bias", motion_rows(), "on_time_z1_s"),
        ("delta_v", bias_rows(), "accelerometer_counts"),
        ("slew", spoilt(drop("q1", "q2", "q3", "q4")), "q1"),
        ("quiescent", spoilt(drop("rwa1_rpm", "rwa2_rpm", "rwa4_rpm")), "rwa1_rpm"),
    ],
)
def test_a_kind_needs_its_channels(tmp_path: Path, kind: str, rows: Rows, missing: str) -> None:
    """The message names the column and the kind."""
    message = refusal(write_event(tmp_path, rows, {**BIAS, "kind": f'"{kind}"'}))
    assert f"'{missing}', because an event of kind {kind} needs it" in message


def test_accelerometer_counts_serve_a_burn(tmp_path: Path) -> None:
    """Counts stand in for a velocity change, are whole numbers, and arrive as they are."""
    rows = bias_rows()
    spoilt(add("accelerometer_counts", "-7"), rows)
    description = {**BIAS, "kind": '"delta_v"'}
    event = read_event(write_event(tmp_path, rows, description), CASSINI)
    assert event.has_accelerometer
    assert np.array_equal(load_event(event, CASSINI).accelerometer_counts, np.full(40, -7.0))
    rows = bias_rows()
    spoilt(add("accelerometer_counts", "-0.0141"), rows)
    again = read_event(write_event(tmp_path / "again", rows, description), CASSINI)
    with pytest.raises(InputError, match=r"accelerometer_counts.*whole number of counts"):
        load_event(again, CASSINI)


def test_a_velocity_change_needs_its_source(tmp_path: Path) -> None:
    """Only a measured one says something about thrust: which it is must be said."""
    rows = bias_rows()
    for axis in "xyz":
        spoilt(add(f"delta_v_{axis}_m_s", "0"), rows)
    assert "event.toml: delta_v_source" in refusal(write_event(tmp_path, rows))
    description = {**BIAS, "delta_v_source": '"computed"'}
    event = read_event(write_event(tmp_path, rows, description), CASSINI)
    assert event.delta_v_source == "computed"
    assert load_event(event, CASSINI).delta_v_m_s.shape == (40, 3)


BAD_FILES = [
    ("", ["an empty file"]),
    ("\n\n", ["an empty file"]),
    (csv_text(bias_rows()).split("\n")[0] + "\n", ["only the header row"]),
    (csv_text(bias_rows(1)), ["at least 2 rows", "one row"]),
    (csv_text(bias_rows(), ";"), ["line 1", "separated by commas", "semicolons"]),
    (csv_text(bias_rows(), "\t"), ["tabs"]),
    (csv_text(bias_rows()).split("\n", 1)[1], ["a header row of column names", "number 0"]),
    (bytes(range(256)) * 40, ["bytes that are no text"]),
    (b"\x1f\x8b\x08\x00" + bytes(100), ["bytes that are no text", "unpacked"]),
    (csv_text(bias_rows()).replace("\n1,", "\n1,2,", 1), ["line 3", "27 cells", "got 28"]),
    (csv_text(bias_rows())[:-30], ["line 41", "cut short"]),
    (csv_text(bias_rows()).encode() + b"\x00" * 50, ["line 42", "27 cells"]),
    (csv_text(bias_rows()) + "40," + "1" * (2 << 20), ["line 42", "a line of at most"]),
    (csv_text(bias_rows()).replace("\n9,0.6", "\n9,0;6", 1), ["line 11, column q1", "'0;6'"]),
]


@pytest.mark.parametrize(
    ("content", "fragments"), BAD_FILES, ids=[fragments[-1] for _, fragments in BAD_FILES]
)
def test_a_bad_file_is_refused(tmp_path: Path, content: str | bytes, fragments: list[str]) -> None:
    """Empty, one row, other separators, binary, cut short, endless lines."""
    message = refusal(write_event(tmp_path, content))
    assert "telemetry.csv" in message
    assert all(fragment in message for fragment in fragments), message


# ---------------------------------------------------------------- cells


BAD_CELLS = [
    ("q1", "abc", ["finite number", "'abc'"]),
    ("q1", "inf", ["finite number", "'inf'"]),
    ("q1", "-Infinity", ["finite number"]),
    ("q1", "1e999", ["finite number"]),
    ("q1", "1_0", ["finite number"]),
    ("q1", "0x10", ["finite number"]),
    ("q1", "1.2.3", ["finite number"]),
    ("q1", "N/A", ["empty the cell"]),
    ("q1", "\u22120.6", ["finite number"]),
    ("q1", "", ["q1 to q4 are sampled together", "an empty cell"]),
    ("q1", "0.59", ["a unit quaternion", "norm 0.99"]),
    ("q1", "-0.6", ["an attitude within", "a turn of 2.57 rad in 1 s"]),
    ("rate_y_rad_s", "", ["sampled together"]),
    ("rate_y_rad_s", "0.2", ["rad/s, not deg/s", "got 0.2"]),
    ("rwa2_rpm", "", ["sampled together"]),
    ("rwa2_rpm", "-7740", ["rev/min, not deg/s", "got -7740"]),
    ("on_time_z3_s", "", ["sampled together"]),
    ("on_time_z3_s", "-1", ["0 or more"]),
    ("on_time_z3_s", "0.5", ["at least 0.625 s", "got 0.5", "reset or misread"]),
    ("on_time_z3_s", "125", ["s, not ms", "a growth by 124.375 s"]),
    ("pulses_y1", "", ["sampled together"]),
    ("pulses_y1", "4", ["at least 5 pulses", "got 4"]),
    ("pulses_y1", "5.5", ["a whole number"]),
    ("time_s", "", ["a time in s"]),
    ("time_s", "nan", ["a time in s"]),
    ("time_s", "10", ["the same time again"]),
    ("time_s", "8.5", ["going back", "after 10 s"]),
]


@pytest.mark.parametrize(("column", "value", "fragments"), BAD_CELLS)
def test_a_bad_cell_is_refused(
    tmp_path: Path, column: str, value: str, fragments: list[str]
) -> None:
    """The message names file, line and column, what was found and the fix."""
    message = refusal(write_event(tmp_path, spoilt(set_cell(11, column, value))))
    where = "q1" if fragments[0].startswith(("a unit", "an attitude")) else column
    assert f"telemetry.csv: line 13, column {where}:" in message
    assert all(fragment in message for fragment in fragments), message


def test_a_channel_that_is_never_sampled_is_refused(tmp_path: Path) -> None:
    """Columns without values are as good as none."""
    for names in (("q1", "q2", "q3", "q4"), tuple(f"pulses_{k}" for k in THRUSTERS)):
        rows = bias_rows()
        for name in names:
            spoilt(add(name, ""), rows)
        message = refusal(write_event(tmp_path, rows))
        assert f"column {names[0]}" in message
        assert "no sample in 40 rows" in message


def test_pulses_without_on_time_are_refused(tmp_path: Path) -> None:
    """A frozen on-time beside a counter that runs: ten pulses are no rounding."""
    rows = bias_rows()
    for row in rows[10:]:
        row["on_time_z3_s"] = "0.625"
    message = refusal(write_event(tmp_path, rows))
    assert "line 32, column on_time_z3_s" in message
    assert "no growth over 10 pulses" in message


def test_on_time_without_pulses_is_refused(tmp_path: Path) -> None:
    """Firings that begin must be counted; one long firing is one pulse."""
    rows = bias_rows()
    for row in rows[10:]:
        row["pulses_z3"] = "5"
    message = refusal(write_event(tmp_path, rows))
    assert "column pulses_z3" in message
    assert "firings that no pulse began" in message
    for i, row in enumerate(rows):
        row["on_time_z3_s"] = f"{min(max(i - 10.5, 0), 20)}"
        row["pulses_z3"] = "0" if i < 11 else "1"
    assert load(write_event(tmp_path, rows)).on_time_s[-1, 2] == 20.0


@pytest.mark.parametrize("lacking", ["on_time", "pulses"])
def test_a_slew_with_one_of_the_counters_is_refused(tmp_path: Path, lacking: str) -> None:
    """It needs neither; one of them without the other tells no pulse."""
    rows = [{k: v for k, v in row.items() if not k.startswith(lacking)} for row in bias_rows()]
    message = refusal(write_event(tmp_path, rows, BIAS | {"kind": '"slew"'}))
    assert f"expected a column '{lacking}_z1" in message
    assert "add both counters of every thruster, or leave both out" in message
    bare = [{k: v for k, v in row.items() if not k.startswith(("on_", "pul"))} for row in rows]
    assert load(write_event(tmp_path, bare, BIAS | {"kind": '"slew"'})).pulses.shape[1] == 0


# ---------------------------------------------------------------- mends


def mended(folder: Path, rows: Rows | str, description: dict[str, str] | None = None) -> Mends:
    """What was mended, after checking that chunks of any size agree on it."""
    write_event(folder, rows, description or BIAS)
    mends = Mends()
    whole = load(folder, mends)
    for size in (1, 3, 7):
        again = Mends()
        parts = list(read_chunks(read_event(folder, CASSINI), CASSINI, size, again))
        assert again.found == mends.found
        for name in ARRAYS:
            joined = np.concatenate([getattr(part, name) for part in parts])
            np.testing.assert_array_equal(joined, getattr(whole, name))
    return mends


def test_good_telemetry_needs_no_mending(tmp_path: Path) -> None:
    """Negative control: nothing is noted where nothing was done."""
    assert mended(tmp_path, bias_rows()).found == ()


def test_repeated_rows_are_dropped(tmp_path: Path) -> None:
    """A row that says nothing new goes, with a note."""
    rows = bias_rows()
    rows[11:11] = [dict(rows[10]), dict(rows[10])]
    (mend,) = mended(tmp_path / "twice", rows).found
    assert (mend.kind, mend.first_row, mend.last_row, mend.count) == ("duplicate_row", 13, 14, 2)
    assert same(load(tmp_path / "twice"), load(write_event(tmp_path / "once", bias_rows())))


def test_spelt_out_nan_is_not_sampled(tmp_path: Path) -> None:
    """NaN in all of a channel is taken as empty cells, with a note; in part of it it is refused."""
    rows = bias_rows()
    for row in rows[5:9]:
        row.update({"rate_x_rad_s": "NaN", "rate_y_rad_s": "nan", "rate_z_rad_s": ""})
    mends = mended(tmp_path, rows)
    assert [(m.kind, m.column, m.first_row, m.last_row, m.count) for m in mends.found] == [
        ("nan", "rate_x_rad_s", 7, 10, 4),
        ("nan", "rate_y_rad_s", 7, 10, 4),
    ]
    assert np.isnan(load(tmp_path).rate_rad_s).sum() == 12
    assert "NaN was taken as not sampled (4×, rows 7 to 10)" in mends.lines()[0]
    rows[6]["rate_z_rad_s"] = "0"
    assert "line 8, column rate_x_rad_s" in refusal(write_event(tmp_path, rows))


def test_signs_of_quaternions_are_made_one(tmp_path: Path) -> None:
    """q and −q are the same attitude: the sign of the first row goes on."""
    rows = bias_rows()
    for row in rows[7:20]:
        row.update({"q1": "-0.6", "q4": "-0.8"})
    (mend,) = mended(tmp_path, rows).found
    assert (mend.kind, mend.first_row, mend.last_row, mend.count) == ("sign_flip", 9, 22, 2)
    assert load(tmp_path).attitude.tolist() == [[0.6, 0.0, 0.0, 0.8]] * 40


def test_rough_quaternions_are_made_unit(tmp_path: Path) -> None:
    """Few decimals are no harm: divided by the norm, with a note."""
    rows = bias_rows()
    for row in rows[4:6]:
        row.update({"q1": "0.6003", "q4": "0.8004"})
    (mend,) = mended(tmp_path, rows).found
    assert (mend.kind, mend.first_row, mend.count) == ("norm", 6, 2)
    np.testing.assert_allclose(load(tmp_path).attitude, [[0.6, 0, 0, 0.8]] * 40, atol=1e-15)


def test_a_late_start_is_noted(tmp_path: Path) -> None:
    """The epoch is the time of the first row; another start is kept and said."""
    rows = bias_rows()[3:]
    (mend,) = mended(tmp_path, rows).found
    assert (mend.kind, mend.column) == ("late_start", "time_s")
    assert load(tmp_path).time_s[0] == 3.0


def wrap(rows: Rows, column: str, size: float, start: float) -> Rows:
    """Rows whose counter begins at ``start`` and wraps at ``size``."""
    for row in rows:
        row[column] = f"{(float(row[column]) + start) % size:.10g}"
    return rows


@pytest.mark.parametrize(
    ("column", "size", "start"),
    [
        ("on_time_z1_s", 65.536, 64.9),
        ("on_time_y4_s", 655.36, 654.0),
        ("on_time_z2_s", 1000.0, 999.5),
        ("on_time_z2_s", 32.0, 31.75),
        ("on_time_z2_s", 10.0, 9.75),
        ("on_time_z2_s", 10.24, 9.75),
        ("pulses_z1", 256.0, 250.0),
        ("pulses_y2", 65536.0, 65535.0),
        ("pulses_y2", 1000.0, 991.0),
    ],
)
def test_a_counter_that_wraps_is_unwrapped(
    tmp_path: Path, column: str, size: float, start: float
) -> None:
    """A fall from the top of a range that counters have goes on growing, with a note."""
    rows = bias_rows()
    plain = load(write_event(tmp_path / "plain", rows))
    (mend,) = mended(tmp_path / "wrapped", wrap(rows, column, size, start)).found
    assert (mend.kind, mend.column, mend.count) == ("counter_wrap", column, 1)
    assert f"it wraps at {size:g}" in mend.sentence
    name = "on_time_s" if column.startswith("on") else "pulses"
    k = THRUSTERS.index(column.split("_")[-1 if name == "pulses" else 2])
    read = getattr(load(tmp_path / "wrapped"), name)[:, k]
    np.testing.assert_allclose(read, getattr(plain, name)[:, k] + start, atol=1e-9)


def test_a_counter_that_wraps_twice(tmp_path: Path) -> None:
    """The size found first serves the second time, for every thruster."""
    rows = bias_rows(2200)
    for name in THRUSTERS:
        wrap(rows, f"pulses_{name}", 256.0, {"z1": 250.0, "z2": 100.0}.get(name, 0.0))
    write_event(tmp_path, rows)
    mends = Mends()
    read = load(tmp_path, mends).pulses
    assert [(m.column, m.count) for m in mends.found[:2]] == [("pulses_z1", 5), ("pulses_z2", 4)]
    assert len(mends.found) == 8
    assert (np.diff(read, axis=0) >= 0).all()
    assert read[-1].tolist() == [1099 + 250, 1099 + 100, *[1099] * 6]


@pytest.mark.parametrize(
    ("column", "start"),
    [("on_time_z1_s", 40.0), ("pulses_z1", 200.0), ("on_time_z1_s", 900.0)],
)
def test_a_reset_is_not_taken_for_a_wrap(tmp_path: Path, column: str, start: float) -> None:
    """Negative control: a counter set to 0 away from the top of any range is refused."""
    rows = bias_rows()
    for i, row in enumerate(rows):
        row[column] = f"{float(row[column]) + start if i < 20 else float(row[column]) - 1.25:.10g}"
    if column.startswith("pulses"):
        for row in rows[20:]:
            row[column] = str(int(float(row["pulses_z2"])) - 10)
    message = refusal(write_event(tmp_path, rows))
    assert f"line 22, column {column}" in message
    assert "reset or misread" in message


def test_a_wrap_below_what_was_counted_is_none(tmp_path: Path) -> None:
    """Another counter beyond the supposed size shows that it was a reset."""
    rows = wrap(bias_rows(), "pulses_z1", 256.0, 250.0)
    for row in rows:
        row["pulses_z4"] = str(int(row["pulses_z4"]) + 700)
    message = refusal(write_event(tmp_path, rows))
    assert "column pulses_z4" in message
    assert "counts below 256" in message


def test_sizes_at_which_counters_wrap() -> None:
    """Powers of two and of ten of the least step."""
    assert {65.536, 40.96, 32.0, 10.0, 1000.0} <= set(wrap_sizes("on_time"))
    assert {256.0, 65536.0, 2.0**32, 100.0} <= set(wrap_sizes("pulses"))
    assert 65.536 not in wrap_sizes("pulses")


def test_the_reader_asks_for_rows(tmp_path: Path) -> None:
    """No rows per chunk is no way to read."""
    event = read_event(write_event(tmp_path, bias_rows()), CASSINI)
    with pytest.raises(InputError, match="at least one row"):
        next(read_chunks(event, CASSINI, 0))


def test_limits_of_rates_are_the_spacecrafts(tmp_path: Path) -> None:
    """What another unit explains for one spacecraft is how fast another one turns."""
    fast = replace(CASSINI, highest_rate_rad_s=0.3, highest_wheel_rpm=8000.0)
    for column, value in (("rate_y_rad_s", "0.2"), ("rwa2_rpm", "-7740")):
        folder = tmp_path / column
        message = refusal(write_event(folder, spoilt(set_cell(11, column, value))))
        assert "in its spacecraft file" in message or "in their spacecraft file" in message
        event = read_event(folder, fast)
        assert load_event(event, fast).rows == 40
    slow = replace(CASSINI, highest_wheel_rpm=100.0)
    write_event(tmp_path / "slow", bias_rows())
    with pytest.raises(InputError, match="within ±100 rev/min"):
        load_event(read_event(tmp_path / "slow", slow), slow)


def test_turns_between_attitudes_go_by_the_highest_rate(tmp_path: Path) -> None:
    """A radian in a second is a jump for Cassini, and none where bodies turn so fast."""
    rows = bias_rows()
    turned = (np.cos(0.5) * np.array([0.6, 0.0, 0.0, 0.8]) + np.sin(0.5) * np.eye(4)[2]).tolist()
    for row in rows[11:]:
        row |= {f"q{i + 1}": repr(value) for i, value in enumerate(turned)}
    folder = write_event(tmp_path, rows)
    assert "an attitude within" in refusal(folder)
    fast = replace(CASSINI, highest_rate_rad_s=3.0)
    assert load_event(read_event(folder, fast), fast).rows == 40
