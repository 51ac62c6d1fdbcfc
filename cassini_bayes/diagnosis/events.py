"""Events that are diagnosed together: telemetry reduced with the effects' columns, totals rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from cassini_bayes.balance.statistics import (
    EventStatistics,
    ExtraColumn,
    Layout,
    Samples,
    Sampling,
    reduce_chunks,
)
from cassini_bayes.balance.statistics.columns import Carry, Rows, settle
from cassini_bayes.effects.catalogue import Catalogue, read_catalogue
from cassini_bayes.effects.effect import Effect
from cassini_bayes.effects.kinematics import RateInformation, combined, rate_information
from cassini_bayes.effects.registry import Kinds, standard
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.joint import sampling_of
from cassini_bayes.model.totals import TotalsModel, build_model
from cassini_bayes.priors.reader import Priors


@dataclass(frozen=True)
class TelemetrySource:
    """One event's telemetry, kept as rows: a diagnosis looks at it more than once."""

    id: str
    kind: str
    wheels: tuple[int, ...]
    thrusters: tuple[str, ...]
    samples: Samples

    @property
    def duration_s(self) -> float:
        """Time of the last row."""
        return float(self.samples.time_s[-1])


@dataclass(frozen=True)
class Events:
    """All that is diagnosed together, with the causes to weigh.

    ``statistics`` are of the ``sources``, ``totals`` is the model of the totals ``rows``. ``rates``
    is what attitudes say of the gyros.
    """

    priors: Priors
    sources: tuple[TelemetrySource, ...]
    statistics: tuple[tuple[EventStatistics, Sampling], ...]
    rows: tuple[TotalsEvent, ...]
    totals: TotalsModel | None
    rates: RateInformation
    catalogue: Catalogue

    @property
    def ids(self) -> tuple[str, ...]:
        """Of all events, totals rows first."""
        return (*(row.id for row in self.rows), *(source.id for source in self.sources))

    @cached_property
    def telemetry_rows(self) -> tuple[Rows, ...]:
        """Columns of every telemetry event's usable rows."""
        return tuple(
            settle(
                source.samples, Carry.start(reduced.layout), reduced.layout, sampling, final=True
            )[0]
            for source, (reduced, sampling) in zip(self.sources, self.statistics, strict=True)
        )

    def without(self, event: str) -> Events:
        """The events with one left out."""
        keep = [i for i, source in enumerate(self.sources) if source.id != event]
        rows = tuple(row for row in self.rows if row.id != event)
        return replace(
            self,
            sources=tuple(self.sources[i] for i in keep),
            statistics=tuple(self.statistics[i] for i in keep),
            rows=rows,
            totals=self.totals if rows == self.rows else build_model(rows, self.priors),
            rates=combined([rate_information(self.sources[i].samples) for i in keep]),
        )

    def with_columns_of(self, effects: Sequence[Effect]) -> Events:
        """The events with the columns that go with what searches settled for some effects."""
        settled = [effect.search_result for effect in effects if effect.search_result is not None]
        if not settled:
            return self
        statistics = tuple(
            reduce_source(
                source,
                self.priors,
                (
                    *self.catalogue.kinds.columns(source.thrusters),
                    *(column for result in settled for column in result.columns(source.samples)),
                ),
                sampling.pulse_shape.name,
            )
            for source, (_, sampling) in zip(self.sources, self.statistics, strict=True)
        )
        return replace(self, statistics=statistics)


def prepare(
    sources: Sequence[TelemetrySource],
    priors: Priors,
    rows: Sequence[TotalsEvent] = (),
    kinds: Kinds | None = None,
    pulse_shape: str = "first_order",
) -> Events:
    """Reduce telemetry with every column that an effect may need, and list the causes.

    ``kinds`` are the effects that there are; those of the package by default.
    """
    known = standard() if kinds is None else kinds
    totals = build_model(tuple(rows), priors) if rows else None
    used = {number for source in sources for number in source.wheels}
    used |= {number for row in rows for number in row.wheels}
    inputs = (*(("telemetry",) if sources else ()), *(("totals",) if rows else ()))
    return Events(
        priors,
        tuple(sources),
        tuple(
            reduce_source(source, priors, known.columns(source.thrusters), pulse_shape)
            for source in sources
        ),
        tuple(rows),
        totals,
        combined([rate_information(source.samples) for source in sources]),
        read_catalogue(priors, sorted(used), inputs, known),
    )


def reduce_source(
    source: TelemetrySource,
    priors: Priors,
    extra: Sequence[ExtraColumn],
    pulse_shape: str = "first_order",
) -> tuple[EventStatistics, Sampling]:
    """One event's Gram matrices with extra columns, which see the whole event at once."""
    plain = sampling_of(priors, source.thrusters, source.duration_s, pulse_shape)
    sampling = replace(plain, extra=tuple(extra))
    layout = Layout(
        source.wheels, source.thrusters, sampling.couples, tuple(column.name for column in extra)
    )
    statistics = reduce_chunks(
        source.id, source.kind, [source.samples], layout, sampling, len(source.samples)
    )
    return statistics, sampling
