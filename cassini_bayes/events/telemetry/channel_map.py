"""Channel maps: which column of somebody else's file is which of ours, and how it is converted.

``docs/how-to/own-columns.md`` has the keys. A map is read without the data
(:func:`read_channel_map`); what it means for the columns of one file is :func:`columns_of`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

from pydantic import Field

from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.block import TextReader
from cassini_bayes.events.telemetry.clocks import (
    DAYS,
    Line,
    TimeSystem,
    line_of_clock,
    reader_of_dates,
)
from cassini_bayes.events.telemetry.columns import TIME, suggestion
from cassini_bayes.events.telemetry.table import ForeignTable
from cassini_bayes.events.telemetry.units import factor_to
from cassini_bayes.files.checks import in_utc
from cassini_bayes.files.toml_file import toml_bytes, toml_of
from cassini_bayes.files.validated import Table, validated

UNITS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "time": "s",
        "attitude": "1",
        "rate": "rad/s",
        "wheel": "rpm",
        "on_time": "s",
        "pulses": "count",
        "delta_v": "m/s",
        "accelerometer": "count",
        "pressure": "kPa",
    }
)
"""Unit of every channel."""
COUNTERS: Final = ("on_time", "pulses", "delta_v", "accelerometer")
"""Channels that count up from the start of the event."""
GROWING: Final = ("on_time", "pulses")
"""Those of them that never fall."""
_ORDERS: Final = {"xyzw": (0, 1, 2, 3), "wxyz": (1, 2, 3, 0)}  # where x, y, z and w stand
_SECONDS_PER_DAY: Final = 86_400.0


class ChannelTable(Table):
    """``[channels.NAME]``: where a column or a channel of ours comes from."""

    source: str | list[str] | None = None
    unit: str | None = None
    scale: float | None = None
    offset: float | None = None
    negate: bool = False
    order: Literal["xyzw", "wxyz"] | None = None
    direction: Literal["inertial_to_body", "body_to_inertial"] | None = None
    kind: Literal["cumulative", "per_interval"] | None = None
    wraps_at: float | None = Field(None, gt=0.0)
    time_system: TimeSystem | None = None
    epoch: Any = None


class _File(Table):
    channels: dict[str, ChannelTable] = Field(default_factory=dict)
    ignore: list[str] = Field(default_factory=list)
    ignore_others: bool = False
    delimiter: str = ","


@dataclass(frozen=True)
class ChannelMap:
    """A channel map as its file has it; ``digest`` is the SHA-256 of the file's bytes."""

    where: str
    channels: Mapping[str, ChannelTable]
    ignore: tuple[str, ...]
    ignore_others: bool
    delimiter: str
    digest: str

    def is_per_interval(self, channel: str, columns: Iterable[str] = ()) -> bool:
        """Whether a counter, or one of its columns by its own key, counts anew in every row."""
        keys = [key for key in (channel, *columns) if key in self.channels]
        return any(self.channels[key].kind == "per_interval" for key in keys)

    def wraps_at(self, channel: str, column: str) -> float | None:
        """Where a counter's column starts again at 0, if that is said: in our unit, no offset."""
        table = self.channels[self._key(channel, column)]
        if table.wraps_at is None:
            return None
        return table.wraps_at * self._factor(channel, column) * _scale_and_offset(table)[0]

    def offset(self, channel: str, column: str) -> float:
        """What is shown of a counter's column where it counts 0, in our unit."""
        table = self.channels[self._key(channel, column)]
        return self._factor(channel, column) * _scale_and_offset(table)[1]

    def _key(self, channel: str, column: str) -> str:
        """Of the table that makes a column: its own, or that of the whole channel."""
        return column if column in self.channels else channel

    def _factor(self, channel: str, column: str) -> float:
        """From the unit of a column to ours."""
        key, ours = self._key(channel, column), UNITS[channel]
        where = f"{self.where}: channels.{key}.unit"
        return factor_to(self.channels[key].unit or ours, ours, where)

    def other_kind(self, channel: str, column: str) -> str:
        """Where the file says how a counter's column counts, and what it may have to say."""
        key = self._key(channel, column)
        where = f"{self.where}: channels.{key}"
        if self.is_per_interval(key):
            return f'{where}.kind is "per_interval": write "cumulative" if the column counts up'
        return f'write kind = "per_interval" in {where} if the column counts anew in every row'


@dataclass(frozen=True)
class Column:
    """One of our columns, made from column ``place`` of a file."""

    name: str
    place: int
    line: Line
    per_interval: bool = False
    grows: bool = False
    dates: TextReader | None = None


