"""Totals events are read with every cell checked, and written so that no half-file ever stays."""

from __future__ import annotations

import csv
import errno
import math
import os
from collections.abc import Callable
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import (
    SOURCES,
    TotalsEvent,
    read_totals,
    totals_columns,
    write_totals,
)
from cassini_bayes.spacecraft import load_spacecraft

SMALL = Path(__file__).parents[1] / "data" / "totals_small.csv"
PUBLISHED = Path(__file__).parents[2] / "cassini_bayes" / "published" / "flight_2009_2010.csv"
CASSINI = load_spacecraft("cassini")
THRUSTERS = ("z1", "z2", "z3", "z4", "y1", "y2", "y3", "y4")

Cells = list[list[str]]


def small_cells() -> Cells:
    """Rows of the small file, the header first."""
    with SMALL.open(newline="") as stream:
        return list(csv.reader(stream))


def write_cells(folder: Path, cells: Cells) -> Path:
    """A CSV file of these cells."""
    path = folder / "events.csv"
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(cells)
    return path


def same(one: TotalsEvent, other: TotalsEvent) -> bool:
    """Whether two events agree in every field, exactly."""
    for field in fields(TotalsEvent):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if (a is None) != (b is None) or (a is not None and not np.array_equal(a, b)):
            return False
    return True


def test_reading_keeps_every_cell() -> None:
    """The flight rows of the small file, field by field."""
    one, two = read_totals(SMALL, CASSINI)
    assert (one.id, one.branch, one.source) == ("b-one", "B", "flight")
    assert one.epoch == datetime(2010, 1, 2, 3, 4, 5, tzinfo=UTC)
    assert one.wheels == (1, 2, 4)
    assert one.rwa_start_rpm.tolist() == [-1118.0, 1290.0, 330.0]
    assert one.rwa_end_rpm.tolist() == [626.0, 1300.0, -729.0]
    assert one.duration_s == 1062.0
    assert one.thrusters == THRUSTERS
    assert one.on_time_s.tolist() == [23.43, 5.99, 1.25, 17.69, 0.25, 3.62, 0.25, 3.62]
    assert one.pulses.tolist() == [180, 48, 9, 141, 2, 28, 2, 28]
    assert one.delta_v_m_s.tolist() == [3e-5, 2e-5, -0.0166]
    assert one.delta_v_source == "computed"
    assert (one.hydrazine_g, one.mass_kg, one.thrust_predicted_n) == (27.0, 2414.4, 0.77)
    assert two.epoch == datetime(2005, 2, 18, tzinfo=UTC)
    assert two.wheels == (3, 1, 2)
    assert two.rwa_start_rpm.tolist() == [836.0, 1026.0, 922.0]  # in the order of wheels
    assert two.on_time_s[5] != two.on_time_s[7]  # thrusters of a couple may differ
    assert (two.delta_v_m_s, two.delta_v_source, two.mass_kg) == (None, None, None)


def test_sources_are_apart() -> None:
    """Each source gives its own rows; the ideal rows have no pulse counts."""
    (ideal,) = read_totals(SMALL, CASSINI, "gsw_ideal")
    assert ideal.pulses is None
    (ground,) = read_totals(SMALL, CASSINI, "gsw")
    assert ground.pulses[5] == 0  # computed counts are rounded beside a short on-time
    assert ground.hydrazine_g == 28.4
    assert ground.delta_v_m_s is None


def test_one_event_by_its_id() -> None:
    """file.csv:ID gives that event alone."""
    (event,) = read_totals(f"{SMALL}:a-two", CASSINI)
    assert event.id == "a-two"


def test_colons_in_names_do_no_harm(tmp_path: Path) -> None:
    """The file that exists decides where the file's name ends."""
    cells = small_cells()
    cells[1][0] = "b:one"
    path = write_cells(tmp_path, cells)
    odd = tmp_path / "a:b.csv"
    path.rename(odd)
    assert len(read_totals(odd, CASSINI)) == 2
    assert read_totals(f"{odd}:b:one", CASSINI)[0].id == "b:one"


def test_published_events_are_read() -> None:
    """All four sources of the eight published events pass the checks."""
    for source in SOURCES[:4]:
        events = read_totals(PUBLISHED, CASSINI, source)
        assert len(events) == 8
        assert all((event.pulses is None) == (source == "gsw_ideal") for event in events)
    bias = read_totals(f"{PUBLISHED}:2010-02-13-bias", CASSINI)[0]
    assert bias.rwa_end_rpm.tolist() == [432.0, -1293.0, -508.0]  # paper 001 Table 3.d
    assert bias.on_time_s.tolist() == [12.52, 2.5, 5.12, 16.39, 23.64, 1.38, 23.64, 1.38]


