"""Bayesian posteriors of spacecraft thrust and inertia from attitude telemetry, with emcee.

The whole job in a few names, loaded when first used::

    import cassini_bayes as cb

    priors = cb.read_priors("priors/cassini_b_branch_2010.toml")
    events = cb.read_totals("flight.csv", priors.spacecraft)
    model = cb.build_model(events, priors)
    sampled = cb.fit_model(model, cb.SamplerSettings(seed=1))
    cb.summarise(sampled.fit)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cassini_bayes.errors import CassiniBayesError, InputError
    from cassini_bayes.events.telemetry import TelemetryEvent, event_from_frame, read_event
    from cassini_bayes.events.totals import TotalsEvent, read_totals, write_totals
    from cassini_bayes.model import Model, ReducedEvent, build_model, reduce_event
    from cassini_bayes.priors.reader import Priors, read_priors
    from cassini_bayes.report import figures_of, sections_of
    from cassini_bayes.results.baselines import perturbation_bars
    from cassini_bayes.results.fitting import Sampled, convergence_table, fit_model
    from cassini_bayes.results.record import Fit, read_fit, save_fit
    from cassini_bayes.results.review import Review
    from cassini_bayes.results.sensitivity import error_budget
    from cassini_bayes.results.tables import nuisance_table, summarise
    from cassini_bayes.sampling.ensembles import SamplerSettings
    from cassini_bayes.spacecraft import Spacecraft, load_spacecraft

__version__ = "0.1.0"

_HOMES = {
    "errors": ("CassiniBayesError", "InputError"),
    "events.telemetry": ("TelemetryEvent", "event_from_frame", "read_event"),
    "events.totals": ("TotalsEvent", "read_totals", "write_totals"),
    "model": ("Model", "ReducedEvent", "build_model", "reduce_event"),
    "priors.reader": ("Priors", "read_priors"),
    "report": ("figures_of", "sections_of"),
    "results.baselines": ("perturbation_bars",),
    "results.fitting": ("Sampled", "convergence_table", "fit_model"),
    "results.record": ("Fit", "read_fit", "save_fit"),
    "results.review": ("Review",),
    "results.sensitivity": ("error_budget",),
    "results.tables": ("nuisance_table", "summarise"),
    "sampling.ensembles": ("SamplerSettings",),
    "spacecraft": ("Spacecraft", "load_spacecraft"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "CassiniBayesError",
    "Fit",
    "InputError",
    "Model",
    "Priors",
    "ReducedEvent",
    "Review",
    "Sampled",
    "SamplerSettings",
    "Spacecraft",
    "TelemetryEvent",
    "TotalsEvent",
    "build_model",
    "convergence_table",
    "error_budget",
    "event_from_frame",
    "figures_of",
    "fit_model",
    "load_spacecraft",
    "nuisance_table",
    "perturbation_bars",
    "read_event",
    "read_fit",
    "read_priors",
    "read_totals",
    "reduce_event",
    "save_fit",
    "sections_of",
    "summarise",
    "write_totals",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module the first time it is asked for."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
