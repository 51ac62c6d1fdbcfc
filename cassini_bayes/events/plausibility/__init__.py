"""Mistakes of units, signs and orders that no single cell of telemetry shows."""

from __future__ import annotations

from cassini_bayes.events.plausibility.balance import Balance, check_momentum, momentum_rows
from cassini_bayes.events.plausibility.rows import MomentumRows

__all__ = ["Balance", "MomentumRows", "check_momentum", "momentum_rows"]