def test_events_are_frozen() -> None:
    """Neither fields nor arrays can be changed, and the caller's arrays are copied."""
    (event,) = read_totals(f"{SMALL}:b-one", CASSINI)
    with pytest.raises(AttributeError):
        event.duration_s = 1.0  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        event.on_time_s[0] = 1.0
    mine = np.ones(8)
    changed = replace(event, on_time_s=mine)
    mine[0] = 5.0
    assert changed.on_time_s[0] == 1.0


@pytest.mark.parametrize(
    "transform",
    [
        lambda text: b"\xef\xbb\xbf" + text,
        lambda text: text.replace(b"\n", b"\r\n"),
        lambda text: text.replace(b"\n", b"\n\n"),
        lambda text: text.replace(b",B,", b", B ,"),
        lambda text: text.rstrip(b"\n"),
    ],
    ids=["byte-order mark", "CRLF", "blank lines", "blanks in cells", "no last newline"],
)
def test_other_editors_are_tolerated(tmp_path: Path, transform: Callable[[bytes], bytes]) -> None:
    """What spreadsheets and editors do to a file changes nothing."""
    path = tmp_path / "events.csv"
    path.write_bytes(transform(SMALL.read_bytes()))
    read, expected = read_totals(path, CASSINI), read_totals(SMALL, CASSINI)
    assert all(same(a, b) for a, b in zip(read, expected, strict=True))


def test_columns_may_come_in_any_order_and_idle_wheels_may_be_left_out(tmp_path: Path) -> None:
    """Names decide, not places; the rates of a wheel that is never prime need no column."""
    rows = [row[::-1] for row in small_cells()[:2]]
    keep = [i for i, name in enumerate(rows[0]) if "rwa3" not in name]
    path = write_cells(tmp_path, [[row[i] for i in keep] for row in rows])
    assert same(read_totals(path, CASSINI)[0], read_totals(SMALL, CASSINI)[0])


def test_an_epoch_with_an_offset_is_turned_into_utc(tmp_path: Path) -> None:
    """03:04:05+02:00 is 01:04:05 UTC."""
    cells = small_cells()
    cells[1][1] = "2010-01-02T03:04:05+02:00"
    event = read_totals(write_cells(tmp_path, cells), CASSINI)[0]
    assert event.epoch == datetime(2010, 1, 2, 1, 4, 5, tzinfo=UTC)
    assert event.epoch.tzinfo is UTC


# column, cell of line 2, fragments of the message beside file, line and column
BAD_CELLS = [
    ("id", "", ["an empty cell"]),
    ("epoch", "", ["an empty cell"]),
    ("epoch", "13 Feb 2010", ["'13 Feb 2010'", "ISO 8601"]),
    ("epoch", "2010-02-30", ["ISO 8601"]),
    ("branch", "", ["A, B"]),
    ("branch", "C", ["'C'", "thruster branch"]),
    ("wheels", "", ["empty"]),
    ("wheels", "1 2 7", ["'1 2 7'", "[1, 2, 3, 4]"]),
    ("wheels", "1 2 2", ["list each wheel once"]),
    ("wheels", "1 -2 4", ["'1 -2 4'"]),
    ("wheels", "1,2,4", ["'1,2,4'", "write e.g. 1 2 3"]),
    ("wheels", "1 2 4.0", ["'1 2 4.0'"]),
    ("wheels", "[1 2 4]", ["'[1 2 4]'"]),
    ("rwa1_rpm_start", "", ["because the wheel is prime", "an empty cell"]),
    ("rwa4_rpm_end", "", ["because the wheel is prime"]),
    ("rwa3_rpm_start", "100", ["wheel 3 is not among the prime wheels 1 2 4", "'100'"]),
    ("rwa1_rpm_start", "70000", ["rev/min", "check the unit"]),
    ("rwa1_rpm_start", "nan", ["finite number", "'nan'"]),
    ("rwa1_rpm_start", "-inf", ["finite number"]),
    ("rwa1_rpm_start", "1e999", ["finite number"]),
    ("rwa1_rpm_start", "\u22121118", ["finite number"]),
    ("rwa1_rpm_start", "1_000", ["finite number"]),
    ("duration_s", "", ["an empty cell"]),
    ("duration_s", "0", ["above 0"]),
    ("duration_s", "-5", ["above 0"]),
    ("duration_s", "17 min", ["finite number"]),
    ("on_time_z1_s", "", ["an empty cell"]),
    ("on_time_z1_s", "-1", ["0 or more"]),
    ("on_time_z1_s", "23,43", ["'23,43'", "'.' as point"]),
    ("on_time_z1_s", "2000", ["no longer than the event, 1062 s"]),
    ("pulses_z1", "", ["for all thrusters or for none"]),
    ("pulses_z1", "-180", ["0 or more"]),
    ("pulses_z1", "180.5", ["whole number"]),
    ("pulses_z1", "0", ["at least one pulse for 23.43 s"]),
    ("pulses_z1", "100000", ["at least 0.005 s on average", "100000 in 23.43 s"]),
    ("delta_v_y_m_s", "", ["all three axes or none"]),
    ("delta_v_y_m_s", "x", ["finite number"]),
    ("delta_v_source", "", ["measured or computed", "an empty cell"]),
    ("delta_v_source", "doppler", ["'doppler'", "measured"]),
    ("delta_v_source", "mesured", ["did you mean 'measured'"]),
    ("hydrazine_g", "-1", ["0 or more"]),
    ("hydrazine_g", "inf", ["finite"]),
    ("hydrazine_g", "1e9", ["at most 1000 g for each second of on-time", "(g, not mg)"]),
    ("mass_kg", "0", ["above 0"]),
    ("mass_kg", "nan", ["finite"]),
    ("thrust_predicted_n", "-0.77", ["above 0"]),
    ("source", "", ["flight"]),
    ("source", "fligth", ["did you mean 'flight'"]),
]


