"""Events as a caller gives them, paths or objects alike, read, checked and reduced for a model."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.computing.processes import in_processes
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import STRICT, Policy, content_of_totals, refuse_duplicates
from cassini_bayes.events.telemetry import TelemetryEvent
from cassini_bayes.events.telemetry.event import event_path
from cassini_bayes.events.totals import TotalsEvent, read_totals, split_reference
from cassini_bayes.model.event_reduction import ReducedEvent, is_event_folder, reduce_event
from cassini_bayes.model.nominal import check_rows
from cassini_bayes.model.posterior import Event
from cassini_bayes.priors.reader import Priors

PathLike = str | os.PathLike[str]
EventLike = PathLike | TotalsEvent | ReducedEvent | TelemetryEvent
READ: Final = (TotalsEvent, ReducedEvent, TelemetryEvent)
_EVENTS: Final = (str, os.PathLike, *READ)


def each_event(events: EventLike | Iterable[EventLike]) -> tuple[EventLike, ...]:
    """One event or several as several, each that is named by its ``event.toml`` by its folder.

    Raises
    ------
    InputError
        None, or something that is no event.
    """
    if isinstance(events, _EVENTS):
        events = (events,)
    result = tuple(events)
    for event in result:
        if not isinstance(event, _EVENTS):
            raise InputError(
                "events",
                "paths of event folders or totals files, or events that were read",
                type(event).__name__,
                "read it with read_totals, read_event or event_from_frame",
            )
    return tuple(event if isinstance(event, READ) else event_path(event) for event in result)


LEAST_DITHER: Final = 0.3
"""Noise of body rates, in steps: with 0.3 p-values were right in eight flights, with 0.25 two of
eight were below 0.05, with 0.2 six."""
AT_REST: Final = 0.2
"""Rate (rms, noise included) about a direction that none turns about, of the largest: noise alone
is 0.14 of a slew's 5e-4 rad/s at most (7e-5 rad/s)."""
DRAWN: Final = 0.3  # of an element of the inertia, about what is at rest: noise can draw it
ALONG: Final = 0.99  # cosine between a direction and a body axis that stands for it


@dataclass(frozen=True)
class Read:
    """Events, findings in words, and where each one came from with the digest of its numbers."""

    events: tuple[Event, ...]
    findings: tuple[str, ...]
    contents: tuple[tuple[str, str], ...]

    @classmethod
    def of_reduced(cls, event: ReducedEvent, where: str = "") -> Read:
        """Telemetry that was reduced."""
        reading = event.reading
        return cls((event,), reading.findings, ((where or event.id, reading.content),))

    @classmethod
    def of_rows(
        cls, rows: Sequence[TotalsEvent], findings: Sequence[str] = (), file: str = ""
    ) -> Read:
        """Totals rows, of a file or in memory."""
        names = (f"{file}: {row.id}" if file else row.id for row in rows)
        contents = zip(names, map(content_of_totals, rows), strict=True)
        return cls(tuple(rows), tuple(findings), tuple(contents))


def read_reference(
    given: EventLike,
    priors: Priors,
    *,
    pulse_shape: str,
    source: str,
    policy: Policy,
    log: Log = silent,
    cache: Path | None = None,
) -> Read:
    """An event folder or an event that was read, reduced; or rows of a totals file, checked.

    Rows, and telemetry that was reduced, are taken as they are. ``cache`` holds earlier reductions
    (:func:`~cassini_bayes.model.event_reduction.reduce_event`).

    Raises
    ------
    InputError
        Bad data: file, row and column are named.
    """
    if isinstance(given, TotalsEvent):
        return Read.of_rows((given,))
    if isinstance(given, ReducedEvent):
        return Read.of_reduced(given)
    if isinstance(given, TelemetryEvent):
        return Read.of_reduced(reduce_event(given, priors, pulse_shape, cache, log, policy))
    given = event_path(given)
    if is_event_folder(Path(given)):
        reduced = reduce_event(Path(given), priors, pulse_shape, cache, log, policy)
        return Read.of_reduced(reduced, str(given))
    rows = read_totals(str(given), priors.spacecraft, source)
    file, _ = split_reference(str(given), Path())
    return Read.of_rows(rows, check_rows(rows, priors, str(given), policy), file)


