"""The first files of a user: priors, run, event and channel map for a spacecraft, to be edited."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry.channel_map import UNITS
from cassini_bayes.events.telemetry.columns import channel_columns
from cassini_bayes.events.telemetry.matches import (
    Match,
    Sample,
    first_date,
    matches,
    may_be_driven,
    sample_of,
    wheels_in,
)
from cassini_bayes.files.checks import in_utc, nearest
from cassini_bayes.files.reading import exists
from cassini_bayes.files.storage import write_text
from cassini_bayes.files.toml_file import toml_of
from cassini_bayes.spacecraft import Spacecraft, load_spacecraft
from cassini_bayes.spacecraft.parameters import ParameterSpec

PROPOSED: Final = "#: "
"""Begins every proposed line of a channel map: taking it away is the user's word that it is so."""
PLACEHOLDER: Final = "placeholder"
"""Begins the source of a prior that nobody has replaced yet."""
_NO_EPOCH: Final = "2000-01-01T00:00:00Z"
_MOST_LISTED: Final = 200
_PLACEHOLDERS: Final[Mapping[str, str]] = {  # of a spacecraft's own parameters, by their unit
    "kg m2": "loc = 0.1\nscale = 0.01\nlow = 0.0",
    "rad": "loc = 0.0\nscale = 0.01",
    "m": "loc = 1.0\nscale = 0.05",
}

_OTHERS: Final[Mapping[str, str]] = {
    "order": ' # "wxyz" or "xyzw": where the scalar w stands',
    "direction": ' # or "body_to_inertial"',
    "kind": ' # or "per_interval"',
    "unit": " # the column's own unit",
}


@dataclass(frozen=True)
class Start:
    """A spacecraft as the user named it, and what the starting files take of it."""

    reference: str
    spacecraft: Spacecraft
    branch: str
    wheels: tuple[int, ...]

    @property
    def is_file(self) -> bool:
        """Whether it is a file of the user's, not a built-in."""
        return Path(self.reference).suffix == ".toml"


def write_starting_files(
    folder: Path,
    reference: str,
    data: Sequence[Path] = (),
    branch: str | None = None,
    log: Log = silent,
) -> tuple[Path, ...]:
    """Write priors, run file, channel map and one event for each file of data.

    Parameters
    ----------
    folder
        Where to write; made if it is not there. No file is replaced.
    reference
        Name of a built-in spacecraft, or the path of a spacecraft file.
    data
        Telemetry files, which stay where they are. Their columns are listed in the channel map,
        with likely matches as comments.
    branch
        Thruster branch; by default the last, for which a spacecraft switches to its spare.
    log
        Is told which wheels were chosen, and why.

    Returns
    -------
    The files written, in the order in which to read them.

    Raises
    ------
    InputError
        Unknown spacecraft or branch, data that cannot be read, a path that TOML cannot have, or a
        file that is there already.
    """
    spacecraft = load_spacecraft(reference)
    chosen = spacecraft.branches[-1] if branch is None else branch
    if chosen not in spacecraft.branches:
        known = spacecraft.branches
        expected = f"one of {', '.join(known)}"
        raise InputError("--branch", expected, repr(chosen), nearest(chosen, known))
    samples = [sample_of(path) for path in data]
    wheels, why = _wheels(spacecraft, reference, chosen, samples)
    start = Start(reference, spacecraft, chosen, wheels)
    events = _event_names(samples)
    texts = {
        folder / "priors.toml": _priors(start, folder),
        folder / "channels.toml": _channels(start, samples),
    }
    for name, sample in events.items():
        place = folder / "events" / name
        texts[place / "event.toml"] = _event(start, place, name, sample)
    texts[folder / "run.toml"] = _run(list(events))
    for path in texts:
        if exists(path):
            raise InputError(
                str(path), "no such file yet", "one", "init never replaces; name a new folder"
            )
    for path, text in texts.items():
        write_text(path, text)
    chosen_wheels = ", ".join(map(str, wheels))
    log(f"wheels {chosen_wheels} {why}; for others change wheels in priors.toml and event.toml")
    return tuple(texts)