@pytest.mark.parametrize(("column", "cell", "fragments"), BAD_CELLS)
def test_bad_cells_say_where_and_why(
    tmp_path: Path, column: str, cell: str, fragments: list[str]
) -> None:
    """Each bad cell is refused with file, line, column, what was expected and the fix."""
    cells = small_cells()
    cells[1][cells[0].index(column)] = cell
    path = write_cells(tmp_path, cells)
    with pytest.raises(InputError) as caught:
        read_totals(path, CASSINI)
    message = str(caught.value)
    assert message.startswith(f"{path}: line 2, column {column}: expected")
    assert "\n" not in message
    for fragment in fragments:
        assert fragment in message


def test_pulses_without_on_time_are_refused(tmp_path: Path) -> None:
    """Nine pulses in 0 s: one of the two cells is wrong."""
    cells = small_cells()
    cells[1][cells[0].index("on_time_z3_s")] = "0"
    with pytest.raises(InputError, match="pulses_z3: expected no pulse for 0 s"):
        read_totals(write_cells(tmp_path, cells), CASSINI)


def test_delta_v_source_without_delta_v_is_refused(tmp_path: Path) -> None:
    """A source of nothing means that a column was lost."""
    cells = small_cells()
    cells[4][cells[0].index("delta_v_source")] = "measured"
    with pytest.raises(InputError, match="line 5, column delta_v_source"):
        read_totals(write_cells(tmp_path, cells), CASSINI)


def drop(column: str) -> Callable[[Cells], Cells]:
    """Cells without one column."""
    return lambda cells: [
        [cell for name, cell in zip(cells[0], row, strict=True) if name != column] for row in cells
    ]


def rename(old: str, new: str) -> Callable[[Cells], Cells]:
    """Cells with another name of a column."""
    return lambda cells: [[new if cell == old else cell for cell in cells[0]], *cells[1:]]


BAD_TABLES: dict[str, tuple[Callable[[Cells], Cells], list[str]]] = {
    **{
        f"no {column}": (drop(column), ["line 1", f"the column '{column}'", "add the column"])
        for column in totals_columns(CASSINI)
        if "_rpm_" not in column
    },
    "no prime wheel": (drop("rwa4_rpm_end"), ["line 2, column rwa4_rpm_end", "no such column"]),
    "misspelt column": (
        rename("on_time_z1_s", "on_time_z1"),
        ["'on_time_z1'", "did you mean 'on_time_z1_s'"],
    ),
    "extra column": (
        lambda cells: [[*row, "x"] for row in cells],
        ["the unknown column 'x'", "drop it"],
    ),
    "a comment first": (
        lambda cells: [["# from tool X"], *cells],
        ["line 1", "the comment '# from tool X'", "delete the lines above"],
    ),
    "column twice": (lambda cells: [[*row, row[0]] for row in cells], ["'id' twice"]),
    "short row": (
        lambda cells: [*cells[:2], cells[2][:-1], *cells[3:]],
        ["line 3", "37 cells", "36"],
    ),
    "long row": (lambda cells: [*cells[:2], [*cells[2], "x"]], ["line 3", "37 cells", "38"]),
    "no rows": (lambda cells: cells[:1], ["only the header"]),
    "no header": (lambda cells: cells[1:], ["line 1", "columns b-one,", "add the header line"]),
    "empty": (lambda cells: cells[:0], ["an empty file"]),
    "same event twice": (
        lambda cells: [*cells, cells[1]],
        ["line 6, column id", "'b-one' again, as in line 2"],
    ),
}


