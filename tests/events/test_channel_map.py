"""Channel maps: the same event comes out of the columns, units and conventions of others."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
from event_folder_cases import BIAS, CASSINI, THRUSTERS, bias_rows, csv_text, write_event
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry import (
    Chunk,
    Mends,
    event_from_frame,
    load_event,
    read_chunks,
    read_event,
)

EPOCH = "2010-02-13T12:00:00"
CHANNELS = ("time_s", "attitude", "rate_rad_s", "wheel_rpm", "on_time_s", "pulses")
MAP: dict[str, Any] = {
    "ignore": ["MODE"],
    "channels": {
        "time": {"source": "UTC", "time_system": "iso8601"},
        "attitude": {
            "source": ["Q0", "Q1", "Q2", "Q3"],
            "order": "wxyz",
            "direction": "body_to_inertial",
        },
        "rate": {"source": ["WX", "WY", "WZ"], "unit": "deg/s"},
        "rwa1_rpm": {"source": "RW1", "unit": "rad/s", "negate": True},
        "rwa2_rpm": {"source": "RW2", "unit": "rev/s"},
        "rwa4_rpm": {"source": "RW4", "scale": 0.25, "offset": -100.0},
        "on_time": {
            "source": [f"T_{name}" for name in THRUSTERS],
            "unit": "ms",
            "kind": "per_interval",
        },
        "pulses": {"source": [f"N_{name}" for name in THRUSTERS], "kind": "per_interval"},
    },
}
DESCRIPTION = {key: json.loads(value) for key, value in BIAS.items()}


def toml_text(table: Mapping[str, Any]) -> str:
    """A channel map as TOML (JSON's values are TOML's, but for its booleans' case alike)."""
    lines = [f"{key} = {json.dumps(value)}" for key, value in table.items() if key != "channels"]
    for name, channel in table["channels"].items():
        lines.append(f"[channels.{name}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in channel.items()]
    return "\n".join(lines) + "\n"


def own_frame(count: int = 40) -> pd.DataFrame:
    """The made-up event as numbers, turning, with thrusters that fire at their own paces."""
    frame = pd.DataFrame(bias_rows(count)).astype(float)
    turn = Rotation.from_rotvec(np.outer(np.arange(count), [1e-3, -2e-3, 5e-4]))
    frame[["q1", "q2", "q3", "q4"]] = turn.as_quat()
    for k, name in enumerate(THRUSTERS):
        pulses = np.arange(count) // (2 + k)
        frame[f"pulses_{name}"], frame[f"on_time_{name}_s"] = pulses, 0.125 * pulses
    return frame


def foreign_frame(own: pd.DataFrame) -> pd.DataFrame:
    """The same with other names, units, quaternions (by scipy) and counts per interval."""
    times = pd.Timestamp(EPOCH) + pd.to_timedelta(own["time_s"], unit="s")
    turn = Rotation.from_quat(own[["q1", "q2", "q3", "q4"]]).inv()
    frame = pd.DataFrame({"UTC": times.dt.strftime("%Y-%m-%dT%H:%M:%S.%f"), "MODE": "a"})
    frame[["Q0", "Q1", "Q2", "Q3"]] = turn.as_quat(scalar_first=True)
    for axis in "xyz":
        frame[f"W{axis.upper()}"] = np.rad2deg(own[f"rate_{axis}_rad_s"])
    frame["RW1"] = -own["rwa1_rpm"] * 2.0 * np.pi / 60.0
    frame["RW2"] = own["rwa2_rpm"] / 60.0
    frame["RW4"] = (own["rwa4_rpm"] + 100.0) * 4.0
    for name in THRUSTERS:
        frame[f"T_{name}"] = 1000.0 * own[f"on_time_{name}_s"].diff().fillna(0.0)
        frame[f"N_{name}"] = own[f"pulses_{name}"].diff().fillna(0.0)
    return frame


def same(one: Chunk, other: Chunk, tolerance: float = 1e-9) -> None:
    """Equal channels, whatever sign the quaternions have."""
    for name in CHANNELS:
        a, b = getattr(one, name), getattr(other, name)
        assert a.shape == b.shape
        off = np.abs(a - b).max() if name != "attitude" else 1.0 - np.abs((a * b).sum(1)).min()
        assert off <= tolerance, name


def expected(own: pd.DataFrame) -> Chunk:
    """What the reader makes of our own columns."""
    return load_event(event_from_frame(own, DESCRIPTION, CASSINI), CASSINI)


def write_csv(path: Path, frame: pd.DataFrame) -> None:
    """A CSV with every digit."""
    frame.to_csv(path, index=False)


def write_semicolons(path: Path, frame: pd.DataFrame) -> None:
    """The same between semicolons."""
    frame.to_csv(path, index=False, sep=";")


def write_parquet(path: Path, frame: pd.DataFrame) -> None:
    """Parquet, its times as time stamps."""
    frame.assign(UTC=pd.to_datetime(frame["UTC"])).to_parquet(path)


def write_hdf5(path: Path, frame: pd.DataFrame) -> None:
    """HDF5, every column a data set."""
    with h5py.File(path, "w") as file:
        for name in frame:
            values = frame[name].to_numpy()
            file[name] = values.astype("S32") if values.dtype.kind == "O" else values


def write_matlab(path: Path, frame: pd.DataFrame) -> None:
    """A .mat file of version 5: character rows and column vectors."""
    columns = {name: frame[name].to_numpy() for name in frame}
    texts = {k: np.array(list(map(str, v))) for k, v in columns.items() if v.dtype.kind == "O"}
    vectors = {k: v[:, None] for k, v in columns.items() if v.dtype.kind != "O"}
    scipy.io.savemat(path, {**texts, **vectors})


WRITERS: dict[str, Callable[[Path, pd.DataFrame], None]] = {
    "data.csv": write_csv,
    "data.txt": write_semicolons,
    "data.parquet": write_parquet,
    "data.h5": write_hdf5,
    "data.mat": write_matlab,
}


def folder_of(place: Path, name: str, table: Mapping[str, Any], frame: pd.DataFrame) -> Path:
    """An event folder with a map, the data beside it."""
    folder = place / "event"
    write_event(folder, "", {**BIAS, "telemetry": f'"../{name}"'})
    delimiter = {"delimiter": ";"} if name.endswith(".txt") else {}
    (folder / "channels.toml").write_text(toml_text({**delimiter, **table}))
    WRITERS[name](place / name, frame.astype({"UTC": object, "MODE": object}))
    return folder


@pytest.mark.parametrize("name", WRITERS)
def test_every_kind_of_file_gives_the_event(tmp_path: Path, name: str) -> None:
    """Names, units, signs, scale and offset, quaternions, intervals and dates, from every kind."""
    own = own_frame()
    folder = folder_of(tmp_path, name, MAP, foreign_frame(own))
    same(load_event(read_event(folder, CASSINI), CASSINI), expected(own))


def test_a_frame_gives_the_event_with_dates_or_text() -> None:
    """A data frame with text, dates, and dates with a zone."""
    own = own_frame()
    frame = foreign_frame(own)
    dates = pd.to_datetime(frame["UTC"])
    for times in (frame["UTC"], dates, dates.dt.tz_localize("UTC").dt.tz_convert("Asia/Tokyo")):
        event = event_from_frame(frame.assign(UTC=times), DESCRIPTION, "cassini", MAP)
        same(load_event(event, CASSINI), expected(own))


def test_a_wrong_map_gives_another_event() -> None:
    """Negative control: the comparison sees another order, sense, unit or way to count."""
    own = own_frame()
    frame = foreign_frame(own)
    changes: tuple[tuple[str, dict[str, Any]], ...] = (
        ("attitude", {"order": "xyzw"}),
        ("attitude", {"direction": "inertial_to_body"}),
        ("rate", {"unit": "mrad/s"}),
        ("pulses", {"kind": "cumulative"}),
        ("rwa1_rpm", {"negate": False}),
    )
    for name, change in changes:
        channels = {**MAP["channels"], name: {**MAP["channels"][name], **change}}
        event = event_from_frame(frame, DESCRIPTION, CASSINI, {**MAP, "channels": channels})
        with pytest.raises((AssertionError, InputError)):
            same(load_event(event, CASSINI), expected(own))


CLOCKS = {  # count at 2010-02-13T12:00:00 (the US Naval Observatory's converter), per second
    "julian_date": (2455241.0, 1.0 / 86400.0, 3e-5),
    "modified_julian_date": (55240.5, 1.0 / 86400.0, 1e-6),
    "matlab_datenum": (734182.5, 1.0 / 86400.0, 1e-5),
    "unix": (1266062400.0, 1.0, 1e-7),
    "elapsed": (0.0, 1.0, 0.0),
}


@pytest.mark.parametrize("system", CLOCKS)
def test_clocks_count_from_their_zero(system: str) -> None:
    """Days and seconds since the zeros of the time systems, to the digits that a float has."""
    first, step, tolerance = CLOCKS[system]
    own = own_frame()
    frame = foreign_frame(own).assign(UTC=first + step * own["time_s"])
    channels = {**MAP["channels"], "time": {"source": "UTC", "time_system": system}}
    event = event_from_frame(frame, DESCRIPTION, CASSINI, {**MAP, "channels": channels})
    assert np.abs(load_event(event, CASSINI).time_s - own["time_s"]).max() <= tolerance


@pytest.mark.parametrize(
    ("table", "shown"),
    [
        ({"unit": "ms"}, lambda t: 1000.0 * t),
        ({"unit": "ms", "scale": 0.5, "offset": -20.0}, lambda t: 2.0 * (1000.0 * t + 20.0)),
        ({"epoch": "2010-02-13T11:59:00Z"}, lambda t: t + 60.0),
        ({"time_system": "unix", "unit": "us"}, lambda t: 1e6 * (t + 1266062400.0)),
    ],
)
def test_elapsed_times_have_unit_and_zero(
    table: dict[str, Any], shown: Callable[[Any], Any]
) -> None:
    """Milliseconds, a scale and an offset, another epoch than the event's, microseconds."""
    own = own_frame()
    frame = foreign_frame(own).assign(UTC=shown(own["time_s"]))
    channels = {**MAP["channels"], "time": {"source": "UTC", **table}}
    event = event_from_frame(frame, DESCRIPTION, CASSINI, {**MAP, "channels": channels})
    assert np.abs(load_event(event, CASSINI).time_s - own["time_s"]).max() < 1e-6


def test_days_of_the_year_are_dates() -> None:
    """2010-044 is 13 February; day 366 of a year without it is refused."""
    own = own_frame()
    frame = foreign_frame(own)
    days = frame["UTC"].str.replace("2010-02-13", "2010-044")
    event = event_from_frame(frame.assign(UTC=days), DESCRIPTION, CASSINI, MAP)
    same(load_event(event, CASSINI), expected(own))
    wrong = frame.assign(UTC=frame["UTC"].str.replace("2010-02-13", "2010-366"))
    with pytest.raises(InputError, match="ISO 8601"):
        load_event(event_from_frame(wrong, DESCRIPTION, CASSINI, MAP), CASSINI)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 5), min_size=3, max_size=30), st.integers(1, 7))
