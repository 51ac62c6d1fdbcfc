"""``event.toml``: what happened, checked, and which file holds the telemetry."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime, time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np

from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.channel_map import (
    ChannelMap,
    channel_map_of,
    read_channel_map,
)
from cassini_bayes.events.telemetry.columns import KINDS, Kind, make_layout
from cassini_bayes.events.telemetry.files import open_table
from cassini_bayes.events.telemetry.memory import MemoryTable
from cassini_bayes.events.totals import DELTA_V_SOURCES, DeltaVSource
from cassini_bayes.files.cells import check_once
from cassini_bayes.files.checks import check_known, in_utc
from cassini_bayes.files.reading import exists
from cassini_bayes.files.storage import digest
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.spacecraft import Spacecraft, load_spacecraft

if TYPE_CHECKING:
    import pandas as pd

Text = TypeVar("Text", bound=str)
DESCRIPTION: Final = "event.toml"
FILES: Final = ("telemetry.csv", "telemetry.parquet")
_NEEDED: Final = ("id", "kind", "epoch", "branch", "wheels", "source")
_KEYS: Final = (*_NEEDED, "delta_v_source", "channels", "telemetry")
CHANNELS: Final = "channels.toml"


@dataclass(frozen=True, repr=False)
class TelemetryEvent:
    """``event.toml`` of an event folder, checked against the header of its telemetry.

    ``wheels`` are the prime wheels in the order of the columns of T and of ``Chunk.wheel_rpm``;
    ``thrusters`` the branch's thrusters in file order, () if the telemetry has no on-times.
    ``telemetry`` is its file or table, ``channels`` the map of its columns if they are not ours.
    ``digest`` is the SHA-256 of event.toml, telemetry and map together, in hexadecimal;
    ``has_accelerometer`` whether the telemetry has an accelerometer's counts.
    """

    id: str
    kind: Kind
    epoch: datetime
    branch: str
    wheels: tuple[int, ...]
    thrusters: tuple[str, ...]
    delta_v_source: DeltaVSource | None
    source: str
    folder: Path
    telemetry: Path | MemoryTable
    digest: str
    has_accelerometer: bool = False
    channels: ChannelMap | None = None

    def __repr__(self) -> str:
        fired = f"thrusters {', '.join(self.thrusters)}" if self.thrusters else "no thrusters"
        return (
            f"TelemetryEvent {self.id}: {self.kind} at {self.epoch.isoformat()}, branch "
            f"{self.branch}, wheels {', '.join(map(str, self.wheels))}, {fired}; {self.telemetry}"
        )

    @property
    def where(self) -> str:
        """What describes the event, for messages."""
        return str(self.folder / DESCRIPTION)


def event_path(given: str | os.PathLike[str]) -> str:
    """The folder of an event that is named by its ``event.toml``; any other path as it is."""
    path = Path(given)
    is_description = path.name == DESCRIPTION and not (exists(path) and path.is_dir())
    return str(path.parent) if is_description else os.fspath(given)


def read_event(folder: str | Path, spacecraft: Spacecraft | str | Path) -> TelemetryEvent:
    """Read an event folder's ``event.toml`` and the header of its telemetry.

    Parameters
    ----------
    folder
        The folder, or its ``event.toml``.
    spacecraft
        A spacecraft, the name of a built-in one, or the path of its file.

    Raises
    ------
    InputError
        No such folder or file, bad TOML, unknown key (with the nearest one), wrong type or value,
        an unknown or missing column, a ΔV without its source or the other way round; anything
        wrong with the channel map.
    """
    path = Path(event_path(folder)) / DESCRIPTION
    keys = _Keys(str(path), _parse(path))
    telemetry = _telemetry_of(path.parent, keys)
    channels = _channels_of(path.parent, keys)
    digests = (digest(path), digest(telemetry))
    return _described(keys, spacecraft, path.parent, telemetry, channels, digests)


def event_from_frame(
    frame: pd.DataFrame,
    event: Mapping[str, Any] | str | Path,
    spacecraft: Spacecraft | str | Path,
    channels: Mapping[str, Any] | str | Path | None = None,
) -> TelemetryEvent:
    """An event whose telemetry is a data frame, for everything that takes an event folder.

    Parameters
    ----------
    frame
        One row per sample time; NaN means "not sampled". The columns are copied.
    event
        What ``event.toml`` would say, or the path of one, or of a folder that holds one.
    spacecraft
        A spacecraft, the name of a built-in one, or the path of its file.
    channels
        What ``channels.toml`` would say, or its path; None for a frame with the columns of this
        package.

    Raises
    ------
    InputError
        As :func:`read_event`, what is no data frame, or a cell of text among numbers.
    """
    if isinstance(event, Mapping):
        keys, folder = _Keys("event", event), Path()
    else:
        place = Path(event)
        path = place / DESCRIPTION if place.is_dir() else place
        keys, folder = _Keys(str(path), _parse(path)), path.parent
    for key in ("telemetry", "channels"):
        keys.refuse_given(key, "the data frame and the argument channels take its place")
    channel_map = None
    if isinstance(channels, Mapping):
        channel_map = channel_map_of(channels)
    elif channels is not None:
        channel_map = read_channel_map(Path(channels))
    table = _table_of(frame, f"data frame of event {keys.text('id')}")
    said = json.dumps(keys.table, sort_keys=True, default=str)
    return _described(keys, spacecraft, folder, table, channel_map, (said, table.digest))


def _table_of(frame: pd.DataFrame, name: str) -> MemoryTable:
    if not (hasattr(frame, "columns") and hasattr(frame, "iloc")):
        got = type(frame).__name__
        raise InputError(name, "a pandas DataFrame", got, "write pandas.DataFrame(…) around it")
    header = [str(label) for label in frame.columns]
    check_once(name, header)
    columns = {}
    for i, label in enumerate(header):
        series = frame.iloc[:, i]
        if getattr(series.dtype, "tz", None) is not None:
            series = series.dt.tz_convert("UTC").dt.tz_localize(None)
        values = np.array(series.to_numpy())
        if values.dtype.hasobject:  # pandas.NA has no truth value: nothing can ask what it is
            values[series.isna().to_numpy()] = None
        values.setflags(write=False)
        columns[label] = values
    return MemoryTable(name, columns)


def _described(
    keys: _Keys,
    given: Spacecraft | str | Path,
    folder: Path,
    telemetry: Path | MemoryTable,
    channels: ChannelMap | None,
    digests: Sequence[str],
) -> TelemetryEvent:
    """The event of a description, checked against the columns of its telemetry."""
    spacecraft = given if isinstance(given, Spacecraft) else load_spacecraft(given)
    digests = (*digests, *([channels.digest] if channels else []))
    kind, branch = keys.choice("kind", KINDS), keys.choice("branch", spacecraft.branches)
    wheels, epoch = keys.wheels(spacecraft), keys.epoch()
    with open_table(telemetry, channels, spacecraft, wheels, branch, epoch) as table:
        layout = make_layout(table.header_place, table.header, spacecraft, kind, wheels, branch)
    return TelemetryEvent(
        id=keys.text("id"),
        kind=kind,
        epoch=epoch,
        branch=branch,
        wheels=wheels,
        thrusters=spacecraft.thruster_names(branch) if layout.channels["on_time"] else (),
        delta_v_source=keys.delta_v_source(bool(layout.channels["delta_v"])),
        source=keys.text("source"),
        folder=folder,
        telemetry=telemetry,
        digest=hashlib.sha256(" ".join(digests).encode()).hexdigest(),
        has_accelerometer=bool(layout.channels["accelerometer"]),
        channels=channels,
    )


def _parse(path: Path) -> dict[str, Any]:
    folder = path.parent
    what = "a description of the event"
    if not exists(folder):
        raise InputError(str(folder), "an event folder", "nothing there", "check the path")
    if not folder.is_dir():
        fix = f"name the folder that holds {DESCRIPTION}"
        raise InputError(str(folder), "an event folder", "a file", fix)
    if not path.exists():
        names = sorted(entry.name for entry in folder.iterdir())
        fix = f"write {DESCRIPTION}; the folder holds {', '.join(names[:5]) or 'nothing'}"
        raise InputError(str(path), what, "no such file", fix)
    return read_toml(path, what)


def _channels_of(folder: Path, keys: _Keys) -> ChannelMap | None:
    """The channel map that the description names, or the one beside it, if there is one."""
    if "channels" in keys.table:
        return read_channel_map(_named(folder, keys.text("channels")))
    beside = folder / CHANNELS
    return read_channel_map(beside) if exists(beside) else None


def _named(folder: Path, name: str) -> Path:
    """A file that a description names, as short as messages should have it."""
    return Path(os.path.normpath(folder / name))


def _telemetry_of(folder: Path, keys: _Keys) -> Path:
    """The file of rows: the one that the description names, or the one beside it."""
    if "telemetry" in keys.table:
        return _named(folder, keys.text("telemetry"))
    there = [folder / name for name in FILES if (folder / name).exists()]
    if not there:
        names = sorted(entry.name for entry in folder.iterdir() if entry.name != DESCRIPTION)
        raise InputError(
            str(folder),
            " or ".join(FILES),
            f"only {', '.join(names[:5])}" if names else "no telemetry",
            f'put the telemetry beside {DESCRIPTION}, or name it there: telemetry = "…"',
        )
    if len(there) > 1:
        expected = f"either {' or '.join(FILES)}"
        raise InputError(str(folder), expected, "both", "keep the one that counts")
    if there[0].is_dir():
        raise InputError(str(there[0]), "a file", "a folder", "put the file in its place")
    return there[0]


class _Keys:
    """Values of ``event.toml``, checked one by one."""

    def __init__(self, file: str, table: Mapping[str, Any]) -> None:
        self._file, self.table = file, table
        for key in table:
            if key not in _KEYS:
                left = [name for name in _KEYS if name not in table] or _KEYS
                check_known(f"{file}: {key}", key, left, "a known key", "an unknown key")
        for key in _NEEDED:
            if key not in table:
                raise InputError(f"{file}: {key}", "a value", "nothing", f"add {key} = …")

    def _refuse(self, key: str, expected: str, fix: str) -> InputError:
        return InputError(f"{self._file}: {key}", expected, repr(self.table[key]), fix)

    def refuse_given(self, key: str, why: str) -> None:
        """Refuse a key that means nothing here."""
        if key in self.table:
            raise self._refuse(key, f"no such key: {why}", "drop the key")

    def text(self, key: str) -> str:
        """A text that is not blank."""
        value = self.table[key]
        if not isinstance(value, str) or not value.strip():
            raise self._refuse(key, "a text", f'write {key} = "…"')
        return value

    def choice(self, key: str, known: tuple[Text, ...]) -> Text:
        """One of several texts."""
        value = self.table[key]
        check_known(f"{self._file}: {key}", value, known)
        return known[known.index(value)]

    def wheels(self, spacecraft: Spacecraft) -> tuple[int, ...]:
        """Different wheels of the spacecraft."""
        value = self.table["wheels"]
        if isinstance(value, tuple | np.ndarray):  # of a caller in Python
            value = np.asarray(value).tolist()
        known = spacecraft.wheel_numbers
        expected, fix = f"a list of wheels out of {known}", f"write e.g. wheels = {known[:3]}"
        if not isinstance(value, list) or not value or not all(type(n) is int for n in value):
            raise self._refuse("wheels", expected, fix)
        if not set(value) <= set(known):
            raise self._refuse("wheels", expected, fix)
        if len(set(value)) != len(value):
            raise self._refuse("wheels", "each wheel once", fix)
        return tuple(value)

    def epoch(self) -> datetime:
        """A time in UTC; without a zone it is taken as UTC."""
        value = self.table["epoch"]
        if isinstance(value, date) and not isinstance(value, datetime):
            value = datetime.combine(value, time())
        epoch = in_utc(value) if isinstance(value, str | datetime) else None
        if epoch is None:
            fix = "write e.g. 2010-02-13T12:00:00Z"
            raise self._refuse("epoch", "an ISO 8601 time, UTC", fix)
        return epoch

    def delta_v_source(self, has_delta_v: bool) -> DeltaVSource | None:
        """Where ΔV comes from; given if and only if there is one."""
        if "delta_v_source" not in self.table:
            if has_delta_v:
                raise InputError(
                    f"{self._file}: delta_v_source",
                    f"{' or '.join(DELTA_V_SOURCES)}, because the telemetry has ΔV columns",
                    "nothing",
                    'add delta_v_source = "…"; only a measured ΔV says something about thrust',
                )
            return None
        source = self.choice("delta_v_source", DELTA_V_SOURCES)
        if not has_delta_v:
            raise self._refuse(
                "delta_v_source",
                "no such key, because the telemetry has no ΔV columns",
                "add the columns delta_v_x_m_s to delta_v_z_m_s, or drop the key",
            )
        return source