@pytest.mark.parametrize(("change", "fragments"), BAD_TABLES.values(), ids=BAD_TABLES)
def test_bad_tables_say_where_and_why(
    tmp_path: Path, change: Callable[[Cells], Cells], fragments: list[str]
) -> None:
    """Columns and rows that do not fit are refused by name and line."""
    path = write_cells(tmp_path, change(small_cells()))
    with pytest.raises(InputError) as caught:
        read_totals(path, CASSINI)
    message = str(caught.value)
    assert message.startswith(str(path))
    for fragment in fragments:
        assert fragment in message


def test_telemetry_is_told_where_it_goes(tmp_path: Path) -> None:
    """A table without anything of totals; one with a quoted header is read as ever."""
    path = tmp_path / "may.csv"
    path.write_text("UTC;ATT_Q0;ATT_Q1\n1;2;3\n")
    with pytest.raises(
        InputError,
        match=r"got columns UTC;ATT_Q0;ATT_Q1; add the header line; telemetry .* --from ",
    ):
        read_totals(path, CASSINI)
    path.write_text('"id","epoch"\n"a","b"\n')
    with pytest.raises(InputError, match="the column 'branch'"):
        read_totals(path, CASSINI)


def test_semicolons_and_broken_quotes(tmp_path: Path) -> None:
    """Another separator or an unclosed quote is named as such."""
    path = tmp_path / "events.csv"
    path.write_text(SMALL.read_text().replace(",", ";"))
    with pytest.raises(InputError, match=r"line 1.*separated by commas, got one with ';'"):
        read_totals(path, CASSINI)
    path.write_text(SMALL.read_text().replace("b-one", '"b-one"x', 1))
    with pytest.raises(InputError, match="comma-separated"):
        read_totals(path, CASSINI)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    """Missing (with the nearest name), a folder, or not UTF-8."""
    path = write_cells(tmp_path, small_cells())
    with pytest.raises(InputError, match=r"no such file.*did you mean 'events\.csv'"):
        read_totals(tmp_path / "event.csv", CASSINI)
    with pytest.raises(InputError, match="no such file"):
        read_totals(f"{tmp_path / 'event.csv'}:b-one", CASSINI)
    with pytest.raises(InputError, match="a folder"):
        read_totals(tmp_path, CASSINI)
    path.write_bytes(SMALL.read_bytes().replace(b"b-one", b"b-\xb5ne", 1))
    with pytest.raises(InputError, match="line 2: expected UTF-8"):
        read_totals(path, CASSINI)


def test_choices_that_are_not_there() -> None:
    """An unknown id or source names the nearest; an id of another source says which."""
    with pytest.raises(InputError, match=r"small\.csv:a-tow.*did you mean 'a-two'"):
        read_totals(f"{SMALL}:a-tow", CASSINI)
    with pytest.raises(InputError, match=r"rows of source 'fsds'.*flight, gsw_ideal, gsw"):
        read_totals(SMALL, CASSINI, "fsds")
    with pytest.raises(InputError, match="only flight has"):
        read_totals(f"{SMALL}:a-two", CASSINI, "gsw")


def test_written_events_are_read_back(tmp_path: Path) -> None:
    """Events of two branches and sets of wheels survive the round trip exactly."""
    events = read_totals(SMALL, CASSINI)
    path = tmp_path / "out.csv"
    write_totals(path, events, CASSINI)
    assert all(same(a, b) for a, b in zip(read_totals(path, CASSINI), events, strict=True))
    write_totals(path, read_totals(PUBLISHED, CASSINI), CASSINI)
    with path.open() as ours, PUBLISHED.open() as theirs:
        assert ours.readline() == theirs.readline()


