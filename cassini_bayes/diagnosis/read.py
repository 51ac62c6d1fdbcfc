"""Events as a caller gives them, read for a diagnosis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.estimate_case import EstimateCase, estimate_case
from cassini_bayes.diagnosis.estimates import estimates_of, is_estimates, read_all_estimates
from cassini_bayes.diagnosis.events import Events, prepare
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import STRICT, Policy
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.gather import EventLike, gather
from cassini_bayes.priors.reader import Priors, read_priors


def read_events(
    references: Iterable[EventLike],
    priors: Path | Priors,
    source: str = "flight",
    log: Log = silent,
    kinds: Kinds | None = None,
    policy: Policy = STRICT,
    processes: int = 1,
) -> Events:
    """Read event folders and totals rows.

    Parameters
    ----------
    references
        Event folders, totals CSV files (all rows), ``file.csv:ID``, or events that were read.
    priors
        The priors, or their file.
    source
        Which rows of a totals CSV.
    log
        Told what was read.
    kinds
        The effects that there are; those of the package by default.
    policy
        Mistakes in the data that the user accepts.
    processes
        That read at the same time.

    Raises
    ------
    InputError
        Bad data or priors, as when fitting.
    """
    known = priors if isinstance(priors, Priors) else read_priors(priors)
    result, findings = gather(references, known, source=source, policy=policy, processes=processes)
    telemetry = [event for event in result if isinstance(event, ReducedEvent)]
    rows = [event for event in result if isinstance(event, TotalsEvent)]
    log(f"read; telemetry events: {len(telemetry)}, totals rows: {len(rows)}")
    events = prepare(telemetry, known, rows, kinds)
    return replace(events, findings=(*findings, *events.findings))


def read_estimate_case(
    references: Sequence[str], priors_path: Path, kinds: Kinds | None = None
) -> EstimateCase:
    """Read CSV files of printed thrusts, which are diagnosed on their own.

    Raises
    ------
    InputError
        Another input among them, bad data or priors, or files that do not go together.
    """
    other = [reference for reference in references if not is_estimates(Path(reference))]
    if other:
        raise InputError(other[0], "estimates alone", "another input", "diagnose it on its own")
    priors = read_priors(priors_path)
    thrusters = priors.spacecraft.thruster_names(priors.branch)
    rows = read_all_estimates([Path(reference) for reference in references], thrusters)
    return estimate_case(estimates_of(rows, priors), priors, kinds)
