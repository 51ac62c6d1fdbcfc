"""Telemetry reduced to sufficient statistics: rows that may be used, columns, Gram matrices."""

from __future__ import annotations

from cassini_bayes.balance.statistics.archive import load_statistics, save_statistics
from cassini_bayes.balance.statistics.columns import Carry, settle
from cassini_bayes.balance.statistics.event_statistics import EventStatistics
from cassini_bayes.balance.statistics.layout import Layout, layout_of
from cassini_bayes.balance.statistics.preparation import BLOCK_S
from cassini_bayes.balance.statistics.reduction import reduce_chunks
from cassini_bayes.balance.statistics.rows import Samples
from cassini_bayes.balance.statistics.sampling import ExtraColumn, RowContext, Sampling

__all__ = [
    "BLOCK_S",
    "Carry",
    "EventStatistics",
    "ExtraColumn",
    "Layout",
    "RowContext",
    "Samples",
    "Sampling",
    "layout_of",
    "load_statistics",
    "reduce_chunks",
    "save_statistics",
    "settle",
]