def gather(
    events: EventLike | Iterable[EventLike],
    priors: Priors,
    *,
    pulse_shape: str = "first_order",
    source: str = "flight",
    policy: Policy = STRICT,
    log: Log = silent,
    processes: int = 1,
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
    processes
        That read at the same time: what fits nothing known takes some seconds to try explanations.

    Raises
    ------
    InputError
        Bad data, of the first event that has some: file, row and column are named.
    """

    def read(given: EventLike) -> Read | InputError:
        try:
            return read_reference(
                given, priors, pulse_shape=pulse_shape, source=source, policy=policy, log=log
            )
        except InputError as error:  # whichever comes first in time: the first in order counts
            return error

    reads: list[Read] = []
    for result in in_processes(read, list(each_event(events)), processes):
        if isinstance(result, InputError):
            raise result
        reads.append(result)
    return together(reads, priors, policy)


def together(
    reads: Sequence[Read], priors: Priors, policy: Policy
) -> tuple[tuple[Event, ...], tuple[str, ...]]:
    """Events of all references, and the findings of each and of all together.

    Raises
    ------
    InputError
        The same data under two names.
    """
    result = tuple(event for read in reads for event in read.events)
    findings = [finding for read in reads for finding in read.findings]
    contents = [pair for read in reads for pair in read.contents if pair[1]]
    findings += [*refuse_duplicates(contents, policy), *unturned(result, priors)]
    findings += coarse_rates(result)
    return result, tuple(findings)


def unturned(events: Sequence[Event], priors: Priors) -> tuple[str, ...]:
    """A warning of directions of the body about which none of the slews turns, in words.

    Of the inertia about a direction at rest the data tell nothing, but the measure of flat motion
    does where the noise is not that of its reference: n (f − f₀) nats per unit of log I, with n
    rows, f the share of the rates' noise in the balance and f₀ that at the reference. Beside a slew
    about it that is nothing (docs/topics/telemetry-likelihood.md §11). An element I_ij is named
    where the projector P on what is at rest leaves :data:`DRAWN` of its unit matrix, P_ii or
    √(P_ii P_jj + P_ij²), and the priors do not fix it. Quiescent events alone turn about none.
    """
    rates = _slew_rates(events)
    if not len(rates) and not only_rest(events):
        return ()
    largest = float(np.sqrt(np.linalg.eigvalsh(rates)[:, -1].max(initial=0.0)))
    at_rest = _directions_at_rest(rates, largest)
    left = at_rest.T @ at_rest
    drawn = []
    for i, j in itertools.combinations_with_replacement(range(3), 2):
        share = left[i, i] if i == j else np.sqrt(left[i, i] * left[j, j] + left[i, j] ** 2)
        name = f"inertia_{'xyz'[i]}{'xyz'[j]}_kg_m2"
        if share > DRAWN and priors.parameters[name].fixed is None:
            drawn.append(name)
    if not drawn:
        return ()
    if not len(rates):
        return (
            f"quiescent events alone: nothing turns the body, and noise alone can draw "
            f"{', '.join(drawn)} by many standard deviations; add a slew or a bias, or fix them "
            "in the priors",
        )
    return (
        f"slews: none turns about {_in_words(at_rest)} ({_turned(rates, at_rest).max():.2g} "
        f"rad/s, rms; {largest:.2g} about another direction): noise alone can draw "
        f"{', '.join(drawn)} by many standard deviations; "
        f"{'add a slew about it' if len(at_rest) == 1 else 'add slews about other directions'}, "
        f"or fix {'it' if len(drawn) == 1 else 'them'} in the priors",
    )


def coarse_rates(events: Sequence[Event]) -> tuple[str, ...]:
    """Warnings of body rates printed in steps beside which their noise is small, in words.

    Between firings a body has one rate, and so one rounding, which is no white noise of its rows.
    (In a slew it passes one printed value after the other.)
    Noise dithers it: of 0.3 steps 2 % of its square last, of 0.2 steps 13 %
    (docs/topics/telemetry-likelihood.md §11).
    """
    result = []
    for event in events:
        if isinstance(event, ReducedEvent) and event.statistics.kind != "slew":
            step, noise = event.statistics.steps.rate_rad_s, event.statistics.noise
            # attitudes take more rows for their noise to be seen: with it that of rates is seen
            if noise.attitude_rad > 0.0 and noise.rate_rad_s < LEAST_DITHER * step:
                result.append(
                    f"event {event.id}: body rates are printed in steps of {step:.2g} rad/s, and "
                    f"their noise is {noise.rate_rad_s / step:.2f} of a step: what of a rounding "
                    "lasts between firings is not counted, so that noise levels can be wrong by "
                    "some standard deviations and p-values are too small; give rates with more "
                    "digits"
                )
    return tuple(result)


def axes_at_rest(events: Sequence[Event]) -> tuple[str, ...]:
    """Body axes about which none of the slews turns; all if there are none."""
    turned = _turned(_slew_rates(events), np.eye(3))
    at_rest = turned <= AT_REST * turned.max()
    return tuple(axis for axis, rests in zip("xyz", at_rest, strict=True) if rests)


def only_rest(events: Sequence[Event]) -> bool:
    """Whether all events are telemetry in which nothing fires and the body does not slew."""
    return all(
        isinstance(event, ReducedEvent) and not event.fires and event.statistics.kind != "slew"
        for event in events
    )


def _directions_at_rest(rates: Array, largest: float) -> Array:
    """Directions (k, 3) at right angles to each other about which no slew of ``rates`` turns.

    ``largest`` is the largest rate about any direction, rad/s.
    """
    directions = np.linalg.eigh(rates.sum(axis=0))[1].T
    return np.asarray(directions[_turned(rates, directions) <= AT_REST * largest])


def _turned(rates: Array, directions: Array) -> Array:
    """Largest rate (k,), rms over a slew, rad/s, of all slews about directions (k, 3)."""
    squares = np.einsum("ki,sij,kj->sk", directions, rates, directions)
    return np.asarray(np.sqrt(squares.max(axis=0, initial=0.0)))


def _in_words(at_rest: Array) -> str:
    """Directions at rest (k, 3): body axes by name, one by itself, or all but one."""
    left = at_rest.T @ at_rest
    axes = [axis for axis, cosine in zip("XYZ", np.diag(left), strict=True) if cosine > ALONG**2]
    if len(axes) == len(at_rest):
        return " and ".join(axes)
    alone = at_rest[0] if len(at_rest) == 1 else np.linalg.eigh(left)[1][:, 0]
    alone = alone * np.sign(alone[np.abs(alone).argmax()])
    direction = f"({', '.join(f'{own:.2f}' for own in alone)}) in body axes"
    return direction if len(at_rest) == 1 else f"any direction but {direction}"


def _slew_rates(events: Sequence[Event]) -> Array:
    """Mean products of rates (s, 3, 3), rad²/s², of every slew."""
    result = []
    for event in events:
        if isinstance(event, ReducedEvent) and event.statistics.kind == "slew":
            places = event.statistics.layout.rate
            # rates are numbers: their products are the same along every axis of the balance
            result.append(event.statistics.gram[0, 0, places, places] / event.statistics.rows)
    return np.array(result).reshape(-1, 3, 3)
