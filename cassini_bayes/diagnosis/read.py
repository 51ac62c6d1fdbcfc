"""Events named on the command line, read for a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from cassini_bayes.balance.statistics import Samples
from cassini_bayes.diagnosis.extended import Case, TelemetrySource, prepare
from cassini_bayes.events.plausibility import check_momentum, momentum_rows
from cassini_bayes.events.telemetry import read_chunks, read_event
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.event_reduction import (
    is_event_folder,
    nominal_values,
    require_branch,
    samples_of,
)
from cassini_bayes.priors.reader import Priors, read_priors


def read_case(
    references: Sequence[str],
    priors_path: Path,
    source: str = "flight",
    say: Callable[[str], None] | None = None,
) -> Case:
    """Read event folders and totals rows.

    Parameters
    ----------
    references
        Event folders, totals CSV files (all rows) or ``file.csv:ID``.
    priors_path
        The priors file.
    source
        Which rows of a totals CSV.
    say
        Told what was read.

    Raises
    ------
    InputError
        Bad data or priors, as when fitting.
    """
    priors = read_priors(priors_path)
    folders = [Path(reference) for reference in references if is_event_folder(Path(reference))]
    sources = [read_source(folder, priors) for folder in folders]
    rows = totals_rows(references, priors, source)
    if say is not None:
        say(f"read {len(sources)} telemetry events and {len(rows)} totals rows")
    return prepare(sources, priors, rows)


def totals_rows(
    references: Sequence[str], priors: Priors, source: str = "flight"
) -> tuple[TotalsEvent, ...]:
    """Totals rows among the references, in order, as :func:`read_case` has them."""
    tables = [reference for reference in references if not is_event_folder(Path(reference))]
    return tuple(row for table in tables for row in read_totals(table, priors.spacecraft, source))


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
