"""Which columns of a foreign table look like which channels: proposals by their names alone."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.clocks import reader_of_dates
from cassini_bayes.events.telemetry.columns import channel_columns
from cassini_bayes.events.telemetry.files import PARQUET, open_foreign
from cassini_bayes.events.telemetry.parquet_file import open_parquet
from cassini_bayes.files.checks import parse_number
from cassini_bayes.files.foreign import SUFFIXES
from cassini_bayes.files.reading import open_file
from cassini_bayes.spacecraft import Spacecraft

DELIMITERS: Final = (",", ";", "\t", "|")
_AHEAD: Final = 1 << 20
# What the rest of a name has to hold, once what tells the members apart is a star.
_WORDS: Final[Mapping[str, re.Pattern[str]]] = {
    "attitude": re.compile(r"q|att"),
    "rate": re.compile(r"rate|gyr|omega|ang|dps|rad|^w\*|_w\*"),
    "wheel": re.compile(r"rw|whl|wheel"),
    "pulses": re.compile(r"pls|puls|cnt|count|num"),
    "on_time": re.compile(r"on|dur|fir|time|sec|ms"),
    "delta_v": re.compile(r"dv|delta"),
}
_DRIVEN: Final = re.compile(r"(?<![a-z])rw|whl|wheel|thr|puls|on_?time")
_TIME: Final = re.compile(r"utc|time|date|epoch|^t$|^sec")


@dataclass(frozen=True)
class Sample:
    """A file's columns with the first value of each, as text; none of HDF5 and MATLAB files."""

    path: Path
    delimiter: str
    header: tuple[str, ...]
    first: Mapping[str, str]


@dataclass(frozen=True)
class Match:
    """A channel and the columns that may be its own, with what else its table should say."""

    channel: str
    sources: tuple[str, ...]
    keys: Mapping[str, str]  # as TOML values


def sample_of(path: Path) -> Sample:
    """Look at a file's columns.

    Raises
    ------
    InputError
        It cannot be read, or has no header.
    """
    if path.suffix.lower() in PARQUET:
        parquet = open_parquet(path)
        return Sample(path, ",", parquet.header, parquet.first_row())
    if path.suffix.lower() in SUFFIXES:
        with open_foreign(path) as table:
            return Sample(path, ",", table.header, {})
    with open_file(path, "telemetry") as stream:
        lines = stream.read(_AHEAD).decode("utf-8-sig", "replace").splitlines()
    lines = [line for line in lines if line.strip()]
    delimiter = max(DELIMITERS, key=lines[0].count) if lines else ","
    with open_foreign(path, delimiter) as table:
        header = table.header
    cells = lines[1].split(delimiter) if len(lines) > 1 else []
    return Sample(path, delimiter, header, dict(zip(header, cells, strict=False)))


def matches(
    sample: Sample, spacecraft: Spacecraft, wheels: Sequence[int], branch: str
) -> tuple[Match, ...]:
    """Channels and the columns that look like theirs, in the order of the format's columns."""
    thrusters = spacecraft.thruster_names(branch)
    members = {
        "rate": ("x", "y", "z"),
        "wheel": tuple(map(str, wheels)),
        "pulses": thrusters,
        "on_time": thrusters,
        "delta_v": ("x", "y", "z"),
    }
    result = {name: _family(sample.header, names, name) for name, names in members.items()}
    proposals = [*_times(sample, spacecraft), *_attitudes(sample.header)]
    taken = {source for match in proposals for source in match.sources}
    for channel in channel_columns(spacecraft, wheels, thrusters):
        sources, stem = result.get(channel, ((), ""))
        if sources and not taken & set(sources):
            proposals.append(Match(channel, sources, _keys(channel, stem)))
            taken |= set(sources)
    return tuple(proposals)


def wheels_in(header: Sequence[str], spacecraft: Spacecraft) -> tuple[int, ...]:
    """Numbers of the wheels that have columns of one pattern, as many as any pattern has."""
    numbers = spacecraft.wheel_numbers
    families = _families(header, list(map(str, numbers)))
    found = [columns for stem, columns in families.items() if _WORDS["wheel"].search(stem)]
    most = max(found, key=len, default={})
    return tuple(number for number in numbers if str(number) in most)


def may_be_driven(name: str, spacecraft: Spacecraft) -> bool:
    """Whether a column's name looks like that of a wheel or a thruster, of any branch."""
    low = name.lower()
    names = [wheel.name for wheel in spacecraft.wheels]
    own = {each.lower() for each in [*names, *(t.name for t in spacecraft.thrusters)]}
    return bool(_DRIVEN.search(low)) or not own.isdisjoint(re.split(r"[^a-z0-9]+", low))


def _family(
    header: Sequence[str], members: Sequence[str], channel: str
) -> tuple[tuple[str, ...], str]:
    """Columns that differ by the members alone, the rest of their name, a star between."""
    for stem, columns in _families(header, members).items():
        other = channel == "on_time" and _WORDS["pulses"].search(stem)
        if len(columns) == len(members) and _WORDS[channel].search(stem) and not other:
            return tuple(columns[member] for member in members), stem
    return (), ""


def _families(header: Sequence[str], members: Sequence[str]) -> dict[str, dict[str, str]]:
    """By the rest of a name, a star in a member's place: the columns of members."""
    families: dict[str, dict[str, str]] = {}
    for name in header:
        low = name.lower()
        for member in members:
            for place in re.finditer(re.escape(member), low):
                stem = f"{low[: place.start()]}*{low[place.end() :]}"
                families.setdefault(stem, {}).setdefault(member, name)
    return families


def _attitudes(header: Sequence[str]) -> list[Match]:
    """Four columns of a quaternion: 0 to 3 begin with the scalar, 1 to 4 may end with it."""
    for members, order in (("0123", "wxyz"), ("1234", "xyzw"), ("xyzw", "xyzw"), ("xyzs", "xyzw")):
        sources, _ = _family(header, tuple(members), "attitude")
        if sources:
            keys = {"order": f'"{order}"', "direction": '"inertial_to_body"'}
            return [Match("attitude", sources, keys)]
    return []


def _times(sample: Sample, spacecraft: Spacecraft) -> list[Match]:
    """The first column whose name is one of a time, and its system by its first value.

    That of a thruster is its on-time.
    """
    for name in sample.header:
        if _TIME.search(name.lower()) and not may_be_driven(name, spacecraft):
            value = sample.first.get(name, "").strip().strip('"')
            keys = {"time_system": '"iso8601"'} if first_date(value) else {"unit": '"s"'}
            return [Match("time", (name,), keys)]
    return []


def first_date(value: str) -> bool:
    """Whether a cell is an ISO 8601 time and no number."""
    if not value or parse_number(value) is not None:
        return False
    try:
        reader_of_dates(datetime(2000, 1, 1, tzinfo=UTC))(value, "")
    except InputError:
        return False
    return True


def _keys(channel: str, stem: str) -> dict[str, str]:
    """Unit and counting, as far as a name tells them."""
    units = {
        "rate": (("mrad", "mrad/s"), ("deg", "deg/s"), ("dps", "deg/s"), ("", "rad/s")),
        "wheel": (("rad", "rad/s"), ("deg", "deg/s"), ("", "rpm")),
        "on_time": (("ms", "ms"), ("", "s")),
        "delta_v": (("mm", "mm/s"), ("", "m/s")),
    }
    unit = next((u for word, u in units.get(channel, ()) if word in stem), None)
    kind = {"kind": '"cumulative"'} if channel in ("on_time", "pulses", "delta_v") else {}
    return {**({"unit": f'"{unit}"'} if unit else {}), **kind}
