"""Totals-only bias events: one row per event and source in a CSV.

``docs/reference/telemetry-format.md`` has the format.

A row is what a flight table gives of one wheel bias: the wheel rates at both ends, the commanded
on-time and the number of pulses of every thruster, and optionally velocity change, hydrazine and
the ground software's mass and thrust. :func:`read_totals` checks every cell at the door and names
file, line and column of the first thing that cannot be right; inside, an event is frozen.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Literal

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.cells import MOST_BYTES, Row, first_line, read_rows, rows_of
from cassini_bayes.files.checks import check_known, in_utc, nearest
from cassini_bayes.files.reading import exists
from cassini_bayes.files.storage import write_text
from cassini_bayes.spacecraft import Spacecraft

DeltaVSource = Literal["measured", "computed"]
DELTA_V_SOURCES: Final[tuple[DeltaVSource, ...]] = ("measured", "computed")

SOURCES: Final = ("flight", "fsds", "gsw_ideal", "gsw", "simulation")
_WHAT: Final = "an event folder or a CSV of totals"
_MOST_SHOWN: Final = 60  # characters of a header in a message
_COUNTED_SOURCES: Final = ("flight", "fsds", "simulation")
"""Pulses of the ground software are computed and rounded: 0 may stand beside a short on-time."""
SHORTEST_PULSE_S: Final = 0.005
"""No valve of this kind opens for less; a mean width below it means swapped or misread columns."""
MOST_HYDRAZINE_G_S: Final = 1_000.0
"""Of a thruster that is open: thrusts of 2 kN; those of attitude control use half a gram."""
_DELTA_V_COLUMNS: Final = tuple(f"delta_v_{axis}_m_s" for axis in "xyz")


@dataclass(frozen=True, eq=False, kw_only=True)
class TotalsEvent:
    """Totals of one bias event, from one source. Arrays are copied and read-only.

    ``on_time_s`` and ``pulses`` are aligned with ``thrusters`` (those of the branch, in file
    order), ``rwa_start_rpm`` and ``rwa_end_rpm`` with ``wheels``. On-times are as commanded, per
    thruster. ``delta_v_m_s`` is in body axes; ``mass_kg`` and ``thrust_predicted_n`` are what the
    ground software assumed. None means not given.
    """

    id: str
    epoch: datetime
    branch: str
    wheels: tuple[int, ...]
    rwa_start_rpm: Array  # (W,)
    rwa_end_rpm: Array  # (W,)
    duration_s: float
    thrusters: tuple[str, ...]
    on_time_s: Array  # (K,)
    pulses: Array | None = None  # (K,)
    delta_v_m_s: Array | None = None  # (3,)
    delta_v_source: DeltaVSource | None = None
    hydrazine_g: float | None = None
    mass_kg: float | None = None
    thrust_predicted_n: float | None = None
    source: str

    def __post_init__(self) -> None:
        for name in ("rwa_start_rpm", "rwa_end_rpm", "on_time_s", "pulses", "delta_v_m_s"):
            value = getattr(self, name)
            if value is not None:
                array = np.array(value, dtype=np.float64)
                array.setflags(write=False)
                object.__setattr__(self, name, array)


def totals_columns(spacecraft: Spacecraft) -> tuple[str, ...]:
    """Columns of a totals CSV of this spacecraft, in the order in which they are written.

    A file may leave out the rate columns of wheels that are prime in none of its events.
    """
    thrusters = dict.fromkeys(thruster.name for thruster in spacecraft.thrusters)
    return (
        *("id", "epoch", "branch", "wheels"),
        *_rate_columns(spacecraft),
        "duration_s",
        *(f"on_time_{name}_s" for name in thrusters),
        *(f"pulses_{name}" for name in thrusters),
        *_DELTA_V_COLUMNS,
        *("hydrazine_g", "mass_kg", "thrust_predicted_n", "delta_v_source", "source"),
    )


def _rate_columns(spacecraft: Spacecraft) -> tuple[str, ...]:
    return tuple(f"{w.name}_rpm_{end}" for end in ("start", "end") for w in spacecraft.wheels)


def read_totals(
    reference: str | Path, spacecraft: Spacecraft, source: str = "flight"
) -> tuple[TotalsEvent, ...]:
    """Read the events of one source from a totals CSV, in file order.

    Parameters
    ----------
    reference
        ``file.csv`` for all events, ``file.csv:ID`` for one.
    spacecraft
        Gives the wheels, branches and thrusters, and with them the columns.
    source
        Which rows: ``flight``, ``fsds``, ``gsw_ideal``, ``gsw`` or ``simulation``.

    Raises
    ------
    InputError
        Names file, line and column, what was expected, what was found and the fix.
    """
    file, wanted = split_reference(str(reference))
    path = Path(file)
    _refuse_telemetry(path)
    rows = read_rows(path, *_columns(spacecraft), what=_WHAT)
    by_source: dict[str, dict[str, Row]] = {}
    for row in rows:
        identity, kind = _identity(row)
        earlier = by_source.setdefault(kind, {}).setdefault(identity, row)
        if earlier is not row:
            raise row.refuse(
                "id",
                f"one row per event and source ({kind})",
                "drop or rename one of the two",
                f"{identity!r} again, as in line {earlier.line}",
            )
    chosen = _choose(str(path), by_source, source, wanted)
    return tuple(_event(row, spacecraft) for row in chosen)


def write_totals(path: str | Path, events: Iterable[TotalsEvent], spacecraft: Spacecraft) -> None:
    """Write events as a totals CSV that :func:`read_totals` reads back exactly.

    The text is read back before the file is touched, and the file is replaced in one step.

    Raises
    ------
    InputError
        The place cannot be written, or an event breaks a rule of the format (the message names
        line and column that the row would have had).
    """
    columns = totals_columns(spacecraft)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for event in events:
        cells = _cells(event, spacecraft)
        unknown = [name for name in cells if name not in columns]
        if unknown:
            raise InputError(
                f"{path}: event {event.id}",
                f"wheels and thrusters of {spacecraft.name}",
                f"a value for {unknown[0]}",
                "write the event with the spacecraft it was made for",
            )
        writer.writerow([cells.get(column, "") for column in columns])
    text = stream.getvalue()
    identities = set()
    for row in rows_of(str(path), text, *_columns(spacecraft)):
        if (identity := _identity(row)) in identities:
            raise row.refuse("id", "one row per event and source", "drop or rename one of the two")
        identities.add(identity)
        _event(row, spacecraft)
    write_text(Path(path), text)


def split_reference(reference: str, base: Path = Path()) -> tuple[str, str | None]:
    """File and id of ``file.csv`` or ``file.csv:ID``, the file relative to ``base``.

    Both names may hold colons: the file that exists decides.
    """
    if exists(base / reference) or ":" not in reference:
        return reference, None
    ends = [i for i, character in enumerate(reference) if character == ":"]
    end = next((i for i in reversed(ends) if exists(base / reference[:i])), ends[-1])
    return reference[:end], reference[end + 1 :]


def _columns(spacecraft: Spacecraft) -> tuple[tuple[str, ...], set[str]]:
    """Columns that a file may have, and those that it must have."""
    columns = totals_columns(spacecraft)
    return columns, set(columns) - set(_rate_columns(spacecraft))


def _identity(row: Row) -> tuple[str, str]:
    return row.text("id", "a name of the event"), row.choice("source", SOURCES)


def _refuse_telemetry(path: Path) -> None:
    """Refuse a table whose header has nothing of totals, and say where telemetry goes."""
    header = first_line(path, _WHAT, "#")
    if path.stat().st_size > MOST_BYTES:
        return  # its size says more
    names = {name.strip(' "') for name in header.split(",")}
    if header and "id" not in names and "duration_s" not in header:
        raise InputError(
            f"{path}: line 1",
            "a table of totals, with columns id, epoch, duration_s, …",
            f"columns {header[:_MOST_SHOWN]}{'…' if len(header) > _MOST_SHOWN else ''}",
            "add the header line; telemetry goes into an event folder: "
            f"cassini-bayes init DIR --spacecraft NAME --from {path}",
        )


def _choose(
    file: str, by_source: Mapping[str, Mapping[str, Row]], source: str, wanted: str | None
) -> list[Row]:
    if source not in by_source:
        wanted_rows, got = f"rows of source {source!r}", f"rows of {', '.join(by_source)}"
        raise InputError(file, wanted_rows, got, nearest(source, by_source))
    rows = by_source[source]
    if wanted is None:
        return list(rows.values())
    if wanted not in rows:
        others = [kind for kind, rows_of in by_source.items() if wanted in rows_of]
        raise InputError(
            f"{file}:{wanted}",
            f"the id of an event of source {source!r}",
            f"one that only {', '.join(others)} has" if others else f"the unknown id {wanted!r}",
            f"choose source {others[0]!r}" if others else nearest(wanted, rows),
        )
    return [rows[wanted]]


def _event(row: Row, spacecraft: Spacecraft) -> TotalsEvent:
    expected = f"a thruster branch of {spacecraft.name}"
    branch = row.choice("branch", spacecraft.branches, expected)
    wheels = _wheels(row, spacecraft)
    start, end = _wheel_rates(row, spacecraft, wheels)
    duration = row.positive("duration_s", "s")
    thrusters = spacecraft.thruster_names(branch)
    on_time = _on_times(row, spacecraft, thrusters, duration)
    delta_v, delta_v_source = _delta_v(row)
    hydrazine = _hydrazine(row, sum(on_time)) if row.cells["hydrazine_g"] else None
    mass = row.positive("mass_kg", "kg") if row.cells["mass_kg"] else None
    predicted = row.cells["thrust_predicted_n"]
    return TotalsEvent(
        id=row.cells["id"],
        epoch=_epoch(row),
        branch=branch,
        wheels=wheels,
        rwa_start_rpm=np.array(start),
        rwa_end_rpm=np.array(end),
        duration_s=duration,
        thrusters=thrusters,
        on_time_s=np.array(on_time),
        pulses=_pulses(row, spacecraft, thrusters, on_time),
        delta_v_m_s=delta_v,
        delta_v_source=delta_v_source,
        hydrazine_g=hydrazine,
        mass_kg=mass,
        thrust_predicted_n=row.positive("thrust_predicted_n", "N") if predicted else None,
        source=row.cells["source"],
    )


def _hydrazine(row: Row, on_time_s: float) -> float:
    value = row.non_negative("hydrazine_g", "g")
    if value > MOST_HYDRAZINE_G_S * on_time_s:
        raise row.refuse(
            "hydrazine_g",
            f"at most {MOST_HYDRAZINE_G_S:g} g for each second of on-time",
            "check the unit (g, not mg) and the on-times",
            f"{value:g} g in {on_time_s:g} s",
        )
    return value


def _epoch(row: Row) -> datetime:
    epoch = in_utc(row.text("epoch", "an ISO 8601 time"))
    if epoch is None:
        fix = "write e.g. 2010-02-13 or 2010-02-13T12:00:00Z"
        raise row.refuse("epoch", "an ISO 8601 time, UTC", fix)
    return epoch


def _wheels(row: Row, spacecraft: Spacecraft) -> tuple[int, ...]:
    known = spacecraft.wheel_numbers
    expected = f"different wheels out of {known}, separated by blanks"
    fix = f"write e.g. {' '.join(str(number) for number in known[:3])}"
    words = row.text("wheels", expected).split()
    numbers = {str(number): number for number in known}
    if not all(word.lstrip("0") in numbers for word in words):
        raise row.refuse("wheels", expected, fix)
    wheels = tuple(numbers[word.lstrip("0")] for word in words)
    if len(set(wheels)) != len(wheels):
        raise row.refuse("wheels", expected, "list each wheel once")
    return wheels


def _wheel_rates(
    row: Row, spacecraft: Spacecraft, wheels: tuple[int, ...]
) -> tuple[list[float], list[float]]:
    names = {wheel.number: wheel.name for wheel in spacecraft.wheels}
    prime = " ".join(map(str, wheels))
    for number, name in names.items():
        for column in (f"{name}_rpm_start", f"{name}_rpm_end"):
            if number not in wheels and row.cells[column]:
                expected = f"an empty cell: wheel {number} is not among the prime wheels {prime}"
                raise row.refuse(column, expected, "correct the wheels, or empty the cell")
    limit = spacecraft.highest_wheel_rpm
    start = [_wheel_rate(row, f"{names[number]}_rpm_start", limit) for number in wheels]
    return start, [_wheel_rate(row, f"{names[number]}_rpm_end", limit) for number in wheels]


def _wheel_rate(row: Row, column: str, limit_rpm: float) -> float:
    rate = row.number(column, "rev/min, because the wheel is prime")
    if abs(rate) > limit_rpm:
        raise row.refuse(
            column,
            f"a wheel rate within ±{limit_rpm:g} rev/min",
            "check the unit (rev/min, not degrees or radians) and the decimal point; faster wheels"
            " have highest_wheel_rpm in their spacecraft file",
        )
    return rate


def _refuse_other_branch(row: Row, spacecraft: Spacecraft, own: Sequence[str], form: str) -> None:
    for thruster in spacecraft.thrusters:
        column = form.format(thruster.name)
        if thruster.name not in own and row.cells[column]:
            branch = row.cells["branch"]
            expected = f"an empty cell: branch {branch} has no thruster {thruster.name}"
            raise row.refuse(column, expected, "correct the branch, or empty the cell")


def _on_times(
    row: Row, spacecraft: Spacecraft, thrusters: tuple[str, ...], duration: float
) -> list[float]:
    _refuse_other_branch(row, spacecraft, thrusters, "on_time_{}_s")
    values = []
    for name in thrusters:
        column = f"on_time_{name}_s"
        value = row.non_negative(column, "s")
        if value > duration:
            expected = f"an on-time no longer than the event, {duration:g} s"
            raise row.refuse(column, expected, "check duration_s and the unit (s)")
        values.append(value)
    return values


def _pulses(
    row: Row, spacecraft: Spacecraft, thrusters: tuple[str, ...], on_time: Sequence[float]
) -> Array | None:
    _refuse_other_branch(row, spacecraft, thrusters, "pulses_{}")
    if not any(row.cells[f"pulses_{name}"] for name in thrusters):
        return None
    values = []
    for name, seconds in zip(thrusters, on_time, strict=True):
        column = f"pulses_{name}"
        count = row.non_negative(column, "pulses (give them for all thrusters or for none)")
        if count != int(count):
            raise row.refuse(column, "a whole number of pulses", "check the column")
        if row.cells["source"] in _COUNTED_SOURCES and (count == 0) != (seconds == 0):
            raise row.refuse(
                column,
                f"{'no' if seconds == 0 else 'at least one'} pulse for {seconds:g} s of on-time",
                f"check this cell and on_time_{name}_s",
            )
        if count > 0 and seconds / count < SHORTEST_PULSE_S:
            raise row.refuse(
                column,
                f"pulses of at least {SHORTEST_PULSE_S:g} s on average",
                f"check this cell and on_time_{name}_s (s, not ms)",
                f"{count:g} in {seconds:g} s",
            )
        values.append(count)
    return np.array(values)


def _delta_v(row: Row) -> tuple[Array | None, DeltaVSource | None]:
    declared = row.cells["delta_v_source"]
    expected = " or ".join(DELTA_V_SOURCES)
    if not any(row.cells[column] for column in _DELTA_V_COLUMNS):
        if declared:
            raise row.refuse(
                "delta_v_source",
                "an empty cell: the row has no velocity change",
                "fill in delta_v_x_m_s to delta_v_z_m_s, or empty this cell",
            )
        return None, None
    unit = "m/s (all three axes or none)"
    vector = np.array([row.number(column, unit) for column in _DELTA_V_COLUMNS])
    row.text("delta_v_source", f"{expected}, because the row has a velocity change")
    check_known(row.where("delta_v_source"), declared, DELTA_V_SOURCES, expected)
    return vector, DELTA_V_SOURCES[DELTA_V_SOURCES.index(declared)]


def _number_cell(value: float) -> str:
    number = float(value)
    return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)


def _cells(event: TotalsEvent, spacecraft: Spacecraft) -> dict[str, str]:
    """Cells of one event by column; what is not given is left out."""
    names = {wheel.number: wheel.name for wheel in spacecraft.wheels}
    numbers: dict[str, float | None] = {
        "duration_s": event.duration_s,
        "hydrazine_g": event.hydrazine_g,
        "mass_kg": event.mass_kg,
        "thrust_predicted_n": event.thrust_predicted_n,
    }
    for i, wheel in enumerate(event.wheels):
        name = names.get(wheel, f"rwa{wheel}")
        numbers[f"{name}_rpm_start"] = event.rwa_start_rpm[i]
        numbers[f"{name}_rpm_end"] = event.rwa_end_rpm[i]
    for i, thruster in enumerate(event.thrusters):
        numbers[f"on_time_{thruster}_s"] = event.on_time_s[i]
        if event.pulses is not None:
            numbers[f"pulses_{thruster}"] = event.pulses[i]
    if event.delta_v_m_s is not None:
        numbers.update(zip(_DELTA_V_COLUMNS, event.delta_v_m_s, strict=True))
    return {
        "id": event.id,
        "epoch": event.epoch.astimezone(UTC).isoformat().replace("+00:00", "Z"),
        "branch": event.branch,
        "wheels": " ".join(str(number) for number in event.wheels),
        "delta_v_source": event.delta_v_source or "",
        "source": event.source,
        **{name: _number_cell(value) for name, value in numbers.items() if value is not None},
    }
