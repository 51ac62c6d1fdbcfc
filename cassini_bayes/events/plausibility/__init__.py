"""Mistakes of units, signs and orders that no single cell of telemetry shows."""

from __future__ import annotations

from cassini_bayes.events.plausibility.cells import CellSearch, without_cells
from cassini_bayes.events.plausibility.check import (
    Plausibility,
    TelemetryCheck,
    check_telemetry,
)
from cassini_bayes.events.plausibility.departures import Nominal
from cassini_bayes.events.plausibility.duplicates import (
    content_of_totals,
    refuse_duplicates,
)
from cassini_bayes.events.plausibility.totals import check_totals
from cassini_bayes.events.plausibility.verdict import MISTAKES, STRICT, MistakeError, Policy

__all__ = [
    "MISTAKES",
    "STRICT",
    "CellSearch",
    "MistakeError",
    "Nominal",
    "Plausibility",
    "Policy",
    "TelemetryCheck",
    "check_telemetry",
    "check_totals",
    "content_of_totals",
    "refuse_duplicates",
    "without_cells",
]
