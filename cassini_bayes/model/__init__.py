"""The model of a fit: terms of telemetry events and totals rows, their sum, and draws of it all."""

from __future__ import annotations

from cassini_bayes.model.draws import Draws, draw, draw_prior, event_log_density
from cassini_bayes.model.event_reduction import ReducedEvent, reduce_event, reduce_samples
from cassini_bayes.model.observability import Observability, observability
from cassini_bayes.model.posterior import (
    Model,
    build_model,
    collapse,
    conditional_thrusts,
    log_likelihood,
    log_posterior,
)

__all__ = [
    "Draws",
    "Model",
    "Observability",
    "ReducedEvent",
    "build_model",
    "collapse",
    "conditional_thrusts",
    "draw",
    "draw_prior",
    "event_log_density",
    "log_likelihood",
    "log_posterior",
    "observability",
    "reduce_event",
    "reduce_samples",
]
