"""Events named on the command line, read for a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cassini_bayes.diagnosis.case import Log, silent
from cassini_bayes.diagnosis.estimate_case import EstimateCase, estimate_case
from cassini_bayes.diagnosis.estimates import estimates_of, is_estimates, read_estimates
from cassini_bayes.diagnosis.events import Events, prepare
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import read_totals
from cassini_bayes.model.event_reduction import is_event_folder, reduce_event
from cassini_bayes.priors.reader import read_priors


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
    telemetry = [reduce_event(folder, priors, "first_order") for folder in folders]
    tables = [reference for reference in references if not is_event_folder(Path(reference))]
    rows = [row for table in tables for row in read_totals(table, priors.spacecraft, source)]
    log(f"read {len(telemetry)} telemetry events and {len(rows)} totals rows")
    return prepare(telemetry, priors, rows, kinds)


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
