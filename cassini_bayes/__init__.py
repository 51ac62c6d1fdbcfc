"""Bayesian posteriors of spacecraft thrust and inertia from attitude telemetry, with emcee.

The whole job in a few verbs, loaded when first used; each takes paths or objects::

    import cassini_bayes as cb

    events, priors = "flight.csv", "priors/cassini_b_branch_2010.toml"
    cb.check(events, priors)  # what is known before sampling
    fit = cb.fit(events, priors, seed=1)
    fit.summary("thrust_level_n")
    fit.plot_corner()
    cb.diagnose(events, priors)  # what the simulation gets wrong
    cb.predict(fit, "rwa1: -1118 -> 626, rwa2: 1290 -> 1300, rwa4: 330 -> -729")

docs/reference/api.md has an example of each.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cassini_bayes.errors import CassiniBayesError, InputError
    from cassini_bayes.events.telemetry import TelemetryEvent, event_from_frame, read_event
    from cassini_bayes.events.totals import TotalsEvent, read_totals, write_totals
    from cassini_bayes.model import Model, ReducedEvent, reduce_event
    from cassini_bayes.pipeline.by_file import sweep, trend
    from cassini_bayes.pipeline.checks import check
    from cassini_bayes.pipeline.diagnoses import diagnose
    from cassini_bayes.pipeline.fits import fit, read_fit, report
    from cassini_bayes.pipeline.listings import causes, parameters, quantities
    from cassini_bayes.pipeline.models import build_model
    from cassini_bayes.pipeline.predictions import plan, predict
    from cassini_bayes.priors.reader import Priors, read_priors
    from cassini_bayes.report import figures_of, sections_of
    from cassini_bayes.results.baselines import perturbation_bars
    from cassini_bayes.results.fitting import Sampled, convergence_table, fit_model
    from cassini_bayes.results.record import Fit, save_fit
    from cassini_bayes.results.review import Review
    from cassini_bayes.results.sensitivity import error_budget
    from cassini_bayes.results.tables import nuisance_table, summarise
    from cassini_bayes.sampling.ensembles import SamplerSettings
    from cassini_bayes.spacecraft import Spacecraft, load_spacecraft
    from cassini_bayes.studies.flight import simulate

__version__ = "0.1.0"

_VERBS = {
    "events.telemetry": ("event_from_frame", "read_event"),
    "events.totals": ("read_totals",),
    "pipeline.by_file": ("sweep", "trend"),
    "pipeline.checks": ("check",),
    "pipeline.diagnoses": ("diagnose",),
    "pipeline.fits": ("fit", "read_fit", "report"),
    "pipeline.listings": ("causes", "parameters", "quantities"),
    "pipeline.models": ("build_model",),
    "pipeline.predictions": ("plan", "predict"),
    "priors.reader": ("read_priors",),
    "studies.flight": ("simulate",),
}
_PARTS = {
    "errors": ("CassiniBayesError", "InputError"),
    "events.telemetry": ("TelemetryEvent",),
    "events.totals": ("TotalsEvent", "write_totals"),
    "model": ("Model", "ReducedEvent", "reduce_event"),
    "priors.reader": ("Priors",),
    "report": ("figures_of", "sections_of"),
    "results.baselines": ("perturbation_bars",),
    "results.fitting": ("Sampled", "convergence_table", "fit_model"),
    "results.record": ("Fit", "save_fit"),
    "results.review": ("Review",),
    "results.sensitivity": ("error_budget",),
    "results.tables": ("nuisance_table", "summarise"),
    "sampling.ensembles": ("SamplerSettings",),
    "spacecraft": ("Spacecraft", "load_spacecraft"),
}
_HOME_OF = {
    name: home for homes in (_VERBS, _PARTS) for home, names in homes.items() for name in names
}

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
    "causes",
    "check",
    "convergence_table",
    "diagnose",
    "error_budget",
    "event_from_frame",
    "figures_of",
    "fit",
    "fit_model",
    "load_spacecraft",
    "nuisance_table",
    "parameters",
    "perturbation_bars",
    "plan",
    "predict",
    "quantities",
    "read_event",
    "read_fit",
    "read_priors",
    "read_totals",
    "reduce_event",
    "report",
    "save_fit",
    "sections_of",
    "simulate",
    "summarise",
    "sweep",
    "trend",
    "write_totals",
]


def _load(name: str) -> Any:
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)


def __getattr__(name: str) -> Any:
    """Load a public name from its module the first time it is asked for."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _load(name)


def __dir__() -> list[str]:
    """The public names, whether they are loaded yet or not."""
    return [*__all__, "__version__"]


class _PartAndVerb(ModuleType):
    """A part of the package that shares its name with a verb: ``report``, ``sweep``.

    Importing a part sets its name on the package, which would hide the verb: so the part can be
    called as the verb.
    """

    @property
    def __wrapped__(self) -> Any:
        """The verb, whose signature and help are shown."""
        return _load(self.__name__.rpartition(".")[2])

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return self.__wrapped__(*arguments, **options)


class _Face(ModuleType):
    """The package, which lets no part hide a verb of its name."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _HOME_OF and isinstance(value, ModuleType):
            value.__class__ = _PartAndVerb
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face
