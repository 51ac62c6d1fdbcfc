"""What a prediction is asked for: planned wheel biases from a line of text or a CSV, checked."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.files.cells import read_rows
from cassini_bayes.files.checks import check_known, in_utc
from cassini_bayes.spacecraft import Spacecraft

FASTER: Final = "plan a slower wheel; faster ones have planned_wheel_rpm in their spacecraft file"
_NUMBER: Final = r"[+-]?\d{1,9}(?:\.\d{0,9})?"
_PART: Final = re.compile(rf"^\s*(\w+)\s*:\s*({_NUMBER})\s*(?:->|→|to)\s*({_NUMBER})\s*$")
_ID: Final = re.compile(r"\w[\w .+-]{0,59}")
_FORM: Final = 'write e.g. "rwa1: -1118 -> 626, rwa2: 1290 -> 1300, rwa4: 330 -> -729"'


@dataclass(frozen=True, eq=False)
class BiasRequest:
    """One planned wheel bias, without anything that is known only after the flight.

    ``wheels`` are wheel numbers, ``start_rpm`` and ``end_rpm`` are aligned with them. ``epoch``
    None means: at the last event of the fit; one without a zone is UTC. ``quaternion`` is inertial
    to body, scalar last.

    Raises
    ------
    InputError
        No wheel, one twice, rates that are not finite or not one per wheel, a quaternion of another
        norm than one.
    """

    id: str
    wheels: tuple[int, ...]
    start_rpm: Array
    end_rpm: Array
    epoch: datetime | None = None
    branch: str | None = None
    quaternion: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("start_rpm", "end_rpm"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
            _check_one_each(f"bias {self.id}: {name}", array, self.wheels)
        for number in self.wheels:
            _check_once(f"bias {self.id}", f"wheel {number}", self.wheels.count(number) > 1)
        if self.epoch is not None and self.epoch.tzinfo is None:
            object.__setattr__(self, "epoch", self.epoch.replace(tzinfo=UTC))
        if self.quaternion is not None:
            unit = _unit_quaternion(f"bias {self.id}: quaternion", self.quaternion)
            object.__setattr__(self, "quaternion", unit)


def request_of(event: TotalsEvent) -> BiasRequest:
    """The wheel rates, branch and date of an event, and nothing else of it."""
    return BiasRequest(
        id=event.id,
        wheels=event.wheels,
        start_rpm=event.rwa_start_rpm,
        end_rpm=event.rwa_end_rpm,
        epoch=event.epoch,
        branch=event.branch,
    )


def parse_bias(text: str, spacecraft: Spacecraft, where: str = "--bias") -> BiasRequest:
    """Read ``rwa1: -1118 -> 626, rwa2: …`` (rev/min).

    Raises
    ------
    InputError
        Another form, an unknown wheel, or one that is there twice.
    """
    names = {wheel.name: wheel.number for wheel in spacecraft.wheels}
    rates: dict[int, tuple[float, float]] = {}
    for part in text.split(","):
        result = _PART.match(part)
        if result is None:
            raise InputError(where, "wheel: start -> end in rev/min", repr(part.strip()), _FORM)
        name, start, end = result[1], float(result[2]), float(result[3])
        check_known(where, name, names, f"a wheel out of {', '.join(names)}")
        _check_once(where, name, names[name] in rates)
        rates[names[name]] = (start, end)
    wheels = tuple(sorted(rates))
    return BiasRequest(
        id="planned",
        wheels=wheels,
        start_rpm=np.array([rates[n][0] for n in wheels]),
        end_rpm=np.array([rates[n][1] for n in wheels]),
    )


def parse_rates(text: str, spacecraft: Spacecraft, where: str) -> dict[int, float]:
    """Read ``rwa1: -1118, rwa2: 1290`` as wheel number → rev/min.

    Raises
    ------
    InputError
        Another form, an unknown wheel, or one that is there twice.
    """
    names = {wheel.name: wheel.number for wheel in spacecraft.wheels}
    result: dict[int, float] = {}
    for part in text.split(","):
        match = re.match(rf"^\s*(\w+)\s*:\s*({_NUMBER})\s*$", part)
        if match is None or match[1] not in names:
            raise InputError(
                where,
                f"wheel: rate in rev/min, wheels out of {', '.join(names)}",
                repr(part.strip()),
                'write e.g. "rwa1: -1118, rwa2: 1290, rwa4: 330"',
            )
        _check_once(where, match[1], names[match[1]] in result)
        result[names[match[1]]] = float(match[2])
    return result


def _check_once(where: str, wheel: str, is_known: bool) -> None:
    """Refuse a wheel that was given a rate before: no one knows which of the two is meant."""
    if is_known:
        raise InputError(where, "every wheel once", f"{wheel} twice", "drop one of the two")


def parse_epoch(text: str, where: str = "--epoch") -> datetime:
    """Read an ISO 8601 time; UTC where it names no zone.

    Raises
    ------
    InputError
        It is none.
    """
    epoch = in_utc(text)
    if epoch is None:
        raise InputError(where, "an ISO 8601 time, UTC", repr(text), "write e.g. 2010-04-15")
    return epoch


def parse_quaternion(text: str, where: str = "--quaternion") -> tuple[float, float, float, float]:
    """Read ``q1 q2 q3 q4`` (J2000 to body, scalar last) of unit norm.

    Raises
    ------
    InputError
        Not four numbers, or of another norm.
    """
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = []
    return _unit_quaternion(where, values, text)


def _unit_quaternion(
    where: str, values: Sequence[float], text: str | None = None
) -> tuple[float, float, float, float]:
    """Four numbers of unit norm, made exactly so; ``text`` is what was written."""
    norm = math.sqrt(sum(v * v for v in values))
    if len(values) != 4 or not abs(norm - 1.0) < 1e-3:
        raise InputError(
            where,
            "four numbers q1 q2 q3 q4 of unit norm, scalar last",
            repr(values if text is None else text),
            'write e.g. "0 0 0 1"',
        )
    a, b, c, d = (value / norm for value in values)
    return a, b, c, d


def _check_one_each(where: str, rates_rpm: Array, wheels: Sequence[int]) -> None:
    """Refuse rates that are not one finite number for every wheel."""
    if not wheels or rates_rpm.shape != (len(wheels),) or not np.isfinite(rates_rpm).all():
        raise InputError(
            where,
            f"one finite rate in rev/min for each of {len(wheels)} wheels, of at least one",
            np.array2string(rates_rpm, threshold=6),
            "give as many rates as wheels",
        )


def read_requests(path: Path, spacecraft: Spacecraft) -> tuple[BiasRequest, ...]:
    """Planned biases from a CSV: id, rates of the wheels; epoch, branch and quaternion optional.

    Columns ``id``, ``rwa<n>_rpm_start`` and ``rwa<n>_rpm_end`` (empty where a wheel is not prime),
    ``epoch``, ``branch``, ``q1`` … ``q4``.

    Raises
    ------
    InputError
        Names file, line and column.
    """
    rates = [f"{w.name}_rpm_{end}" for w in spacecraft.wheels for end in ("start", "end")]
    columns = ("id", *rates, "epoch", "branch", "q1", "q2", "q3", "q4")
    result = []
    for row in read_rows(path, columns, {"id"}):
        start, end = {}, {}
        for wheel in spacecraft.wheels:
            given = [f"{wheel.name}_rpm_{side}" for side in ("start", "end")]
            if any(row.cells.get(column) for column in given):
                start[wheel.number] = row.number(given[0], "rev/min")
                end[wheel.number] = row.number(given[1], "rev/min")
        if not start:
            raise row.refuse(rates[0], "rates of at least one wheel", "fill in start and end")
        turned = any(row.cells.get(f"q{i}") for i in range(1, 5))
        request = BiasRequest(
            id=row.text("id", "a name of the bias"),
            wheels=tuple(start),
            start_rpm=np.array(list(start.values())),
            end_rpm=np.array(list(end.values())),
            branch=row.cells.get("branch") or None,
        )
        if row.cells.get("epoch"):
            request = replace(request, epoch=parse_epoch(row.cells["epoch"], row.where("epoch")))
        if turned:
            text = " ".join(row.cells.get(f"q{i}", "") for i in range(1, 5))
            request = replace(request, quaternion=parse_quaternion(text, row.where("q1")))
        result.append(request)
    return tuple(result)


def check_ids(where: str, ids: Sequence[str]) -> None:
    """Refuse ids that name no file, or two biases: each is the name of a figure and of a row.

    Raises
    ------
    InputError
        The first such id is named; ``where`` is the file or argument that it came from.
    """
    seen: set[str] = set()
    for name in ids:
        if not _ID.fullmatch(name):
            raise InputError(
                f"{where}: id",
                "up to 60 letters, digits, spaces or . + - _, the first a letter or digit",
                repr(name),
                "rename the bias: its figure has that name",
            )
        if name in seen:
            raise InputError(
                f"{where}: id", "an id once", f"{name!r} twice", "give every bias an id of its own"
            )
        seen.add(name)


def check_rates(where: str, rates_rpm: Array, limit_rpm: float) -> None:
    """Refuse rates beyond the wheels' limit (:attr:`.Spacecraft.planned_wheel_rpm`).

    Raises
    ------
    InputError
        The fastest of them is named.
    """
    fastest = rates_rpm[np.abs(rates_rpm).argmax()]
    if abs(fastest) > limit_rpm:
        expected = f"rates within ±{limit_rpm:.0f} rev/min"
        raise InputError(where, expected, f"{fastest:g}", FASTER)


def check_request(
    request: BiasRequest,
    spacecraft: Spacecraft,
    branch: str,
    prime: tuple[int, ...],
    first_epoch: datetime,
) -> None:
    """Refuse what cannot be flown or predicted with this fit.

    ``prime`` are the wheels that events of the fit turned. Ends inside the low-rpm zone are allowed
    here (``plan`` avoids them).

    Raises
    ------
    InputError
        Rates beyond the spacecraft's limit, none that changes, an unknown or another branch, a
        wheel that is not prime, an epoch before the fit's first event.
    """
    where = f"bias {request.id}"
    names = {wheel.number: wheel.name for wheel in spacecraft.wheels}
    _check_branch(where, request.branch, spacecraft, branch)
    limit = spacecraft.planned_wheel_rpm[1]
    for number, start, end in zip(request.wheels, request.start_rpm, request.end_rpm, strict=True):
        if number not in prime:
            name = names.get(number, f"wheel {number}")
            raise InputError(
                f"{where}: {name}",
                f"prime wheels {', '.join(names[n] for n in prime)}",
                f"{name}, which is not prime in the fit",
                "drop the wheel, or predict with a fit in which it is prime",
            )
        for rate in (start, end):
            check_rates(f"{where}: {names[number]}", np.array([rate]), limit)
    if not np.any(request.start_rpm != request.end_rpm):
        raise InputError(where, "a wheel that changes its rate", "none", "check start and end")
    if request.epoch is not None and request.epoch < first_epoch:
        raise InputError(
            f"{where}: epoch",
            f"a time from {first_epoch.date()} on, the fit's first event",
            str(request.epoch.date()),
            "predict with a fit of events from that time",
        )


def _check_branch(where: str, asked: str | None, spacecraft: Spacecraft, branch: str) -> None:
    if asked is None:
        return
    if asked not in spacecraft.branches:
        known = ", ".join(spacecraft.branches)
        raise InputError(f"{where}: branch", f"one of {known}", repr(asked), f"write {branch}")
    if asked != branch:
        raise InputError(
            f"{where}: branch",
            f"branch {branch}, which the fit knows",
            asked,
            f"predict with a fit of branch {asked}, or write {branch}",
        )
