"""Which columns a telemetry file may, must and must not have, and where each channel stands."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from types import MappingProxyType
from typing import Final, Literal

from cassini_bayes.errors import InputError
from cassini_bayes.files.cells import check_once, refuse_comment
from cassini_bayes.spacecraft import Spacecraft

Kind = Literal["slew", "bias", "quiescent", "delta_v"]
KINDS: Final[tuple[Kind, ...]] = ("slew", "bias", "quiescent", "delta_v")
TIME: Final = "time_s"
_ALIKE: Final = 0.8  # of 1, a name and what it may have been
_CLEARLY: Final = 0.05
_UNITS: Final = frozenset(
    {"deg", "mrad", "urad", "arcsec", "ms", "us", "min", "h", "hz", "rps"}
    | {"psi", "bar", "pa", "mpa", "mm", "cm", "km", "g"}
)
"""Words of a name that are units, but none of this format's."""
_MOTION: Final = ("attitude", "rate", "wheel")
NEEDED: Final[Mapping[Kind, tuple[str, ...]]] = MappingProxyType(
    {
        "slew": _MOTION,
        "bias": (*_MOTION, "on_time", "pulses"),
        "quiescent": _MOTION,
        "delta_v": ("on_time", "pulses"),
    }
)
"""Channels without which an event of a kind says nothing."""
VELOCITY: Final = ("delta_v", "accelerometer")
"""Channels of which an event of kind delta_v needs one."""


@dataclass(frozen=True)
class Layout:
    """Place of every channel in a file: indices of its columns, () for an absent channel.

    ``foreign`` are columns of idle wheels and of the other branch's thrusters.
    """

    header: tuple[str, ...]
    channels: Mapping[str, tuple[int, ...]]
    foreign: tuple[int, ...]

    def names(self, channel: str) -> tuple[str, ...]:
        """Columns of a channel."""
        return tuple(self.header[i] for i in self.channels[channel])


def channel_columns(
    spacecraft: Spacecraft, wheels: Sequence[int], thrusters: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Columns of every channel, in the order of its array's columns."""
    return {
        "time": (TIME,),
        "attitude": ("q1", "q2", "q3", "q4"),
        "rate": tuple(f"rate_{axis}_rad_s" for axis in "xyz"),
        "wheel": tuple(f"{spacecraft.wheel(number).name}_rpm" for number in wheels),
        "on_time": tuple(f"on_time_{name}_s" for name in thrusters),
        "pulses": tuple(f"pulses_{name}" for name in thrusters),
        "delta_v": tuple(f"delta_v_{axis}_m_s" for axis in "xyz"),
        "accelerometer": ("accelerometer_counts",),
        "pressure": ("tank_pressure_kpa",),
    }


def all_columns(spacecraft: Spacecraft) -> dict[str, tuple[str, ...]]:
    """Columns of every channel, of all wheels and of the thrusters of all branches."""
    thrusters = dict.fromkeys(thruster.name for thruster in spacecraft.thrusters)
    return channel_columns(spacecraft, spacecraft.wheel_numbers, tuple(thrusters))


def make_layout(
    where: str,
    header: Sequence[str],
    spacecraft: Spacecraft,
    kind: Kind,
    wheels: Sequence[int],
    branch: str,
) -> Layout:
    """Find every channel in a header row.

    Raises
    ------
    InputError
        An unknown, repeated or missing column, part of a channel, or a channel the kind needs.
    """
    own = channel_columns(spacecraft, wheels, spacecraft.thruster_names(branch))
    every = all_columns(spacecraft)
    known = [name for names in every.values() for name in names]
    _check_names(where, header, known, every)
    places = {name: i for i, name in enumerate(header)}
    channels = {}
    for channel, names in own.items():
        missing = [name for name in names if name not in places]
        needed = channel == "time" or channel in NEEDED[kind]
        if missing and (needed or len(missing) < len(names)):
            reason = f"an event of kind {kind} needs it" if needed else "the other columns need it"
            raise InputError(
                where,
                f"a column {missing[0]!r}, because {reason}",
                "a header without it",
                "add the column, or correct kind, branch and wheels in event.toml",
            )
        channels[channel] = () if missing else tuple(places[name] for name in names)
    fired = [channel for channel in ("on_time", "pulses") if channels[channel]]
    if len(fired) == 1:
        lacking = "pulses" if fired == ["on_time"] else "on_time"
        raise InputError(
            where,
            f"a column {own[lacking][0]!r}, because {own[fired[0]][0]!r} is there",
            "a header without it",
            "add both counters of every thruster, or leave both out",
        )
    if kind == "delta_v" and not any(channels[channel] for channel in VELOCITY):
        raise InputError(
            where,
            f"a column {own['delta_v'][0]!r} or {own['accelerometer'][0]!r}, because an event of"
            " kind delta_v needs it",
            "a header without them",
            "add the columns, or correct kind in event.toml",
        )
    mine = {name for names in own.values() for name in names}
    foreign = tuple(i for i, name in enumerate(header) if name not in mine)
    return Layout(tuple(header), MappingProxyType(channels), foreign)


def suggestion(
    name: str, known: Sequence[str], channels: Mapping[str, Sequence[str]] | None = None
) -> str:
    """A hint for an unknown column: the one name that it can only have been.

    A guess that has rivals, or that would change the unit, is worse than none: ``on_time_0_s``
    could be any thruster's, ``rate_x_deg_s`` is not in rad/s. Then the names are listed, of the
    channel that the first word tells if there is one.
    """
    bare = {_bare(other): other for other in known}
    if _bare(name) in bare:
        return f"did you mean {bare[_bare(name)]!r}?"
    alike = {
        other: difflib.SequenceMatcher(None, name.lower(), other.lower()).ratio() for other in known
    }
    best = sorted(alike, key=lambda other: -alike[other])[:2]
    clear = len(best) == 1 or (len(best) == 2 and alike[best[0]] > alike[best[1]] + _CLEARLY)
    words = set(name.lower().split("_")) - set(best[0].split("_")) if best else set()
    if clear and alike[best[0]] > _ALIKE and not words & _UNITS:
        return f"did you mean {best[0]!r}?"
    own = (of for of in (channels or {}).values() if (stem := _stem(of)) and name.startswith(stem))
    return f"known: {', '.join(next(own, known)) or 'none'}"


def _bare(name: str) -> str:
    return "".join(character for character in name.lower() if character.isalnum())


def _stem(names: Sequence[str]) -> str:
    """The words that all columns of a channel begin with: ``on_time_`` of on-times."""
    words = zip(*(name.split("_") for name in names), strict=False)
    return "".join(f"{column[0]}_" for column in takewhile(lambda own: len(set(own)) == 1, words))


def _check_names(
    where: str,
    header: Sequence[str],
    known: Sequence[str],
    channels: Mapping[str, Sequence[str]],
) -> None:
    refuse_comment(where, header)
    for i, name in enumerate(header):
        if name not in known:
            hint = suggestion(name, [o for o in known if o not in header] or known, channels)
            raise InputError(
                where,
                "a known column",
                f"the unknown column {name!r}" if name else f"no name for column {i + 1}",
                f"{hint}; columns of your own need a channel map (channels.toml)",
            )
        check_once(where, header[: i + 1])