def test_intervals_add_up_over_chunks(counts: list[int], rows: int) -> None:
    """Counts per interval become running sums, wherever chunks end and cells are empty."""
    from cassini_bayes.events.telemetry.channel_map import Column
    from cassini_bayes.events.telemetry.clocks import Line
    from cassini_bayes.events.telemetry.mapped import MappedTable
    from cassini_bayes.events.telemetry.memory import MemoryTable

    values = np.array(counts, dtype=float)
    values[::3] = np.nan
    table = MemoryTable("memory", {"n": values, "t": np.arange(values.size, dtype=float)})
    line = Line(1.0, 0.0)
    columns = [Column("pulses_z1", 0, line, per_interval=True), Column("time_s", 1, line)]
    mapped = MappedTable(table, columns)
    found = np.concatenate([b.cells[0] for b in mapped.blocks(rows, Mends())])
    sums = pd.Series(values).cumsum().to_numpy()  # pandas skips NaN and keeps it in its place
    np.testing.assert_array_equal(found, sums)


def test_matrices_and_structures_are_columns(tmp_path: Path) -> None:
    """Columns of a matrix by their place, of a structure by its field, of a group by its path."""
    own = own_frame()
    frame = foreign_frame(own)
    q = frame[["Q0", "Q1", "Q2", "Q3"]].to_numpy()
    others = {name: frame[name].to_numpy() for name in frame if name[0] in "WRTN"}
    time = own["time_s"].to_numpy()
    fields = {**others, "q": q, "t": time}
    scipy.io.savemat(tmp_path / "data.mat", {"tlm": fields, "notes": np.array([[1, "x"]], object)})
    with h5py.File(tmp_path / "data.h5", "w") as file:
        for name, values in fields.items():
            file[f"tlm/{name}"] = values
    for name, mark in (("data.mat", "."), ("data.h5", "/")):
        channels: dict[str, Any] = {
            **MAP["channels"],
            "time": {"source": "t"},
            "attitude": {**MAP["channels"]["attitude"], "source": "q"},
        }
        for channel, table in channels.items():
            source = table["source"]
            prefixed = f"tlm{mark}{source}" if isinstance(source, str) else None
            listed = [f"tlm{mark}{own_name}" for own_name in source]
            channels[channel] = {**table, "source": prefixed or listed}
        folder = tmp_path / name.replace(".", "-")
        write_event(folder, "", {**BIAS, "telemetry": f'"../{name}"'})
        table_text = toml_text({"ignore_others": True, "channels": channels})
        (folder / "channels.toml").write_text(table_text)
        same(load_event(read_event(folder, CASSINI), CASSINI), expected(own))


