"""Events as a caller gives them, paths or objects alike, read, checked and reduced for a model."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import STRICT, Policy, content_of_totals, refuse_duplicates
from cassini_bayes.events.telemetry import TelemetryEvent
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.event_reduction import ReducedEvent, is_event_folder, reduce_event
from cassini_bayes.model.nominal import check_rows
from cassini_bayes.model.posterior import Event
from cassini_bayes.priors.reader import Priors

PathLike = str | os.PathLike[str]
EventLike = PathLike | TotalsEvent | ReducedEvent | TelemetryEvent
READ: Final = (TotalsEvent, ReducedEvent, TelemetryEvent)
_EVENTS: Final = (str, os.PathLike, *READ)


def each_event(events: EventLike | Iterable[EventLike]) -> tuple[EventLike, ...]:
    """One event or several as several.

    Raises
    ------
    InputError
        None, or something that is no event.
    """
    if isinstance(events, _EVENTS):
        return (events,)
    result = tuple(events)
    for event in result:
        if not isinstance(event, _EVENTS):
            raise InputError(
                "events",
                "paths of event folders or totals files, or events that were read",
                type(event).__name__,
                "read it with read_totals, read_event or event_from_frame",
            )
    return result


LEAST_TURNED: Final = 0.2
"""Rate about an axis, rms and noise included, of the largest: noise alone is 0.14 of a slew's 5e-4
rad/s at most (7e-5 rad/s)."""


@dataclass(frozen=True)
class Read:
    """What a reference names: events, findings in words, and the digest of each one's numbers."""

    events: tuple[Event, ...]
    findings: tuple[str, ...]
    contents: tuple[str, ...]


def read_reference(
    given: PathLike | TelemetryEvent,
    priors: Priors,
    *,
    pulse_shape: str,
    source: str,
    policy: Policy,
    log: Log = silent,
    cache: Path | None = None,
) -> Read:
    """An event folder or an event that was read, reduced; or rows of a totals file, checked.

    ``cache`` holds earlier reductions (:func:`~cassini_bayes.model.event_reduction.reduce_event`).

    Raises
    ------
    InputError
        Bad data: file, row and column are named.
    """
    if isinstance(given, TelemetryEvent) or is_event_folder(Path(given)):
        folder = given if isinstance(given, TelemetryEvent) else Path(given)
        reduced = reduce_event(folder, priors, pulse_shape, cache, log, policy)
        return Read((reduced,), reduced.reading.findings, (reduced.reading.content,))
    rows = read_totals(str(given), priors.spacecraft, source)
    findings = check_rows(rows, priors, str(given), policy)
    return Read(rows, findings, tuple(content_of_totals(row) for row in rows))


def gather(
    events: EventLike | Iterable[EventLike],
    priors: Priors,
    *,
    pulse_shape: str = "first_order",
    source: str = "flight",
    policy: Policy = STRICT,
    log: Log = silent,
) -> tuple[tuple[Event, ...], tuple[str, ...]]:
    """Events ready for a model, and what was accepted or fits nothing known.

    Parameters
    ----------
    events
        Event folders, totals files (all rows of ``source``), ``file.csv:ID``, or events that were
        read.
    priors
        They decide how telemetry is reduced.
    policy
        Mistakes that the caller accepts; none by default.

    Raises
    ------
    InputError
        Bad data: file, row and column are named.
    """
    result: list[Event] = []
    findings: list[str] = []
    contents: list[tuple[str, str]] = []
    for given in each_event(events):
        if isinstance(given, TotalsEvent):
            read = Read((given,), (), (content_of_totals(given),))
        elif isinstance(given, ReducedEvent):
            read = Read((given,), given.reading.findings, (given.reading.content,))
        else:
            read = read_reference(
                given, priors, pulse_shape=pulse_shape, source=source, policy=policy, log=log
            )
        result += read.events
        findings += read.findings
        names = (_place(given, event) for event in read.events)
        contents += zip(names, read.contents, strict=True)
    findings += refuse_duplicates([pair for pair in contents if pair[1]], policy)
    findings += unturned(result, priors)
    return tuple(result), tuple(findings)


def unturned(events: Sequence[Event], priors: Priors) -> tuple[str, ...]:
    """Warnings of body axes about which none of the slews turns, in words.

    Where wheels have a flat distribution, as in slews, their noise draws the inertia about an axis
    at rest upwards: by n I_w² σ_ρ² / V nats per unit of log I, with n rows and V the variance of
    the balance. Beside a slew about the axis that is nothing (docs/topics/telemetry-likelihood.md
    §11).
    """
    slews = [e for e in events if isinstance(e, ReducedEvent) and e.statistics.kind == "slew"]
    if not slews:
        return ()
    each = []
    for slew in slews:
        places = slew.statistics.layout.rate
        squares = np.einsum("aajj->j", slew.statistics.gram[:, :, places, places])
        each.append(np.sqrt(squares / slew.statistics.rows))
    turned = np.max(each, axis=0)
    largest = float(turned.max())
    return tuple(
        f"slews: none turns about {axis.upper()} ({rate:.2g} rad/s, rms; {largest:.2g} about "
        f"another axis): the noise of wheels draws {name} upwards, by many standard deviations; "
        "add a slew about that axis, or fix it in the priors"
        for axis, rate in zip("xyz", turned, strict=True)
        if rate < LEAST_TURNED * largest
        and priors.parameters[name := f"inertia_{axis}{axis}_kg_m2"].fixed is None
    )


def _place(given: EventLike, event: Event) -> str:
    """Where an event came from, for a message."""
    if isinstance(given, READ):
        return event.id
    return str(given) if isinstance(event, ReducedEvent) else f"{given}: {event.id}"
