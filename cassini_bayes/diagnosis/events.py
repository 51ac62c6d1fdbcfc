"""Events that are diagnosed together: telemetry reduced with the effects' columns, totals rows."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from cassini_bayes.effects.catalogue import Catalogue, read_catalogue
from cassini_bayes.effects.effect import Effect, SearchResult, settled_for
from cassini_bayes.effects.registry import Kinds, standard
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.gather import axes_at_rest
from cassini_bayes.model.order import in_order_of_time
from cassini_bayes.model.posterior import Event
from cassini_bayes.priors.reader import Priors


@dataclass(frozen=True, eq=False)
class Events:
    """All that is diagnosed together, with the causes to weigh.

    ``findings`` are warnings about the data: mistakes accepted, what fits nothing known. Two are
    the same if they are one: what is made of events is kept for them.
    """

    priors: Priors
    telemetry: tuple[ReducedEvent, ...]
    rows: tuple[TotalsEvent, ...]
    catalogue: Catalogue
    findings: tuple[str, ...] = ()
    _with_columns: list[tuple[tuple[SearchResult, ...], Events]] = field(
        default_factory=list, init=False, repr=False
    )

    @property
    def all(self) -> tuple[Event, ...]:
        """All events, totals rows first."""
        return (*self.rows, *self.telemetry)

    @property
    def ids(self) -> tuple[str, ...]:
        """Of all events."""
        return tuple(event.id for event in self.all)

    @property
    def in_order(self) -> tuple[str, ...]:
        """Ids in order of time."""
        return in_order_of_time(self.all)

    def without(self, event: str) -> Events:
        """The events with one left out."""
        return replace(
            self,
            telemetry=tuple(reduced for reduced in self.telemetry if reduced.id != event),
            rows=tuple(row for row in self.rows if row.id != event),
        )

    def with_columns_of(self, effects: Sequence[Effect]) -> Events:
        """The events with the columns that go with what searches settled for some effects."""
        settled = settled_for(effects)
        if not settled:
            return self
        for known, events in self._with_columns:
            if len(known) == len(settled) and all(map(operator.is_, known, settled)):
                return events
        kinds = self.catalogue.kinds
        events = replace(
            self,
            telemetry=tuple(
                event.with_columns(
                    (
                        *kinds.columns(event.thrusters),
                        *(column for one in settled for column in one.columns(event.samples)),
                    )
                )
                for event in self.telemetry
            ),
        )
        self._with_columns.append((settled, events))
        return events


def prepare(
    telemetry: Sequence[ReducedEvent],
    priors: Priors,
    rows: Sequence[TotalsEvent] = (),
    kinds: Kinds | None = None,
) -> Events:
    """Reduce telemetry with every column that an effect may need, and list the causes.

    ``kinds`` are the effects that there are; those of the package by default. Causes are weighed by
    momentum: a measured velocity change is left out. What rows with late pulses cannot tell is not
    weighed where an event has them, nor by events without firings what needs turns about an axis at
    rest: a finding says so. The causes that are weighed have all that causes have of the prior
    probability.
    """
    known = standard() if kinds is None else kinds
    events: tuple[Event, ...] = (*rows, *telemetry)
    wheels = sorted({number for event in events for number in event.wheels})
    inputs = (*(("telemetry",) if telemetry else ()), *(("totals",) if rows else ()))
    catalogue = read_catalogue(priors, wheels, inputs, known)
    if any(event.sampling.block_s > 0.0 for event in telemetry):
        told = tuple(e for e in catalogue.effects if not e.kind.needs_quiet_rows)
        catalogue = replace(catalogue, effects=told)
    untold = untold_axes(telemetry)
    told = tuple(e for e in catalogue.effects if not turns_only_about(e, untold))
    left_out = [e.name for e in catalogue.effects if turns_only_about(e, untold)]
    return Events(
        priors,
        tuple(
            replace(event.with_columns(known.columns(event.thrusters)), delta_v=None)
            for event in telemetry
        ),
        tuple(rows),
        catalogue.of_these(told),
        (_not_weighed(left_out),) if left_out else (),
    )


def untold_axes(telemetry: Sequence[ReducedEvent]) -> frozenset[str]:
    """Axes about which no slew turns, where no other event's firings tell of them either."""
    if not telemetry or any(event.kind != "slew" and event.thrusters for event in telemetry):
        return frozenset()
    return frozenset(axes_at_rest(telemetry))


def turns_only_about(effect: Effect, axes: frozenset[str]) -> bool:
    """Whether an effect needs turns, and about none but these axes."""
    return effect.kind.needs_turns and effect.target != "" and axes.issuperset(effect.target)


def _not_weighed(causes: Sequence[str]) -> str:
    names = ", ".join(causes)
    return f"no event turns about an axis of {names}: not weighed, as noise alone can draw it"
