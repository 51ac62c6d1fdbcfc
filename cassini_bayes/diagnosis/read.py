"""Events named on the command line, read for a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cassini_bayes.balance.statistics import Samples
from cassini_bayes.diagnosis.case import Log, silent
from cassini_bayes.diagnosis.estimate_case import EstimateCase, estimate_case
from cassini_bayes.diagnosis.estimates import estimates_of, is_estimates, read_estimates
from cassini_bayes.diagnosis.events import Events, TelemetrySource, prepare
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import check_momentum, momentum_rows
from cassini_bayes.events.telemetry import read_chunks, read_event
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.event_reduction import (
    ReducedEvent,
    is_event_folder,
    nominal_values,
    reduce_event,
    require_branch,
    samples_of,
)
from cassini_bayes.priors.reader import Priors, read_priors


def read_events(
    references: Sequence[str],
    priors_path: Path,
    source: str = "flight",
    log: Log = silent,
    kinds: Kinds | None = None,
) -> Events:
    """Read event folders and totals rows.

    Parameters
    ----------
    references
        Event folders, totals CSV files (all rows) or ``file.csv:ID``.
    priors_path
        The priors file.
    source
        Which rows of a totals CSV.
    log
        Told what was read.
    kinds
        The effects that there are; those of the package by default.

    Raises
    ------
    InputError
        Bad data or priors, as when fitting.
    """
    priors = read_priors(priors_path)
    folders = [Path(reference) for reference in references if is_event_folder(Path(reference))]
    sources = [read_source(folder, priors) for folder in folders]
    rows = totals_rows(references, priors, source)
    log(f"read {len(sources)} telemetry events and {len(rows)} totals rows")
    return prepare(sources, priors, rows, kinds)


def read_estimate_case(
    references: Sequence[str], priors_path: Path, kinds: Kinds | None = None
) -> EstimateCase:
    """Read CSV files of printed thrusts, which are diagnosed on their own.

    Raises
    ------
    InputError
        Another input among them, or bad data or priors.
    """
    other = [reference for reference in references if not is_estimates(Path(reference))]
    if other:
        raise InputError(other[0], "estimates alone", "another input", "diagnose it on its own")
    priors = read_priors(priors_path)
    thrusters = priors.spacecraft.thruster_names(priors.branch)
    rows = [row for reference in references for row in read_estimates(Path(reference), thrusters)]
    return estimate_case(estimates_of(rows, priors), priors, kinds)


def totals_rows(
    references: Sequence[str], priors: Priors, source: str = "flight"
) -> tuple[TotalsEvent, ...]:
    """Totals rows among the references, in order, as :func:`read_events` has them."""
    tables = [reference for reference in references if not is_event_folder(Path(reference))]
    return tuple(row for table in tables for row in read_totals(table, priors.spacecraft, source))


def reduced_events(references: Sequence[str], priors: Priors) -> list[ReducedEvent]:
    """Records of the event folders among the references, in order, as a fit has them."""
    folders = [Path(reference) for reference in references if is_event_folder(Path(reference))]
    return [reduce_event(folder, priors, "first_order") for folder in folders]


def read_source(folder: Path, priors: Priors) -> TelemetrySource:
    """One event folder as rows, checked as for a fit; a diagnosis keeps them in memory."""
    event = read_event(folder, priors.spacecraft)
    require_branch(event, priors)
    nominal = nominal_values(priors)
    momentum, samples = momentum_rows(nominal), []
    for chunk in read_chunks(event, priors.spacecraft):
        momentum.add(chunk)
        samples.append(samples_of(chunk))
    check_momentum(event, momentum, priors.spacecraft, nominal)
    return TelemetrySource(
        event.id, event.kind, event.wheels, event.thrusters, Samples.joined(samples)
    )
