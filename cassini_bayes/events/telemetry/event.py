"""``event.toml``: what happened, checked, and which file holds the telemetry."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime, time
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.columns import KINDS, Kind, Layout, make_layout
from cassini_bayes.events.telemetry.files import open_table
from cassini_bayes.files.checks import in_utc, nearest
from cassini_bayes.files.reading import exists
from cassini_bayes.files.storage import digest
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.spacecraft import Spacecraft

Text = TypeVar("Text", bound=str)
DESCRIPTION: Final = "event.toml"
FILES: Final = ("telemetry.csv", "telemetry.parquet")
SOURCES_OF_DELTA_V: Final[tuple[Literal["measured", "computed"], ...]] = ("measured", "computed")
_NEEDED: Final = ("id", "kind", "epoch", "branch", "wheels", "source")
_KEYS: Final = (*_NEEDED, "delta_v_source")


@dataclass(frozen=True)
class TelemetryEvent:
    """``event.toml`` of an event folder, checked against the header of its telemetry.

    ``wheels`` are the prime wheels in the order of the columns of T and of ``Chunk.wheel_rpm``;
    ``thrusters`` the branch's thrusters in file order, () if the telemetry has no on-times.
    ``digest`` is the SHA-256 of event.toml and telemetry together, in hexadecimal.
    """

    id: str
    kind: Kind
    epoch: datetime
    branch: str
    wheels: tuple[int, ...]
    thrusters: tuple[str, ...]
    delta_v_source: Literal["measured", "computed"] | None
    source: str
    folder: Path
    telemetry: Path
    digest: str


def read_event(folder: str | Path, spacecraft: Spacecraft) -> TelemetryEvent:
    """Read an event folder's ``event.toml`` and the header of its telemetry.

    Raises
    ------
    InputError
        No such folder or file, bad TOML, unknown key (with the nearest one), wrong type or value,
        an unknown or missing column, a ΔV without its source or the other way round.
    """
    place = Path(folder)
    path = place / DESCRIPTION
    table = _parse(path)
    keys = _Keys(str(path), table)
    kind, branch = keys.choice("kind", KINDS), keys.choice("branch", spacecraft.branches)
    wheels = keys.wheels(spacecraft)
    telemetry = _find_telemetry(place)
    layout = layout_of(telemetry, spacecraft, kind, wheels, branch)
    return TelemetryEvent(
        id=keys.text("id"),
        kind=kind,
        epoch=keys.epoch(),
        branch=branch,
        wheels=wheels,
        thrusters=spacecraft.thruster_names(branch) if layout.channels["on_time"] else (),
        delta_v_source=keys.delta_v_source(bool(layout.channels["delta_v"])),
        source=keys.text("source"),
        folder=place,
        telemetry=telemetry,
        digest=hashlib.sha256(f"{digest(path)} {digest(telemetry)}".encode()).hexdigest(),
    )


def layout_of(
    telemetry: Path, spacecraft: Spacecraft, kind: Kind, wheels: tuple[int, ...], branch: str
) -> Layout:
    """Where every channel stands in a telemetry file, from its header."""
    with open_table(telemetry) as table:
        return make_layout(table.header_place, table.header, spacecraft, kind, wheels, branch)


def _parse(path: Path) -> dict[str, Any]:
    folder = path.parent
    if not exists(folder):
        raise InputError(str(folder), "an event folder", "nothing there", "check the path")
    if not folder.is_dir():
        raise InputError(
            str(folder), "an event folder", "a file", f"name the folder that holds {DESCRIPTION}"
        )
    if not path.exists():
        names = sorted(entry.name for entry in folder.iterdir())
        raise InputError(
            str(path),
            "a description of the event",
            "no such file",
            f"write {DESCRIPTION}; the folder holds {', '.join(names[:5]) or 'nothing'}",
        )
    return read_toml(path, "a description of the event")


def _find_telemetry(folder: Path) -> Path:
    there = [folder / name for name in FILES if (folder / name).exists()]
    if not there:
        names = sorted(entry.name for entry in folder.iterdir() if entry.name != DESCRIPTION)
        raise InputError(
            str(folder),
            " or ".join(FILES),
            f"only {', '.join(names[:5])}" if names else "no telemetry",
            f"put the telemetry beside {DESCRIPTION}",
        )
    if len(there) > 1:
        raise InputError(
            str(folder), f"either {' or '.join(FILES)}", "both", "keep the one that counts"
        )
    if there[0].is_dir():
        raise InputError(str(there[0]), "a file", "a folder", "put the file in its place")
    return there[0]


class _Keys:
    """Values of ``event.toml``, checked one by one."""

    def __init__(self, file: str, table: Mapping[str, Any]) -> None:
        self._file = file
        self._table = table
        for key in table:
            if key not in _KEYS:
                left = [name for name in _KEYS if name not in table] or _KEYS
                raise InputError(
                    f"{file}: {key}", "a known key", "an unknown key", nearest(key, left)
                )
        for key in _NEEDED:
            if key not in table:
                raise InputError(f"{file}: {key}", "a value", "nothing", f"add {key} = …")

    def _refuse(self, key: str, expected: str, fix: str) -> InputError:
        return InputError(f"{self._file}: {key}", expected, repr(self._table[key]), fix)

    def text(self, key: str) -> str:
        """A text that is not blank."""
        value = self._table[key]
        if not isinstance(value, str) or not value.strip():
            raise self._refuse(key, "a text", f'write {key} = "…"')
        return value

    def choice(self, key: str, known: tuple[Text, ...]) -> Text:
        """One of several texts."""
        value = self._table[key]
        for entry in known:
            if value == entry:
                return entry
        raise self._refuse(key, f"one of {', '.join(known)}", nearest(str(value), known))

    def wheels(self, spacecraft: Spacecraft) -> tuple[int, ...]:
        """Different wheels of the spacecraft."""
        value = self._table["wheels"]
        known = [wheel.number for wheel in spacecraft.wheels]
        expected, fix = f"a list of wheels out of {known}", f"write e.g. wheels = {known[:3]}"
        if not isinstance(value, list) or not value:
            raise self._refuse("wheels", expected, fix)
        for number in value:
            if isinstance(number, bool) or not isinstance(number, int) or number not in known:
                raise self._refuse("wheels", expected, fix)
        if len(set(value)) != len(value):
            raise self._refuse("wheels", "each wheel once", fix)
        return tuple(value)

    def epoch(self) -> datetime:
        """A time in UTC; without a zone it is taken as UTC."""
        value = self._table["epoch"]
        if isinstance(value, date) and not isinstance(value, datetime):
            value = datetime.combine(value, time())
        epoch = in_utc(value) if isinstance(value, str | datetime) else None
        if epoch is None:
            fix = "write e.g. 2010-02-13T12:00:00Z"
            raise self._refuse("epoch", "an ISO 8601 time, UTC", fix)
        return epoch

    def delta_v_source(self, has_delta_v: bool) -> Literal["measured", "computed"] | None:
        """Where ΔV comes from; given if and only if there is one."""
        if "delta_v_source" not in self._table:
            if has_delta_v:
                raise InputError(
                    f"{self._file}: delta_v_source",
                    f"{' or '.join(SOURCES_OF_DELTA_V)}, because the telemetry has ΔV columns",
                    "nothing",
                    'add delta_v_source = "…"; only a measured ΔV says something about thrust',
                )
            return None
        source = self.choice("delta_v_source", SOURCES_OF_DELTA_V)
        if not has_delta_v:
            raise self._refuse(
                "delta_v_source",
                "no such key, because the telemetry has no ΔV columns",
                "add the columns delta_v_x_m_s to delta_v_z_m_s, or drop the key",
            )
        return source