def _starting_text(reference: str, branch: str) -> str | None:
    """Priors of a built-in spacecraft's branch, if the package has them."""
    file = (
        resources.files("cassini_bayes.priors") / "starting" / f"{reference}_{branch.lower()}.toml"
    )
    return file.read_text(encoding="utf-8") if file.is_file() else None


def _wheels(
    spacecraft: Spacecraft, reference: str, branch: str, samples: Sequence[Sample]
) -> tuple[tuple[int, ...], str]:
    """The prime wheels, and why these."""
    text = _starting_text(reference, branch)
    if text is not None:
        return tuple(toml_of(text.encode(), reference)["spacecraft"]["wheels"]), "of its priors"
    seen = wheels_in(samples[0].header, spacecraft) if samples else ()
    if seen:
        return seen, f"have columns in {samples[0].path.name}"
    return tuple(spacecraft.wheel_numbers[:3]), "are the first of the spacecraft file"


def _priors(start: Start, folder: Path) -> str:
    text = _starting_text(start.reference, start.branch)
    if text is not None and not start.is_file:
        return text
    generic = resources.files("cassini_bayes.priors") / "starting" / "generic.toml"
    named = f'name = "{start.reference}"'
    if start.is_file:
        named = f"file = {_path_from(folder, Path(start.reference))}"
    # angles of platforms are left out: one that is given turns its platform, and needs its wheel
    angles = {w.platform.parameter for w in start.spacecraft.wheels if w.platform is not None}
    tables = [_placeholder(p) for p in start.spacecraft.parameters if p.name not in angles]
    return "\n".join(
        [
            "# Placeholders, which fit no spacecraft: `check` names those that are left.\n"
            "# Replace loc, scale and source of every parameter by what you know, and why.\n\n"
            f'[spacecraft]\n{named}\nbranch = "{start.branch}"\nwheels = {list(start.wheels)}\n',
            *tables,
            generic.read_text(encoding="utf-8"),
        ]
    )


def _placeholder(spec: ParameterSpec) -> str:
    """A prior of the right kind and unit, and of no known value."""
    values = _PLACEHOLDERS.get(spec.unit, "loc = 0.0\nscale = 1.0")
    return (
        f'[parameters.{spec.name}] # {spec.meaning}\ndist = "norm"\n{values}\n'
        f'unit = "{spec.unit}"\nsource = {_toml(f"{PLACEHOLDER}: {spec.meaning}")}\n'
    )


def _channels(start: Start, samples: Sequence[Sample]) -> str:
    known = channel_columns(
        start.spacecraft, start.wheels, start.spacecraft.thruster_names(start.branch)
    )
    lines = [
        "# Which column of your telemetry is which channel of this package.",
        "# Keys and units: docs/how-to/own-columns.md.",
    ]
    if not samples:
        lines += [
            "# Telemetry in the package's own columns needs no map: then delete this file.",
            "#",
            *(f"#   {name}: {', '.join(names)} in {UNITS[name]}" for name, names in known.items()),
            "",
            *_proposed([Match(name, tuple(names), {}) for name, names in known.items()]),
        ]
        return "\n".join(lines) + "\n"
    first = samples[0]
    if first.delimiter != ",":
        lines += ["", f"delimiter = {json.dumps(first.delimiter)}"]
    with_values = ", with their first values" * bool(first.first)
    lines += ["", f"# Columns of {_printable(first.path.name)}{with_values}:"]
    lines += [
        _printable(f"#   {n}  {first.first.get(n, '')[:40]}".rstrip())
        for n in first.header[:_MOST_LISTED]
    ]
    if len(first.header) > _MOST_LISTED:
        lines.append(f"#   and {len(first.header) - _MOST_LISTED} more")
    result = matches(first, start.spacecraft, start.wheels, start.branch)
    used = {source for match in result for source in match.sources}
    left = [name for name in first.header if name not in used]
    driven = [name for name in left if may_be_driven(name, start.spacecraft)]
    left = [name for name in left if name not in driven]
    missing = [name for name in known if name not in {match.channel for match in result}]
    lines += [
        "",
        "# Likely matches, by their names alone. None is in force: check source, unit, order,",
        f'# direction and kind of each, correct them, then take away the "{PROPOSED.strip()}" that'
        " begins its lines.",
        *([f"# No column was found for: {', '.join(missing)}."] if missing else []),
        "",
        *([f"# Of wheels or thrusters, it seems: map or ignore {_listed(driven)}."] * bool(driven)),
        *([f"{PROPOSED}ignore = {_toml(left)}", ""] if left else []),
        *_proposed(result),
    ]
    return "\n".join(lines) + "\n"


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
    return _printable(", ".join(names[:_MOST_LISTED]) + more)


