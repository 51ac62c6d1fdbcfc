"""Events as a caller gives them, paths or objects alike, read, checked and reduced for a model."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import STRICT, Policy, content_of_totals, refuse_duplicates
from cassini_bayes.events.telemetry import TelemetryEvent
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.event_reduction import (
    ReducedEvent,
    check_rows,
    is_event_folder,
    reduce_event,
)
from cassini_bayes.model.posterior import Event
from cassini_bayes.priors.reader import Priors

Say = Callable[[str], None]
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
    found = tuple(events)
    for event in found:
        if not isinstance(event, _EVENTS):
            raise InputError(
                "events",
                "paths of event folders or totals files, or events that were read",
                type(event).__name__,
                "read it with read_totals, read_event or event_from_frame",
            )
    return found


def gather(
    events: EventLike | Iterable[EventLike],
    priors: Priors,
    *,
    pulse_shape: str = "first_order",
    source: str = "flight",
    policy: Policy = STRICT,
    say: Say | None = None,
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
    found: list[Event] = []
    findings: list[str] = []
    contents: list[tuple[str, str]] = []
    for given in each_event(events):
        if isinstance(given, TotalsEvent):
            found.append(given)
            contents.append((given.id, content_of_totals(given)))
            continue
        if isinstance(given, ReducedEvent):
            own: ReducedEvent | None = given
        elif isinstance(given, TelemetryEvent) or is_event_folder(Path(given)):
            read = given if isinstance(given, TelemetryEvent) else Path(given)
            own = reduce_event(read, priors, pulse_shape, say=say, policy=policy)
        else:
            own = None
        if own is not None:
            found.append(own)
            findings += own.reading.findings
            name = own.id if isinstance(given, READ) else str(given)
            contents.append((name, own.reading.content))
        else:
            rows = read_totals(str(given), priors.spacecraft, source)
            findings += check_rows(rows, priors, str(given), policy)
            contents += [(f"{given}: {row.id}", content_of_totals(row)) for row in rows]
            found += rows
    findings += refuse_duplicates([pair for pair in contents if pair[1]], policy)
    return tuple(found), tuple(findings)
