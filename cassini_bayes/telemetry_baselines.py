"""The papers' least squares on telemetry, beside which the posterior stands."""

from __future__ import annotations

import pandas as pd

from cassini_bayes.event_reduction import ReducedEvent
from cassini_bayes.joint import JointModel


def inertia_methods(model: JointModel, events: tuple[ReducedEvent, ...]) -> pd.DataFrame:
    """to come"""
    return pd.DataFrame()


def thrust_methods(model: JointModel, events: tuple[ReducedEvent, ...]) -> pd.DataFrame:
    """to come"""
    return pd.DataFrame()