def read_channel_map(path: Path) -> ChannelMap:
    """Read and check a channel map.

    Raises
    ------
    InputError
        Missing file, TOML syntax, unknown key (with the nearest one), wrong type.
    """
    content = toml_bytes(path, "a channel map")
    return _checked(toml_of(content, str(path)), str(path), hashlib.sha256(content).hexdigest())


def channel_map_of(table: Mapping[str, Any], where: str = "channels") -> ChannelMap:
    """A channel map from a mapping of the same keys as its file.

    Raises
    ------
    InputError
        As :func:`read_channel_map`.
    """
    content = json.dumps(table, sort_keys=True, default=str).encode()
    return _checked(table, where, hashlib.sha256(content).hexdigest())


def _checked(table: Mapping[str, Any], where: str, digest: str) -> ChannelMap:
    file = validated(_File, table, where)
    mark = file.delimiter
    if len(mark) != 1 or mark.isalnum() or mark in ' ."+-_\r\n' or not (mark.isascii()):
        raise InputError(
            f"{where}: delimiter",
            "one character that stands in no name and no number, such as ; or a tab",
            repr(mark),
            'write e.g. delimiter = ";"',
        )
    channels = dict(file.channels)  # plain: events go from process to process with their map
    return ChannelMap(where, channels, tuple(file.ignore), file.ignore_others, mark, digest)


def columns_of(
    channel_map: ChannelMap,
    file: ForeignTable,
    own: Mapping[str, Sequence[str]],
    every: Mapping[str, Sequence[str]],
    epoch: datetime,
) -> tuple[Column, ...]:
    """Our columns that a map makes from the columns of a file.

    Parameters
    ----------
    file
        The file's columns.
    own, every
        Our columns by channel: those of the event, and those of the whole spacecraft, each of which
        may be mapped by its own name.
    epoch
        Of the event.

    Raises
    ------
    InputError
        Names the map's file and key, or the file whose columns are not all mapped or ignored.
    """
    result: list[Column] = []
    for key, table in channel_map.channels.items():
        where = f"{channel_map.where}: channels.{key}"
        channel, names = _named(key, own, every, where)
        _check_keys(channel, key, table, where)
        sources = _sources(table, names, file, where)
        for name, source in zip(_turned(names, table), sources, strict=True):
            taken = next((column for column in result if column.name == name), None)
            if taken is not None:
                got = f"another one, {file.header[taken.place]!r}, before it"
                raise InputError(where, f"{name} from one column", got, "drop one of the two")
            result.append(_column(name, file.header.index(source), channel, table, epoch, where))
    _check_others(channel_map, file, {column.place for column in result})
    return tuple(result)


def _named(
    key: str, own: Mapping[str, Sequence[str]], every: Mapping[str, Sequence[str]], where: str
) -> tuple[str, tuple[str, ...]]:
    """Channel of a key, and the columns that it stands for."""
    for channel, names in every.items():
        if key in names:
            return channel, (key,)
    if key in own:
        return key, tuple(own[key])
    known = [name for names in every.values() for name in names]
    raise InputError(
        where,
        f"a channel ({', '.join(own)}) or one of its columns",
        "an unknown name",
        suggestion(key, [*own, *known], every),
    )


def _check_keys(channel: str, key: str, table: ChannelTable, where: str) -> None:
    """Refuse keys that say nothing of this channel."""
    dates = table.time_system == "iso8601"
    elapsed = channel == "time" and table.time_system in (None, "elapsed")
    whole, of_whole = key == "attitude", "of the whole channel, [channels.attitude]"
    rules = (
        ("order", table.order, whole, of_whole),
        ("direction", table.direction, whole, of_whole),
        ("kind", table.kind, channel in COUNTERS, f"of {', '.join(COUNTERS)}"),
        (
            "wraps_at",
            table.wraps_at,
            channel in GROWING and table.kind != "per_interval",
            f"of {' and '.join(GROWING)} that count up",
        ),
        ("time_system", table.time_system, channel == "time", "of the time"),
        ("epoch", table.epoch, elapsed, "of a time that has elapsed since then"),
        ("negate", table.negate or None, channel not in ("time", *GROWING), "of what has a sign"),
        ("unit", table.unit, not dates and table.time_system not in DAYS, "of no date or day"),
        ("scale", table.scale, not dates, "of numbers"),
        ("offset", table.offset, not dates and table.kind != "per_interval", "of no interval"),
    )
    for name, value, may, what in rules:
        if value is not None and not may:
            raise InputError(f"{where}.{name}", f"a key {what}", repr(value), "drop the key")
    if table.scale == 0.0:
        raise InputError(f"{where}.scale", "another number than 0", "0", "write the true factor")