def test_the_map_is_part_of_the_digest(tmp_path: Path) -> None:
    """Another map is another event, though the data are the same bytes."""
    folder = folder_of(tmp_path, "data.csv", MAP, foreign_frame(own_frame()))
    first = read_event(folder, CASSINI)
    with (folder / "channels.toml").open("a") as stream:
        stream.write("# another comment\n")
    second = read_event(folder, CASSINI)
    assert first.digest != second.digest
    assert first.channels is not None
    assert second.channels is not None
    assert first.channels.digest != second.channels.digest


def test_without_a_map_the_digest_is_as_before(tmp_path: Path) -> None:
    """An event folder of our own columns keeps the digest that its earlier fits have."""
    import hashlib

    folder = write_event(tmp_path / "own", bias_rows())
    parts = [hashlib.sha256((folder / n).read_bytes()).hexdigest() for n in
             ("event.toml", "telemetry.csv")]  # fmt: skip
    joined = hashlib.sha256(" ".join(parts).encode()).hexdigest()
    assert read_event(folder, CASSINI).digest == joined


def changed(channel: str, **keys: Any) -> dict[str, Any]:
    """The map with other keys in one channel."""
    table = {**MAP["channels"].get(channel, {}), **keys}
    return {**MAP, "channels": {**MAP["channels"], channel: table}}


