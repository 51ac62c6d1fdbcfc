"""Events named on the command line, read for a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cassini_bayes.diagnosis.case import Log, silent
from cassini_bayes.diagnosis.estimate_case import EstimateCase, estimate_case
from cassini_bayes.diagnosis.estimates import estimates_of, is_estimates, read_estimates
from cassini_bayes.diagnosis.events import Events, prepare
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import (
    STRICT,
    Policy,
    content_of_totals,
    refuse_duplicates,
)
from cassini_bayes.events.telemetry import TelemetryEvent
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.event_reduction import (
    ReducedEvent,
    check_rows,
    is_event_folder,
    reduce_event,
)
from cassini_bayes.priors.reader import read_priors


def read_events(
    references: Sequence[str | TelemetryEvent],
    priors_path: Path,
    source: str = "flight",
    log: Log = silent,
    kinds: Kinds | None = None,
    policy: Policy = STRICT,
) -> Events:
    """Read event folders and totals rows.

    Parameters
    ----------
    references
        Event folders, events of telemetry, totals CSV files (all rows) or ``file.csv:ID``.
    priors_path
        The priors file.
    source
        Which rows of a totals CSV.
    log
        Told what was read.
    kinds
        The effects that there are; those of the package by default.
    policy
        Mistakes in the data that the user accepts.

    Raises
    ------
    InputError
        Bad data or priors, as when fitting.
    """
    priors = read_priors(priors_path)
    telemetry: list[ReducedEvent] = []
    rows: list[TotalsEvent] = []
    findings: list[str] = []
    contents: list[tuple[str, str]] = []
    for given in references:
        if isinstance(given, TelemetryEvent) or is_event_folder(Path(given)):
            reduced = reduce_event(given, priors, "first_order", policy=policy)
            telemetry.append(reduced)
            findings += reduced.reading.findings
            name = given.id if isinstance(given, TelemetryEvent) else str(Path(given))
            contents.append((name, reduced.reading.content))
        else:
            own = read_totals(given, priors.spacecraft, source)
            findings += check_rows(own, priors, given, policy)
            contents += [(f"{given}: {row.id}", content_of_totals(row)) for row in own]
            rows += own
    findings += refuse_duplicates(contents, policy)
    log(f"read {len(telemetry)} telemetry events and {len(rows)} totals rows")
    return replace(prepare(telemetry, priors, rows, kinds), findings=tuple(findings))


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