number = st.floats(-2000, 2000)
tables = st.lists(
    st.tuples(st.floats(0.01, 400.0), st.integers(1, 60)) | st.just((0.0, 0)),
    min_size=8,
    max_size=8,
).map(lambda rows: [(s, n) if n == 0 or s / n >= 0.005 else (s, 1) for s, n in rows])
maybe = st.none() | st.floats(1e-6, 1e6)
zones = st.integers(-14, 14).map(lambda hours: timezone(timedelta(hours=hours)))
names = st.text(st.characters(categories=["L", "N", "P"]), min_size=1, max_size=12)


@st.composite
def any_event(draw: st.DrawFn) -> TotalsEvent:
    """An event that the format allows."""
    wheels = tuple(draw(st.permutations([1, 2, 3, 4])))[: draw(st.integers(1, 4))]
    table = draw(tables)
    counted = draw(st.booleans())
    delta_v = draw(st.none() | st.tuples(number, number, number))
    rates = st.lists(number, min_size=len(wheels), max_size=len(wheels))
    return TotalsEvent(
        id=draw(names),
        epoch=draw(
            st.datetimes(datetime(1997, 1, 1), datetime(2017, 1, 1), timezones=zones)  # noqa: DTZ001
        ),
        branch=draw(st.sampled_from(CASSINI.branches)),
        wheels=wheels,
        rwa_start_rpm=np.array(draw(rates)),
        rwa_end_rpm=np.array(draw(rates)),
        duration_s=draw(st.floats(400.0, 1e5)),
        thrusters=THRUSTERS,
        on_time_s=np.array([seconds for seconds, _ in table]),
        pulses=np.array([count for _, count in table]) if counted else None,
        delta_v_m_s=None if delta_v is None else np.array(delta_v),
        delta_v_source=None if delta_v is None else draw(st.sampled_from(["measured", "computed"])),
        hydrazine_g=draw(st.none() | st.floats(0.0, 0.99e3 * sum(s for s, _ in table))),
        mass_kg=draw(maybe),
        thrust_predicted_n=draw(maybe),
        source="simulation",
    )


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(events=st.lists(any_event(), min_size=1, max_size=3, unique_by=lambda event: event.id))
def test_round_trip_of_any_event(tmp_path: Path, events: list[TotalsEvent]) -> None:
    """Whatever the format allows is read back to the last bit."""
    path = tmp_path / "out.csv"
    write_totals(path, events, CASSINI)
    again = read_totals(path, CASSINI, "simulation")
    assert all(same(a, b) for a, b in zip(again, events, strict=True))


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        ({"duration_s": math.nan}, "duration_s"),
        ({"hydrazine_g": math.inf}, "hydrazine_g"),
        ({"source": "guess"}, "source"),
        ({"id": ""}, "column id"),
        ({"on_time_s": -np.ones(8)}, "on_time_z1_s"),
        ({"wheels": (1, 2, 9)}, "rwa9_rpm_start"),
        ({"thrusters": ("q1", *THRUSTERS[1:])}, "on_time_q1_s"),
    ],
)
def test_events_that_break_the_format_are_not_written(
    tmp_path: Path, change: dict[str, Any], fragment: str
) -> None:
    """The writer refuses what the reader would, and leaves the old file alone."""
    event = read_totals(SMALL, CASSINI)[0]
    path = tmp_path / "out.csv"
    path.write_text("old")
    with pytest.raises(InputError, match=fragment):
        write_totals(path, [replace(event, **change)], CASSINI)
    with pytest.raises(InputError, match="one row per event"):
        write_totals(path, [event, event], CASSINI)
    assert path.read_text() == "old"


@pytest.mark.parametrize("call", ["write", "fsync", "replace"])
def test_a_full_disk_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    """Whichever step fails, the old file stays whole and no temporary file is left."""
    events = read_totals(SMALL, CASSINI)
    path = tmp_path / "out.csv"
    write_totals(path, events[:1], CASSINI)
    old = path.read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def half(self: Path, text: str, **_: object) -> None:
        self.write_bytes(text[: len(text) // 2].encode())
        full()

    with monkeypatch.context() as patch:
        if call == "write":
            patch.setattr(Path, "write_text", half)
        else:
            patch.setattr(os, call, full)
        with pytest.raises(InputError, match="No space left"):
            write_totals(path, events, CASSINI)
    assert path.read_bytes() == old
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.csv"]
    write_totals(path, events, CASSINI)
    assert path.read_bytes() != old  # the control: without the fault the file does change