BAD: list[tuple[dict[str, Any], list[str]]] = [
    ({**MAP, "ignore": []}, ['"MODE"', "ignore_others"]),
    ({**MAP, "ignored": ["MODE"]}, ["ignored", "did you mean 'ignore'"]),
    ({**MAP, "delimiter": "1"}, ["delimiter", "one character"]),
    ({**MAP, "delimiter": "::"}, ["delimiter", "one character"]),
    (changed("rates", source="WX"), ["channels.rates", "unknown name", "did you mean 'rate'"]),
    (changed("rate", source=["WX", "WY"]), ["channels.rate.source", "3 columns", "rate_z_rad_s"]),
    (changed("rate", source=["WX", "WY", "wz"]), ["'wz'", "nowhere", "did you mean 'WZ'"]),
    (changed("rate", unit="Hz"), ["channels.rate.unit", "'Hz'", "deg/s"]),
    (changed("rate", unit="furlong/parsec"), ["channels.rate.unit", "dimensionless"]),
    (changed("rate", unit="9**9**9**9"), ["channels.rate.unit", "pint"]),
    (changed("rate", unit="m" * 5000), ["channels.rate.unit", "pint"]),
    (changed("rate", unitt="deg/s"), ["channels.rate.unitt", "did you mean 'unit'"]),
    (changed("rate", order="wxyz"), ["channels.rate.order", "attitude"]),
    (changed("rate", kind="per_interval"), ["channels.rate.kind", "on_time"]),
    (changed("rate", scale=0.0), ["channels.rate.scale"]),
    (changed("pulses", negate=True), ["channels.pulses.negate"]),
    (changed("pulses", wraps_at=256.0), ["channels.pulses.wraps_at", "that count up"]),
    (changed("rate", wraps_at=256.0), ["channels.rate.wraps_at", "on_time and pulses"]),
    (changed("on_time", kind="cumulative", wraps_at=0), ["channels.on_time.wraps_at"]),
    (changed("on_time", offset=1.0), ["channels.on_time.offset"]),
    (changed("time", unit="s"), ["channels.time.unit", "no date"]),
    (changed("time", time_system="tai"), ["channels.time.time_system", "julian_date"]),
    (changed("attitude", order="zyxw"), ["channels.attitude.order", "xyzw"]),
    (changed("rate_x_rad_s", source="WX"), ["rate_x_rad_s", "another one"]),
    ({**MAP, "channels": {}}, ["[channels.time]"]),
]


@pytest.mark.parametrize(("table", "fragments"), BAD)
def test_a_bad_map_is_refused_in_one_line(
    tmp_path: Path, table: dict[str, Any], fragments: list[str]
) -> None:
    """The map's file and key, what was expected, what was found, and the nearest name."""
    folder = folder_of(tmp_path, "data.csv", table, foreign_frame(own_frame(4)))
    with pytest.raises(InputError) as caught:
        load_event(read_event(folder, CASSINI), CASSINI)
    message = str(caught.value)
    assert message.isprintable()
    assert str(tmp_path) in message
    assert all(fragment in message for fragment in fragments), message


def test_a_bad_cell_is_named_by_both_names(tmp_path: Path) -> None:
    """A rate too high names our column and theirs, with the line; a bad date its own."""
    frame = foreign_frame(own_frame())
    frame.loc[5, "WY"] = 40.0
    folder = folder_of(tmp_path, "data.csv", MAP, frame)
    with pytest.raises(InputError, match=r"line 7, column rate_y_rad_s \(from 'WY'\)"):
        load_event(read_event(folder, CASSINI), CASSINI)
    frame = foreign_frame(own_frame())
    frame.loc[5, "UTC"] = "noon"
    folder = folder_of(tmp_path, "data.csv", MAP, frame)
    with pytest.raises(InputError, match="line 7, column UTC: expected an ISO 8601 time"):
        load_event(read_event(folder, CASSINI), CASSINI)