def _sources(
    table: ChannelTable, names: Sequence[str], file: ForeignTable, where: str
) -> tuple[str, ...]:
    """The file's columns that a table names, one for each of ours."""
    given = names if table.source is None else table.source
    listed = (given,) if isinstance(given, str) else tuple(given)
    parts = tuple(f"{listed[0]}[{i}]" for i in range(1, len(names) + 1)) if listed else ()
    if len(listed) == 1 < len(names) and set(parts) <= set(file.header):
        listed = parts  # the columns of a matrix
    if len(listed) != len(names):
        raise InputError(
            f"{where}.source",
            f"{len(names)} columns, for {', '.join(names)}",
            f"{len(listed)}",
            "list one column for each, in this order",
        )
    for source in listed:
        if source in file.refused:
            got = f"{source!r}: {file.refused[source]}"
            fix = "name another column, or store it as numbers"
            raise InputError(f"{where}.source", "a column of numbers", got, fix)
        if file.header.count(source) != 1:
            expected = f"a column of {file.header_place}"
            is_there = source in file.header
            got = f"{source!r}, which is there {'twice' if is_there else 'nowhere'}"
            fix = "rename one of the two" if is_there else suggestion(source, file.header)
            raise InputError(f"{where}.source", expected, got, fix)
    return listed


def _turned(names: Sequence[str], table: ChannelTable) -> Iterator[str]:
    """Our names in the order in which the sources are listed."""
    places = _ORDERS[table.order] if table.order else range(len(names))
    yield from (names[places.index(i)] for i in range(len(names)))


def _column(
    name: str, place: int, channel: str, table: ChannelTable, epoch: datetime, where: str
) -> Column:
    if channel == "time":
        return _clock(name, place, table, epoch, where)
    factor = factor_to(table.unit or UNITS[channel], UNITS[channel], f"{where}.unit")
    back = table.direction == "body_to_inertial" and name != "q4"  # the inverse turn
    sign = -1.0 if back != table.negate else 1.0
    scale, offset = _scale_and_offset(table)
    line = Line(sign * scale * factor, sign * offset * factor)
    return Column(name, place, line, table.kind == "per_interval", channel in GROWING)


def _clock(name: str, place: int, table: ChannelTable, epoch: datetime, where: str) -> Column:
    system = table.time_system or "elapsed"
    if system == "iso8601":
        return Column(name, place, Line(1.0, 0.0), dates=reader_of_dates(epoch))
    unit_s = _SECONDS_PER_DAY
    if system not in DAYS:
        unit_s = factor_to(table.unit or UNITS["time"], UNITS["time"], f"{where}.unit")
    began = in_utc(table.epoch) if isinstance(table.epoch, str | datetime) else None
    if began is None and table.epoch is not None:
        got, fix = repr(table.epoch), "write e.g. 2010-02-13T12:00:00Z"
        raise InputError(f"{where}.epoch", "an ISO 8601 time, UTC", got, fix)
    line = line_of_clock(system, unit_s, *_scale_and_offset(table), began, epoch)
    return Column(name, place, line)


def _scale_and_offset(table: ChannelTable) -> tuple[float, float]:
    return 1.0 if table.scale is None else table.scale, table.offset or 0.0


def _check_others(channel_map: ChannelMap, file: ForeignTable, mapped: set[int]) -> None:
    """Refuse columns that are neither mapped nor ignored: nothing is left out in silence."""
    if TIME not in channel_map.channels and "time" not in channel_map.channels:
        where, fix = f"{channel_map.where}: channels", "say which column holds the time"
        raise InputError(where, "a table [channels.time]", "none", fix)
    if channel_map.ignore_others:
        return
    others = [name for i, name in enumerate(file.header) if i not in mapped]
    left = [name for name in (*others, *file.refused) if name not in channel_map.ignore]
    if left:
        names = ", ".join(json.dumps(name, ensure_ascii=False) for name in left[:12])
        more = ", …" if len(left) > 12 else ""
        raise InputError(
            file.header_place,
            f"columns that {channel_map.where} maps or ignores",
            f"{names}{more} besides",
            f"map them, or add ignore = [{names}{more}] or ignore_others = true there",
        )