def _proposed(found: Sequence[Match]) -> list[str]:
    lines = []
    for match in found:
        sources = match.sources[0] if len(match.sources) == 1 else list(match.sources)
        lines += [
            f"{PROPOSED}[channels.{match.channel}]",
            f"{PROPOSED}source = {_toml(sources)}",
            *(
                f"{PROPOSED}{key} = {value}{_remark(match.channel, key)}"
                for key, value in match.keys.items()
            ),
            "",
        ]
    return lines


def _remark(channel: str, key: str) -> str:
    """What else could stand there."""
    if channel == "time" and key == "unit":
        return ' # for dates and text in its place: time_system = "iso8601"'
    return _OTHERS.get(key, "")


def _event_names(samples: Sequence[Sample]) -> dict[str, Sample | None]:
    """Names of the events, after their files."""
    names: dict[str, Sample | None] = {}
    for sample in samples:
        name = re.sub(r"[^A-Za-z0-9._-]+", "-", sample.path.stem).strip("-.") or "event"
        if name in names:
            raise InputError(
                str(sample.path), "files of different names", f"{name} twice", "rename one of them"
            )
        names[name] = sample
    return names or {"event": None}


def _event(start: Start, place: Path, name: str, sample: Sample | None) -> str:
    epoch, said = _NO_EPOCH, "the time of the first row, UTC: replace it"
    dated = [c for c in (sample.first if sample else {}).values() if first_date(c.strip())]
    if dated and (time := in_utc(dated[0].strip())) is not None:
        epoch = time.isoformat().replace("+00:00", "Z")
        said = "the first time in the data; an event's epoch is the time of its first row, UTC"
    data = '# telemetry = "…"  # telemetry.csv or telemetry.parquet beside this file, or any other'
    if sample is not None:
        data = f"telemetry = {_path_from(place, sample.path)}"
    return f"""# What happened, and where its telemetry is.
id = {json.dumps(name)}
kind = "bias" # or "slew", "quiescent", "delta_v"
epoch = {epoch} # {said}
branch = "{start.branch}" # of {", ".join(start.spacecraft.branches)}
wheels = {list(start.wheels)} # the prime wheels, in the order of the columns
source = "flight"
{data}
channels = {json.dumps("../../channels.toml")}
"""


def _run(events: Sequence[str]) -> str:
    listed = "".join(f"    {json.dumps(f'events/{name}')},\n" for name in events)
    return f"""# What to fit, with which priors: cassini-bayes run run.toml
events = [
{listed}]
priors = "priors.toml"

[model]
effects = [] # causes to fit beside the standard physics, e.g. ["thruster_degraded:z3"]

[sampler]
ensembles = 4
target_ess = 2000
seed = 1
"""


def _path_from(folder: Path, path: Path) -> str:
    """A path that is relative to a folder, as TOML."""
    relative = Path(os.path.relpath(path, folder)).as_posix()
    try:
        relative.encode()
    except UnicodeEncodeError:
        expected, fix = "a path of UTF-8 characters, as TOML has no others", "rename it"
        raise InputError(str(path), expected, "other bytes in it", fix) from None
    return _toml(relative)


def _toml(value: str | Sequence[str]) -> str:
    """Text, or a list of it, as TOML: as JSON, and what that leaves unprintable escaped as well."""
    return _printable(json.dumps(value, ensure_ascii=False))


def _printable(text: str) -> str:
    """Text with what cannot be printed as TOML escapes it: a line break would end a comment."""
    return "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in text)