def test_a_counter_of_the_wrong_kind_is_told_by_the_key_of_its_map(tmp_path: Path) -> None:
    """On-times that count up, read as those of intervals, outrun the clock, and the other way round
    they fall: both name the map's file, table and key, where only the unit was spoken of.
    """
    frame = foreign_frame(own_frame())
    table = {**MAP, "channels": {**MAP["channels"]}}
    for name in THRUSTERS:
        frame[f"T_{name}"] = frame[f"T_{name}"].cumsum()
    folder = folder_of(tmp_path / "up", "data.csv", table, frame)
    hint = r'channels\.toml: channels\.on_time\.kind is "per_interval": write "cumulative"'
    with pytest.raises(InputError, match=hint):
        load_event(read_event(folder, CASSINI), CASSINI)
    table["channels"]["on_time"] = {**MAP["channels"]["on_time"], "kind": "cumulative"}
    folder = folder_of(tmp_path / "anew", "data.csv", table, foreign_frame(own_frame()))
    hint = r'write kind = "per_interval" in .*channels\.toml: channels\.on_time if'
    with pytest.raises(InputError, match=hint):
        load_event(read_event(folder, CASSINI), CASSINI)


def test_a_map_says_where_a_counter_wraps(tmp_path: Path) -> None:
    """In the unit of the column: at no usual size. Another size is not believed, nor none."""
    own = own_frame()
    frame = foreign_frame(own)
    for name in THRUSTERS:
        frame[f"T_{name}"] = (1000.0 * own[f"on_time_{name}_s"] + 1900.0) % 2500.0
    kept: dict[str, Any] = {"kind": "cumulative"}
    for place, size in (("right", 2500.0), ("wrong", 5000.0), ("unsaid", None)):
        keys = kept if size is None else {**kept, "wraps_at": size}
        folder = folder_of(tmp_path / place, "data.csv", changed("on_time", **keys), frame)
        if place == "right":
            read = load_event(read_event(folder, CASSINI), CASSINI).on_time_s
            gained = own[[f"on_time_{name}_s" for name in THRUSTERS]].to_numpy()
            np.testing.assert_allclose(read - read[0], gained, atol=1e-9)
            continue
        expected = "than 5 s" if size else "than a usual one"
        with pytest.raises(InputError, match=f"wraps at another size {expected}.*say wraps_at in"):
            load_event(read_event(folder, CASSINI), CASSINI)


def on_times_by_column(keys: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The map with a table for every on-time, counting up in ms, some of them with other keys."""
    channels = {name: table for name, table in MAP["channels"].items() if name != "on_time"}
    for name in THRUSTERS:
        table = {"source": f"T_{name}", "unit": "ms", **keys.get(name, {})}
        channels[f"on_time_{name}_s"] = table
    return {**MAP, "channels": channels}


def counted_up(own: pd.DataFrame, first_ms: float, sizes_ms: Mapping[str, float]) -> pd.DataFrame:
    """On-times in ms from a first one on, each of which starts again at 0 where it has a size."""
    frame = foreign_frame(own)
    for name in THRUSTERS:
        frame[f"T_{name}"] = 1000.0 * own[f"on_time_{name}_s"] + first_ms
        if name in sizes_ms:
            frame[f"T_{name}"] %= sizes_ms[name]
    return frame


def read_on_times(frame: pd.DataFrame, table: Mapping[str, Any]) -> Any:
    """On-times (n, K) that a map makes of a frame."""
    return load_event(event_from_frame(frame, DESCRIPTION, CASSINI, table), CASSINI).on_time_s


def test_every_column_of_a_counter_wraps_at_its_own_size() -> None:
    """Two on-times wrap, at 2.3 and 3.1 s; one that is wider than both passes them. The size of
    another column is not believed.
    """
    own = own_frame()
    sizes = {"z1": 2300.0, "z2": 3100.0}
    frame = counted_up(own, 1700.0, sizes)
    gained = own[[f"on_time_{name}_s" for name in THRUSTERS]].to_numpy()
    assert 1.7 + gained[-1, 2] > 2.3
    said: dict[str, dict[str, Any]] = {name: {"wraps_at": size} for name, size in sizes.items()}
    read = read_on_times(frame, on_times_by_column(said))
    np.testing.assert_allclose(read - read[0], gained, atol=1e-9)
    swapped = {"z1": said["z2"], "z2": said["z1"]}
    with pytest.raises(InputError, match=r"z1.*wraps at another size than 3\.1 s"):
        read_on_times(frame, on_times_by_column(swapped))


@pytest.mark.parametrize("size", [13.0, 50.0])
def test_a_growth_over_a_stated_wrap_may_be_the_largest(size: float) -> None:
    """A firing of 2 s after short ones: believed over a wrap at 13 s that a map states.

    Not without the map, nor if it were more than a quarter of the size; nor a counter that falls
    from a fourth of its size, which was reset.
    """
    own = own_frame()
    names = [f"on_time_{name}_s" for name in THRUSTERS]
    own[names] = 0.0
    own.loc[10:, "on_time_z1_s"] = 0.125
    own.loc[20:, "on_time_z1_s"] = 2.125
    own[[f"pulses_{name}" for name in THRUSTERS]] = 0
    own.loc[10:, "pulses_z1"] = 1
    own.loc[20:, "pulses_z1"] = 2
    own = own.iloc[::4]  # with 1 s between rows none fires for 2 s
    frame = counted_up(own, 11_000.0, {"z1": 13_000.0})
    stated: dict[str, dict[str, Any]] = {"z1": {"wraps_at": 1000.0 * size}}
    if size == 13.0:
        read = read_on_times(frame, on_times_by_column(stated))
        gained = own[names].to_numpy()
        np.testing.assert_allclose(read - read[0], gained, atol=1e-9)
        stated = {}
    with pytest.raises(InputError, match="was reset or misread"):
        read_on_times(frame, on_times_by_column(stated))


def test_the_size_of_a_wrap_that_was_seen_is_that_of_columns_without_one() -> None:
    """A usual size that one counter showed holds for the next, beside one of an own size."""
    own = own_frame(120)
    sizes = {"z1": 12_300.0, "z2": 20_480.0, "z3": 20_480.0}
    frame = counted_up(own, 0.0, {})
    for name, first in (("z1", 12_000.0), ("z2", 20_100.0), ("z3", 19_000.0)):
        frame[f"T_{name}"] = (1000.0 * own[f"on_time_{name}_s"] + first) % sizes[name]
    gained = own[[f"on_time_{name}_s" for name in THRUSTERS]].to_numpy()
    table = on_times_by_column({"z1": {"wraps_at": 12_300.0}})
    read = read_on_times(frame, table)
    np.testing.assert_allclose(read - read[0], gained, atol=1e-9)
    frame["T_y1"] += 21_000.0
    with pytest.raises(InputError, match=r"on_time_y1_s.*counts below 20\.48 s"):
        read_on_times(frame, table)


@pytest.mark.parametrize(
    ("keys", "offset_s"),
    [
        ({"offset": 500.0}, 0.5),
        ({"offset": -2000.0}, -2.0),
        ({"unit": "s", "scale": 0.001, "offset": 0.5}, 0.5),
    ],
)
def test_a_counter_wraps_where_it_does_without_its_offset(
    keys: dict[str, Any], offset_s: float
) -> None:
    """An offset moves what is shown, not where the counter starts again; another size is refused,
    and so is a count beyond it or below 0.
    """
    own = own_frame()
    frame = counted_up(own, 1900.0, dict.fromkeys(THRUSTERS, 2500.0))
    gained = own[[f"on_time_{name}_s" for name in THRUSTERS]].to_numpy()
    keys = {**keys, "kind": "cumulative"}
    read = read_on_times(frame, changed("on_time", **keys, wraps_at=2500.0))
    np.testing.assert_allclose(read, 1.9 + offset_s + gained, atol=1e-9)
    with pytest.raises(InputError, match=r"wraps at another size than 2\.3 s"):
        read_on_times(frame, changed("on_time", **keys, wraps_at=2300.0))
    flat = counted_up(own, 0.0, {})
    with pytest.raises(InputError, match=rf"counts below {2.3 + offset_s:.10g} s"):
        read_on_times(flat, changed("on_time", **keys, wraps_at=2300.0))
    flat["T_z1"] -= 3000.0
    with pytest.raises(InputError, match=f"expected {min(offset_s, 0.0):.10g} or more, in s"):
        read_on_times(flat, changed("on_time", **keys, wraps_at=2500.0))


@pytest.mark.parametrize("wheels", [(1, 2, 4), np.array([1, 2, 4])])
def test_wheels_may_be_any_sequence_in_python(wheels: Any) -> None:
    """A tuple or an array is as good as a list."""
    event = event_from_frame(own_frame(), {**DESCRIPTION, "wheels": wheels}, CASSINI)
    assert event.wheels == (1, 2, 4)


@pytest.mark.parametrize("rows", [1, 3, 5, 100_000])
def test_a_row_that_is_repeated_counts_once(rows: int) -> None:
    """Counts per interval of a repeated row are dropped with it, whether or not any fired."""
    own = own_frame()
    frame = foreign_frame(own)
    assert frame.loc[4, "N_z1"] == 1.0
    twice = frame.loc[sorted([*range(40), 0, 1, 4, 4, 5, 39])]
    mends = Mends()
    event = event_from_frame(twice, DESCRIPTION, CASSINI, MAP)
    chunks = list(read_chunks(event, CASSINI, rows, mends))
    for name in ("time_s", "on_time_s", "pulses"):
        found = np.concatenate([getattr(chunk, name) for chunk in chunks])
        np.testing.assert_allclose(found, getattr(expected(own), name), atol=1e-9)
    assert [(mend.kind, mend.count) for mend in mends.found] == [("duplicate_row", 6)]
    other = pd.concat([frame.loc[:4], frame.loc[[4]].assign(N_z1=2.0), frame.loc[5:]])
    with pytest.raises(InputError, match=r"row 6, .*the same time again, 4 s, with other values"):
        read_rows(other, rows)


def read_rows(frame: pd.DataFrame, rows: int = 100_000) -> list[Chunk]:
    """All chunks of a frame of counts per interval."""
    return list(read_chunks(event_from_frame(frame, DESCRIPTION, CASSINI, MAP), CASSINI, rows))


def test_counts_per_interval_are_lost_with_a_row(tmp_path: Path) -> None:
    """A row that is missing takes its counts with it: refused. Another cadence has them all."""
    frame = foreign_frame(own_frame())
    folder = folder_of(tmp_path / "gap", "data.csv", MAP, frame.drop(index=17))
    said = r"line 19, column on_time_z1_s .*a row every 1 s,.*got none from 16 s to 18 s; fill in"
    with pytest.raises(InputError, match=said):
        load_event(read_event(folder, CASSINI), CASSINI)
    slower = frame.loc[[*range(20), *range(23, 40, 4)]]
    folder = folder_of(tmp_path / "slower", "data.csv", MAP, slower)
    load_event(read_event(folder, CASSINI), CASSINI)
    faster = frame.loc[[*range(0, 20, 4), *range(20, 40)]]
    assert sum(chunk.rows for chunk in read_rows(faster, 3)) == 25


@pytest.mark.parametrize("rows", [1, 3, 10, 17, 100_000])
@pytest.mark.parametrize(
    ("missing", "row"),
    [
        *[((1,), 2), ((2,), 3), ((10,), 11), ((17,), 18), ((38,), 39), ((17, 19), 18)],
        *[((17, 19, 21, 23), 19), ((1, 3), 2), ((36, 38), 38), ((20, 21, 22), 21)],
    ],
)
def test_a_missing_row_is_seen_anywhere(missing: tuple[int, ...], row: int, rows: int) -> None:
    """At the ends of file and blocks, and beside others that are missing, wherever blocks end."""
    frame = foreign_frame(own_frame()).drop(index=list(missing))
    with pytest.raises(InputError, match=rf": row {row}, .*a row every 1 s, as counts per"):
        read_rows(frame, rows)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.sampled_from([1, 1, 1, 2, 4]), min_size=2, max_size=38), st.integers(1, 40))
def test_where_blocks_end_is_nothing_to_a_missing_row(steps: list[int], rows: int) -> None:
    """The same row is refused, or none, in blocks of any size: steps against plain medians."""
    place = np.cumsum([0, *steps])
    usual = [
        max(
            sorted(side)[len(side) // 2]
            for side in (steps[max(i - 5, 0) : i], steps[i + 1 : i + 6])
            if side
        )
        for i in range(len(steps))
    ]
    first = next((i + 2 for i, step in enumerate(steps) if step > 1.5 * usual[i]), None)
    frame = foreign_frame(own_frame(int(place[-1]) + 1)).loc[place]
    if first is None:
        assert sum(chunk.rows for chunk in read_rows(frame, rows)) == len(place)
        return
    with pytest.raises(InputError, match=rf": row {first}, .*as counts per interval"):
        read_rows(frame, rows)


@pytest.mark.parametrize("channel", ["delta_v", "accelerometer"])
def test_velocity_per_interval_is_lost_with_a_row(channel: str) -> None:
    """Twenty rows of a burn: refused for its velocity changes as for counters, by their column."""
    own = own_frame(60).drop(columns=["q1", "q2", "q3", "q4"])
    own = own[[name for name in own if not str(name).startswith(("rate", "rwa"))]]
    names = {
        "delta_v": [f"delta_v_{axis}_m_s" for axis in "xyz"],
        "accelerometer": ["accelerometer_counts"],
    }[channel]
    own[names] = 1.0
    table = {"channels": {"time": {"source": "time_s"}, channel: {"kind": "per_interval"}}}
    for counter in ("on_time", "pulses"):
        table["channels"][counter] = {"kind": "cumulative"}
    burn = {**DESCRIPTION, "kind": "delta_v"}
    burn |= {"delta_v_source": "measured"} if channel == "delta_v" else {}
    whole = load_event(event_from_frame(own, burn, CASSINI, table), CASSINI)
    total = whole.delta_v_m_s[:, 0] if channel == "delta_v" else whole.accelerometer_counts
    assert total.tolist() == list(range(1, 61))
    event = event_from_frame(own.drop(index=range(20, 40)), burn, CASSINI, table)
    with pytest.raises(InputError, match=rf"row 21, column {names[0]}: .*from 19 s to 40 s"):
        load_event(event, CASSINI)


def test_what_is_no_frame_and_text_in_one_are_named() -> None:
    """Nothing, a dictionary and an array are told from a frame; one cell of text by its row."""
    own = own_frame()
    for other in (None, own.to_dict("list"), own.to_numpy()):
        with pytest.raises(InputError, match=r"expected a pandas DataFrame, got \w+; write"):
            event_from_frame(other, DESCRIPTION, CASSINI)  # type: ignore[arg-type]
    frame = own.astype({"rwa1_rpm": object})
    frame.loc[5, "rwa1_rpm"] = "bad"
    with pytest.raises(
        InputError, match=r"row 6, column rwa1_rpm: expected a number, .* got 'bad'"
    ):
        load_event(event_from_frame(frame, DESCRIPTION, CASSINI), CASSINI)


@pytest.mark.parametrize("kind", ["string", object])
def test_a_missing_date_is_named_whatever_stands_for_it(kind: Any) -> None:
    """pandas has NA in columns of text: in one of dates its row is named, elsewhere it is well."""
    frame = foreign_frame(own_frame()).astype({"UTC": kind, "MODE": kind})
    frame.loc[3, "MODE"] = pd.NA
    same(load_event(event_from_frame(frame, DESCRIPTION, CASSINI, MAP), CASSINI),
         expected(own_frame()))  # fmt: skip
    frame.loc[5, "UTC"] = pd.NA
    with pytest.raises(InputError, match=r"row 6, column time_s .*expected a time in s"):
        load_event(event_from_frame(frame, DESCRIPTION, CASSINI, MAP), CASSINI)


def test_arrays_in_cells_of_a_frame_are_refused_where_they_are_read() -> None:
    """In a column of dates they are no text; in one that is ignored they may stand."""
    frame = foreign_frame(own_frame())
    lists = pd.Series([np.zeros(2)] * len(frame), dtype=object)
    event = event_from_frame(frame.assign(MODE=lists), DESCRIPTION, CASSINI, MAP)
    same(load_event(event, CASSINI), expected(own_frame()))
    with pytest.raises(InputError, match=r"column UTC: expected dates as text, got ndarray"):
        load_event(event_from_frame(frame.assign(UTC=lists), DESCRIPTION, CASSINI, MAP), CASSINI)


def test_a_date_of_digits_is_no_number(tmp_path: Path) -> None:
    """20100213 in a column of dates is a day, never a count of seconds."""
    own = own_frame(2)
    frame = foreign_frame(own).assign(UTC=["20100213T120000", "20100214"])
    folder = folder_of(tmp_path, "data.csv", MAP, frame)
    assert load_event(read_event(folder, CASSINI), CASSINI).time_s.tolist() == [0.0, 43_200.0]


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("on_time_0_s", "known: on_time_z1_s"),
        ("rate_x_deg_s", "known: rate_x_rad_s"),
        ("rate_x_rads", "did you mean 'rate_x_rad_s'"),
        ("Pulses_Z1", "did you mean 'pulses_z1'"),
        ("tank_pressure_psi", "known"),
    ],
)
def test_no_dangerous_guess_is_made(tmp_path: Path, name: str, hint: str) -> None:
    """A name with rivals or of another unit gets the list; one that can be only one is guessed."""
    rows = [{**row, name: "0"} for row in bias_rows(3)]
    for row in rows:
        row.pop("rate_x_rad_s" if name == "rate_x_rads" else "pulses_z1")
    folder = write_event(tmp_path / "e", csv_text(rows))
    with pytest.raises(InputError) as caught:
        read_event(folder, CASSINI)
    assert hint in str(caught.value)
    assert "channel map" in str(caught.value)


def test_an_event_goes_to_another_process_with_its_map(tmp_path: Path) -> None:
    """Several events are read in processes of their own; a map that could not go ended them all."""
    event = read_event(folder_of(tmp_path, "data.csv", MAP, foreign_frame(own_frame())), CASSINI)
    copied = pickle.loads(pickle.dumps(event))  # noqa: S301  its own bytes
    assert copied.channels == event.channels
